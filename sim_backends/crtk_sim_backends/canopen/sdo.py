"""SDO server: expedited, segmented and block transfer (CiA 301, section 7.2.4).

A block transfer has a CRC when the client asks for it; the server says that it has one only then,
because there are clients that take its word for it whatever they asked for.
"""

from __future__ import annotations

import binascii
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

from crtk_sim_backends.canopen.aborts import Abort, SdoAbort
from crtk_sim_backends.canopen.dictionary import LONGEST_DOMAIN, Key, ObjectDictionary

LONGEST_BLOCK: Final = 127  # segments
TIMEOUT: Final = 1.0  # s without a frame of the client that end a transfer

_ABORT: Final = 4
_SEGMENT: Final = 7  # bytes of data in a segment


@dataclass
class _Download:
    """Segmented download under way."""

    key: Key
    size: int | None
    data: bytearray = field(default_factory=bytearray)
    toggle: int = 0


@dataclass
class _Upload:
    """Segmented upload under way."""

    key: Key
    data: bytes
    position: int = 0
    toggle: int = 0


@dataclass
class _BlockDownload:
    """Block download under way: segments, then `ended` when the last one is in."""

    key: Key
    size: int | None
    crc: bool
    block: int
    data: bytearray = field(default_factory=bytearray)
    sequence: int = 0  # of the last segment received in order
    ended: bool = False


@dataclass
class _BlockUpload:
    """Block upload under way; `position` is what the client has confirmed."""

    key: Key
    data: bytes
    block: int
    crc: bool
    position: int = 0
    sent: int = 0  # segments in the block under way
    started: bool = False
    finished: bool = False  # all confirmed, waits for the last word of the client


_Transfer = _Download | _Upload | _BlockDownload | _BlockUpload


class SdoServer:
    """The default SDO server of a node: request in, answers out.

    Args:
        dictionary: what is read and written.
        block: segments in a block that the server asks for, 1..127; 0 for no block transfer.
        refuse: called with the key and "read" or "write" before an access; raises
            :class:`SdoAbort` to refuse it (fault injection).
    """

    def __init__(
        self,
        dictionary: ObjectDictionary,
        block: int = LONGEST_BLOCK,
        refuse: Callable[[Key, str], None] | None = None,
    ) -> None:
        self._dictionary = dictionary
        self._block = block
        self._refuse = refuse
        self._transfer: _Transfer | None = None
        self._last = 0.0
        self._commands: dict[int, Callable[[bytes], list[bytes]]] = {
            0: self._download_segment,
            1: self._download,
            2: self._upload,
            3: self._upload_segment,
        }
        if block:
            self._commands |= {5: self._block_upload, 6: self._block_download}

    def reset(self) -> None:
        """Forget the transfer under way."""
        self._transfer = None

    @property
    def deadline(self) -> float | None:
        """When the transfer under way times out, None without one."""
        return None if self._transfer is None else self._last + TIMEOUT

    def expire(self, now: float) -> list[bytes]:
        """Abort the transfer under way when the client has said nothing for too long."""
        if self._transfer is None or now < self._last + TIMEOUT:
            return []
        return [self._abort(self._transfer.key, Abort.TIMEOUT)]

    def on_request(self, data: bytes, now: float) -> list[bytes]:
        """Handle one frame of the client and return the frames that answer it, 8 bytes each.

        A frame that has not 8 bytes is no SDO and has no answer.
        """
        if len(data) != 8:
            return []
        self._last = now
        command = data[0] >> 5
        if data[0] == 0x80 or (command == _ABORT and not self._in_block_download):
            self._transfer = None
            return []
        transfer = self._transfer
        try:
            if isinstance(transfer, _BlockDownload) and not transfer.ended:
                return self._block_segment(transfer, data)
            handler = self._commands.get(command)
            if handler is None:
                raise SdoAbort(Abort.COMMAND)
            return handler(data)
        except SdoAbort as refusal:
            begins = command in (1, 2) or (command in (5, 6) and not data[0] & 1)
            key = _key(data) if begins or transfer is None else transfer.key
            return [self._abort(key, refusal.code)]

    @property
    def _in_block_download(self) -> bool:
        return isinstance(self._transfer, _BlockDownload) and not self._transfer.ended

    def _abort(self, key: Key, code: int) -> bytes:
        self._transfer = None
        return struct.pack("<BHBI", 0x80, *key, code)

    def _read(self, key: Key) -> bytes:
        if self._refuse:
            self._refuse(key, "read")
        return self._dictionary.read(*key)

    def _check_write(self, key: Key, size: int | None) -> None:
        if self._refuse:
            self._refuse(key, "write")
        self._dictionary.check_writable(*key, size)

    # Expedited and segmented download

    def _download(self, data: bytes) -> list[bytes]:
        self._transfer = None
        key = _key(data)
        expedited, sized = data[0] & 2, data[0] & 1
        if expedited:
            size = 4 - (data[0] >> 2 & 3) if sized else self._natural_size(key)
            self._check_write(key, size)
            self._dictionary.write(*key, data[4 : 4 + size])
        else:
            size_or_none = struct.unpack_from("<I", data, 4)[0] if sized else None
            self._check_write(key, size_or_none)
            self._transfer = _Download(key, size_or_none)
        return [struct.pack("<BHB4x", 0x60, *key)]

    def _natural_size(self, key: Key) -> int:
        """Size of an entry for an expedited download that does not tell it."""
        return min(4, self._dictionary.variable(*key).type.size or 4)

    def _download_segment(self, data: bytes) -> list[bytes]:
        transfer = self._transfer
        if not isinstance(transfer, _Download):
            raise SdoAbort(Abort.COMMAND)
        toggle = data[0] >> 4 & 1
        if toggle != transfer.toggle:
            raise SdoAbort(Abort.TOGGLE)
        transfer.toggle ^= 1
        transfer.data += data[1 : 8 - (data[0] >> 1 & 7)]
        _check_length(transfer.data, transfer.size, last=bool(data[0] & 1))
        if data[0] & 1:
            self._transfer = None
            try:
                self._dictionary.write(*transfer.key, bytes(transfer.data))
            except SdoAbort as refusal:
                return [self._abort(transfer.key, refusal.code)]
        return [bytes((0x20 | toggle << 4,)) + bytes(7)]

    # Expedited and segmented upload

    def _upload(self, data: bytes) -> list[bytes]:
        self._transfer = None
        return [self._begin_upload(_key(data))]

    def _begin_upload(self, key: Key, value: bytes | None = None) -> bytes:
        value = self._read(key) if value is None else value
        if 1 <= len(value) <= 4:
            head = struct.pack("<BHB", 0x43 | (4 - len(value)) << 2, *key)
            return head + value.ljust(4, b"\0")
        self._transfer = _Upload(key, value)
        return struct.pack("<BHBI", 0x41, *key, len(value))

    def _upload_segment(self, data: bytes) -> list[bytes]:
        transfer = self._transfer
        if not isinstance(transfer, _Upload):
            raise SdoAbort(Abort.COMMAND)
        toggle = data[0] >> 4 & 1
        if toggle != transfer.toggle:
            raise SdoAbort(Abort.TOGGLE)
        transfer.toggle ^= 1
        piece = transfer.data[transfer.position : transfer.position + _SEGMENT]
        transfer.position += len(piece)
        last = transfer.position >= len(transfer.data)
        if last:
            self._transfer = None
        head = toggle << 4 | (_SEGMENT - len(piece)) << 1 | last
        return [bytes((head,)) + piece.ljust(_SEGMENT, b"\0")]

    # Block download

    def _block_download(self, data: bytes) -> list[bytes]:
        if data[0] & 1:
            return self._end_block_download(data)
        self._transfer = None
        key = _key(data)
        size = struct.unpack_from("<I", data, 4)[0] if data[0] & 2 else None
        self._check_write(key, size)
        self._transfer = _BlockDownload(key, size, bool(data[0] & 4), self._block)
        return [struct.pack("<BHBB3x", 0xA0 | data[0] & 4, *key, self._block)]

    def _block_segment(self, transfer: _BlockDownload, data: bytes) -> list[bytes]:
        sequence, last = data[0] & 0x7F, data[0] >> 7
        if not 1 <= sequence <= transfer.block:
            raise SdoAbort(Abort.SEQUENCE)
        if sequence == transfer.sequence + 1:  # after a lost one there is none
            transfer.sequence = sequence
            transfer.data += data[1:]
            transfer.ended = bool(last)
            if len(transfer.data) > LONGEST_DOMAIN + _SEGMENT:
                raise SdoAbort(Abort.MEMORY)
        if not last and sequence != transfer.block:
            return []
        confirmed, transfer.sequence = transfer.sequence, 0
        return [bytes((0xA2, confirmed, transfer.block)) + bytes(5)]

    def _end_block_download(self, data: bytes) -> list[bytes]:
        transfer = self._transfer
        if not isinstance(transfer, _BlockDownload):
            raise SdoAbort(Abort.COMMAND)
        unused = data[0] >> 2 & 7
        content = bytes(transfer.data[: len(transfer.data) - unused])
        _check_length(content, transfer.size, last=True)
        if transfer.crc and binascii.crc_hqx(content, 0) != struct.unpack_from("<H", data, 1)[0]:
            raise SdoAbort(Abort.CRC)
        self._dictionary.write(*transfer.key, content)
        self._transfer = None
        return [bytes((0xA1,)) + bytes(7)]

    # Block upload

    def _block_upload(self, data: bytes) -> list[bytes]:
        command = data[0] & 3
        if command == 0:
            return self._begin_block_upload(data)
        transfer = self._transfer
        if not isinstance(transfer, _BlockUpload):
            raise SdoAbort(Abort.COMMAND)
        if command == 3 and not transfer.started:
            transfer.started = True
            return self._send_block(transfer)
        if command == 2 and transfer.started and not transfer.finished:
            return self._confirm_block(transfer, confirmed=data[1], block=data[2])
        if command == 1 and transfer.finished:
            self._transfer = None
            return []
        raise SdoAbort(Abort.COMMAND)

    def _begin_block_upload(self, data: bytes) -> list[bytes]:
        self._transfer = None
        key, block, switch = _key(data), data[4], data[5]
        if not 1 <= block <= LONGEST_BLOCK:
            raise SdoAbort(Abort.BLOCK_SIZE)
        value = self._read(key)
        if len(value) <= switch:
            return [self._begin_upload(key, value)]
        self._transfer = _BlockUpload(key, value, block, crc=bool(data[0] & 4))
        return [struct.pack("<BHBI", 0xC2 | data[0] & 4, *key, len(value))]

    def _send_block(self, transfer: _BlockUpload) -> list[bytes]:
        rest = transfer.data[transfer.position : transfer.position + _SEGMENT * transfer.block]
        pieces = [rest[start : start + _SEGMENT] for start in range(0, max(1, len(rest)), _SEGMENT)]
        ends = transfer.position + len(rest) >= len(transfer.data)
        transfer.sent = len(pieces)
        return [
            bytes((number | (0x80 if ends and number == len(pieces) else 0),))
            + piece.ljust(_SEGMENT, b"\0")
            for number, piece in enumerate(pieces, 1)
        ]

    def _confirm_block(self, transfer: _BlockUpload, confirmed: int, block: int) -> list[bytes]:
        if confirmed > transfer.sent:
            raise SdoAbort(Abort.SEQUENCE)
        if not 1 <= block <= LONGEST_BLOCK:
            raise SdoAbort(Abort.BLOCK_SIZE)
        transfer.block = block
        reached = transfer.position + _SEGMENT * confirmed
        transfer.position = min(len(transfer.data), reached)
        if reached < len(transfer.data) or not confirmed:
            return self._send_block(transfer)
        transfer.finished = True
        unused = -len(transfer.data) % _SEGMENT if transfer.data else _SEGMENT
        crc = binascii.crc_hqx(transfer.data, 0) if transfer.crc else 0
        return [struct.pack("<BH5x", 0xC1 | unused << 2, crc)]


def _key(data: bytes) -> Key:
    index, sub = struct.unpack_from("<HB", data, 1)
    return index, sub


def _check_length(data: bytes | bytearray, size: int | None, *, last: bool) -> None:
    """Compare what has come with what was announced.

    Raises:
        SdoAbort: TOO_LONG, TOO_SHORT or MEMORY.
    """
    if size is not None and len(data) > size:
        raise SdoAbort(Abort.TOO_LONG)
    if size is not None and last and len(data) < size:
        raise SdoAbort(Abort.TOO_SHORT)
    if len(data) > LONGEST_DOMAIN:
        raise SdoAbort(Abort.MEMORY)

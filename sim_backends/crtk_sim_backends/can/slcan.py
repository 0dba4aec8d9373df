"""An slcan (Lawicel CAN232) adapter on a pty: ASCII commands that end with a carriage return.

``t1232AABB`` sends a frame (``T`` extended, ``r`` and ``R`` remote), ``S6`` sets the bit rate, ``O``
opens the channel, ``L`` opens it to listen only, ``C`` closes it, ``F`` reads the status flags,
``V`` the version, ``N`` the serial number, ``Z1`` turns time stamps on. The answer is a carriage
return (``z`` or ``Z`` before it for a frame), or BEL when the command is refused.
Source: CAN232 manual V3, Lawicel AB.
"""

from __future__ import annotations

import contextlib
import logging
import os
import pty
import re
import time
import tty
from collections.abc import Callable, Mapping
from typing import Final

from crtk_sim_backends.can import frames
from crtk_sim_backends.can.node import Bus
from crtk_sim_backends.can.port import State
from crtk_sim_backends.kit.loop import READ, WRITE
from crtk_sim_backends.process import SimStartError

BITRATES: Final[Mapping[str, int]] = {
    "0": 10_000,
    "1": 20_000,
    "2": 50_000,
    "3": 100_000,
    "4": 125_000,
    "5": 250_000,
    "6": 500_000,
    "7": 800_000,  # python-can takes it for 750000
    "8": 1_000_000,
}
"""Bit rates by the digit of the command S."""

OK: Final = b"\r"
REFUSED: Final = b"\a"

_LONGEST: Final = 40  # bytes of an unfinished command; beyond, they are no command
_READ_SIZE: Final = 4096
_FRAME: Final = re.compile(
    r"(?:(?P<kind>[tr])(?P<id>[0-7][0-9A-Fa-f]{2})|(?P<kind8>[TR])(?P<id8>[01][0-9A-Fa-f]{7}))"
    r"(?P<length>[0-8])(?P<data>(?:[0-9A-Fa-f]{2})*)"
)
_STAMP_PERIOD: Final = 60_000  # ms

_FLAG_TRANSMIT_FULL: Final = 0x02
_FLAG_PASSIVE: Final = 0x20
_FLAG_BUS_ERROR: Final = 0x80

log = logging.getLogger(__name__)


def frame_command(raw: bytes, stamp: int | None = None) -> bytes:
    """Line for a received frame, empty for an error frame; `stamp` in ms of the minute."""
    can_id, data = frames.unpack(raw)
    if can_id & frames.ERROR:
        return b""
    remote = bool(can_id & frames.REMOTE)
    if can_id & frames.EXTENDED:
        head = f"{'R' if remote else 'T'}{can_id & frames.EXTENDED_MASK:08X}{len(data)}"
    else:
        head = f"{'r' if remote else 't'}{can_id & frames.STANDARD_MASK:03X}{len(data)}"
    body = "" if remote else data.hex().upper()
    tail = "" if stamp is None else f"{stamp:04X}"
    return f"{head}{body}{tail}\r".encode()


def parse_frame(line: str) -> bytes | None:
    """Frame of a command t, T, r or R; None when it is none."""
    match = _FRAME.fullmatch(line)
    if match is None:
        return None
    length, data = int(match["length"]), bytes.fromhex(match["data"])
    kind = match["kind"] or match["kind8"]
    can_id = int(match["id"] or match["id8"], 16) | (frames.EXTENDED if kind in "TR" else 0)
    if kind in "rR":
        return None if data else frames.pack(can_id | frames.REMOTE, b"", length)
    return frames.pack(can_id, data) if len(data) == length else None


class SlcanDoor:
    """One adapter; `tty` is the terminal that a client opens.

    Args:
        hub: the bus.
        link: path of a symbolic link to make to the terminal; none when empty.
    """

    def __init__(self, hub: Bus, link: str = "") -> None:
        self._hub = hub
        self._link = ""
        self._input = bytearray()
        self._output = bytearray()  # what the terminal has not taken
        self._listen_only = False
        self._stamps = False
        self.bitrate: int | None = None  # that the client has set
        self._handlers: Mapping[str, Callable[[str], bytes]] = {
            **dict.fromkeys("tTrR", self._transmit),
            "S": self._set_bitrate,
            "s": self._set_registers,
            "O": self._open_channel,
            "L": self._open_channel,
            "C": self._close_channel,
            "F": self._flags,
            "Z": self._set_stamps,
            "V": lambda line: b"V1013\r",
            "N": lambda line: b"NA123\r",
        }
        try:
            self._fd, self._terminal = pty.openpty()  # held open: no hang-up between two clients
        except OSError as error:
            raise SimStartError(f"no pty for slcan: {error.strerror}") from error
        self.tty = os.ttyname(self._terminal)
        try:
            tty.setraw(self._terminal)
            os.set_blocking(self._fd, False)
            if link:
                self._make_link(link)
        except BaseException:
            os.close(self._fd)
            os.close(self._terminal)
            raise
        self.node = hub.add("slcan", self)
        self.node.listening = False
        hub.loop.watch(self._fd, self._ready)

    def _make_link(self, link: str) -> None:
        try:
            if os.path.islink(link):
                os.unlink(link)
            os.symlink(self.tty, link)
        except OSError as error:
            raise SimStartError(
                f"cannot make the link {link} to the slcan terminal: {error.strerror}"
            ) from error
        self._link = link

    def _ready(self, events: int) -> None:
        if events & WRITE:
            self._flush()
        if events & READ:
            try:
                data = os.read(self._fd, _READ_SIZE)
            except BlockingIOError:
                return
            self._receive(data)

    def _receive(self, data: bytes) -> None:
        self._input += data
        while (end := self._input.find(b"\r")) >= 0:
            line = bytes(self._input[:end])
            del self._input[: end + 1]
            self._answer(self._obey(line.decode("ascii", "replace").strip("\n")))
        if len(self._input) > _LONGEST:
            self.node.counters.invalid += 1
            self._input.clear()
            self._answer(REFUSED)

    def _obey(self, line: str) -> bytes:
        """Do what a line asks for, and return the answer."""
        if not line:
            return OK
        handler = self._handlers.get(line[0])
        answer = REFUSED if handler is None else handler(line)
        if answer == REFUSED:
            self.node.counters.invalid += 1
        return answer

    @property
    def _is_open(self) -> bool:
        return self.node.listening

    def _transmit(self, line: str) -> bytes:
        raw = parse_frame(line)
        if raw is None or not self._is_open or self._listen_only:
            return REFUSED
        if self._hub.transmit(self.node, raw):
            return REFUSED
        return b"z\r" if line[0] in "tr" else b"Z\r"

    def _set_bitrate(self, line: str) -> bytes:
        if self._is_open or line[1:] not in BITRATES:
            return REFUSED
        self.bitrate = BITRATES[line[1:]]
        if self._hub.bitrate not in (0, self.bitrate):
            log.warning(
                "%s: the client has set %d bit/s, the bus has %d; a real one would be in error",
                self.tty,
                self.bitrate,
                self._hub.bitrate,
            )
        return OK

    def _set_registers(self, line: str) -> bytes:
        return REFUSED if self._is_open or not re.fullmatch(r"s[0-9A-Fa-f]{4}", line) else OK

    def _open_channel(self, line: str) -> bytes:
        if self._is_open or len(line) > 1:
            return REFUSED
        self.node.listening, self._listen_only = True, line == "L"
        self._hub.happened("client_connected")
        return OK

    def _close_channel(self, line: str) -> bytes:
        if not self._is_open or len(line) > 1:
            return REFUSED
        self.node.listening = False
        return OK

    def _set_stamps(self, line: str) -> bytes:
        if self._is_open or line not in ("Z0", "Z1"):
            return REFUSED
        self._stamps = line == "Z1"
        return OK

    def _flags(self, line: str) -> bytes:
        if not self._is_open or len(line) > 1:
            return REFUSED
        state = self.node.state
        flags = 0
        if state & State.FULL:
            flags |= _FLAG_TRANSMIT_FULL
        if state & State.PASSIVE:
            flags |= _FLAG_PASSIVE
        if state & State.BUS_OFF:
            flags |= _FLAG_BUS_ERROR
        return b"F%02X\r" % flags

    def _answer(self, data: bytes) -> None:
        """Send an answer, after what still waits."""
        self._output += data
        self._flush()

    def deliver(self, raw: bytes) -> None:
        """Send a frame, or lose it when the client does not read."""
        if self._output:
            self.node.counters.missed += 1
            return
        stamp = time.monotonic_ns() // 1_000_000 % _STAMP_PERIOD if self._stamps else None
        self._output += frame_command(raw, stamp)
        self._flush()

    def _flush(self) -> None:
        try:
            sent = os.write(self._fd, self._output) if self._output else 0
        except BlockingIOError:
            sent = 0
        del self._output[:sent]
        if len(self._output) > _READ_SIZE:  # answers that nobody reads
            self._output.clear()
        self._hub.loop.watch(self._fd, self._ready, READ | WRITE if self._output else READ)

    def state_changed(self, state: State) -> None:
        """Do nothing: the command F tells."""

    def waiting(self, count: int) -> None:
        """Do nothing: the answer to a frame tells when the queue is full."""

    def close(self) -> None:
        """Leave the bus, close the pty and remove the link; safe to repeat."""
        if self._fd < 0:
            return
        self.node.detach()
        self._hub.loop.forget(self._fd)
        os.close(self._fd)
        os.close(self._terminal)
        self._fd = self._terminal = -1
        if self._link:
            with contextlib.suppress(OSError):
                os.unlink(self._link)

"""Emergency producer: EMCY messages, error register and history (CiA 301, 7.2.7, 1001, 1003, 1014)."""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable
from enum import IntFlag

from crtk_sim_backends.canopen.aborts import Abort, SdoAbort
from crtk_sim_backends.canopen.dictionary import ObjectDictionary
from crtk_sim_backends.canopen.objects import VALID


class Register(IntFlag):
    """Bits of the error register 1001."""

    GENERIC = 0x01
    CURRENT = 0x02
    VOLTAGE = 0x04
    TEMPERATURE = 0x08
    COMMUNICATION = 0x10
    PROFILE = 0x20
    VENDOR = 0x80


_CLASSES = (
    (0x2000, 0x2FFF, Register.CURRENT),
    (0x3000, 0x3FFF, Register.VOLTAGE),
    (0x4000, 0x4FFF, Register.TEMPERATURE),
    (0x8000, 0x83FF, Register.COMMUNICATION),
    (0x8400, 0x87FF, Register.PROFILE),
    (0xFF00, 0xFFFF, Register.VENDOR),
)


def register_of(code: int) -> Register:
    """Bits of the error register that an error code sets (CiA 301, table 26: classes of codes)."""
    own = next((bit for low, high, bit in _CLASSES if low <= code <= high), Register.GENERIC)
    return own | Register.GENERIC


class Emergency:
    """What is wrong with a node, and the messages about it that wait to be sent."""

    def __init__(self, dictionary: ObjectDictionary) -> None:
        self._dictionary = dictionary
        self._present: dict[tuple[int, int], Register] = {}
        self.waiting: deque[bytes] = deque()  # messages that are to be sent
        self._next = 0.0  # earliest time of the next message
        dictionary.guards[0x1003] = self._guard_history
        dictionary.guards[0x1014] = self._guard_identifier
        dictionary.written[0x1003] = lambda _: self._clear_history()
        kept = [sub for index, sub in dictionary.variables if index == 0x1003 and sub]
        for sub in kept:
            dictionary.live[0x1003, sub] = self._history_entry(sub)
        self._history: deque[int] = deque(maxlen=len(kept))
        dictionary.live[0x1003, 0] = lambda: len(self._history)

    def reset(self) -> None:
        """Forget everything, as a reset of the node does."""
        self._present.clear()
        self.waiting.clear()
        self._history.clear()
        self._next = 0.0

    def begin(self, code: int, vendor: bytes = b"", source: int = 0) -> None:
        """Report an error that now exists; nothing happens when it exists already.

        Args:
            code: error code.
            vendor: up to 5 bytes of the manufacturer.
            source: what has it: an axis, for errors that each can have.
        """
        if (code, source) in self._present:
            return
        self._present[code, source] = register_of(code)
        additional = int.from_bytes(vendor[:2].ljust(2, b"\0"), "little")
        self._history.appendleft(code | additional << 16)
        self._queue(code, vendor)

    def end(self, code: int, source: int = 0) -> None:
        """Report that an error is gone, if it existed: code 0000."""
        if self._present and self._present.pop((code, source), None) is not None:
            self._queue(0, b"")

    def once(self, code: int, vendor: bytes = b"") -> None:
        """Report an error that is over at once, such as a PDO of the wrong length."""
        self._present[code, -1] = register_of(code)
        self._history.appendleft(code)
        self._queue(code, vendor)
        del self._present[code, -1]
        self._update_register()

    def ends_of(self, source: int) -> None:
        """Report that all errors of a source are gone."""
        for code, owner in list(self._present):
            if owner == source:
                self.end(code, source)

    def _queue(self, code: int, vendor: bytes) -> None:
        self._update_register()
        register = self._dictionary[0x1001, 0]
        if not self._dictionary[0x1014, 0] & VALID:
            self.waiting.append(struct.pack("<HB5s", code, register, vendor[:5]))

    def _update_register(self) -> None:
        register = 0
        for bits in self._present.values():
            register |= bits
        self._dictionary[0x1001, 0] = register

    @property
    def next_timer(self) -> float | None:
        """When a waiting message may be sent, None when there is none."""
        return self._next if self.waiting else None

    def take(self, now: float) -> list[tuple[int, bytes]]:
        """Frames that are due: all of them, or one per inhibit time (1015)."""
        frames = []
        while self.waiting and now >= self._next:
            frames.append((self._dictionary[0x1014, 0] & 0x7FF, self.waiting.popleft()))
            self._next = now + self._dictionary[0x1015, 0] * 1e-4
        return frames

    def drop(self) -> None:
        """Lose the waiting messages, as in the NMT state STOPPED."""
        self.waiting.clear()

    def _history_entry(self, sub: int) -> Callable[[], int]:
        def read() -> int:
            if sub > len(self._history):
                raise SdoAbort(Abort.NO_DATA)
            return self._history[sub - 1]

        return read

    def _guard_history(self, sub: int, value: int) -> None:
        if sub == 0 and value != 0:
            raise SdoAbort(Abort.VALUE)

    def _clear_history(self) -> None:
        self._history.clear()

    def _guard_identifier(self, sub: int, value: int) -> None:
        present = self._dictionary[0x1014, 0]
        if not (present | value) & VALID and value & 0x7FF != present & 0x7FF:
            raise SdoAbort(Abort.VALUE)

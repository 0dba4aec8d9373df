"""Answers of a controller: text, then ``:`` (taken) or ``?`` (refused), one for each command.

Text ends with CR LF; what a program on the controller says by itself (MG) has the highest bit set in each
character after ``CW 1``, and is kept apart.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from crtk_drivers.kit import BadData

LONGEST: Final = 4096
_TAKEN: Final = ord(":")
_REFUSED: Final = ord("?")


class Reply(NamedTuple):
    """One answer.

    Attributes:
        text: without the ends of its lines.
        taken: whether the command was.
    """

    text: str
    taken: bool


class Replies:
    """Bytes, cut anywhere, to answers; see `crtk_drivers.kit.Decoder`.

    Attributes:
        said: characters that came unasked.
    """

    def __init__(self) -> None:
        self.said = 0
        self._rest = bytearray()

    def feed(self, data: bytes) -> list[Reply]:
        """Return the answers that `data` completes.

        Raises:
            BadData: there is no end to one.
        """
        found = []
        for byte in data:
            if byte & 0x80:
                self.said += 1
            elif byte in (_TAKEN, _REFUSED):
                text = self._rest.decode("ascii").replace("\r\n", "\n").strip("\r\n ")
                found.append(Reply(text, byte == _TAKEN))
                self._rest.clear()
            else:
                self._rest.append(byte)
        if len(self._rest) > LONGEST:
            raise BadData(f"{len(self._rest)} bytes without an end of an answer")
        return found


def numbers(text: str) -> list[float]:
    """Return the numbers of an answer such as `` 0, 0, 3``.

    Raises:
        ValueError: one is none.
    """
    return [float(part) for part in text.split(",")]

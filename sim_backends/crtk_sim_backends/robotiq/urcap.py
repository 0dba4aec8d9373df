"""The text server of the URCap on the robot's port 63352, in both of its dialects."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Final

from crtk_sim_backends.kit import Session
from crtk_sim_backends.kit.modbus_line import Distortion
from crtk_sim_backends.robotiq.gripper import ACT, ATR, GTO, Gripper

WRITTEN: Final = {"POS": 3, "SPE": 4, "FOR": 5}
"""Byte of the command block, by the name of the variable."""
BITS: Final = {"ACT": ACT, "GTO": GTO, "ATR": ATR, "ARD": 0x20}
BARE: Final = {b"GET STA": 1, b"GET OBJ": 1, b"GET FLT": 2, b"GET PRE": 3}
"""What URScript asks for without an end of line, and how many digits it reads."""
UNKNOWN: Final = "?"


def value(gripper: Gripper, name: str) -> int | None:
    """Return a variable that can be read; None: there is none of that name."""
    status, _, fault, asked, position, _ = gripper.report
    known = {
        "ACT": status & 1,
        "GTO": status >> 3 & 1,
        "STA": status >> 4 & 3,
        "OBJ": status >> 6,
        "FLT": fault & 0xF,
        "PRE": asked,
        "POS": position,
        "SID": 9,
        **{word: gripper.written[at] for word, at in WRITTEN.items() if word != "POS"},
    }
    return known.get(name)


class UrcapSession:
    """One client.

    Args:
        gripper: that it speaks to.
        distortion: of its answers.
        end: of a line that is answered to a GET: it may be empty.
        later: sends bytes to this session so many seconds from now.
    """

    ended = False

    def __init__(
        self,
        gripper: Gripper,
        distortion: Distortion,
        end: bytes,
        later: Callable[[float, Session, bytes], object],
    ) -> None:
        self._gripper = gripper
        self._distortion = distortion
        self._end = end
        self._later = later
        self._rest = b""

    def receive(self, data: bytes) -> bytes:
        """Take received bytes; answers come later."""
        for line, obey in self._requests(data):
            is_set = line.upper().startswith(b"SET")
            self._distortion.pass_on("request", partial(self._hear, obey, is_set), writes=is_set)
        return b""

    def _hear(self, obey: Callable[[], bytes], is_set: bool) -> None:
        if not self._gripper.powered:
            return
        self._gripper.heard()
        answer = obey()
        if not answer or self._distortion.strikes("unit_silent"):
            return
        send = partial(self._later, self._distortion.delay, self, answer)
        self._distortion.pass_on("answer", send, writes=is_set)

    def _requests(self, data: bytes) -> list[tuple[bytes, Callable[[], bytes]]]:
        """Return each request that is whole by now, and what carries it out and answers."""
        if not self._rest and data in BARE:
            return [(data, partial(self._tell_bare, data))]
        *lines, self._rest = (self._rest + data).split(b"\n")
        return [(line, partial(self._obey, line.decode("ascii", "replace"))) for line in lines]

    def _tell_bare(self, data: bytes) -> bytes:
        return f"{value(self._gripper, data[4:].decode()):0{BARE[data]}}".encode()

    def close(self) -> None:
        """Forget an unfinished line."""
        self._rest = b""

    def _obey(self, line: str) -> bytes:
        verb, *words = line.upper().split() or [""]
        if verb == "GET" and len(words) == 1:
            number = value(self._gripper, words[0])
            told = UNKNOWN if number is None else f"{words[0]} {number}"
            return told.encode() + self._end
        if verb == "SET" and words and len(words) % 2 == 0:
            return self._set(dict(zip(words[::2], words[1::2], strict=True)))
        return UNKNOWN.encode() + self._end if verb else b""

    def _set(self, pairs: dict[str, str]) -> bytes:
        self._gripper.meanwhile()
        block = bytearray(self._gripper.written)
        for name, text in pairs.items():
            if not text.isdigit() or int(text) > 255:
                return UNKNOWN.encode() + self._end
            if name in WRITTEN:
                block[WRITTEN[name]] = int(text)
            elif name in BITS:
                block[0] = block[0] & ~BITS[name] | BITS[name] * (text != "0")
            elif name != "SID":
                return UNKNOWN.encode() + self._end
        self._gripper.command(0, bytes(block))
        return b"ack"

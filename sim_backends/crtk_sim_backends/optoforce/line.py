"""The simulated unit's port: what a host tells it, measurements as bytes, and what goes wrong."""

from __future__ import annotations

import random
import struct
from collections.abc import Mapping
from typing import Any, Final

from crtk_sim_backends.kit import Fault, FaultKind, Parameter
from crtk_sim_backends.optoforce.unit import NAMES, Unit

SERIAL: Final = b"ISE0A129"
CONFIGURE: Final = b"\xaa\x00\x32\x03"
ASK_SERIAL: Final = bytes.fromhex("AB00120800C5")

_WRENCH: Final[Mapping[str, Parameter]] = {axis: Parameter(float, 0.0) for axis in NAMES}
_EVERY: Final = {"every": Parameter(int, 3, minimum=1)}
KINDS: Final[Mapping[str, FaultKind]] = {
    kind.name: kind
    for kind in (
        FaultKind(
            "load",
            "a load acts on a sensor, in N and N·m; sensor 0: on each",
            {**_WRENCH, "sensor": Parameter(int, 0, minimum=0, maximum=4)},
            lasting=True,
        ),
        FaultKind("carry", "what hangs on it weighs so much, until the next one", _WRENCH),
        FaultKind(
            "status",
            "bits of its status word are set",
            {"word": Parameter(int, 0x2000, minimum=0, maximum=0xFFFF)},
            lasting=True,
        ),
        FaultKind("frozen", "it repeats one measurement, its number too", lasting=True),
        FaultKind("stopped", "it sends no measurements, and answers", lasting=True),
        FaultKind("deaf", "it measures, and takes nothing", lasting=True),
        FaultKind("refuses", "it refuses every configuration", lasting=True),
        FaultKind("restart", "it loses its power for a moment: settings, zero and number are gone"),
        FaultKind("left_out", "every n-th measurement is left out", _EVERY, lasting=True),
        FaultKind("doubled", "every n-th measurement comes twice", _EVERY, lasting=True),
        FaultKind("bad_sum", "a byte of every n-th measurement is changed", _EVERY, lasting=True),
        FaultKind("cut", "every n-th measurement ends too early", _EVERY, lasting=True),
        FaultKind("noise", "bytes of nobody stand before every measurement", lasting=True),
    )
}


class Line:
    """The port of one unit.

    Args:
        unit: that is behind it.
        mute: it does not tell its serial number.
    """

    kinds = KINDS

    def __init__(self, unit: Unit, *, mute: bool) -> None:
        self._unit = unit
        self._mute = mute
        self._faults: dict[str, Mapping[str, Any]] = {}
        self._sent = 0
        self._random = random.Random(11)

    # ---------------------------------------------------------------------------------- its host

    def obey(self, frame: bytes) -> bytes:
        """Return the answer to a whole frame."""
        if "deaf" in self._faults:
            return b""
        if frame == ASK_SERIAL:
            return b"" if self._mute else _summed(b"\xaa\x00\x12\x08" + SERIAL)
        error = 2 if "refuses" in self._faults else self._unit.configure(*frame[4:7])
        return _summed(b"\xaa\x00\x50\x01" + bytes((error,)))

    def advance(self) -> bytes:
        """Let one cycle pass; return what is sent."""
        measured = self._unit.advance()
        if measured is None:
            return b""
        number, status, counts = measured
        size = 4 + 2 * len(counts)
        head = bytes((0xAA, 0x07, 0x08, size))
        frame = _summed(head + struct.pack(f">HH{len(counts)}h", number, status, *counts))
        self._sent += 1
        if self._strikes("left_out"):
            return b""
        if self._strikes("bad_sum"):
            at = self._random.randrange(4, len(frame))
            frame = frame[:at] + bytes((frame[at] ^ 0x55,)) + frame[at + 1 :]
        if self._strikes("cut"):
            frame = frame[: self._random.randrange(1, len(frame))]
        if self._strikes("doubled"):
            frame += frame
        return self._random.randbytes(3) + frame if "noise" in self._faults else frame

    def _strikes(self, kind: str) -> bool:
        return kind in self._faults and self._sent % int(self._faults[kind]["every"]) == 0

    # ------------------------------------------------------------------------------------ faults

    def begin(self, fault: Fault) -> None:
        """Let a fault begin."""
        given = fault.parameters
        if fault.kind == "carry":
            self._unit.carried = [given[name] for name in NAMES]
        elif fault.kind == "restart":
            self._unit.restart()
        else:
            self._faults[fault.kind] = given
            self._apply()

    def end(self, fault: Fault) -> None:
        """Let it end."""
        self._faults.pop(fault.kind, None)
        self._apply()

    def _apply(self) -> None:
        unit, faults = self._unit, self._faults
        unit.frozen, unit.stopped = "frozen" in faults, "stopped" in faults
        unit.status_word = faults["status"]["word"] if "status" in faults else 0
        load = faults.get("load")
        acting = [load[name] for name in NAMES] if load else [0.0] * 6
        for number in range(unit.sensors):
            meant = load is not None and load["sensor"] in (0, number + 1)
            unit.loads[number] = acting if meant else [0.0] * 6

    def status(self) -> dict[str, Any]:
        """What a test or a person wants to know."""
        return {**self._unit.status(), "sent": self._sent}


class Host:
    """A program at the port: its frames, cut anywhere.

    Args:
        line: to which it talks.
    """

    ended = False

    def __init__(self, line: Line) -> None:
        self._line = line
        self._rest = b""

    def receive(self, data: bytes) -> bytes:
        """Take bytes and return answers; what is no frame is skipped byte by byte."""
        self._rest += data
        answers = b""
        while self._rest:
            for head, size in ((CONFIGURE, 9), (ASK_SERIAL, 6)):
                if not self._rest.startswith(head[: len(self._rest)]):
                    continue
                frame = self._rest[:size]
                if len(frame) < size:
                    return answers
                if frame == ASK_SERIAL or frame == _summed(frame[:-2]):
                    answers += self._line.obey(frame)
                    self._rest = self._rest[size:]
                    break
            else:
                self._rest = self._rest[1:]
        return answers

    def close(self) -> None:
        """Forget what is not whole."""
        self._rest = b""


def _summed(data: bytes) -> bytes:
    return data + struct.pack(">H", sum(data) & 0xFFFF)

"""The simulated force sensor: what acts on it, its registers, and its stream."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable, Mapping
from typing import Any, Final

from crtk_sim_backends.kit import Fault, FaultKind, Parameter
from crtk_sim_backends.kit.modbus import ALL, ILLEGAL_ADDRESS, Refused, crc
from crtk_sim_backends.page import Gauge, Gauges

PERIOD: Final = 0.01
"""Seconds from one measurement of the stream to the next."""
SETTLING: Final = 0.03
"""Seconds from the request for a stream to its first measurement."""
STREAM: Final = 410
STREAM_ON: Final = 0x0200
COUNTS: Final = (100.0,) * 3 + (1000.0,) * 3
"""Counts of a newton and of a newton metre."""
AXES: Final = ("fx", "fy", "fz", "mx", "my", "mz")

_WRENCH: Final[Mapping[str, Parameter]] = {axis: Parameter(float, 0.0) for axis in AXES}
KINDS: Final[Mapping[str, FaultKind]] = {
    kind.name: kind
    for kind in (
        FaultKind("load", "a load acts on it, in N and N·m", _WRENCH, lasting=True),
        FaultKind("carry", "what hangs on it weighs so much, until the next one", _WRENCH),
        FaultKind("frozen", "it repeats one measurement", lasting=True),
        FaultKind(
            "unpowered",
            "no supply: it is silent, and streams as before when it is back",
            lasting=True,
        ),
        FaultKind("other_master", "another program ends its stream"),
        FaultKind("other_streams", "another program lets it stream"),
        FaultKind(
            "left_out",
            "every n-th measurement of the stream is left out",
            {"every": Parameter(int, 2, minimum=1)},
            lasting=True,
        ),
    )
}


class Sensor:
    """One sensor.

    Args:
        noise: standard deviation of each force, in N.
        streams: whether somebody has let it stream.
    """

    kinds = KINDS
    functions = ALL

    def __init__(self, noise: float, *, streams: bool) -> None:
        self.streams = streams
        self.listeners: list[Callable[[bytes], object]] = []
        self.ends = 0
        self._noise = noise
        self._random = random.Random(3)
        self._load: tuple[float, ...] = (0.0,) * 6
        self._carried = self._load
        self._is_frozen = False
        self._powered = True
        self._counts: tuple[int, ...] = (0,) * 6
        self._due = 0.0
        self._numbers = 0
        self._left_out = 0
        self._measure()

    # ------------------------------------------------------------------------------------ registers

    @property
    def powered(self) -> bool:
        """Whether it answers: it does not while it streams."""
        return self._powered and not self.streams

    def heard(self) -> None:
        """A request was understood."""

    def read(self, address: int, count: int) -> bytes:
        """Return the bytes of registers."""
        known = self._registers()
        wanted = range(address, address + count)
        if not all(number in known for number in wanted):
            raise Refused(ILLEGAL_ADDRESS)
        return b"".join(struct.pack(">H", known[number] & 0xFFFF) for number in wanted)

    def write(self, address: int, data: bytes) -> None:
        """Take the bytes of registers: there is one that can be written."""
        if address != STREAM or len(data) != 2:
            raise Refused(ILLEGAL_ADDRESS)
        if int.from_bytes(data) == STREAM_ON:
            self.streams, self._due = True, SETTLING

    def _registers(self) -> dict[int, int]:
        known = {180 + at: count for at, count in enumerate(self._counts)}
        known |= {190: 0, 191: 0, 192: -1000, STREAM: 0, 514: 2021}
        for first, text in ((500, b"FT1.05"), (510, b"FTS-0815")):
            numbers = struct.unpack(f">{len(text) // 2}H", text)
            known |= {first + at: number for at, number in enumerate(numbers)}
        return known

    # --------------------------------------------------------------------------------- its stream

    def end_stream(self) -> None:
        """It was told to listen again."""
        self.ends += self.streams
        self.streams = False

    def advance(self, seconds: float) -> None:
        """Let time pass."""
        self._due -= seconds
        if self._due > 0.0:
            return
        self._due += PERIOD
        if not self._is_frozen:
            self._measure()
        if not self.streams or not self._powered:
            return
        self._numbers += 1
        if self._left_out and self._numbers % self._left_out == 0:
            return
        frame = b"\x20\x4e" + struct.pack("<6h", *self._counts)
        frame += crc(frame)
        for listener in self.listeners:
            listener(frame)

    def _measure(self) -> None:
        values = (
            load + carried + self._random.gauss(0.0, self._noise * (0.1 if at > 2 else 1.0))
            for at, (load, carried) in enumerate(zip(self._load, self._carried, strict=True))
        )
        self._counts = tuple(
            min(max(round(value * scale), -32768), 32767)
            for value, scale in zip(values, COUNTS, strict=True)
        )

    # ------------------------------------------------------------------------------------ its faults

    def begin(self, fault: Fault) -> None:
        """Let a fault begin."""
        given = fault.parameters
        if fault.kind == "load":
            self._load = tuple(given[axis] for axis in AXES)
        elif fault.kind == "carry":
            self._carried = tuple(given[axis] for axis in AXES)
        elif fault.kind == "frozen":
            self._is_frozen = True
        elif fault.kind == "unpowered":
            self._powered = False
        elif fault.kind == "other_master":
            self.end_stream()
        elif fault.kind == "other_streams":
            self.streams = True
        else:
            self._left_out = given["every"]

    def end(self, fault: Fault) -> None:
        """Let it end."""
        if fault.kind == "load":
            self._load = (0.0,) * 6
        elif fault.kind == "frozen":
            self._is_frozen = False
        elif fault.kind == "unpowered":
            self._powered = True
        elif fault.kind == "left_out":
            self._left_out = 0

    def status(self) -> dict[str, Any]:
        """What a test or a person wants to know."""
        scaled = zip(self._counts, COUNTS, strict=True)
        return {
            "load": [count / scale for count, scale in scaled],
            "streams": self.streams,
            "stream_ends": self.ends,
            "measurements": self._numbers,
        }

    def gauges(self) -> list[Gauges]:
        """What the page shows."""
        values = [count / scale for count, scale in zip(self._counts, COUNTS, strict=True)]
        forces: list[Gauge] = [
            {"name": axis, "low": -300.0, "high": 300.0, "value": value}
            for axis, value in zip(AXES[:3], values[:3], strict=True)
        ]
        moments: list[Gauge] = [
            {"name": axis, "low": -30.0, "high": 30.0, "value": value}
            for axis, value in zip(AXES[3:], values[3:], strict=True)
        ]
        return [
            {"title": "Forces", "unit": "N", "rate": "", "digits": 2, "gauges": forces},
            {"title": "Moments", "unit": "N·m", "rate": "", "digits": 3, "gauges": moments},
        ]

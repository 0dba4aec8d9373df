"""The simulated sensor and its box: what it measures, is told, and sends. No port, no clock."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np

from crtk_sim_backends.kit import Fault, FaultKind, Parameter
from crtk_sim_backends.kit.datagrams import EVERY, STREAM, STREAM_KINDS, FaultyWay
from crtk_sim_backends.kit.loads import Array, parse_load
from crtk_sim_backends.schunk.fts.config import SimConfig

HEAD: Final = struct.Struct("<2sHH")
TARE, RESET_TARE, TOOL, FILTER, START, STOP, GET, SET = (
    0x12,
    0x13,
    0x30,
    0x31,
    0x40,
    0x41,
    0xF0,
    0xF1,
)
KNOWN: Final = frozenset({0x10, 0x11, TARE, RESET_TARE, 0x20, TOOL, FILTER, START, STOP, GET, SET})
UNKNOWN_COMMAND, BAD_LENGTH, BAD_VALUE, STREAMING, READ_ONLY, NO_INDEX = 1, 2, 0x16, 5, 0x11, 0x13
NAME, RATE, PORT = (0x0001, 0), (0x1020, 0), (0x1033, 0)

MODES: Final[Mapping[int, tuple[int, int]]] = {
    0: (1, 1),
    1: (2, 1),
    2: (4, 1),
    3: (10, 1),
    10: (1, 16),
}
"""Ticks of 1 ms from one datagram to the next, and measurements in it, by output rate."""
READY, MECHANICAL = 1 << 0, 1 << 4

KINDS: Final[Mapping[str, FaultKind]] = {
    **STREAM_KINDS,
    **{
        kind.name: kind
        for kind in (
            FaultKind(
                "foreign", "a stranger sends as well, for every n-th", {"every": EVERY}, True
            ),
            FaultKind(
                "status",
                "bits of every status word are turned round",
                {"bits": Parameter(int, minimum=0, maximum=2**32 - 1)},
                lasting=True,
            ),
            FaultKind(
                "push",
                "somebody pushes at the sensor (N, N.m)",
                {"wrench": Parameter(list, minimum=-1e6, maximum=1e6, length=6)},
                lasting=True,
            ),
            FaultKind("not_a_number", "its loads are no numbers", lasting=True),
            FaultKind("stall", "it hangs: nothing is measured, sent or answered", lasting=True),
            FaultKind("unplugged", "the cable is out, and it measures on", lasting=True),
            FaultKind("restart", "it starts anew: counter, tare and stream are gone"),
            FaultKind("stopped", "another client stops the stream"),
            FaultKind(
                "refuses",
                "every request is refused",
                {"code": Parameter(int, 4, minimum=1, maximum=255)},
                lasting=True,
            ),
        )
    },
}


class Box:
    """One sensor."""

    kinds = KINDS

    def __init__(self, config: SimConfig) -> None:
        self._config = config
        self._load = parse_load(config.load)
        self.port = config.udp_port
        self.mode = 0
        self.carried = np.zeros(6)
        self.measured = np.zeros(6)
        self.sent = 0
        self.foreign: list[bytes] = []
        self._ticks = 0
        self._faults: dict[str, Mapping[str, Any]] = {}
        self._way = FaultyWay()
        self._start()

    def _start(self) -> None:
        self.streams = False
        self._counter = 0
        self._tare = np.zeros(6)

    @property
    def hangs(self) -> bool:
        """Whether it does nothing at all."""
        return "stall" in self._faults

    # ------------------------------------------------------------------------------------- requests

    def answer(self, counter: int, payload: bytes) -> bytes:
        """Carry out a request, and return the reply; nothing while it hangs."""
        if self.hangs or "unplugged" in self._faults:
            return b""
        op, data = payload[0], payload[1:]
        told = self._faults.get("refuses", {}).get("code", 0)
        reply = bytes((op, told)) if told else self._carry_out(op, data)
        return HEAD.pack(b"\xff\xff", counter, len(reply)) + reply

    def _carry_out(self, op: int, data: bytes) -> bytes:
        if op not in KNOWN:
            return bytes((op, UNKNOWN_COMMAND))
        if op in (GET, SET):
            return self._parameter(op, data)
        if len(data) != (op in (TOOL, FILTER)):
            return bytes((op, BAD_LENGTH))
        acts: Mapping[int, Callable[[], object]] = {
            TARE: lambda: self._set_tare(self.measured + self._tare),
            RESET_TARE: lambda: self._set_tare(np.zeros(6)),
            START: lambda: setattr(self, "streams", True),
            STOP: lambda: setattr(self, "streams", False),
        }
        acts.get(op, lambda: None)()
        return bytes((op, 0))

    def _set_tare(self, load: Array) -> None:
        self._tare = load

    def _parameter(self, op: int, data: bytes) -> bytes:
        if len(data) < 3:
            return bytes((op, BAD_LENGTH))
        index, sub = struct.unpack_from("<HB", data)
        error, value = self._get(index, sub) if op == GET else self._put(index, sub, data[3:])
        return bytes((op, error)) + data[:3] + value

    def _get(self, index: int, sub: int) -> tuple[int, bytes]:
        values = {NAME: b"FTS simulated".ljust(32, b"\0")}
        if not self._config.old_firmware:
            values |= {RATE: bytes((self.mode,)), PORT: struct.pack("<H", self.port)}
        value = values.get((index, sub))
        return (NO_INDEX, b"") if value is None else (0, value)

    def _put(self, index: int, sub: int, value: bytes) -> tuple[int, bytes]:
        if self._config.old_firmware or (index, sub) not in (RATE, PORT):
            return (READ_ONLY if (index, sub) == NAME else NO_INDEX), b""
        if self.streams:
            return STREAMING, b""
        number = int.from_bytes(value, "little")
        fits = number in MODES if (index, sub) == RATE else 1024 <= number <= 65535
        if len(value) != (1 if (index, sub) == RATE else 2) or not fits:
            return BAD_VALUE, b""
        setattr(self, "mode" if (index, sub) == RATE else "port", number)
        return 0, b""

    # -------------------------------------------------------------------------------------- stream

    def tick(self) -> list[bytes]:
        """Let a millisecond pass; return the datagrams to send, and leave those of a stranger."""
        self.foreign = []
        if self.hangs:
            return []
        self._ticks += 1
        every, count = MODES[self.mode]
        if self._ticks % every:
            return []
        payload = bytes((self._counter & 0xFF,)) + b"".join(self._sample() for _ in range(count))
        data = HEAD.pack(b"\xff\xff", self._counter, len(payload)) + payload
        self._counter = (self._counter + 1) & 0xFFFF
        if not self.streams or "unplugged" in self._faults:
            return []
        self.sent += 1
        if "foreign" in self._faults and self.sent % self._faults["foreign"]["every"] == 0:
            self.foreign = [data[:11] + struct.pack("<6f", *[9e3] * 6)]
        return self._way.through([data])

    def _sample(self) -> bytes:
        push = np.array(self._faults.get("push", {}).get("wrench", np.zeros(6)))
        acting = self._load.wrench(np.array([1e-3 * self._ticks]))[0] + self.carried + push
        self.measured = acting - self._tare
        rated = np.repeat((self._config.rated_force, self._config.rated_torque), 3)
        status = READY | MECHANICAL * bool((np.abs(acting) > rated).any())
        status ^= self._faults.get("status", {}).get("bits", 0)
        told = np.full(6, np.nan) if "not_a_number" in self._faults else self.measured
        return struct.pack("<I6f", status, *told)

    # --------------------------------------------------------------------------------- its faults

    def begin(self, fault: Fault) -> None:
        """Let a fault begin."""
        if fault.kind in STREAM:
            self._way.begin(fault.kind, STREAM[fault.kind](fault.parameters))
        elif fault.kind == "restart":
            self._start()
        elif fault.kind == "stopped":
            self.streams = False
        else:
            self._faults[fault.kind] = fault.parameters

    def end(self, fault: Fault) -> None:
        """Let it end."""
        self._way.end(fault.kind)
        self._faults.pop(fault.kind, None)

    def carry(self, wrench: list[float]) -> None:
        """Let something hang on it, beside all else that acts: N and N·m, in its frame."""
        carried = np.array(wrench, np.float64)
        if carried.shape != (6,) or not np.isfinite(carried).all():
            raise ValueError(f"wrench must be six finite numbers, not {wrench}")
        self.carried = carried

    def status(self) -> dict[str, Any]:
        """What a test or a person wants to know."""
        return {
            "streams": self.streams,
            "sent": self.sent,
            "counter": self._counter,
            "mode": self.mode,
            "udp_port": self.port,
            "measured": self.measured.tolist(),
            "tare": self._tare.tolist(),
        }

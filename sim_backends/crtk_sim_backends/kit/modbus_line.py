"""The ways to a Modbus device: whose bytes are mixed, what is answered, when, and what goes wrong."""

from __future__ import annotations

import random
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Final, Protocol

from crtk_sim_backends.faults import Fault, FaultKind, Parameter
from crtk_sim_backends.kit.modbus import Registers, answer, crc, mbap_requests, rtu_requests
from crtk_sim_backends.kit.ports import Session

_EVERY = Parameter(int, 1, minimum=1)
KINDS: Final[Mapping[str, FaultKind]] = {
    kind.name: kind
    for kind in (
        FaultKind("unit_silent", "requests are heard, and not answered", lasting=True),
        FaultKind(
            "exception",
            "every n-th request is refused",
            {"code": Parameter(int, minimum=1, maximum=11), "every": _EVERY},
            lasting=True,
        ),
        FaultKind("bad_crc", "the CRC of every n-th answer is wrong", {"every": _EVERY}, True),
        FaultKind("cut", "every n-th answer ends too early", {"every": _EVERY}, lasting=True),
        FaultKind("doubled", "every n-th answer comes twice", {"every": _EVERY}, lasting=True),
        FaultKind("noise", "bytes of nobody stand before every answer", lasting=True),
        FaultKind(
            "late",
            "answers come later by so many seconds",
            {"seconds": Parameter(float, minimum=0.0, maximum=10.0)},
            lasting=True,
        ),
        FaultKind(
            "message",
            "the n-th request or answer of a kind, and only that, is lost, comes twice, or is late",
            {
                "part": Parameter(str, "request", choices=("request", "answer")),
                "of": Parameter(str, "any", choices=("any", "read", "write")),
                "number": Parameter(int, 1, minimum=1),
                "effect": Parameter(str, "lost", choices=("lost", "doubled", "late")),
                "seconds": Parameter(float, 0.03, minimum=0.0001, maximum=60.0),
            },
            lasting=True,
        ),
    )
}
WRITING: Final = frozenset({6, 16, 23})
"""Functions of the requests that write."""

GAP: Final = 0.02
"""Seconds of silence after which the rest of a request is forgotten."""
BITS: Final = 10
"""Of a byte on the line."""

Beyond = Callable[[int, bytes], bytes | None]
After = Callable[[float, Callable[[], object]], object]
Deliver = Callable[[Session, bytes], object]


class ModbusUnit(Registers, Protocol):
    """A device that answers."""

    @property
    def powered(self) -> bool:
        """Whether it does; otherwise it is silent."""

    def heard(self) -> None:
        """A request was understood, whatever it was."""


class Distortion:
    """What goes wrong with requests and answers now; the same for every way to the device.

    Args:
        after: calls a function so many seconds from now.
    """

    kinds = KINDS

    def __init__(self, after: After) -> None:
        self._after = after
        self.faults: dict[str, Mapping[str, object]] = {}
        self._counts: dict[str, int] = {}
        self._random = random.Random(1)

    def begin(self, fault: Fault) -> None:
        """Let a fault begin."""
        self.faults[fault.kind] = fault.parameters
        self._counts[fault.kind] = 0

    def end(self, fault: Fault) -> None:
        """Let it end."""
        self.faults.pop(fault.kind, None)

    def strikes(self, kind: str) -> bool:
        """Whether a fault strikes this answer."""
        if kind not in self.faults:
            return False
        self._counts[kind] += 1
        every = self.faults[kind].get("every", 1)
        assert isinstance(every, int)
        return self._counts[kind] % every == 0

    @property
    def delay(self) -> float:
        """Seconds by which answers are late."""
        seconds = self.faults.get("late", {}).get("seconds", 0.0)
        assert isinstance(seconds, float)
        return seconds

    def pass_on(
        self, part: str, deliver: Callable[[], object], *, writes: bool, wait: float = 0.0
    ) -> None:
        """Deliver a message, unless the fault ``message`` hits this very one.

        Args:
            part: ``request`` or ``answer``.
            deliver: does it; twice if it is doubled.
            writes: whether that request writes.
            wait: s that it takes anyway.
        """
        for late in self._arrivals(part, writes=writes):
            if wait + late:
                self._after(wait + late, deliver)
            else:
                deliver()

    def _arrivals(self, part: str, *, writes: bool) -> tuple[float, ...]:
        """Return by how many s each copy of a message is late: none if it is lost, two if it is doubled."""
        wanted = self.faults.get("message", {})
        if wanted.get("part") != part or wanted["of"] not in ("any", _OF[writes]):
            return (0.0,)
        self._counts["message"] += 1
        if self._counts["message"] != wanted["number"]:
            return (0.0,)
        seconds = wanted["seconds"]
        assert isinstance(seconds, float)
        return {"lost": (), "doubled": (0.0, 0.0), "late": (seconds,)}[str(wanted["effect"])]

    def reply(self, device: ModbusUnit, request: bytes) -> bytes | None:
        """Return what is answered to a request; None: nothing."""
        if not device.powered:
            return None
        device.heard()
        if self.strikes("exception"):
            code = self.faults["exception"]["code"]
            assert isinstance(code, int)
            return bytes((request[0] | 0x80, code))
        told = answer(device, request)
        return None if self.strikes("unit_silent") else told

    def on_the_line(self, frame: bytes) -> bytes:
        """Return what becomes of an answer."""
        if self.strikes("bad_crc"):
            frame = frame[:-1] + bytes((frame[-1] ^ 0x55,))
        if self.strikes("cut"):
            frame = frame[: len(frame) // 2]
        if self.strikes("doubled"):
            frame += frame
        return (self._random.randbytes(5) if self.strikes("noise") else b"") + frame


_OF: Final = {False: "read", True: "write"}


class RtuSession:
    """One program at a line; every byte of all of them is on it."""

    ended = False

    def __init__(self, line: RtuLine) -> None:
        self._line = line
        line.sessions.append(self)

    def receive(self, data: bytes) -> bytes:
        """Put bytes on the line; answers come later."""
        self._line.take(data)
        return b""

    def close(self) -> None:
        """Leave the line."""
        if self in self._line.sessions:
            self._line.sessions.remove(self)


class RtuLine:
    """A serial line with one device, in Modbus RTU.

    Several programs at one line, as at the socket of a robot's tool, share what comes back: it goes to
    whoever reads next.

    Args:
        device: on the line.
        distortion: of its answers.
        unit: address of the device.
        baud: bits a second; 0: as fast as it goes.
        turnaround: seconds from the end of a request to the beginning of its answer.
        after: calls a function so many seconds from now.
        deliver: sends bytes to a session.
        client_baud: rate that its client has set: at another one nothing is understood; None: not known.
    """

    def __init__(
        self,
        device: ModbusUnit,
        distortion: Distortion,
        unit: int,
        baud: int,
        turnaround: float,
        after: After,
        deliver: Deliver,
        client_baud: Callable[[], int] | None = None,
    ) -> None:
        self.sessions: list[RtuSession] = []
        self._device = device
        self._distortion = distortion
        self._unit = unit
        self._byte_time = BITS / baud if baud else 0.0
        self._turnaround = turnaround
        self._after = after
        self._deliver = deliver
        self._client_baud = client_baud
        self._baud = baud
        self._rest = b""
        self._heard = 0.0
        self._random = random.Random(2)

    def take(self, data: bytes) -> None:
        """Take bytes from any of the programs."""
        if self._client_baud is not None and self._baud not in (0, self._client_baud()):
            return
        now = time.monotonic()
        if now - self._heard > GAP:
            self._rest = b""
        self._heard = now
        requests, self._rest = rtu_requests(self._rest + data)
        for unit, request in requests:
            if unit in (0, self._unit):
                self._serve(unit, request)

    def _serve(self, unit: int, request: bytes) -> None:
        carry_out = partial(self._carry_out, unit, request)
        self._distortion.pass_on("request", carry_out, writes=request[0] in WRITING)

    def _carry_out(self, unit: int, request: bytes) -> None:
        reply = self._distortion.reply(self._device, request)
        if reply is None or unit == 0:  # a broadcast is not answered
            return
        body = bytes((unit,)) + reply
        frame = self._distortion.on_the_line(body + crc(body))
        on_the_wire = (len(request) + 3 + len(frame)) * self._byte_time
        wait = on_the_wire + self._turnaround + self._distortion.delay
        deal = partial(self.deal, frame)
        self._distortion.pass_on("answer", deal, writes=request[0] in WRITING, wait=wait)

    def deal(self, frame: bytes) -> None:
        """Send an answer; of several programs one reads it, or one its beginning and one the rest."""
        cut = self._random.randrange(2 * len(frame)) if len(self.sessions) > 1 else 0
        for piece in (frame[:cut], frame[cut:]):
            if piece and self.sessions:
                self._deliver(self._random.choice(self.sessions), piece)


class TcpSession:
    """A client of Modbus TCP.

    Args:
        device: behind the port.
        distortion: of its answers; a CRC there is none.
        unit: address of the device.
        beyond: answers for other units, and for a device without power; None: nobody.
        later: sends bytes to this session so many seconds from now.
    """

    def __init__(
        self,
        device: ModbusUnit,
        distortion: Distortion,
        unit: int,
        beyond: Beyond,
        later: Callable[[float, Session, bytes], object],
    ) -> None:
        self.ended = False
        self._beyond = beyond
        self._device = device
        self._distortion = distortion
        self._unit = unit
        self._later = later
        self._rest = b""

    def receive(self, data: bytes) -> bytes:
        """Take received bytes and return the answers."""
        try:
            *requests, (_, _, self._rest) = mbap_requests(self._rest + data)
        except ValueError:
            self.ended = True
            return b""
        for transaction, unit, request in requests:
            carry_out = partial(self._carry_out, transaction, unit, request)
            self._distortion.pass_on("request", carry_out, writes=request[0] in WRITING)
        return b""

    def _carry_out(self, transaction: bytes, unit: int, request: bytes) -> None:
        if unit == self._unit and self._device.powered:
            reply = self._distortion.reply(self._device, request)
        else:
            reply = self._beyond(unit, request)
        if reply is None:
            return
        size = (1 + len(reply)).to_bytes(2)
        frame = transaction + b"\0\0" + size + bytes((unit,)) + reply
        frame = frame * (2 if self._distortion.strikes("doubled") else 1)
        send = partial(self._later, self._distortion.delay, self, frame)
        self._distortion.pass_on("answer", send, writes=request[0] in WRITING)

    def close(self) -> None:
        """Forget an unfinished frame."""
        self._rest = b""

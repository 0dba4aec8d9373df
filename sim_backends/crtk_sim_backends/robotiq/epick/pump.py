"""The simulated vacuum gripper: pump, valve, what lies under its cups, and the six bytes of its status."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from crtk_sim_backends.kit import Fault, FaultKind, Parameter
from crtk_sim_backends.kit.cups import Cups
from crtk_sim_backends.kit.modbus import ALL, window
from crtk_sim_backends.page import Gauge, Gauges

COMMAND: Final = 1000
STATUS: Final = 2000
REGISTERS: Final = 3
"""First registers of both blocks, and how many each has."""

ACT: Final = 0x01
ADVANCED: Final = 0x02
GTO: Final = 0x08

SURROUNDING: Final = 100.0
"""kPa."""
DEEPEST: Final = 15.0
"""kPa absolute that the pump comes to when nothing leaks."""
EVACUATING: Final = 0.15
"""Seconds in which the pump takes the pressure down to a third of the way."""
VENTING: Final = 0.05
"""The same of the valve, and of a cup that nothing closes."""
AUTOMATIC: Final = (40.0, 60.0)
"""kPa absolute between which it keeps by its own judgement."""
POROUS: Final = 2.0
"""Seconds without a rest of the pump after which what it holds counts as porous."""

STANDBY, GRIPS, PASSIVE, ACTIVE = 0, 1, 2, 3
UNKNOWN, AT_MINIMUM, AT_MAXIMUM, NONE = 0, 1, 2, 3

MAJOR: Final = 0xA
"""Faults from here up need a reset."""
LEAKS, NOT_YET, TIMEOUT, NOT_ACTIVE, SILENCE = 0x3, 0x5, 0x6, 0x7, 0x9
QUIET: Final = 1.0
"""Seconds without a request after which fault 9 is set; the next request clears it."""

KINDS: Final[Mapping[str, FaultKind]] = {
    kind.name: kind
    for kind in (
        FaultKind(
            "object",
            "something lies under the cups, which leaks: share of the pump's flow at full vacuum",
            {"leak": Parameter(float, 0.0, minimum=0.0, maximum=2.0)},
            lasting=True,
        ),
        FaultKind("object_lost", "what lies there is gone"),
        FaultKind(
            "gripper_fault",
            "the gripper reports a fault (gFLT); one from 10 up outlasts it, until a reset",
            {"code": Parameter(int, minimum=0, maximum=15)},
            lasting=True,
        ),
        FaultKind("unpowered", "no supply: it is silent, and reset when it is back", lasting=True),
        FaultKind("deactivated", "another master resets it"),
        FaultKind(
            "deactivated_meanwhile", "another master resets it just before the next command comes"
        ),
        FaultKind("activated", "another master activates it"),
        FaultKind(
            "other_master",
            "another master asks it for a pressure",
            {"pressure": Parameter(int, minimum=0, maximum=255)},
        ),
    )
}


class Pump:
    """One gripper.

    Args:
        activated: whether somebody has activated it already.
        leak: of what lies under the cups; None: nothing lies there.
    """

    kinds = KINDS
    functions = ALL

    def __init__(self, *, activated: bool, leak: float | None) -> None:
        self.cups = Cups()
        self._put(leak)
        self.powered = True
        self.written = bytearray(6)
        self.writes = self.releases = 0
        self._ready = self._resets_next = False
        self._runs = False
        self._valve = STANDBY
        self._object = UNKNOWN
        self._had = False
        self._since = self._busy = self._quiet = 0.0
        self._fault = 0
        if activated:
            self.written[0], self._ready = ACT, True

    # ------------------------------------------------------------------------------- its registers

    def heard(self) -> None:
        """A request was understood, whatever it was."""
        self._quiet = 0.0
        if self._fault == SILENCE:
            self._fault = 0

    def read(self, address: int, count: int) -> bytes:
        """Return the bytes of registers; those of the command can be read, and read as zeros."""
        if COMMAND <= address < COMMAND + REGISTERS:
            window(COMMAND, REGISTERS, address, count)
            return bytes(2 * count)
        return self.report[window(STATUS, REGISTERS, address, count)]

    def write(self, address: int, data: bytes) -> None:
        """Take the bytes of registers."""
        self.command(window(COMMAND, REGISTERS, address, len(data) // 2).start, data)

    def command(self, at: int, data: bytes) -> None:
        """Take bytes of the command, from byte `at`."""
        if self._resets_next:
            self._resets_next = False
            self.command(0, bytes(6))
        before = bytes(self.written)
        self.written[at : at + len(data)] = data
        self.writes += 1
        action = self.written[0]
        if not action & ACT:
            self._ready, self._runs, self._valve = False, False, STANDBY
            self._fault = NOT_ACTIVE if action & GTO else 0
        else:
            self._ready = True
            if not before[0] & ACT or self._fault < MAJOR:
                self._fault = 0
        if bytes(self.written) != before or self._object == NONE:
            self._object, self._since, self._busy, self._had = UNKNOWN, 0.0, 0.0, False
            self.releases += self._lets_go

    @property
    def report(self) -> bytes:
        """The registers from 2000 on."""
        action = self.written[0]
        status = action & (ACT | ADVANCED | GTO) | 0x30 * self._ready | self._object << 6
        return bytes((status, self._valve, self._fault, self.written[3], round(self.pressure), 0))

    @property
    def _lets_go(self) -> bool:
        return bool(self.written[0] & GTO) and self.written[3] >= SURROUNDING

    @property
    def _goals(self) -> tuple[float, float]:
        """Pressures at which the pump rests, and at which it runs again."""
        if not self.written[0] & ADVANCED:
            return AUTOMATIC
        return max(float(self.written[3]), DEEPEST), max(float(self.written[5]), DEEPEST + 1.0)

    # ------------------------------------------------------------------------------ its mechanics

    def advance(self, seconds: float) -> None:
        """Let time pass."""
        self._quiet += seconds
        if self.powered and self._quiet > QUIET and not self._fault:
            self._fault = SILENCE
        works = self.powered and self._ready and self.written[0] & GTO and self._fault < MAJOR
        if not works:
            self._runs, self._valve = False, STANDBY
        elif self._lets_go:
            self._release(seconds)
        else:
            self._grip(seconds)
        self._flow(seconds)

    def _release(self, seconds: float) -> None:
        self._runs = False
        self._since += seconds
        blows = self._since < 0.1 * self.written[4]
        done = not blows or self.pressure > SURROUNDING - 1.0
        self._valve = STANDBY if done else ACTIVE
        self._object = NONE if done else UNKNOWN

    def _grip(self, seconds: float) -> None:
        deep, least = self._goals
        self._since += seconds
        if self._object == NONE:
            self._runs, self._valve = False, STANDBY
            return
        self._valve = GRIPS
        if self.pressure <= deep + 0.5:
            self._runs, self._busy = False, 0.0
        elif self.pressure > least or not self._had:
            self._runs = True
        self._busy += seconds * self._runs
        if self.pressure <= least:
            self._had = True
            self._object = AT_MAXIMUM if self.pressure <= deep + 1.0 else self._object or AT_MINIMUM
            if self._busy > POROUS:
                self._fault = LEAKS
        elif self._had and self.pressure > least + 5.0:
            self._object, self._runs = NONE, False
        elif not self._had and self._since > 0.1 * self.written[4]:
            self._object, self._fault = NONE, TIMEOUT

    def _flow(self, seconds: float) -> None:
        """Air comes in by valve, leak and open cup, and goes out by the pump."""
        blows = self._valve in (PASSIVE, ACTIVE)
        is_open = blows or (
            self._valve == STANDBY and self.powered
        )  # without power a check valve keeps it
        self.cups.flow(
            seconds,
            deepest=1e3 * (SURROUNDING - DEEPEST),
            pump=1.0 / EVACUATING if self._runs else 0.0,
            vent=1.0 / VENTING if is_open else 0.0,
            is_open=1.0 / VENTING,
        )

    @property
    def pressure(self) -> float:
        """At the cups, absolute, in kPa."""
        return SURROUNDING - 1e-3 * self.cups.vacuum

    # --------------------------------------------------------------------------------- its faults

    def begin(self, fault: Fault) -> None:
        """Let a fault begin."""
        given = fault.parameters
        if fault.kind == "object":
            self._put(given["leak"])
        elif fault.kind == "object_lost":
            self._put(None)
        elif fault.kind == "gripper_fault":
            self._fault = given["code"]
        elif fault.kind == "unpowered":
            self.powered = False
        elif fault.kind == "deactivated":
            self.command(0, bytes(6))
        elif fault.kind == "deactivated_meanwhile":
            self._resets_next = True
        elif fault.kind == "activated":
            self.command(0, bytes((ACT, 0, 0, 0, 0, 0)))
        else:
            self.command(0, bytes((ACT | ADVANCED | GTO, 0, 0, given["pressure"], 20, 90)))

    def end(self, fault: Fault) -> None:
        """Let it end."""
        if fault.kind == "object":
            self._put(None)
        elif fault.kind == "gripper_fault" and self._fault < MAJOR:
            self._fault = 0
        elif fault.kind == "unpowered":
            self.powered = True
            self.command(0, bytes(6))

    def _put(self, leak: float | None) -> None:
        """Have something lie under the cups that leaks by a share of the pump's flow, or nothing."""
        self.cups.leak = None if leak is None else leak / EVACUATING

    def status(self) -> dict[str, Any]:
        """What a test or a person wants to know."""
        return {
            "vacuum": self.cups.vacuum,
            "ready": self._ready,
            "pump": self._runs,
            "valve": self._valve,
            "object": self._object,
            "fault": self._fault,
            "written": bytes(self.written).hex(" "),
            "writes": self.writes,
            "releases": self.releases,
        }

    def gauges(self) -> list[Gauges]:
        """What the page shows."""
        vacuum: Gauge = {
            "name": "vacuum",
            "low": 0.0,
            "high": 100.0,
            "value": SURROUNDING - self.pressure,
        }
        return [{"title": "Cups", "unit": "kPa", "rate": "", "digits": 1, "gauges": [vacuum]}]

"""The simulated gripper: fingers, what lies between them, and the six bytes of its status."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from crtk_sim_backends.kit import Fault, FaultKind, Parameter
from crtk_sim_backends.robotiq.models import MODELS

ACT: Final = 0x01
GTO: Final = 0x08
ATR: Final = 0x10

RESET, ACTIVATING, ACTIVE = 0, 1, 3
MOVING, OPENED_ONTO, CLOSED_ONTO, THERE = 0, 1, 2, 3

MAJOR: Final = 0xA
"""Faults from here up need a reset."""
NOT_YET, NOT_ACTIVE, SILENCE = 0x5, 0x7, 0x9

QUIET: Final = 1.0
"""Seconds without a request after which fault 9 is set; the next request clears it."""
PRESSING: Final = 0.1
"""Seconds for which the motor goes on to press after it has stalled; the screw holds without it."""
RUNNING_CURRENT: Final = 0.1
NEWTONS_PER_AMPERE: Final = 250.0

_CODE = Parameter(int, minimum=0, maximum=15)
_WIDTH = Parameter(float, minimum=0.0, maximum=0.2)
KINDS: Final[Mapping[str, FaultKind]] = {
    kind.name: kind
    for kind in (
        FaultKind(
            "object",
            "something lies between the fingers, or around them",
            {
                "width": _WIDTH,
                "stiffness": Parameter(float, 1e5, minimum=100.0),
                "around": Parameter(bool, False),
            },
            lasting=True,
        ),
        FaultKind("object_lost", "what lies there is gone"),
        FaultKind(
            "gripper_fault",
            "the gripper reports a fault (gFLT); one from 10 up outlasts it, until a reset",
            {"code": _CODE},
            lasting=True,
        ),
        FaultKind(
            "controller_fault",
            "the controller reports a fault (kFLT)",
            {"code": _CODE},
            lasting=True,
        ),
        FaultKind("unpowered", "no supply: it is silent, and reset when it is back", lasting=True),
        FaultKind("deactivated", "another master resets it"),
        FaultKind("activated", "another master activates it"),
        FaultKind(
            "other_master",
            "another master sends it elsewhere",
            {
                "position": Parameter(int, minimum=0, maximum=255),
                "speed": Parameter(int, 255, minimum=0, maximum=255),
            },
        ),
        FaultKind(
            "other_model",
            "it is replaced by another gripper, which is not activated",
            {"model": Parameter(str, choices=tuple(MODELS))},
        ),
    )
}


@dataclass
class Thing:
    """Something to grip: width in m, stiffness in N/m; `around`: the fingers open onto it."""

    width: float
    stiffness: float
    around: bool


class Gripper:
    """One gripper. Positions inside are counts of gPO: 0 open to 255 closed.

    Args:
        model: one of `MODELS`.
        band: counts at which the fingers are open and closed as far as they go.
        activated: whether somebody has activated it already.
        lag: seconds by which gOBJ comes later than the echo of a request.
    """

    kinds = KINDS

    def __init__(
        self, model: str, band: tuple[float, float], *, activated: bool, lag: float
    ) -> None:
        self._lag = lag
        self.model = MODELS[model]
        self.band = band
        self.position = band[0]
        self.written = bytearray(6)
        self.powered = True
        self.writes = 0
        self.widest = 0.0
        self._state = RESET
        self._object = MOVING
        self._told = MOVING
        self._told_late = 0.0
        self._fault = self._controller_fault = 0
        self._sweep: list[float] = []
        self.thing: Thing | None = None
        self.current = 0.0
        self._stalled = 0.0
        self._quiet = 0.0
        if activated:
            self.written[0], self._state = ACT, ACTIVE

    # ------------------------------------------------------------------------------- its registers

    def heard(self) -> None:
        """A request was understood, whatever it was."""
        self._quiet = 0.0
        if self._fault == SILENCE:
            self._fault = 0

    def write(self, at: int, data: bytes) -> None:
        """Take bytes of the registers from 1000 on, from byte `at`."""
        before = bytes(self.written)
        self.written[at : at + len(data)] = data
        self.writes += 1
        action = self.written[0]
        if not action & ACT:
            self._state, self._sweep, self._object, self.current = RESET, [], MOVING, 0.0
            self._fault = NOT_ACTIVE if action & GTO else 0
        elif not before[0] & ACT:
            self._state, self._sweep = ACTIVATING, [self.band[0], self.band[1], self.band[0]]
            self._fault = 0
        elif action & GTO and self._state == ACTIVATING:
            self._fault = NOT_YET
        elif self._fault in (NOT_YET, NOT_ACTIVE):
            self._fault = 0
        if self.written != before and action & GTO:
            self._object, self._told_late, self._stalled = MOVING, self._lag, 0.0

    @property
    def report(self) -> bytes:
        """The registers from 2000 on."""
        action = self.written[0]
        status = action & (ACT | GTO) | self._state << 4 | self._told << 6
        fault = self._controller_fault << 4 | self._fault
        current = min(255, round(100.0 * self.current))
        return bytes((status, 0, fault, self.written[3], round(self.position), current))

    # ------------------------------------------------------------------------------ its mechanics

    def advance(self, seconds: float) -> None:
        """Let time pass."""
        self._quiet += seconds
        if self.powered and self._quiet > QUIET and not self._fault:
            self._fault = SILENCE
        self._told_late = max(0.0, self._told_late - seconds)
        if not self._told_late:
            self._told = self._object
        self.current = 0.0
        if not self.powered or self._fault >= MAJOR:
            return
        if self._state == ACTIVATING:
            if self._goes_to(self._sweep[0], self.model.speeds[1], self.model.forces[0], seconds):
                del self._sweep[0]
            if not self._sweep:
                self._state = ACTIVE
        elif self._state == ACTIVE and self.written[0] & (ACT | GTO) == ACT | GTO:
            self._follow(seconds)
        self.widest = max(self.widest, self.opening)

    def _follow(self, seconds: float) -> None:
        """Go to the position that was asked for."""
        _, _, _, asked, speed, force = self.written
        slow, fast = self.model.speeds
        weak, strong = self.model.forces
        goal = min(max(float(asked), self.band[0]), self.band[1])
        closes = goal > self.position
        pace, press = slow + speed / 255 * (fast - slow), weak + force / 255 * (strong - weak)
        if self._goes_to(goal, pace, press, seconds):
            blocked = abs(goal - self.position) > 0.5
            self._object = (CLOSED_ONTO if closes else OPENED_ONTO) if blocked else THERE
            self._stalled += seconds
            if blocked and self._stalled < PRESSING:
                self.current = RUNNING_CURRENT + press / NEWTONS_PER_AMPERE
        elif self._object != MOVING:  # what held it is gone
            self._object, self._stalled = MOVING, 0.0

    def _goes_to(self, goal: float, speed: float, force: float, seconds: float) -> bool:
        """Move for a while; whether it can go no further."""
        step = self._counts(speed * seconds)
        target, thing = goal, self.thing
        if thing is not None and thing.around is (goal < self.position):
            give = force / thing.stiffness
            edge = self._count_at(thing.width + give if thing.around else thing.width - give)
            beyond = edge < self.position if thing.around else edge > self.position
            target = (max(goal, edge) if thing.around else min(goal, edge)) if beyond else goal
            if not beyond and abs(edge - self.position) < 2.0 * step + 1e-6:
                target = self.position
        left = target - self.position
        self.position += min(max(left, -step), step)
        if abs(left) <= step:
            return True
        self.current = RUNNING_CURRENT
        return False

    @property
    def opening(self) -> float:
        """Between the fingers, in m."""
        return self.model.stroke * (self.band[1] - self.position) / (self.band[1] - self.band[0])

    def _counts(self, metres: float) -> float:
        return metres / self.model.stroke * (self.band[1] - self.band[0])

    def _count_at(self, opening: float) -> float:
        return self.band[1] - self._counts(opening)

    # --------------------------------------------------------------------------------- its faults

    def begin(self, fault: Fault) -> None:
        """Let a fault begin."""
        given = fault.parameters
        acts: Mapping[str, Callable[[], object]] = {
            "object": lambda: self._put(Thing(given["width"], given["stiffness"], given["around"])),
            "object_lost": lambda: self._put(None),
            "gripper_fault": lambda: setattr(self, "_fault", given["code"]),
            "controller_fault": lambda: setattr(self, "_controller_fault", given["code"]),
            "unpowered": lambda: setattr(self, "powered", False),
            "deactivated": lambda: self.write(0, bytes(6)),
            "activated": lambda: self.write(0, bytes((ACT, 0, 0, 0, 0, 0))),
            "other_master": lambda: self.write(
                0, bytes((ACT | GTO, 0, 0, given["position"], given["speed"], 0))
            ),
            "other_model": lambda: self._become(given["model"]),
        }
        acts[fault.kind]()

    def end(self, fault: Fault) -> None:
        """Let it end."""
        if fault.kind == "object":
            self._put(None)
        elif fault.kind == "controller_fault":
            self._controller_fault = 0
        elif fault.kind == "gripper_fault" and self._fault < MAJOR:
            self._fault = 0
        elif fault.kind == "unpowered":
            self.powered = True
            self.write(0, bytes(6))

    def _put(self, thing: Thing | None) -> None:
        self.thing = thing

    def _become(self, model: str) -> None:
        self.model = MODELS[model]
        self.write(0, bytes(6))

    def status(self) -> dict[str, Any]:
        """What a test or a person wants to know."""
        names = {RESET: "reset", ACTIVATING: "activating", ACTIVE: "active"}
        return {
            "opening": self.opening,
            "position": self.position,
            "state": names[self._state] if self.powered else "no power",
            "moves": bool(self.current) and self._object == MOVING,
            "object": self._object,
            "stalled": self._stalled,
            "current": self.current,
            "fault": self._fault,
            "written": bytes(self.written).hex(" "),
            "writes": self.writes,
            "widest": self.widest,
        }

"""Fingers that open and close, and what lies between them: the mechanics that simulated grippers have in
common."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum, auto
from typing import Final

from crtk_sim_backends.faults import Fault, FaultKind, Parameter
from crtk_sim_backends.page import Gauges

__all__ = ["JAW_KINDS", "Jaw", "Met", "Thing"]

NEAR: Final = 1e-4
"""Metres by which fingers may miss what they touch, or where they go."""

JAW_KINDS: Final[Mapping[str, FaultKind]] = {
    kind.name: kind
    for kind in (
        FaultKind(
            "object",
            "something lies between the fingers, or around them",
            {
                "width": Parameter(float, minimum=0.0, maximum=0.3),
                "stiffness": Parameter(float, 1e5, minimum=100.0),
                "around": Parameter(bool, False),
            },
            lasting=True,
        ),
        FaultKind("object_lost", "what lies there is gone"),
        FaultKind(
            "slip",
            "what is held slips: it becomes thinner by so many m in a second",
            {"speed": Parameter(float, 0.002, minimum=1e-6, maximum=1.0)},
            lasting=True,
        ),
        FaultKind("reset_widest", "its widest opening is counted anew"),
    )
}
"""Faults of what lies there, which `Jaw.begin` and `Jaw.end` let begin and end."""


@dataclass
class Thing:
    """Something to grip: width in m, stiffness in N/m; `around`: the fingers open onto it."""

    width: float
    stiffness: float
    around: bool = False


class Met(Enum):
    """How far fingers have come."""

    NOTHING = auto()
    """They are on their way."""
    GOAL = auto()
    OBJECT = auto()


class Jaw:
    """Fingers of one gripper, in m, m/s and N; no clock.

    Args:
        opening: between the fingers.
        width: of what lies there; 0: nothing.
        stiffness: of that.

    Attributes:
        opening: now.
        widest: that it has been.
        thing: what lies there.
        stalled: seconds for which they have pressed on it.
        pressing: with so many N.
    """

    def __init__(self, opening: float, width: float = 0.0, stiffness: float = 1e5) -> None:
        self.opening = self.widest = opening
        self.thing = Thing(width, stiffness) if width else None
        self.stalled = self.pressing = 0.0
        # What was in their way, and stays there, however far it is pressed.
        self._met: Thing | None = None
        self._slips = 0.0

    def follow(self, goal: float, speed: float, force: float, seconds: float) -> Met:
        """Move to an opening for a while, with a force against what is in the way."""
        target, step = self.edge(goal, force), speed * seconds
        left = target - self.opening
        self.opening += min(max(left, -step), step)
        self.widest = max(self.widest, self.opening)
        self.pressing = 0.0
        if abs(left) > step:
            if abs(left) > NEAR + 2.0 * step:
                self.stalled = 0.0
            return Met.NOTHING
        if abs(goal - target) <= NEAR:
            self.stalled = 0.0
            return Met.GOAL
        self.stalled += seconds
        self.pressing = force
        return Met.OBJECT

    def edge(self, goal: float, force: float) -> float:
        """Return how far they get on the way to an opening, with a force."""
        thing = self.thing
        if thing is None or thing.around is (goal < self.opening):
            return goal
        way = 1.0 if thing.around else -1.0
        edge = thing.width + way * force / thing.stiffness
        if self.stalled or way * (edge - self.opening) > -NEAR:
            self._met = thing
        if self._met is not thing:
            return goal
        return min(goal, edge) if thing.around else max(goal, edge)

    def slip(self, seconds: float) -> None:
        """Let what is held slip for a while, if it does."""
        if self.thing is not None and self._slips:
            self.thing.width = max(0.0, self.thing.width - self._slips * seconds)

    def begin(self, fault: Fault) -> bool:
        """Let a fault begin, if it is of `JAW_KINDS`; return whether it is."""
        given = fault.parameters
        if fault.kind == "object":
            self.thing = Thing(given["width"], given["stiffness"], given["around"])
        elif fault.kind == "object_lost":
            self.thing = None
        elif fault.kind == "slip":
            self._slips = given["speed"]
        elif fault.kind == "reset_widest":
            self.widest = self.opening
        return fault.kind in JAW_KINDS

    def end(self, fault: Fault) -> bool:
        """Let it end, if it is one of them; return whether it is."""
        if fault.kind == "object":
            self.thing = None
        elif fault.kind == "slip":
            self._slips = 0.0
        return fault.kind in JAW_KINDS

    @property
    def status(self) -> dict[str, float]:
        """What a test or a person wants to know."""
        return {
            "opening": self.opening,
            "widest": self.widest,
            "stalled": self.stalled,
            "pressing": self.pressing,
        }

    def gauges(self, lower: float, upper: float) -> Gauges:
        """What the page shows, of openings between two."""
        return {
            "title": "Fingers",
            "unit": "mm",
            "rate": "",
            "digits": 1,
            "gauges": [
                {
                    "name": "opening",
                    "low": 1e3 * lower,
                    "high": 1e3 * upper,
                    "value": 1e3 * self.opening,
                }
            ],
        }

"""What a gripper does, in the same words for all of them, and what is wrong with it."""

from __future__ import annotations

from enum import Enum, StrEnum
from typing import Final, NamedTuple

__all__ = ["EMPTY", "ENDS_WELL", "HELD", "ON_ITS_WAY", "Doing", "Fault", "Weight"]


class Doing(StrEnum):
    """What fingers or cups do."""

    UNKNOWN = "unknown"
    INACTIVE = "not activated"
    ERROR = "stopped by an error"
    MOVING = "moving"
    PRESSING = "closing on an object"
    THERE = "at the position"
    HOLDS = "holds an object"
    HOLDS_INSIDE = "holds an object from inside"
    HOLDS_WEAKLY = "holds an object, at the least vacuum"
    WRONG = "holds an object of another size"
    NOTHING = "nothing gripped"
    LOST = "object lost"
    REFUSED = "not feasible"
    STOPPED = "stopped"
    EVACUATING = "builds up vacuum"
    RELEASING = "lets go"
    FREE = "holds nothing"


HELD: Final = frozenset({Doing.HOLDS, Doing.HOLDS_INSIDE, Doing.HOLDS_WEAKLY, Doing.WRONG})
"""In which something is held."""
EMPTY: Final = frozenset({Doing.THERE, Doing.NOTHING, Doing.LOST, Doing.FREE})
"""In which nothing is."""
ON_ITS_WAY: Final = frozenset(
    {Doing.UNKNOWN, Doing.MOVING, Doing.PRESSING, Doing.EVACUATING, Doing.RELEASING}
)
"""In which it is not done with what it was asked for."""
ENDS_WELL: Final = frozenset({*HELD, Doing.THERE, Doing.NOTHING, Doing.FREE})
"""In which a move has reached its goal, or what was in its way."""


class Weight(Enum):
    """What a fault means for use."""

    PASSES = "passes by itself, and hinders nothing"
    INACTIVE = "not activated"
    STOPS = "stops it until its cause is gone"
    RESET = "stops it until it is made ready anew"


class Fault(NamedTuple):
    """What a gripper reports."""

    text: str
    remedy: str
    weight: Weight = Weight.STOPS

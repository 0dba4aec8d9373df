"""The table: twenty faults, the ways in which a driver meets them, and what must follow. Data only."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, NamedTuple

REST = "rest"
THINNED = 11
"""See `covering`; no divisor of what there are of anything, so that every kind has its turn."""

NOW_AND_THEN = ", not every time"
"""Ends the reason of a cell that does not fail in every run."""

ANY = "any activity"
"""In `Way.pending`."""


class Follows(StrEnum):
    """What must follow; each is a procedure of `bench.reliability.procedures`."""

    STOPS = "leaves ENABLED and stands"
    GOES_ON = "goes on"
    HOLDS = "stands, stays ENABLED"
    STARTS_LATER = "says why it does not start, starts later"
    OUTLIVED = "stands without its driver"
    RESTARTED = "starts DISABLED"
    KEPT_OUT = "the second host is refused"
    OBEYS = "stands, whatever message is lost"


class Fault(NamedTuple):
    """One of the twenty."""

    number: str
    name: str


FAULTS = (
    Fault("F1", "connection closed by the peer"),
    Fault("F2", "peer connected but silent"),
    Fault("F3", "peer does not answer at start-up"),
    Fault("F4", "packets split or coalesced"),
    Fault("F5", "corrupt data"),
    Fault("F6", "one servo or node misses its reply"),
    Fault("F7", "adapter unplugged and plugged in again"),
    Fault("F8", "loss, duplicates, another order"),
    Fault("F9", "sensor restarts"),
    Fault("F10", "CAN: no room, bus-off, interface down"),
    Fault("F11", "heartbeat lost, unexpected boot-up"),
    Fault("F12", "the hardware reports an error"),
    Fault("F13", "protective stop, emergency stop, safety fault"),
    Fault("F14", "somebody at the device takes over"),
    Fault("F15", "stream of commands stops"),
    Fault("F16", "driver's process killed or frozen"),
    Fault("F17", "driver's cycle overruns, sticks or fails"),
    Fault("F18", "system clock jumps"),
    Fault("F19", "driver restarted"),
    Fault("F20", "two hosts claim one device"),
)


@dataclass(frozen=True)
class Way:
    """A way in which a driver meets a fault, and what must follow.

    Attributes:
        fault: its number.
        name: in words, unique with the driver and the number.
        follows: what must follow.
        kind: of fault at the simulator, or one of the rig's own (`rig.OWN_KINDS`).
        parameters: of it.
        states: the operating states of which one must be announced.
        detail: words that the reason must have.
        within: declared s from the fault until the state is announced.
        stands: declared s from the fault until the joints stand; the deceleration included.
        far: how far (rad, m) a joint may go from the fault on.
        runs_on: no stop of ours counts in it. None comes to the hardware, which goes on to where it was sent
            last, or another program moves it: for `stands` at most.
        may_lose_link: for `Follows.OBEYS`, it may end the connection: a stop is refused until that is back,
            where the joints that move are stopped.
        freezes: the joints stand in it whatever they did. When they stand, and how far they go, is judged
            from its end. A walk does not take it.
        lags: joints that it held back, no further than a following error, catch up when it is over.
        repair: name of a method of the rig that does what a person does besides.
        activities: those in which it is met; all of the driver if empty.
        younger: seconds by which stamps may be too young in it, since this driver cannot know better.
        action: for `Follows.OBEYS`, what is asked for: hold, disable, pause, or close.
        pending: why a cell still fails, in words, by activity or `ANY`.
    """

    fault: str
    name: str
    follows: Follows = Follows.STOPS
    kind: str = ""
    parameters: Mapping[str, Any] = field(default_factory=dict)
    states: tuple[str, ...] = ("FAULT",)
    detail: str = ""
    within: float = 0.1
    stands: float = 1.0
    far: float = math.inf
    runs_on: bool = False
    may_lose_link: bool = False
    freezes: bool = False
    lags: bool = False
    repair: str = ""
    activities: tuple[str, ...] = ()
    younger: float = 0.0
    action: str = ""
    pending: Mapping[str, str] = field(default_factory=dict)

    def finding(self, activity: str) -> str:
        """Return why this cell still fails; empty if it must pass."""
        return self.pending.get(activity, self.pending.get(ANY, ""))


@dataclass(frozen=True)
class Absent:
    """A fault that a driver cannot meet, and why."""

    fault: str
    why: str


class Cell(NamedTuple):
    """One run: a driver meets a fault in one way while it does something."""

    driver: str
    way: Way
    activity: str

    @property
    def name(self) -> str:
        """For people, and unique."""
        return f"{self.driver} {self.way.fault} {self.way.name}, {self.activity}"


def full(driver: str, ways: tuple[Way, ...], activities: tuple[str, ...]) -> list[Cell]:
    """Return the product: each way in each activity."""
    return [
        Cell(driver, way, activity)
        for way in ways
        for activity in (way.activities or activities)
        if activity in activities
    ]


def thinned(ways: tuple[Way, ...]) -> tuple[Way, ...]:
    """Return the ways without most of those of single messages."""
    single = [way for way in ways if way.follows is Follows.OBEYS and way.kind]
    left_out = {id(way) for number, way in enumerate(single) if number % THINNED}
    return tuple(way for way in ways if id(way) not in left_out)


def single_messages(
    kinds: Mapping[str, Mapping[str, Any]], *, within: float, actions: tuple[str, ...], **more: Any
) -> tuple[Way, ...]:
    """Return F8 for each kind of message on the way to a stop: exactly one is lost, doubled or late.

    Args:
        kinds: the parameters of the fault ``message`` of a simulator, by what people call the message.
        within: declared s in which the joints stand after each action.
        actions: what is asked for.
        more: of each `Way`.
    """
    return tuple(
        Way(
            "F8",
            f"{effect}: {ordinal} {kind} after {action}",
            Follows.OBEYS,
            "message",
            {**parameters, "effect": effect, "number": number},
            stands=within,
            action=action,
            **more,
        )
        for kind, parameters in kinds.items()
        for action in actions
        for effect in ("lost", "doubled", "late")
        for number, ordinal in ((1, "1st"), (2, "2nd"))
    )


def asked_to_stop(within: float, activities: tuple[str, ...]) -> tuple[Way, ...]:
    """Return F8 of stops in a transition that moves, of which no message is lost.

    Args:
        within: declared s in which the joints stand after each.
        activities: the transitions.
    """
    return tuple(
        Way("F8", f"nothing is lost after {action}", Follows.OBEYS, stands=within,
            activities=activities, action=action)
        for action in ("hold", "disable", "pause", "close")
    )  # fmt: skip


def covering(
    driver: str, ways: tuple[Way, ...], activities: tuple[str, ...], *, thorough: bool = True
) -> list[Cell]:
    """Return a part of `full` in which each way is met, and each activity: one cell a way, in turn.

    If `thorough`, the first way that stops the driver is met in every activity. Of single messages that are
    lost on the way to a stop there are too many: one in `THINNED` is taken.
    """
    cells: list[Cell] = []
    first = next((way for way in ways if way.follows is Follows.STOPS), None) if thorough else None
    for number, way in enumerate(thinned(ways)):
        own = full(driver, (way,), activities)
        cells += own if way is first else own[number % len(own) :][:1]
    return cells

"""The power state machine of a CiA 402 drive (CiA 402-2, "finite state automaton"), as data.

`Drive402` takes the last statusword (6041) once for each SYNC and returns the controlword (6040) to send.
It never waits. It goes up only when told to, one transition after another, and gives up when one takes
too long; a drive that leaves the wanted state by itself (fault, safe torque off) is not brought back
until someone asks again.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntFlag, StrEnum
from types import MappingProxyType
from typing import Final, NamedTuple


class State(StrEnum):
    """States of a drive."""

    NOT_READY = "not ready to switch on"
    DISABLED = "switch on disabled"
    READY = "ready to switch on"
    SWITCHED_ON = "switched on"
    ENABLED = "operation enabled"
    QUICK_STOP = "quick stop active"
    FAULT_REACTION = "fault reaction active"
    FAULT = "fault"


class Status(IntFlag):
    """Bits of the statusword that mean the same in every mode."""

    READY = 0x0001
    SWITCHED_ON = 0x0002
    ENABLED = 0x0004
    FAULT = 0x0008
    VOLTAGE = 0x0010
    NO_QUICK_STOP = 0x0020
    DISABLED = 0x0040
    WARNING = 0x0080
    REMOTE = 0x0200
    TARGET_REACHED = 0x0400
    INTERNAL_LIMIT = 0x0800


class Control(IntFlag):
    """Controlwords of the commands, and bits beside them."""

    DISABLE_VOLTAGE = 0x0000
    QUICK_STOP = 0x0002
    SHUTDOWN = 0x0006
    SWITCH_ON = 0x0007
    ENABLE = 0x000F
    FAULT_RESET = 0x0080
    HALT = 0x0100


class Pattern(NamedTuple):
    """The statuswords of one state: those with `value` under `mask`."""

    state: State
    mask: int
    value: int


STATUSWORDS: Final = (
    Pattern(State.NOT_READY, 0x4F, 0x00),
    Pattern(State.DISABLED, 0x4F, 0x40),
    Pattern(State.READY, 0x6F, 0x21),
    Pattern(State.SWITCHED_ON, 0x6F, 0x23),
    Pattern(State.ENABLED, 0x6F, 0x27),
    Pattern(State.QUICK_STOP, 0x6F, 0x07),
    Pattern(State.FAULT_REACTION, 0x4F, 0x0F),
    Pattern(State.FAULT, 0x4F, 0x08),
)
"""CiA 402-2, statusword: state coding."""


def _state(low: int) -> State | None:
    return next((row.state for row in STATUSWORDS if low & row.mask == row.value), None)


_STATES: Final = tuple(_state(low) for low in range(0x80))


def decode(statusword: int) -> State | None:
    """Return the state that a statusword shows; None for a combination that no state has."""
    return _STATES[statusword & 0x7F]


class Transition(NamedTuple):
    """One transition, by its number in CiA 402-2.

    Attributes:
        command: the controlword that causes it; None if the drive makes it by itself.
    """

    number: int
    source: State
    target: State
    command: Control | None


_S = State
_C = Control

TRANSITIONS: Final = (
    Transition(1, _S.NOT_READY, _S.DISABLED, None),
    Transition(2, _S.DISABLED, _S.READY, _C.SHUTDOWN),
    Transition(3, _S.READY, _S.SWITCHED_ON, _C.SWITCH_ON),
    Transition(4, _S.SWITCHED_ON, _S.ENABLED, _C.ENABLE),
    Transition(5, _S.ENABLED, _S.SWITCHED_ON, _C.SWITCH_ON),
    Transition(6, _S.SWITCHED_ON, _S.READY, _C.SHUTDOWN),
    Transition(7, _S.READY, _S.DISABLED, _C.DISABLE_VOLTAGE),
    Transition(8, _S.ENABLED, _S.READY, _C.SHUTDOWN),
    Transition(9, _S.ENABLED, _S.DISABLED, _C.DISABLE_VOLTAGE),
    Transition(10, _S.SWITCHED_ON, _S.DISABLED, _C.DISABLE_VOLTAGE),
    Transition(11, _S.ENABLED, _S.QUICK_STOP, _C.QUICK_STOP),
    Transition(12, _S.QUICK_STOP, _S.DISABLED, _C.DISABLE_VOLTAGE),
    Transition(14, _S.FAULT_REACTION, _S.FAULT, None),
    Transition(15, _S.FAULT, _S.DISABLED, _C.FAULT_RESET),
    Transition(16, _S.QUICK_STOP, _S.ENABLED, _C.ENABLE),
)
"""CiA 402-2, transitions. 0 and 13 (from power-up and into a fault) are not caused by a controlword."""

POWERED: Final = frozenset({State.ENABLED, State.QUICK_STOP, State.FAULT_REACTION})
"""States in which the motor has current."""

HOLDING: Final[Mapping[State, Control]] = MappingProxyType(
    {
        State.DISABLED: Control.DISABLE_VOLTAGE,
        State.READY: Control.SHUTDOWN,
        State.SWITCHED_ON: Control.SWITCH_ON,
        State.ENABLED: Control.ENABLE,
        State.QUICK_STOP: Control.QUICK_STOP,
    }
)
"""The controlword that keeps a drive where it is; its keys are the states that can be wanted."""

TIMEOUTS: Final[Mapping[int, float]] = MappingProxyType(
    {
        1: 5.0,
        2: 2.0,
        3: 5.0,
        4: 2.0,
        5: 5.0,
        6: 2.0,
        7: 1.0,
        8: 5.0,
        9: 1.0,
        10: 1.0,
        11: 1.0,
        12: 1.0,
    }
    | {14: 10.0, 15: 2.0, 16: 1.0}
)
"""Seconds in which a transition is done: ramps, brakes and the charging of a DC link take their time."""

UPWARDS: Final = frozenset({2, 3, 4, 16})
"""Transitions towards power at the motor."""

STAYS_IN_QUICK_STOP: Final = frozenset({5, 6, 7, 8})
"""Quick stop option codes (605A) with which a drive stays in quick stop active, and can go on from there."""

OPTION_CODES: Final[Mapping[int, Mapping[int, str]]] = MappingProxyType(
    {
        0x6007: {
            0: "no action",
            1: "fault signal",
            2: "disable voltage",
            3: "quick stop",
        },
        0x605A: {
            0: "disable drive function",
            1: "slow down ramp, then switch on disabled",
            2: "quick stop ramp, then switch on disabled",
            3: "current limit, then switch on disabled",
            4: "voltage limit, then switch on disabled",
            5: "slow down ramp, stay in quick stop",
            6: "quick stop ramp, stay in quick stop",
            7: "current limit, stay in quick stop",
            8: "voltage limit, stay in quick stop",
        },
        0x605B: {0: "disable drive function", 1: "slow down ramp"},
        0x605C: {0: "disable drive function", 1: "slow down ramp"},
        0x605D: {
            0: "disable drive function",
            1: "slow down ramp",
            2: "quick stop ramp",
            3: "current limit",
            4: "voltage limit",
        },
        0x605E: {
            0: "disable drive function",
            1: "slow down ramp",
            2: "quick stop ramp",
            3: "current limit",
            4: "voltage limit",
        },
    }
)
"""What codes say in abort connection, quick stop, shutdown, disable operation, halt, fault reaction."""


def option_text(index: int, code: int) -> str:
    """Return what `code` means in the option object `index`; negative codes are the manufacturer's."""
    if code < 0:
        return f"of the manufacturer ({code})"
    return OPTION_CODES[index].get(code, f"reserved ({code})")


def _routes(stays_in_quick_stop: bool) -> dict[tuple[State, State], Transition]:
    """Return the first transition of the shortest way from a state to a wanted one.

    No way leads out of a fault: that needs `Drive402.reset_fault`. A quick stop is never left
    but where it was asked for, and where a drive cannot stop quickly it is switched off.
    """
    usable = [
        row for row in TRANSITIONS if row.number != 15 and (row.number != 16 or stays_in_quick_stop)
    ]
    first: dict[tuple[State, State], Transition] = {}
    for goal in HOLDING:
        reached = deque([goal])
        seen = {goal}
        while reached:
            state = reached.popleft()
            for row in usable:
                if row.target is state and row.source not in seen:
                    seen.add(row.source)
                    reached.append(row.source)
                    first[row.source, goal] = row
    del first[State.DISABLED, State.QUICK_STOP]
    for state in (State.READY, State.SWITCHED_ON):
        first[state, State.QUICK_STOP] = first[state, State.DISABLED]
    return first


_ROUTES: Final = {stays: _routes(stays) for stays in (False, True)}


def next_transition(
    state: State, goal: State, *, stays_in_quick_stop: bool = False
) -> Transition | None:
    """Return the transition to make now; None when there is none to make, or no way but a fault reset."""
    return _ROUTES[stays_in_quick_stop].get((state, goal))


@dataclass(frozen=True)
class Failure:
    """Why a drive is not in the state that was wanted.

    Attributes:
        state: that it shows; None for a statusword without a state.
        goal: that was wanted.
        statusword: last one.
        text: for people.
    """

    state: State | None
    goal: State
    statusword: int
    text: str


_HINTS: Final[Mapping[int, str]] = MappingProxyType(
    {
        2: "; check its power supply, safe torque off and enable inputs",
        3: "; check the voltage of its power stage and safe torque off",
        4: "; check its brake, its mode of operation, and that a setpoint is there",
    }
)
"""What keeps a drive from a transition upwards, where the statusword does not tell."""

_EDGE: Final = 0.01
"""Seconds with bit 7 low before a fault reset: longer than a cycle, so that the drive sees the edge."""


_STATELESS: Final = 0.1
"""Seconds in which a drive that is to follow may tell statuswords that no state has."""


class Drive402:
    """One axis. `step` is called once for each SYNC; the rest tells what is wanted.

    Args:
        stays_in_quick_stop: whether the quick stop option code (605A) of the drive is one of
            `STAYS_IN_QUICK_STOP`.
        timeouts: seconds by number of transition, where they differ from `TIMEOUTS`.

    Attributes:
        state: shown by the last statusword; None before the first one, and for one without a state.
        statusword: the last one.
        goal: the state that is wanted.
        reached: whether the drive was there at the last step.
        failure: why it could not be reached, or was left; None from the time a state is asked for again.
        halt: sets bit 8 of the controlword while operation is enabled.
        mode_bits: bits 4, 5, 6 and 9 of the controlword while operation is enabled.
    """

    def __init__(
        self, *, stays_in_quick_stop: bool = False, timeouts: Mapping[int, float] | None = None
    ) -> None:
        self.state: State | None = None
        self.statusword = 0
        self.goal = State.DISABLED
        self.reached = False
        self.failure: Failure | None = None
        self.halt = False
        self.mode_bits = 0
        self._stays = stays_in_quick_stop
        self._timeouts = {**TIMEOUTS, **(timeouts or {})}
        self._running: Transition | None = None
        self._since = 0.0
        self._reset_since: float | None = None
        self._reset_wanted = False
        self._sent = int(Control.DISABLE_VOLTAGE)
        self._stateless_since = math.inf

    def request(self, goal: State) -> None:
        """Want a state, and forget the last failure.

        Raises:
            ValueError: no controlword leads there.
        """
        if goal not in HOLDING:
            raise ValueError(f"a drive cannot be brought to {goal}")
        self._reset_wanted = False
        self._want(goal, None)

    def reset_fault(self) -> None:
        """Want switch on disabled, by one fault reset if the drive is in fault."""
        self._reset_wanted, self._reset_since = True, None
        self._want(State.DISABLED, None)

    def step(self, statusword: int, now: float) -> int:
        """Return the controlword to send.

        Args:
            statusword: of the last TPDO.
            now: monotonic seconds.
        """
        self.statusword = statusword
        self.state = decode(statusword)
        if self.state is not None:
            self._stateless_since = math.inf
        if self.state is State.FAULT:
            self._sent = self._in_fault(now)
        elif self.state is not None:
            self._sent = self._on_the_way(self.state, now)
        else:
            self._sent = self._without_state(now)
        return self._sent

    def _without_state(self, now: float) -> int:
        if self.goal is State.ENABLED:
            self._stateless_since = min(self._stateless_since, now)
            if now - self._stateless_since <= _STATELESS:
                return self._sent
            self._fail(State.QUICK_STOP, "it shows no state")
        return int(HOLDING[self.goal])  # leads downwards from wherever it is

    def _on_the_way(self, state: State, now: float) -> int:
        if state is not State.FAULT_REACTION:
            self._reset_wanted = False
        if self.reached and state is not self.goal:
            self._left(state)
        if state is State.DISABLED and self.goal is State.QUICK_STOP:
            self._want(State.DISABLED, self.failure)  # it has stopped, or had nothing to stop
        if state is self.goal:
            self.reached, self._running = True, None
            return self._held()
        transition = next_transition(state, self.goal, stays_in_quick_stop=self._stays)
        if transition is None:
            if state is State.FAULT_REACTION and self.goal is not State.DISABLED:
                self._fail(State.DISABLED, "it reacts to a fault")
            return int(Control.DISABLE_VOLTAGE)
        if transition is not self._running:
            self._running, self._since = transition, now
        elif now - self._since > self._timeouts[transition.number] and self.failure is None:
            self._late(transition)
            if transition.number in UPWARDS:
                return int(Control.DISABLE_VOLTAGE)
        return int(transition.command or Control.DISABLE_VOLTAGE)

    def _held(self) -> int:
        word = int(HOLDING[self.goal])
        if self.goal is State.ENABLED:
            word |= self.mode_bits | self.halt * int(Control.HALT)
        return word

    def _in_fault(self, now: float) -> int:
        if not self._reset_wanted:
            if self.goal is not State.DISABLED:
                self._fail(State.DISABLED, "it is in fault")
            self.reached = False
            return int(Control.DISABLE_VOLTAGE)
        if self._reset_since is None:
            self._reset_since = now
        passed = now - self._reset_since
        if passed < _EDGE:
            return int(Control.DISABLE_VOLTAGE)
        if passed > _EDGE + self._timeouts[15]:
            self._reset_wanted = False
            self._fail(
                State.DISABLED, "a fault reset did not clear the fault: its cause is still there"
            )
            return int(Control.DISABLE_VOLTAGE)
        return int(Control.FAULT_RESET)

    def _left(self, state: State) -> None:
        """Take note that the drive left the wanted state by itself; follow it down, never back up."""
        if self.goal in (State.ENABLED, State.SWITCHED_ON, State.READY):
            # A drive that stops quickly by itself is not cut off in the middle of its ramp.
            goal = State.QUICK_STOP if state is State.QUICK_STOP else State.DISABLED
            self._fail(goal, f"it went to {state} by itself{self._hint()}")
        self.reached = False

    def _late(self, transition: Transition) -> None:
        seconds = self._timeouts[transition.number]
        goal = State.DISABLED if transition.number in UPWARDS else self.goal
        hint = self._hint() or _HINTS.get(transition.number, "")
        self._fail(goal, f"it is still {transition.source} after {seconds:g} s{hint}")

    def _hint(self) -> str:
        if not self.statusword & Status.REMOTE:
            return "; remote (bit 9) is 0: it takes no controlwords from the bus"
        if not self.statusword & Status.VOLTAGE:
            return "; voltage enabled (bit 4) is 0: check its power supply and safe torque off"
        return ""

    def _fail(self, goal: State, text: str) -> None:
        whole = f"{text} (statusword 0x{self.statusword:04x}, wanted: {self.goal})"
        self._want(goal, Failure(self.state, self.goal, self.statusword, whole))

    def _want(self, goal: State, failure: Failure | None) -> None:
        self.goal, self.failure = goal, failure
        self.reached, self._running = False, None

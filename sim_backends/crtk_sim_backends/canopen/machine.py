"""The state machine of a drive as a table (CiA 402-2, 8.4: finite state automaton)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Final


class State(Enum):
    """State of the drive; the value is what it shows in bits 0 to 6 of the statusword."""

    NOT_READY = 0x00
    SWITCH_ON_DISABLED = 0x40
    READY_TO_SWITCH_ON = 0x21
    SWITCHED_ON = 0x23
    OPERATION_ENABLED = 0x27
    QUICK_STOP_ACTIVE = 0x07
    FAULT_REACTION = 0x0F
    FAULT = 0x08

    __hash__ = object.__hash__  # of the identity, by which members are compared; Enum's is slow


POWERED: Final = (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION)


class Command(Enum):
    """What a controlword asks for: (mask, value)."""

    SHUTDOWN = (0x87, 0x06)
    SWITCH_ON = (0x8F, 0x07)  # "disable operation" when operation is enabled
    ENABLE_OPERATION = (0x8F, 0x0F)
    DISABLE_VOLTAGE = (0x82, 0x00)
    QUICK_STOP = (0x86, 0x02)

    __hash__ = object.__hash__


def _command_in(low: int) -> Command | None:
    return next((each for each in Command if low & each.value[0] == each.value[1]), None)


_COMMANDS: Final = tuple(_command_in(low) for low in range(256))


def command_in(controlword: int) -> Command | None:
    """Decode the command of a controlword, which is in its low byte; None when it has none."""
    return _COMMANDS[controlword & 0xFF]


class Ramp(Enum):
    """How an axis comes to rest."""

    COAST = 0
    SLOW = 1
    QUICK = 2
    LIMIT = 3  # at the current or voltage limit


@dataclass(frozen=True)
class Transition:
    """One transition: its number in the standard, where it leads, the object that says how."""

    number: int
    target: State
    option: int | None = None  # index of an option code


_S, _C = State, Command
TRANSITIONS: Final[dict[tuple[State, Command], Transition]] = {
    (_S.SWITCH_ON_DISABLED, _C.SHUTDOWN): Transition(2, _S.READY_TO_SWITCH_ON),
    (_S.READY_TO_SWITCH_ON, _C.SWITCH_ON): Transition(3, _S.SWITCHED_ON),
    (_S.READY_TO_SWITCH_ON, _C.ENABLE_OPERATION): Transition(3, _S.SWITCHED_ON),
    (_S.READY_TO_SWITCH_ON, _C.DISABLE_VOLTAGE): Transition(7, _S.SWITCH_ON_DISABLED),
    (_S.READY_TO_SWITCH_ON, _C.QUICK_STOP): Transition(7, _S.SWITCH_ON_DISABLED),
    (_S.SWITCHED_ON, _C.ENABLE_OPERATION): Transition(4, _S.OPERATION_ENABLED),
    (_S.SWITCHED_ON, _C.SHUTDOWN): Transition(6, _S.READY_TO_SWITCH_ON),
    (_S.SWITCHED_ON, _C.DISABLE_VOLTAGE): Transition(10, _S.SWITCH_ON_DISABLED),
    (_S.SWITCHED_ON, _C.QUICK_STOP): Transition(10, _S.SWITCH_ON_DISABLED),
    (_S.OPERATION_ENABLED, _C.SWITCH_ON): Transition(5, _S.SWITCHED_ON, 0x605C),
    (_S.OPERATION_ENABLED, _C.SHUTDOWN): Transition(8, _S.READY_TO_SWITCH_ON, 0x605B),
    (_S.OPERATION_ENABLED, _C.DISABLE_VOLTAGE): Transition(9, _S.SWITCH_ON_DISABLED),
    (_S.OPERATION_ENABLED, _C.QUICK_STOP): Transition(11, _S.QUICK_STOP_ACTIVE, 0x605A),
    (_S.QUICK_STOP_ACTIVE, _C.ENABLE_OPERATION): Transition(16, _S.OPERATION_ENABLED),
    (_S.QUICK_STOP_ACTIVE, _C.DISABLE_VOLTAGE): Transition(12, _S.SWITCH_ON_DISABLED),
}

RAMPS: Final[dict[int, dict[int, Ramp]]] = {
    0x605A: {0: Ramp.COAST, 1: Ramp.SLOW, 2: Ramp.QUICK, 3: Ramp.LIMIT, 4: Ramp.LIMIT,
             5: Ramp.SLOW, 6: Ramp.QUICK, 7: Ramp.LIMIT, 8: Ramp.LIMIT},
    0x605B: {0: Ramp.COAST, 1: Ramp.SLOW},
    0x605C: {0: Ramp.COAST, 1: Ramp.SLOW},
    0x605D: {1: Ramp.SLOW, 2: Ramp.QUICK, 3: Ramp.LIMIT, 4: Ramp.LIMIT},
    0x605E: {0: Ramp.COAST, 1: Ramp.SLOW, 2: Ramp.QUICK, 3: Ramp.LIMIT, 4: Ramp.LIMIT},
}  # fmt: skip

_STAYS: Final = 5  # quick stop option codes from here on stay in QUICK STOP ACTIVE


class Machine:
    """State of one axis.

    Args:
        option: reads an option code, by its index.
        permitted: whether the power stage lets a transition (its number) happen now.

    Attributes:
        state: where it is; the next four follow from it.
        word: bits 0 to 6 of the statusword.
        powered: the motor has current.
        enabled: operation is enabled.
        faulted: it is in FAULT.
        after_stop: where to go once the axis rests.
        ramp: how the axis comes to rest, None when it need not.
    """

    after_stop: State | None
    ramp: Ramp | None

    def __init__(self, option: Callable[[int], int], permitted: Callable[[int], bool]) -> None:
        self._option = option
        self._permitted = permitted
        self.reset()

    def reset(self) -> None:
        """Begin anew, as a reset of the node does."""
        self._controlword = 0
        self._enter(State.SWITCH_ON_DISABLED)  # after the automatic transitions 0 and 1

    def control(self, controlword: int, *, fault_present: bool) -> None:
        """Follow a controlword that has been received.

        Args:
            controlword: object 6040.
            fault_present: the cause of the fault is still there, so that it cannot be reset.
        """
        reset = controlword & ~self._controlword & 0x80
        self._controlword = controlword
        if self.faulted:
            if reset and not fault_present:
                self._enter(State.SWITCH_ON_DISABLED)  # transition 15
            return
        command = command_in(controlword)
        if command is None:
            return
        if self.state is State.READY_TO_SWITCH_ON and command is Command.ENABLE_OPERATION:
            self._follow(command)
        self._follow(command)

    def _follow(self, command: Command) -> None:
        transition = TRANSITIONS.get((self.state, command))
        if transition is None or not self._permitted(transition.number):
            if self.enabled and command is Command.ENABLE_OPERATION:
                self.after_stop = self.ramp = None
            return
        if transition.number == 16 and self._option(0x605A) < _STAYS:
            return
        if transition.option is None:
            self._enter(transition.target)
            return
        option = self._option(transition.option)
        ramp = RAMPS[transition.option][option]
        if transition.target is State.QUICK_STOP_ACTIVE:
            self._enter(State.QUICK_STOP_ACTIVE)
            self.after_stop = State.SWITCH_ON_DISABLED if option < _STAYS else None
            self.ramp = ramp
        elif ramp is Ramp.COAST:
            self._enter(transition.target)
        else:
            self.after_stop, self.ramp = transition.target, ramp
        if ramp is Ramp.COAST and self.after_stop:
            self._enter(self.after_stop)

    def fault(self) -> None:
        """Go to FAULT, by way of the fault reaction when the motor is powered."""
        if self.state in (State.FAULT, State.FAULT_REACTION):
            return
        ramp = RAMPS[0x605E][self._option(0x605E)]
        if not self.powered or ramp is Ramp.COAST:
            self._enter(State.FAULT)
            return
        self._enter(State.FAULT_REACTION)
        self.after_stop, self.ramp = State.FAULT, ramp

    def cut_power(self, *, fault: bool) -> None:
        """Lose the power stage at once."""
        self._enter(State.FAULT if fault else State.SWITCH_ON_DISABLED)

    def quick_stop(self) -> None:
        """Stop as the controlword would ask for."""
        self._follow(Command.QUICK_STOP)

    def rested(self) -> None:
        """The axis has come to rest: a transition that waited for it happens."""
        if self.after_stop is not None:
            self._enter(self.after_stop)

    def _enter(self, state: State) -> None:
        self.state = state
        self.word = state.value
        self.powered = state in POWERED
        self.enabled = state is State.OPERATION_ENABLED
        self.faulted = state is State.FAULT
        self.after_stop = self.ramp = None

"""The operating state as data (CRTK api-operating-state.rst). Pure: no clock, no thread, no device.

    from \\ command   enable          disable         pause       resume
    DISABLED         -> ENABLED      stay            invalid     invalid
    ENABLED          stay            -> DISABLED     -> PAUSED   invalid
    PAUSED           invalid         -> DISABLED     stay        -> ENABLED
    FAULT            -> ENABLED      -> DISABLED     invalid     invalid

No command leads to FAULT: only the device does. `home` and `unhome` set is_homed and leave the state.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType

from crtk_drivers.errors import CommandRefused, Reason


class OperatingState(StrEnum):
    """The four meta-states of a CRTK device."""

    DISABLED = "DISABLED"
    ENABLED = "ENABLED"
    PAUSED = "PAUSED"
    FAULT = "FAULT"


class StateCommand(StrEnum):
    """What may be said on ``state_command``."""

    ENABLE = "enable"
    DISABLE = "disable"
    PAUSE = "pause"
    RESUME = "resume"
    HOME = "home"
    UNHOME = "unhome"


_S, _C = OperatingState, StateCommand

TRANSITIONS: Mapping[tuple[OperatingState, StateCommand], OperatingState] = MappingProxyType(
    {
        (_S.DISABLED, _C.ENABLE): _S.ENABLED,
        (_S.DISABLED, _C.DISABLE): _S.DISABLED,
        (_S.ENABLED, _C.ENABLE): _S.ENABLED,
        (_S.ENABLED, _C.DISABLE): _S.DISABLED,
        (_S.ENABLED, _C.PAUSE): _S.PAUSED,
        (_S.PAUSED, _C.DISABLE): _S.DISABLED,
        (_S.PAUSED, _C.PAUSE): _S.PAUSED,
        (_S.PAUSED, _C.RESUME): _S.ENABLED,
        (_S.FAULT, _C.ENABLE): _S.ENABLED,
        (_S.FAULT, _C.DISABLE): _S.DISABLED,
    }
)
"""The state that a command leads to; a pair that is absent is invalid."""

HOMING_STATES = frozenset({OperatingState.ENABLED})
"""Where `home` is accepted: homing may move. `unhome` moves nothing and is accepted everywhere."""

HOMING_COMMANDS = frozenset({StateCommand.HOME, StateCommand.UNHOME})
"""They leave the operating state as it is."""

STOPS = frozenset({StateCommand.PAUSE, StateCommand.DISABLE})
"""They stop what moves, in any state, also where they are refused."""


REPEATED = "repeated"
"""The `frame_id` of a state command that is sent again, with the stamp of the first, as it is not confirmed.

A driver that has carried out the first, and something newer after it, does not carry it out once more."""


@dataclass(frozen=True, slots=True)
class Status:
    """What ``operating_state`` says.

    `detail` is the reason of FAULT or PAUSED in words. After a connection DISABLED has one, too: that the
    link was lost and is back, and how the device was found. Otherwise it is empty. It does not name the
    device, and ends with `remedy`: what to do about it, if that is known.

    `connecting`: the first attempt to reach the hardware is not over. CRTK has no state for that. It is told
    as FAULT, so that DISABLED always means that the device can be enabled; but nothing is wrong.
    """

    state: OperatingState = OperatingState.DISABLED
    is_homed: bool = False
    is_busy: bool = False
    detail: str = ""
    remedy: str = ""
    connecting: bool = False

    @property
    def cause(self) -> str:
        """The reason without the remedy, for a text that goes on."""
        return self.detail.removesuffix(self.remedy).rstrip(" .") if self.remedy else self.detail


def parse_command(text: str) -> StateCommand:
    """Return the state command of `text`, which must match exactly.

    Raises:
        CommandRefused: no such command; the message lists the valid ones.
    """
    try:
        return StateCommand(text)
    except ValueError:
        begin = str(text)[:80]
        raise CommandRefused(
            "state_command",
            Reason.UNKNOWN_COMMAND,
            f"{begin!r} is not a state command",
            remedy=f"Valid, exactly as written: {', '.join(StateCommand)}.",
            state_command=begin,
        ) from None


def target_of(state: OperatingState, command: StateCommand) -> OperatingState:
    """Return the state that `command` leads to from `state`.

    Raises:
        CommandRefused: the command is invalid in this state; the message lists what is valid.
    """
    if command is StateCommand.UNHOME or (command is StateCommand.HOME and state in HOMING_STATES):
        return state
    try:
        return TRANSITIONS[state, command]
    except KeyError:
        homing = [_C.HOME, _C.UNHOME] if state in HOMING_STATES else [_C.UNHOME]
        valid = [*(c for s, c in TRANSITIONS if s is state), *homing]
        raise CommandRefused(
            "state_command",
            Reason.INVALID_TRANSITION,
            f"{command} is invalid in {state}",
            remedy=f"From {state}: {', '.join(valid)}.",
            state_command=command,
        ) from None

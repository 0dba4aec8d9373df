"""What the controller says of itself, and the operating state that it allows.

Numbers: Universal Robots, "Real-Time Data Exchange (RTDE) Guide", output fields `robot_mode`,
`safety_mode`, `runtime_state`, `robot_status_bits` and `safety_status_bits`.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum, IntFlag
from functools import lru_cache
from types import MappingProxyType

from crtk_driver_ur.rtde.state_sample import StateSample
from crtk_drivers.device import Condition
from crtk_drivers.state import OperatingState

__all__ = [
    "PAUSED_PROGRAM",
    "STANDING_PROGRAM",
    "STILL",
    "RobotMode",
    "RobotStatus",
    "RuntimeState",
    "SafetyMode",
    "SafetyStatus",
    "condition_of",
    "found_in",
    "name_of",
    "stood",
]


class RobotMode(IntEnum):
    """Where the arm is on its way from power off to running."""

    NO_CONTROLLER = -1
    DISCONNECTED = 0
    CONFIRM_SAFETY = 1
    BOOTING = 2
    POWER_OFF = 3
    POWER_ON = 4
    IDLE = 5
    BACKDRIVE = 6
    RUNNING = 7
    UPDATING_FIRMWARE = 8


class SafetyMode(IntEnum):
    """State of the safety system."""

    NORMAL = 1
    REDUCED = 2
    PROTECTIVE_STOP = 3
    RECOVERY = 4
    SAFEGUARD_STOP = 5
    SYSTEM_EMERGENCY_STOP = 6
    ROBOT_EMERGENCY_STOP = 7
    VIOLATION = 8
    FAULT = 9
    VALIDATE_JOINT_ID = 10
    UNDEFINED = 11
    AUTOMATIC_MODE_SAFEGUARD_STOP = 12
    SYSTEM_THREE_POSITION_ENABLING_STOP = 13


class RuntimeState(IntEnum):
    """State of the program that runs on the controller."""

    STOPPING = 0
    STOPPED = 1
    PLAYING = 2
    PAUSING = 3
    PAUSED = 4
    RESUMING = 5


STANDING_PROGRAM = frozenset({RuntimeState.STOPPING, RuntimeState.STOPPED})
"""States in which no program runs, or not for long."""

PAUSED_PROGRAM = frozenset({RuntimeState.PAUSING, RuntimeState.PAUSED})
"""States in which a program carries nothing out, but can be continued."""


def stood(state: StateSample) -> bool:
    """Return whether no program ran in a state, or in one that was passed over since the one before."""
    return not STANDING_PROGRAM.isdisjoint((state.runtime_state, *state.passed))


def name_of(kind: type[IntEnum], number: int) -> str:
    """Return the name of a mode; of one that this driver does not know, its number."""
    try:
        return kind(number).name
    except ValueError:
        return f"unknown ({number})"


class RobotStatus(IntFlag):
    """Bits of `robot_status_bits`."""

    POWER_ON = 1 << 0
    PROGRAM_RUNNING = 1 << 1
    TEACH_BUTTON_PRESSED = 1 << 2
    POWER_BUTTON_PRESSED = 1 << 3


class SafetyStatus(IntFlag):
    """Bits of `safety_status_bits`."""

    NORMAL = 1 << 0
    REDUCED = 1 << 1
    PROTECTIVE_STOPPED = 1 << 2
    RECOVERY = 1 << 3
    SAFEGUARD_STOPPED = 1 << 4
    SYSTEM_EMERGENCY_STOPPED = 1 << 5
    ROBOT_EMERGENCY_STOPPED = 1 << 6
    EMERGENCY_STOPPED = 1 << 7
    VIOLATION = 1 << 8
    FAULT = 1 << 9
    STOPPED_DUE_TO_SAFETY = 1 << 10
    THREE_POSITION_ENABLING_INPUT_ACTIVE = 1 << 11


_FREE = Condition()
_FAULT, _PAUSED, _DISABLED = OperatingState.FAULT, OperatingState.PAUSED, OperatingState.DISABLED

SAFETY_CONDITIONS: Mapping[SafetyMode, Condition] = MappingProxyType(
    {
        SafetyMode.NORMAL: _FREE,
        SafetyMode.REDUCED: _FREE,
        SafetyMode.PROTECTIVE_STOP: Condition(
            _FAULT,
            "protective stop. Find out what stopped the arm, unlock it by unlock_protective_stop (at the "
            "earliest 5 s after the stop), then enable.",
        ),
        SafetyMode.RECOVERY: Condition(
            _FAULT,
            "recovery mode: the arm is outside its safety limits. Move it back by freedrive or "
            "jogging on the teach pendant, then enable.",
        ),
        SafetyMode.SAFEGUARD_STOP: Condition(
            _PAUSED, "safeguard stop. Close the guard or leave the scanned area, then resume."
        ),
        SafetyMode.SYSTEM_EMERGENCY_STOP: Condition(
            _FAULT,
            "emergency stop of the cell. Release the button that is connected to the controller, "
            "then enable.",
        ),
        SafetyMode.ROBOT_EMERGENCY_STOP: Condition(
            _FAULT, "emergency stop on the teach pendant. Release the button, then enable."
        ),
        SafetyMode.VIOLATION: Condition(
            _FAULT, "safety violation. Read the log on the teach pendant and restart the safety."
        ),
        SafetyMode.FAULT: Condition(
            _FAULT, "safety fault. Read the log on the teach pendant and restart the controller."
        ),
        SafetyMode.VALIDATE_JOINT_ID: Condition(
            _FAULT, "a joint was exchanged. Validate its identity on the teach pendant."
        ),
        SafetyMode.UNDEFINED: Condition(
            _FAULT, "the safety system reports no mode. Restart the controller."
        ),
        SafetyMode.AUTOMATIC_MODE_SAFEGUARD_STOP: Condition(
            _PAUSED, "safeguard stop of the automatic mode. Close the guard, then resume."
        ),
        SafetyMode.SYSTEM_THREE_POSITION_ENABLING_STOP: Condition(
            _PAUSED, "the enabling switch is not held. Hold it in its middle position, then resume."
        ),
    }
)
"""What each safety mode allows."""

ROBOT_CONDITIONS: Mapping[RobotMode, Condition] = MappingProxyType(
    {
        RobotMode.NO_CONTROLLER: Condition(
            _FAULT, "the controller is not running. Start it on the teach pendant."
        ),
        RobotMode.DISCONNECTED: Condition(
            _FAULT, "the controller has lost the arm. Check the cable of the arm and restart."
        ),
        RobotMode.CONFIRM_SAFETY: Condition(
            _DISABLED, "the safety configuration waits to be confirmed on the teach pendant."
        ),
        RobotMode.BOOTING: Condition(_DISABLED, "the controller is starting. Wait, then enable."),
        RobotMode.POWER_OFF: Condition(_DISABLED, "the arm has no power. Enable powers it."),
        RobotMode.POWER_ON: Condition(_DISABLED, "the arm is powering up. Wait, then enable."),
        RobotMode.IDLE: Condition(
            _DISABLED,
            "the brakes are engaged. Enable releases them, and the arm may move a little.",
        ),
        RobotMode.BACKDRIVE: Condition(
            _PAUSED, "the arm is being moved by hand (backdrive). Let it go, then resume."
        ),
        RobotMode.RUNNING: _FREE,
        RobotMode.UPDATING_FIRMWARE: Condition(
            _DISABLED, "the firmware of the arm is being updated. Wait; do not switch it off."
        ),
    }
)
"""What each robot mode allows, when the safety system allows everything."""

STILL = 1e-3
"""rad/s below which a target speed counts as standing still."""


def found_in(state: StateSample | None) -> str:
    """Return in what moving or powered state an arm is, in words; empty if it cannot move by itself."""
    if state is None or state.robot_mode != RobotMode.RUNNING:
        return ""
    moves = max(map(abs, state.target_qd)) >= STILL
    parts = (
        (True, "its brakes were already released"),
        (state.runtime_state not in STANDING_PROGRAM, "a program runs on the controller"),
        (moves, "the arm moves"),
    )
    return "not under our control: " + ", ".join(text for holds, text in parts if holds)


LOCAL_CONTROL = Condition(
    _PAUSED, "the teach pendant has control (local). Switch it to remote control, then resume."
)
TEACH_BUTTON = Condition(
    _PAUSED, "the freedrive button of the teach pendant is pressed. Let it go, then resume."
)
PROGRAM_PAUSED = Condition(
    _PAUSED,
    "the program was paused on the teach pendant. Stop it there (or by stop_program) if it has not ended, "
    "then resume.",
)


@lru_cache(64)
def condition_of(
    robot_mode: int,
    safety_mode: int,
    runtime_state: int,
    robot_status: int,
    remote_control: bool | None = None,
) -> Condition:
    """Return the best operating state that the controller allows, with the reason.

    The worst finding wins, in this order: safety system, power of the arm, hands on the pendant.

    Args:
        robot_mode, safety_mode, runtime_state, robot_status: as read over RTDE.
        remote_control: the dashboard's answer; None where it is not known (CB3 has no such mode).
    """
    try:
        safety = SAFETY_CONDITIONS[SafetyMode(safety_mode)]
        robot = ROBOT_CONDITIONS[RobotMode(robot_mode)]
    except ValueError:
        return Condition(
            _FAULT,
            f"robot mode {robot_mode} with safety mode {safety_mode} is unknown to this driver. "
            "Report it with the version of the controller's software.",
        )
    if safety is not _FREE:
        return safety
    if robot is not _FREE:
        return robot
    if remote_control is False:
        return LOCAL_CONTROL
    if robot_status & RobotStatus.TEACH_BUTTON_PRESSED:
        return TEACH_BUTTON
    if runtime_state in PAUSED_PROGRAM:
        return PROGRAM_PAUSED
    return _FREE

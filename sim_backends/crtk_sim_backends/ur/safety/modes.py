"""Robot modes, safety modes and runtime states, and what each of them permits, as tables.

Numbers: Universal Robots RTDE guide (robot_mode, safety_mode, runtime_state, joint_mode,
robot_status_bits, safety_status_bits).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, IntEnum, IntFlag
from typing import Final

from crtk_sim_backends.ur.messages import ReportLevel


class RobotMode(IntEnum):
    """`robot_mode` of RTDE."""

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
    """`safety_mode` and `safety_status` of RTDE."""

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
    """`runtime_state` of RTDE."""

    STOPPING = 0
    STOPPED = 1
    PLAYING = 2
    PAUSING = 3
    PAUSED = 4
    RESUMING = 5


class JointMode(IntEnum):
    """`joint_mode` of RTDE."""

    RESET = 235
    SHUTTING_DOWN = 236
    BACKDRIVE = 238
    POWER_OFF = 239
    READY_FOR_POWER_OFF = 240
    NOT_RESPONDING = 245
    MOTOR_INITIALISATION = 246
    BOOTING = 247
    VIOLATION = 251
    FAULT = 252
    RUNNING = 253
    IDLE = 255


class RobotStatus(IntFlag):
    """`robot_status_bits` of RTDE."""

    POWER_ON = 1
    PROGRAM_RUNNING = 2
    TEACH_BUTTON = 4
    POWER_BUTTON = 8


class SafetyStatus(IntFlag):
    """`safety_status_bits` of RTDE."""

    NORMAL = 1
    REDUCED = 2
    PROTECTIVE_STOPPED = 4
    RECOVERY = 8
    SAFEGUARD_STOPPED = 16
    SYSTEM_EMERGENCY_STOPPED = 32
    ROBOT_EMERGENCY_STOPPED = 64
    EMERGENCY_STOPPED = 128
    VIOLATION = 256
    FAULT = 512
    STOPPED_DUE_TO_SAFETY = 1024
    THREE_POSITION_ENABLING = 2048


class ProgramRule(Enum):
    """What a safety mode does to the running program."""

    RUN = "run"
    PAUSE = "pause"
    STOP = "stop"


@dataclass(frozen=True)
class SafetyRule:
    """What a safety mode means: its status bits, the fate of the program, the arm's power."""

    bits: SafetyStatus
    program: ProgramRule
    keeps_power: bool = True
    speed_limit: float = 1.0  # largest speed scaling
    deceleration: float = 10.0  # of a moving arm that is no longer commanded, rad/s^2


_STOPPED: Final = SafetyStatus.STOPPED_DUE_TO_SAFETY
_EMERGENCY: Final = SafetyStatus.EMERGENCY_STOPPED | _STOPPED

SAFETY_RULES: Final[dict[SafetyMode, SafetyRule]] = {
    SafetyMode.FAULT: SafetyRule(
        SafetyStatus.FAULT | _STOPPED, ProgramRule.STOP, False, deceleration=20.0
    ),
    SafetyMode.VIOLATION: SafetyRule(
        SafetyStatus.VIOLATION | _STOPPED, ProgramRule.STOP, False, deceleration=20.0
    ),
    SafetyMode.ROBOT_EMERGENCY_STOP: SafetyRule(
        SafetyStatus.ROBOT_EMERGENCY_STOPPED | _EMERGENCY,
        ProgramRule.STOP,
        False,
        deceleration=20.0,
    ),
    SafetyMode.SYSTEM_EMERGENCY_STOP: SafetyRule(
        SafetyStatus.SYSTEM_EMERGENCY_STOPPED | _EMERGENCY,
        ProgramRule.STOP,
        False,
        deceleration=20.0,
    ),
    SafetyMode.SYSTEM_THREE_POSITION_ENABLING_STOP: SafetyRule(
        SafetyStatus.THREE_POSITION_ENABLING | _STOPPED, ProgramRule.PAUSE
    ),
    SafetyMode.AUTOMATIC_MODE_SAFEGUARD_STOP: SafetyRule(
        SafetyStatus.SAFEGUARD_STOPPED | _STOPPED, ProgramRule.PAUSE
    ),
    SafetyMode.SAFEGUARD_STOP: SafetyRule(
        SafetyStatus.SAFEGUARD_STOPPED | _STOPPED, ProgramRule.PAUSE
    ),
    SafetyMode.PROTECTIVE_STOP: SafetyRule(
        SafetyStatus.PROTECTIVE_STOPPED | _STOPPED, ProgramRule.STOP, deceleration=20.0
    ),
    SafetyMode.RECOVERY: SafetyRule(SafetyStatus.RECOVERY, ProgramRule.STOP),
    SafetyMode.REDUCED: SafetyRule(SafetyStatus.REDUCED, ProgramRule.RUN, speed_limit=0.5),
    SafetyMode.NORMAL: SafetyRule(SafetyStatus.NORMAL, ProgramRule.RUN),
}
"""What each safety mode means, the gravest first: of several causes the first one shows."""

POWER_UP: Final[dict[RobotMode, tuple[float, RobotMode]]] = {
    RobotMode.DISCONNECTED: (0.0, RobotMode.BOOTING),  # a boot takes what the option says
    RobotMode.BOOTING: (0.0, RobotMode.POWER_OFF),
    RobotMode.POWER_OFF: (0.25, RobotMode.POWER_ON),
    RobotMode.POWER_ON: (0.375, RobotMode.IDLE),
    RobotMode.IDLE: (0.375, RobotMode.RUNNING),
}
"""Next robot mode on the way up, and which part of the time to RUNNING it takes to get there."""

BOOT_STEPS: Final = 2

POWER_SECONDS: Final = 0.8
"""From POWER_OFF to RUNNING."""

POWER_OFF_SECONDS: Final = 0.2

JOINT_MODES: Final[dict[RobotMode, JointMode]] = {
    RobotMode.DISCONNECTED: JointMode.NOT_RESPONDING,
    RobotMode.BOOTING: JointMode.NOT_RESPONDING,
    RobotMode.POWER_OFF: JointMode.POWER_OFF,
    RobotMode.POWER_ON: JointMode.BOOTING,
    RobotMode.IDLE: JointMode.IDLE,
    RobotMode.BACKDRIVE: JointMode.BACKDRIVE,
    RobotMode.RUNNING: JointMode.RUNNING,
}

PROTECTIVE_STOP_LOCK_SECONDS: Final = 5.0
"""A protective stop cannot be unlocked before this time has passed."""

JOINTS: Final = ("Base", "Shoulder", "Elbow", "Wrist 1", "Wrist 2", "Wrist 3")

STOP_REASONS: Final[dict[tuple[int, int], str]] = {
    (150, 0): "Position close to joint limits",
    **{(153, i): f"Position deviates from path: {joint}" for i, joint in enumerate(JOINTS)},
    (154, 0): "Position in singularity",
    **{(157, i): f"Collision detected by joint: {joint}" for i, joint in enumerate(JOINTS)},
    **{
        (158, i): f"Collision detected by joint: {joint}. The user specified payload is 0 kg"
        for i, joint in enumerate(JOINTS)
    },
    (191, 3): "Safety system violation: TCP speed limit violated",
    (191, 6): "Safety system violation: Power limit violated",
    (191, 12): "Safety system violation: Momentum limit violation",
    **{
        (191, 32 + i): f"Safety system violation: Joint speed limit violated - {joint}"
        for i, joint in enumerate(JOINTS)
    },
    (204, 1): "Path sanity check failed: Sudden change in target position",
    (209, 0): "A protective stop was triggered by the program",
}
"""Texts of the error codes and arguments with which this controller stops protectively.

Codes: Universal Robots service manual, "Error codes". With a violated safety limit (191) the real
controller goes to VIOLATION where its own monitoring is too late; here that is always in time.
"""

SAFETY_LIMIT: Final = 191


def stop_level(code: int) -> ReportLevel:
    """Severity of a protective stop.

    A warning, as tests of Universal_Robots_Client_Library have it of `protective_stop()` and of a line out
    of reach, but for a violated limit of the safety configuration, as its name says.
    """
    return ReportLevel.VIOLATION if code == SAFETY_LIMIT else ReportLevel.WARNING


def gravest(causes: set[SafetyMode]) -> SafetyMode:
    """Safety mode that shows when all of `causes` hold; NORMAL when there is none."""
    return next((mode for mode in SAFETY_RULES if mode in causes), SafetyMode.NORMAL)

"""The control program of our own: its registers, the text that is uploaded, and what it reports.

Driver and program talk over RTDE registers, counted from the first of the range that is used (0, or 24):

| Input    | int                                         | double                                       |
|----------|---------------------------------------------|----------------------------------------------|
| 0        | number of the program that is meant         | 0 to 5: values of the motion                 |
| 1, 2     | sequence number and `Kind` of the motion    | 6, 7: its parameters (see `Kind`)            |
|          |                                             | 8: speed scaling of the controller, 0 to 1   |
| 3, 4     | number and `Setting` of a setting           | 10 to 19: values of the setting              |
| 5        | number of the package, see `Echoes`         |                                              |

| Output   | int                                                                                        |
|----------|--------------------------------------------------------------------------------------------|
| 0        | number of the program that runs, or ran last                                               |
| 1, 2     | sequence number that it took last, and its `Phase`                                         |
| 3        | number of the setting that it took last                                                    |
| 4        | counts the cycles of the program                                                           |
| 5        | number of the package that it saw last                                                     |

A program obeys what is meant for its own number only: nothing that another one left in the registers is
carried out. The number is written with every package, and feeds the watchdog.

Source of the built-ins, their parameters and the versions that have them: URScript manual.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from importlib.resources import files
from string import Template
from types import MappingProxyType
from typing import Final, NamedTuple

from crtk_driver_ur.models import Limits

__all__ = [
    "FEED",
    "MOTION",
    "SERVOJ_LOOKAHEAD",
    "SETTING",
    "UPPER_RANGE",
    "Kind",
    "Phase",
    "ProgramOptions",
    "ProgramState",
    "Setting",
    "program_text",
]

UPPER_RANGE: Final = 24
"""First register of the upper range, which no fieldbus claims (RTDE Guide)."""


class Kind(IntEnum):
    """Kinds of motion, with their six values and two parameters."""

    REST = 0
    """Stop, and hold."""
    SERVO_JOINT = 1
    """Joint angles, rad; gain of servoJ."""
    SPEED_JOINT = 2
    """Joint speeds, rad/s; acceleration, rad/s², and for how many seconds it is good."""
    SPEED_CARTESIAN = 3
    """Twist of the tool in base axes, m/s and rad/s; acceleration, m/s², and for how many seconds."""
    MOVE_JOINT = 4
    """Joint angles, rad; speed, rad/s, and acceleration, rad/s²."""
    MOVE_LINEAR = 5
    """Pose: m and rotation vector; speed, m/s, and acceleration, m/s²."""
    FREEDRIVE = 6
    """Let the arm be moved by hand."""
    FORCE = 7
    """Wrench on the axes that are selected, N and N·m."""
    QUIT = 8
    """Stop, and end the program."""


class Phase(IntEnum):
    """What the program is doing."""

    STANDING = 0
    MOVING = 1
    STOPPING = 2


class Setting(IntEnum):
    """What can be set beside any motion, with its values."""

    PAYLOAD = 1
    """Mass, kg, and centre of gravity from the flange, m (3)."""
    TCP = 2
    """Pose of the tool centre point from the flange: m and rotation vector (6)."""
    GRAVITY = 3
    """Acceleration opposite to gravity in base axes, m/s² (3)."""
    ZERO_FORCE_SENSOR = 4
    TARGET_PAYLOAD = 5
    """Mass, kg, centre of gravity, m (3), and inertia about it: xx, yy, zz, xy, xz, yz, kg m² (6)."""
    FREE_AXES = 6
    """One for each axis that freedrive lets go, else zero (6); one if they are those of the tool (1)."""
    FORCE_AXES = 7
    """One for each axis that gives way in force mode, else zero (6); one if of the tool (1)."""
    FORCE_LIMITS = 8
    """Along axes that give way the largest speed, m/s and rad/s; along others the deviation, m and rad."""
    FORCE_DAMPING = 9
    """0 (none) to 1."""
    FORCE_GAIN = 10
    """0 to 2."""


SETTING_VALUES: Final = 10
"""Most values that a setting has."""


SERVOJ_LOOKAHEAD: Final = 0.03
"""Seconds of lookahead of servoJ itself: the least that it takes (URScript manual)."""

USUAL_GAIN: Final = 300.0
"""Gain of servoJ, its default (URScript manual), below which it is softer, and late by more than that."""

NEARLY_FULL: Final = 0.98
"""Share of its greatest speed at which a joint that is behind may be led: at all of it none would be left."""

SHORTEST_SMOOTHING: Final = 4.0
"""Control periods that the smoothing before it takes at least."""

SLOWEST_PACE: Final = 0.1
"""At which the program follows positions at least, whatever the speed slider says."""

SLIDER_RAMP: Final = 0.25
"""Seconds in which the arm becomes as slow as the speed slider says, from full speed to none, at most."""

LARGEST_VALUE: Final = 10000.0
"""Of a motion's values (rad, m, N, ...): what is larger, or not finite, cannot be meant."""


class Registers(NamedTuple):
    """Registers that one package writes, counted from the first of the range."""

    ints: tuple[int, ...]
    doubles: tuple[int, ...] = ()

    def names(self, first: int) -> tuple[str, ...]:
        """Return the names of the input variables."""
        return (
            *(f"input_int_register_{first + i}" for i in self.ints),
            *(f"input_double_register_{first + i}" for i in self.doubles),
        )


FEED: Final = Registers((0, 5))
MOTION: Final = Registers((0, 1, 2, 5), (*range(9),))
SETTING: Final = Registers((0, 3, 4), (*range(10, 10 + SETTING_VALUES),))


class ProgramState(NamedTuple):
    """What a program reports, in the order of its output registers."""

    program: int = 0
    sequence: int = 0
    phase: int = Phase.STANDING
    setting: int = 0
    cycle: int = 0
    echo: int = 0


@dataclass(frozen=True, slots=True)
class ProgramOptions:
    """What is filled in.

    Attributes:
        version: major and minor version of the controller's software.
        first: first register of the range.
        watchdog_frequency: Hz at which the driver feeds the watchdog at least.
        period: control period of the controller, s.
        joint_deceleration: of stops of joint motions, rad/s².
        linear_deceleration: of stops of the tool, m/s².
        lookahead: s by which the arm lags behind joint positions.
        joint_acceleration: with which a joint speeds up at most on its way to them, rad/s².
        joint_speeds: of each joint at most, rad/s.
        joint_ranges: of each joint, rad.
    """

    version: tuple[int, int]
    first: int
    watchdog_frequency: float
    period: float
    joint_deceleration: float
    linear_deceleration: float
    lookahead: float
    joint_acceleration: float
    joint_speeds: tuple[float, ...]
    joint_ranges: Limits

    @property
    def smoothing_rate(self) -> float:
        """1/s, of the smoothing that is the program's own: the lookahead without that of servoJ."""
        return 1.0 / max(self.lookahead - SERVOJ_LOOKAHEAD, SHORTEST_SMOOTHING * self.period)

    @property
    def is_cb3(self) -> bool:
        """Whether the controller is of the generation before the e-Series."""
        return self.version < (5, 0)


_SINCE: Final[Mapping[str, tuple[tuple[int, int], tuple[int, int]]]] = MappingProxyType(
    {
        "freedrive_mode": ((99, 0), (5, 10)),
        "set_target_payload": ((3, 15), (5, 10)),
        "zero_ftsensor": ((99, 0), (5, 0)),
        "force_mode_set_gain_scaling": ((99, 0), (5, 0)),
    }
)
"""Versions of CB3 and e-Series from which on there is a built-in; a program that names another fails."""


def program_text(options: ProgramOptions, program: int) -> str:
    """Return the URScript text of the program with the number `program` (above 0, 31 bits)."""

    def has(name: str) -> bool:
        return options.version >= _SINCE[name][0 if options.is_cb3 else 1]

    def real(address: int) -> str:
        return f"read_input_float_register({options.first + address})"

    target_payload = (
        f"set_target_payload({real(10)}, three_from({options.first + 11}), "
        f"six_from({options.first + 14}))"
        if has("set_target_payload")
        else f"set_payload({real(10)}, three_from({options.first + 11}))"
    )
    freedrive = has("freedrive_mode")
    values = {
        "register": options.first,
        "program": program,
        "watchdog_frequency": options.watchdog_frequency,
        "period": options.period,
        "joint_deceleration": options.joint_deceleration,
        "linear_deceleration": options.linear_deceleration,
        "lookahead": SERVOJ_LOOKAHEAD,
        "reach": NEARLY_FULL * SERVOJ_LOOKAHEAD,
        "usual_gain": USUAL_GAIN,
        "smoothing_rate": options.smoothing_rate,
        "joint_acceleration": options.joint_acceleration,
        "joint_speeds": list(options.joint_speeds),
        "lower": [max(-LARGEST_VALUE, value) for value in options.joint_ranges.lower],
        "upper": [min(LARGEST_VALUE, value) for value in options.joint_ranges.upper],
        "largest_value": LARGEST_VALUE,
        "slowest": SLOWEST_PACE,
        "slider_ramp": SLIDER_RAMP,
        "kinds": _constants(Kind),
        "phases": _constants(Phase),
        "settings": _constants(Setting),
        "zero_force_sensor": "zero_ftsensor()" if has("zero_ftsensor") else "sync()",
        "target_payload": target_payload,
        "force_gain": (
            f"force_mode_set_gain_scaling({real(10)})"
            if has("force_mode_set_gain_scaling")
            else "sync()"
        ),
        "begin_freedrive": (
            "freedrive_mode(freeAxes=free_axes, feature=frame_of(free_of_tool))"
            if freedrive
            else "teach_mode()"
        ),
        "end_freedrive": "end_freedrive_mode()" if freedrive else "end_teach_mode()",
    }
    template = files("crtk_driver_ur.native").joinpath("program.script").read_text("utf-8")
    _, _, body = template.partition("\n\n")
    return Template(body).substitute(values)


def _constants(kinds: type[IntEnum]) -> str:
    return "\n".join(f"  {kind.name} = {kind.value}" for kind in kinds)

"""The command table: every CRTK name, once.

Node, client, plain Python front, command line, capability manifest, documentation and conformance
suite are derived from `COMMANDS`; nobody types a topic name a second time. Names are
``<level>_<space><kind>`` as in the CRTK specification (collaborative-robotics/documentation,
api-robot-motion.rst and api-operating-state.rst); ``trajectory_j/``, ``use_gravity_compensation`` and
``body/set_cf_orientation_absolute`` as on the dVRK.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cache
from types import MappingProxyType


class Level(StrEnum):
    """Who closes which loop, or where a value comes from."""

    SERVO = "servo"
    INTERPOLATE = "interpolate"
    MOVE = "move"
    MEASURED = "measured"
    SETPOINT = "setpoint"
    GOAL = "goal"
    STATE = "state"
    SETTING = "setting"
    QUERY = "query"


class Space(StrEnum):
    """Joint or Cartesian."""

    JOINT = "j"
    CARTESIAN = "c"
    NONE = ""


class Kind(StrEnum):
    """What the numbers are."""

    POSITION = "p"
    RELATIVE = "r"
    VELOCITY = "v"
    EFFORT = "f"
    STATE = "s"
    NONE = ""


class Direction(StrEnum):
    """Seen from the device."""

    PUBLISHED = "published"
    COMMANDED = "commanded"
    SERVICE = "service"


class Payload(StrEnum):
    """What travels, independent of any middleware."""

    JOINT_STATE = "joint state"
    POSE = "pose"
    POSES = "poses"
    TWIST = "twist"
    WRENCH = "wrench"
    MATRIX = "matrix"
    JOINT_SERVO = "mixed joint setpoint"
    CARTESIAN_SERVO = "mixed Cartesian setpoint"
    TRAJECTORY = "joint trajectory"
    OPERATING_STATE = "operating state"
    TEXT = "text"
    EMPTY = "empty"
    NUMBER = "number"
    FLAG = "flag"
    NUMBERS = "numbers"
    JOY = "axes and buttons"
    FORWARD_KINEMATICS = "forward kinematics query"
    INVERSE_KINEMATICS = "inverse kinematics query"


ROS_TYPES: Mapping[Payload, str] = MappingProxyType(
    {
        Payload.JOINT_STATE: "sensor_msgs/msg/JointState",
        Payload.POSE: "geometry_msgs/msg/PoseStamped",
        Payload.POSES: "geometry_msgs/msg/PoseArray",
        Payload.TWIST: "geometry_msgs/msg/TwistStamped",
        Payload.WRENCH: "geometry_msgs/msg/WrenchStamped",
        Payload.MATRIX: "std_msgs/msg/Float64MultiArray",
        Payload.OPERATING_STATE: "crtk_msgs/msg/OperatingState",
        Payload.TEXT: "crtk_msgs/msg/StringStamped",
        Payload.EMPTY: "std_msgs/msg/Empty",
        Payload.NUMBER: "std_msgs/msg/Float64",
        Payload.FLAG: "std_msgs/msg/Bool",
        Payload.NUMBERS: "std_msgs/msg/Float64MultiArray",
        Payload.JOY: "sensor_msgs/msg/Joy",
        Payload.JOINT_SERVO: "crtk_msgs/msg/JointServo",
        Payload.CARTESIAN_SERVO: "crtk_msgs/msg/CartesianServo",
        Payload.TRAJECTORY: "trajectory_msgs/msg/JointTrajectory",
        Payload.FORWARD_KINEMATICS: "crtk_msgs/srv/QueryForwardKinematics",
        Payload.INVERSE_KINEMATICS: "crtk_msgs/srv/QueryInverseKinematics",
    }
)
"""The ROS type of each payload, as CRTK has it."""


@dataclass(frozen=True, slots=True)
class Command:
    """One CRTK name and all that is known of it without a device.

    `name` carries the sub-namespace, if there is one: ``body/servo_cv``.
    """

    name: str
    level: Level
    space: Space
    kind: Kind
    direction: Direction
    payload: Payload
    units: str
    summary: str

    @property
    def base_name(self) -> str:
        """The name without its sub-namespace: a key of `COMMANDS`, or ``measured2_js``."""
        return self.name if self.name in COMMANDS else self.name.rpartition("/")[2]

    @property
    def frame(self) -> str:
        """``local``, ``body`` or ``spatial`` where that is its sub-namespace; else empty."""
        frame = self.name.partition("/")[0]
        return frame if frame in FRAMES else ""

    @property
    def is_relative(self) -> bool:
        """Whether the payload is an increment, of which none may be lost."""
        return self.kind is Kind.RELATIVE

    @property
    def is_stream(self) -> bool:
        """Whether it belongs to a stream, which goes on only as long as it is sent."""
        return self.level in (Level.SERVO, Level.INTERPOLATE)

    @property
    def is_motion(self) -> bool:
        """Whether it asks the device to move."""
        return self.is_stream or self.level is Level.MOVE


FRAMES = ("local", "body", "spatial")
"""Sub-namespaces that say in which frame a Cartesian value is given, see `crtk_drivers.geometry.frames`."""


def device_of(topic: str) -> str:
    """Return the namespace of the device that a topic is of: ``/ur5`` for ``/ur5/local/measured_cp``."""
    space = topic.rpartition("/")[0]
    parent, _, name = space.rpartition("/")
    return (parent if name in FRAMES else space) or "/"


SUB_NAMESPACES = (*FRAMES, "jaw", "gripper", "actuators", "raw")
"""Where a device may offer the same names a second time, for example ``local/measured_cp``."""

_JOINT_UNITS = {
    Kind.POSITION: "rad or m",
    Kind.RELATIVE: "rad or m",
    Kind.VELOCITY: "rad/s or m/s",
    Kind.EFFORT: "N·m or N",
    Kind.STATE: "rad, rad/s, N·m (m, m/s, N)",
}
_CARTESIAN_UNITS = {
    Kind.POSITION: "m, unit quaternion",
    Kind.RELATIVE: "m, unit quaternion",
    Kind.VELOCITY: "m/s, rad/s",
    Kind.EFFORT: "N, N·m",
    Kind.STATE: "m, m/s, N (rad, rad/s, N·m)",
}
_CARTESIAN_PAYLOAD = {
    Kind.POSITION: Payload.POSE,
    Kind.RELATIVE: Payload.POSE,
    Kind.VELOCITY: Payload.TWIST,
    Kind.EFFORT: Payload.WRENCH,
    Kind.STATE: Payload.CARTESIAN_SERVO,
}

_OF_JOINTS: Mapping[str, tuple[str, str, str]] = MappingProxyType(
    {"rad": ("rad", "rad/s", "N·m"), "m": ("m", "m/s", "N")}
)
"""Units of position, velocity and effort, by that of the position."""

# (level, direction, joint kinds, Cartesian kinds, summary). A joint state holds position, velocity
# and effort together, so that feedback has one joint name, `_js`.
_MOTION_ROWS = (
    (Level.MEASURED, Direction.PUBLISHED, "s", "pvf", "sensor feedback"),
    (
        Level.SETPOINT,
        Direction.PUBLISHED,
        "s",
        "pvf",
        "the value last sent to the low-level control",
    ),
    (Level.GOAL, Direction.PUBLISHED, "s", "pv", "the goal last accepted by interpolate or move"),
    (Level.SERVO, Direction.COMMANDED, "prvfs", "prvfs", "direct real-time stream, newest wins"),
    (Level.INTERPOLATE, Direction.COMMANDED, "prvf", "prvf", "low-rate stream, smoothed"),
    (Level.MOVE, Direction.COMMANDED, "pr", "pr", "plan a trajectory to a goal and stop there"),
)

_OTHER_ROWS = (
    ("operating_state", Level.STATE, Direction.PUBLISHED, Payload.OPERATING_STATE, "",
     "DISABLED, ENABLED, PAUSED or FAULT, with is_homed and is_busy"),
    ("state_command", Level.STATE, Direction.COMMANDED, Payload.TEXT, "",
     "enable, disable, pause, resume, home or unhome"),
    ("hold", Level.STATE, Direction.COMMANDED, Payload.EMPTY, "",
     "stop, and stay at the present position"),
    ("free", Level.STATE, Direction.COMMANDED, Payload.EMPTY, "",
     "let go: the arm may be moved by hand"),
    ("use_gravity_compensation", Level.SETTING, Direction.COMMANDED, Payload.FLAG, "",
     "whether efforts are added that carry the arm's own weight"),
    ("body/set_cf_orientation_absolute", Level.SETTING, Direction.COMMANDED, Payload.FLAG, "",
     "whether wrenches of body/ are along the axes of the base frame instead of the tool's"),
    ("trajectory_j/set_ratio", Level.SETTING, Direction.COMMANDED, Payload.NUMBER, "1",
     "share of the velocity and acceleration limits that moves use, above 0 and up to 1"),
    ("trajectory_j/set_ratio_v", Level.SETTING, Direction.COMMANDED, Payload.NUMBER, "1",
     "share of the velocity limits that moves use, above 0 and up to 1"),
    ("trajectory_j/set_ratio_a", Level.SETTING, Direction.COMMANDED, Payload.NUMBER, "1",
     "share of the acceleration limits that moves use, above 0 and up to 1"),
    ("trajectory_j/ratio", Level.SETTING, Direction.PUBLISHED, Payload.NUMBER, "1",
     "the lesser of the two shares in force"),
    ("trajectory_j/ratio_v", Level.SETTING, Direction.PUBLISHED, Payload.NUMBER, "1",
     "share of the velocity limits in force"),
    ("trajectory_j/ratio_a", Level.SETTING, Direction.PUBLISHED, Payload.NUMBER, "1",
     "share of the acceleration limits in force"),
    ("measured_cp_array", Level.MEASURED, Direction.PUBLISHED, Payload.POSES, "m, unit quaternion",
     "where all is that is seen: tools, then markers of none"),
    ("jacobian", Level.QUERY, Direction.PUBLISHED, Payload.MATRIX, "m/rad, 1",
     "6 x n geometric Jacobian of the tool, linear rows first"),
    ("forward_kinematics", Level.QUERY, Direction.SERVICE, Payload.FORWARD_KINEMATICS, "rad, m",
     "pose of a joint position"),
    ("inverse_kinematics", Level.QUERY, Direction.SERVICE, Payload.INVERSE_KINEMATICS, "rad, m",
     "joint position of a pose, nearest to a reference"),
)  # fmt: skip


def _table() -> dict[str, Command]:
    rows: list[Command] = []
    for level, direction, joint_kinds, cartesian_kinds, summary in _MOTION_ROWS:
        for kind in map(Kind, joint_kinds):
            mixed = level is Level.SERVO and kind is Kind.STATE
            payload = Payload.JOINT_SERVO if mixed else Payload.JOINT_STATE
            name, units = f"{level}_j{kind}", _JOINT_UNITS[kind]
            rows.append(Command(name, level, Space.JOINT, kind, direction, payload, units, summary))
        for kind in map(Kind, cartesian_kinds):
            name, units = f"{level}_c{kind}", _CARTESIAN_UNITS[kind]
            payload = _CARTESIAN_PAYLOAD[kind]
            rows.append(
                Command(name, level, Space.CARTESIAN, kind, direction, payload, units, summary)
            )
    for name, level, direction, payload, units, summary in _OTHER_ROWS:
        rows.append(Command(name, level, Space.NONE, Kind.NONE, direction, payload, units, summary))
    return {row.name: row for row in rows}


COMMANDS: Mapping[str, Command] = MappingProxyType(_table())

FOLLOW = Command(
    "follow_joint_trajectory",
    Level.MOVE,
    Space.JOINT,
    Kind.POSITION,
    Direction.COMMANDED,
    Payload.TRAJECTORY,
    _JOINT_UNITS[Kind.POSITION],
    "go through the points of a trajectory, each at its time",
)
"""No name of CRTK, but carried out as a move: what FollowJointTrajectory of ros2_controllers asks."""


def units_for(command: Command, joint_units: Collection[str]) -> str:
    """Return the units of a command of a device whose joints are in `joint_units`: ``rad``, ``m``, ``Pa``.

    Where the joints differ, or are in a unit that is not known (empty), these are the command's own.
    """
    if command.space is not Space.JOINT or len(set(joint_units)) != 1 or "" in joint_units:
        return command.units
    unit = next(iter(joint_units))
    position, velocity, effort = _OF_JOINTS.get(unit, (unit, f"{unit}/s", ""))
    return {
        Kind.POSITION: position,
        Kind.RELATIVE: position,
        Kind.VELOCITY: velocity,
        Kind.EFFORT: effort,
    }.get(command.kind, ", ".join(filter(None, (position, velocity, effort))))


CHILDREN = tuple(
    dict.fromkeys((*SUB_NAMESPACES, *(n.partition("/")[0] for n in COMMANDS if "/" in n)))
)
"""All sub-namespaces of names, ``trajectory_j`` among them."""

_REDUNDANT = re.compile(r"measured[2-9]_js")
"""Redundant sensors, beside those of measured_js: ``measured2_js``."""


@cache
def find(name: str) -> Command:
    """Return the row of `name`, which may carry a sub-namespace (``local/measured_cp``); or `FOLLOW`.

    Raises:
        KeyError: there is no such name.
    """
    if name in COMMANDS:
        return COMMANDS[name]
    if name == FOLLOW.name:
        return FOLLOW
    space, slash, base = name.rpartition("/")
    if slash and space not in SUB_NAMESPACES:
        raise KeyError(name)
    row = COMMANDS["measured_js" if _REDUNDANT.fullmatch(base) else base]
    return replace(row, name=name)


_TOPIC = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


def is_free_topic(name: str, taken: Collection[str]) -> bool:
    """Whether a device may give this name to a topic of its own: one word, no CRTK name, none of `taken`."""
    return bool(_TOPIC.fullmatch(name)) and name not in taken and not is_name(name)


def is_name(name: str) -> bool:
    """Whether there is such a CRTK name, see `find`."""
    try:
        return find(name) is not FOLLOW
    except KeyError:
        return False

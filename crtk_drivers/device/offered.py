"""Which CRTK commands a device offers: derived by table from its capabilities, and whether it has kinematics.

A command that is not derived here does not exist on the device: its topic is not created, its method
is absent, and asking for it says what would be needed (`missing_for`).

Cartesian velocities, efforts and increments are offered in ``body/`` and ``spatial/`` as well (see
`crtk_drivers.geometry.frames`), everything Cartesian in ``local/`` where the device's own base has a pose of
its own, and where the tool is in any case.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from crtk_drivers.commands import (
    COMMANDS,
    FOLLOW,
    Command,
    Direction,
    Kind,
    Level,
    Space,
    find,
    is_name,
)
from crtk_drivers.device.capabilities import Mode
from crtk_drivers.device.interface import Device

KINEMATICS = "kinematics (the key kinematics of the configuration)"
TOOL_LIMITS = "limits of the tool"
FORCE_LIMITS = "limits of the tool's force and torque"
FREE = "free drive"
GRAVITY = "gravity compensation"
BASE = "a base with a pose of its own (the key base of the configuration)"
NATIVE = "its own "
WRENCH_AXES = "body/set_cf_orientation_absolute"
ANY_MODE = "any mode"
JOINTS = "joints"

_POSES: tuple[frozenset[str], ...] = (
    frozenset({Mode.CARTESIAN_POSITION}),
    frozenset({Mode.JOINT_POSITION, KINEMATICS}),
)
_POSE_MOVES: tuple[frozenset[str], ...] = (
    frozenset({NATIVE + "move_cp"}),
    frozenset({Mode.JOINT_POSITION, KINEMATICS}),
)
_SLOW_POSES: tuple[frozenset[str], ...] = (
    frozenset({Mode.CARTESIAN_POSITION, TOOL_LIMITS}),
    frozenset({Mode.JOINT_POSITION, KINEMATICS, TOOL_LIMITS}),
)

_SLOW_TWISTS: tuple[frozenset[str], ...] = (
    frozenset({Mode.CARTESIAN_VELOCITY}),
    frozenset({Mode.JOINT_VELOCITY, KINEMATICS, TOOL_LIMITS}),
    frozenset({Mode.JOINT_POSITION, KINEMATICS, TOOL_LIMITS}),
)

_WRENCHES: tuple[frozenset[str], ...] = (
    frozenset({Mode.CARTESIAN_EFFORT}),
    frozenset({Mode.JOINT_EFFORT, KINEMATICS, FORCE_LIMITS}),
)

_TWISTS: tuple[frozenset[str], ...] = (
    frozenset({Mode.CARTESIAN_VELOCITY}),
    frozenset({Mode.JOINT_VELOCITY, KINEMATICS}),
    frozenset({Mode.JOINT_POSITION, KINEMATICS}),
)

_MOVES: tuple[frozenset[str], ...] = (
    frozenset({Mode.JOINT_POSITION}),
    frozenset({NATIVE + "move_jp"}),
)

# Each alternative is a set of features that together are enough.
_NEEDS: Mapping[str, tuple[frozenset[str], ...]] = MappingProxyType(
    {
        "servo_jp": (frozenset({Mode.JOINT_POSITION}),),
        "servo_jr": (frozenset({Mode.JOINT_POSITION}),),
        "servo_jv": (frozenset({Mode.JOINT_VELOCITY}),),
        "servo_jf": (frozenset({Mode.JOINT_EFFORT}),),
        "servo_cp": _POSES,
        "servo_cr": _POSES,
        "servo_cv": _TWISTS,
        "servo_cf": _WRENCHES,
        "servo_js": (
            frozenset({Mode.JOINT_POSITION}),
            frozenset({Mode.JOINT_VELOCITY}),
            frozenset({Mode.JOINT_EFFORT}),
        ),
        "servo_cs": (
            frozenset({Mode.CARTESIAN_POSITION, TOOL_LIMITS}),
            frozenset({Mode.JOINT_POSITION, KINEMATICS, TOOL_LIMITS}),
        ),
        "interpolate_jp": (frozenset({Mode.JOINT_POSITION}),),
        "interpolate_jr": (frozenset({Mode.JOINT_POSITION}),),
        "interpolate_jv": (frozenset({Mode.JOINT_VELOCITY}),),
        "interpolate_jf": (frozenset({Mode.JOINT_EFFORT}),),
        "interpolate_cp": _SLOW_POSES,
        "interpolate_cr": _SLOW_POSES,
        "interpolate_cv": _SLOW_TWISTS,
        "interpolate_cf": _WRENCHES,
        "move_jp": _MOVES,
        "move_jr": _MOVES,
        "move_cp": _POSE_MOVES,
        "move_cr": _POSE_MOVES,
        "hold": (frozenset({ANY_MODE}),),
        "free": (frozenset({FREE}),),
        "jacobian": (frozenset({KINEMATICS}),),
        "forward_kinematics": (frozenset({KINEMATICS}),),
        "inverse_kinematics": (frozenset({KINEMATICS}),),
        "setpoint_js": (frozenset({ANY_MODE, JOINTS}),),
        "setpoint_cp": (frozenset({ANY_MODE, KINEMATICS}), frozenset({Mode.CARTESIAN_POSITION})),
        "setpoint_cv": (frozenset({ANY_MODE, KINEMATICS}), frozenset({Mode.CARTESIAN_VELOCITY})),
        "setpoint_cf": _WRENCHES,
        "goal_js": (
            frozenset({Mode.JOINT_POSITION}),
            frozenset({Mode.JOINT_VELOCITY}),
            frozenset({Mode.JOINT_EFFORT}),
            frozenset({NATIVE + "move_jp"}),
        ),
        "goal_cp": (
            frozenset({NATIVE + "move_cp"}),
            frozenset({Mode.JOINT_POSITION, KINEMATICS}),
            frozenset({Mode.CARTESIAN_POSITION, TOOL_LIMITS}),
        ),
        "goal_cv": _SLOW_TWISTS,
        "use_gravity_compensation": (frozenset({GRAVITY}),),
        WRENCH_AXES: _WRENCHES,
        **{
            f"trajectory_j/{name}": _MOVES
            for name in ("set_ratio", "set_ratio_v", "set_ratio_a", "ratio", "ratio_v", "ratio_a")
        },
        "operating_state": (frozenset(),),
        "state_command": (frozenset(),),
    }
)


def _features(device: Device) -> frozenset[str]:
    capabilities = device.capabilities
    features: set[str] = {*capabilities.modes}
    features.update(NATIVE + name for name in capabilities.native_moves)
    limits = capabilities.cartesian_limits
    has = {
        KINEMATICS: device.kinematics is not None,
        TOOL_LIMITS: limits is not None,
        FORCE_LIMITS: limits is not None and limits.force > 0.0 and limits.torque > 0.0,
        FREE: capabilities.has_free,
        GRAVITY: capabilities.has_gravity_compensation,
        BASE: capabilities.base_pose is not None,
        JOINTS: bool(capabilities.joints),
        ANY_MODE: bool(capabilities.modes or capabilities.native_moves),
    }
    features.update(feature for feature, is_there in has.items() if is_there)
    return frozenset(features)


_STATE = frozenset({"operating_state", "state_command"})

IN_OWN_BASE = ("measured_cp", "setpoint_cp", "forward_kinematics")
"""What is told in ``local/`` too, whether the device's own base is the base frame or not."""

_MOVING = frozenset({Kind.RELATIVE, Kind.VELOCITY, Kind.EFFORT})


def in_frames(command: Command) -> tuple[str, ...]:
    """Return the frames in which a Cartesian command or value of the base frame may be offered as well."""
    if command.base_name == "jacobian":
        return ("body", "spatial")
    if command.space is not Space.CARTESIAN or command.level is Level.GOAL:
        return ()
    if command.direction is Direction.PUBLISHED:
        return () if command.kind is Kind.POSITION else ("body", "spatial")
    return ("body", "spatial", "local") if command.kind in _MOVING else ("local",)


def offered(device: Device) -> Mapping[str, Command]:
    """Return the CRTK names that a device offers, in the table's order."""
    features = _features(device)
    names = dict.fromkeys(device.capabilities.measured, None)
    for name, alternatives in _NEEDS.items():
        if any(needs <= features for needs in alternatives):
            names[name] = None
    if KINEMATICS in features or "measured_cp" in names:
        for name in [name for name in names if "/" not in name]:
            for frame in in_frames(find(name)):
                if frame != "local" or BASE in features:
                    names[f"{frame}/{name}"] = None
    names.update((f"local/{name}", None) for name in IN_OWN_BASE if name in names)
    if "body/servo_cf" not in names:
        names.pop(WRENCH_AXES, None)
    order = {name: index for index, name in enumerate(COMMANDS)}
    ranked = sorted(names, key=lambda name: order.get(find(name).base_name, 0))
    return MappingProxyType({name: find(name) for name in ranked})


def follows_trajectories(device: Device) -> bool:
    """Whether `crtk_drivers.commands.FOLLOW` can be asked of a device."""
    return Mode.JOINT_POSITION in device.capabilities.modes


def without_state(commands: Mapping[str, Command]) -> Mapping[str, Command]:
    """Return what is left for a device that follows the operating state of another one."""
    return MappingProxyType({name: row for name, row in commands.items() if name not in _STATE})


def missing_for(name: str, device: Device) -> str:
    """Say in words what a device would need in order to offer `name`."""
    if name == FOLLOW.name:
        return f"It would need {Mode.JOINT_POSITION}."
    if not is_name(name):
        return "There is no such CRTK command."
    command = find(name)
    alternatives = _NEEDS.get(command.base_name)
    if alternatives is None:
        return "Its samples hold no such value."
    features = _features(device)
    extra = {BASE} if command.frame == "local" and command.base_name not in IN_OWN_BASE else set()
    lacks = (" and ".join(sorted((needs | extra) - features)) for needs in alternatives)
    return f"It would need {', or '.join(lacks)}."

"""Which CRTK commands a device offers: derived from its declared capabilities, by table.

A command that is not derived here does not exist on the device: its topic is not created, its method
is absent, and asking for it says what would be needed (`missing_for`).
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from crtk_drivers.commands import COMMANDS, Command
from crtk_drivers.device import Capabilities, Mode

KINEMATICS = "kinematics"
TOOL_LIMITS = "limits of the tool"
FREE = "free drive"
NATIVE = "its own "
ANY_MODE = "any mode"

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

# Each alternative is a set of features that together are enough.
_NEEDS: Mapping[str, tuple[frozenset[str], ...]] = MappingProxyType(
    {
        "servo_jp": (frozenset({Mode.JOINT_POSITION}),),
        "servo_jr": (frozenset({Mode.JOINT_POSITION}),),
        "servo_jv": (frozenset({Mode.JOINT_VELOCITY}),),
        "servo_jf": (frozenset({Mode.JOINT_EFFORT}),),
        "servo_cp": _POSES,
        "servo_cr": _POSES,
        "servo_cv": (
            frozenset({Mode.CARTESIAN_VELOCITY}),
            frozenset({Mode.JOINT_VELOCITY, KINEMATICS}),
            frozenset({Mode.JOINT_POSITION, KINEMATICS}),
        ),
        "servo_cf": (frozenset({Mode.CARTESIAN_EFFORT}),),
        "interpolate_jp": (frozenset({Mode.JOINT_POSITION}),),
        "interpolate_jr": (frozenset({Mode.JOINT_POSITION}),),
        "interpolate_jv": (frozenset({Mode.JOINT_VELOCITY}),),
        "interpolate_jf": (frozenset({Mode.JOINT_EFFORT}),),
        "interpolate_cp": _SLOW_POSES,
        "interpolate_cr": _SLOW_POSES,
        "interpolate_cv": _SLOW_TWISTS,
        "move_jp": (frozenset({Mode.JOINT_POSITION}), frozenset({NATIVE + "move_jp"})),
        "move_jr": (frozenset({Mode.JOINT_POSITION}), frozenset({NATIVE + "move_jp"})),
        "move_cp": _POSE_MOVES,
        "move_cr": _POSE_MOVES,
        "hold": (frozenset({ANY_MODE}),),
        "free": (frozenset({FREE}),),
        "jacobian": (frozenset({KINEMATICS}),),
        "forward_kinematics": (frozenset({KINEMATICS}),),
        "inverse_kinematics": (frozenset({KINEMATICS}),),
        "setpoint_js": (frozenset({ANY_MODE}),),
        "setpoint_cp": (frozenset({ANY_MODE, KINEMATICS}),),
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
        "operating_state": (frozenset(),),
        "state_command": (frozenset(),),
    }
)


def _features(capabilities: Capabilities) -> frozenset[str]:
    features: set[str] = {*capabilities.modes}
    features.update(NATIVE + name for name in capabilities.native_moves)
    if capabilities.has_kinematics:
        features.add(KINEMATICS)
    if capabilities.cartesian_limits is not None:
        features.add(TOOL_LIMITS)
    if capabilities.has_free:
        features.add(FREE)
    if capabilities.modes or capabilities.native_moves:
        features.add(ANY_MODE)
    return frozenset(features)


def offered(capabilities: Capabilities) -> Mapping[str, Command]:
    """Return the CRTK names that a device with these capabilities offers, in the table's order."""
    features = _features(capabilities)
    names = dict.fromkeys(capabilities.measured, None)
    for name, alternatives in _NEEDS.items():
        if any(needs <= features for needs in alternatives):
            names[name] = None
    order = {name: index for index, name in enumerate(COMMANDS)}
    ranked = sorted(names, key=lambda name: order[name.rpartition("/")[2]])
    return MappingProxyType({name: COMMANDS[name.rpartition("/")[2]] for name in ranked})


def missing_for(name: str, capabilities: Capabilities) -> str:
    """Say in words what a device would need in order to offer `name`."""
    if name.rpartition("/")[2] not in COMMANDS:
        return "There is no such CRTK command."
    alternatives = _NEEDS.get(name)
    if alternatives is None:
        if COMMANDS[name.rpartition("/")[2]].is_motion:
            return "It is not implemented for any device yet."
        return "Its samples hold no such value."
    features = _features(capabilities)
    lacks = (" and ".join(sorted(needs - features)) for needs in alternatives)
    return f"It would need {', or '.join(lacks)}."

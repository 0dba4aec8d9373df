"""What a device offers follows from what it declares."""

import math
from typing import Any

import pytest

from crtk_drivers.commands import COMMANDS
from crtk_drivers.device import Capabilities, CartesianLimits, JointLimits, Mode
from crtk_drivers.device.offered import missing_for, offered
from crtk_drivers.samples import Pose, vector
from crtk_drivers.testing.clock import FakeClock
from rigs.scripted_engine import LIMIT, ScriptedDevice, two_joints

STATE = {"operating_state", "state_command"}
JOINT_STREAMS = {"servo_jp", "servo_jr", "interpolate_jp", "interpolate_jr"}
RATIOS = {
    f"trajectory_j/{name}{kind}" for name in ("set_ratio", "ratio") for kind in ("", "_v", "_a")
}
MOVES = {"move_jp", "move_jr", "goal_js"} | RATIOS
JOINT_MOTION = JOINT_STREAMS | MOVES | {"servo_js", "hold", "setpoint_js"}


def framed(*names: str) -> set[str]:
    """Return names with those of the tool's and the base's axes."""
    return {*names, *(f"{frame}/{name}" for frame in ("body", "spatial") for name in names)}


KINEMATICS = framed("jacobian") | {"forward_kinematics", "inverse_kinematics"}
KINEMATICS |= {"local/forward_kinematics"}
SLOW_POSES = framed("interpolate_cr") | {"interpolate_cp", "servo_cs"}
SLOW = SLOW_POSES | framed("interpolate_cv") | {"goal_cv"}
WITH_KINEMATICS = KINEMATICS | SLOW | framed("servo_cr", "servo_cv", "move_cr", "setpoint_cv")
WITH_KINEMATICS |= {"servo_cp", "move_cp", "setpoint_cp", "local/setpoint_cp", "goal_cp"}
BARE = {
    "modes": frozenset[Mode](),
    "has_free": False,
    "measured": ("measured_js",),
}
POSITION = frozenset({Mode.JOINT_POSITION})
BASE = Pose(vector((0.0, 0.0, 1.0)), vector((0.0, 0.0, 0.0, 1.0)))

CASES: dict[str, tuple[dict[str, Any], set[str]]] = {
    "a sensor": (
        {"joints": (), "limits": (), "measured": ("measured_cf", "local/measured_cf")},
        {"measured_cf", "local/measured_cf"},
    ),
    "an encoder": ({}, {"measured_js"}),
    "positions": ({"modes": POSITION}, {"measured_js"} | JOINT_MOTION),
    "positions and kinematics": (
        {"modes": POSITION, "kinematics": True},
        {"measured_js"} | JOINT_MOTION | WITH_KINEMATICS,
    ),
    "positions and kinematics of a tool without limits": (
        {"modes": POSITION, "kinematics": True, "cartesian_limits": None},
        {"measured_js"} | JOINT_MOTION | WITH_KINEMATICS - SLOW,
    ),
    "poses and twists": (
        {"modes": frozenset({Mode.CARTESIAN_POSITION, Mode.CARTESIAN_VELOCITY})},
        {"measured_js", "servo_cp", "servo_cr", "servo_cv", "interpolate_cv", "hold", "setpoint_js"}
        | {"interpolate_cp", "interpolate_cr", "servo_cs", "setpoint_cv", "goal_cp", "goal_cv"}
        | {"setpoint_cp", "local/setpoint_cp"},
    ),
    "poses, and nothing is measured": (
        {"modes": frozenset({Mode.CARTESIAN_POSITION}), "joints": (), "limits": ()}
        | {"measured": ()},
        {"servo_cp", "servo_cr", "interpolate_cp", "interpolate_cr", "servo_cs", "hold", "goal_cp"}
        | {"setpoint_cp", "local/setpoint_cp"},
    ),
    "velocities": (
        {"modes": frozenset({Mode.JOINT_VELOCITY})},
        {"measured_js", "servo_jv", "interpolate_jv", "servo_js", "hold", "setpoint_js", "goal_js"},
    ),
    "efforts": (
        {"modes": frozenset({Mode.JOINT_EFFORT}), "has_free": True},
        {"measured_js", "servo_jf", "interpolate_jf", "servo_js", "hold"}
        | {"setpoint_js", "goal_js", "free"},
    ),
    "its own moves": (
        {"native_moves": frozenset({"move_jp"})},
        {"measured_js", "hold", "setpoint_js"} | MOVES,
    ),
    "efforts and kinematics": (
        {
            "modes": frozenset({Mode.JOINT_EFFORT}),
            "kinematics": True,
            "has_gravity_compensation": True,
        },
        {"measured_js", "servo_jf", "interpolate_jf", "servo_js", "hold", "setpoint_js", "goal_js"}
        | {"setpoint_cp", "local/setpoint_cp", "use_gravity_compensation"}
        | {"body/set_cf_orientation_absolute"}
        | KINEMATICS
        | framed("servo_cf", "interpolate_cf", "setpoint_cf", "setpoint_cv"),
    ),
    "a base with a pose": (
        {"modes": frozenset({Mode.CARTESIAN_POSITION, Mode.CARTESIAN_VELOCITY})}
        | {"measured": ("measured_js", "measured_cp"), "base_pose": BASE},
        {
            "measured_js",
            "measured_cp",
            "local/measured_cp",
            "setpoint_cp",
            "local/setpoint_cp",
            "hold",
            "setpoint_js",
            "goal_cp",
            "goal_cv",
        }
        | framed("servo_cr", "servo_cv", "interpolate_cr", "interpolate_cv", "setpoint_cv")
        | {"servo_cp", "interpolate_cp", "servo_cs"}
        | {f"local/servo_c{kind}" for kind in "prvs"}
        | {f"local/interpolate_c{kind}" for kind in "prv"},
    ),
    "a force sensor on a known tool": (
        {"joints": (), "limits": (), "measured": ("measured_cp", "measured_cf")},
        {"measured_cp", "local/measured_cp"} | framed("measured_cf"),
    ),
}


def device(kinematics: bool = False, **changes: Any) -> ScriptedDevice:
    return ScriptedDevice(FakeClock(), two_joints(**changes), kinematics)


@pytest.mark.parametrize("case", CASES)
def test_offered(case: str) -> None:
    changes, names = CASES[case]
    found = offered(device(**(BARE | changes)))
    assert set(found) == names | STATE
    order = list(COMMANDS)
    ranks = [order.index(command.base_name) for command in found.values()]
    assert ranks == sorted(ranks)


def test_what_is_missing_is_said_in_words() -> None:
    encoder = device(**BARE)
    assert missing_for("servo_jp", encoder) == "It would need joint position."
    assert "Cartesian position, or joint position and kinematics" in missing_for(
        "servo_cp", encoder
    )
    assert "a base with a pose of its own (the key base" in missing_for("local/servo_cp", encoder)
    absolute = missing_for("body/set_cf_orientation_absolute", encoder)
    assert absolute == missing_for("servo_cf", encoder)
    assert missing_for("local/setpoint_cp", encoder) == missing_for("setpoint_cp", encoder)
    assert missing_for("measured_cf", encoder) == "Its samples hold no such value."
    assert missing_for("dance", encoder) == "There is no such CRTK command."


INCOHERENT: dict[str, tuple[dict[str, Any], str]] = {
    "limits": ({"limits": (LIMIT,)}, "1 limits for 2 joints"),
    "names twice": ({"joints": ("a", "a")}, "names of their own"),
    "no name": ({"joints": ("a", "")}, "names of their own"),
    "no rate": ({"rate": 0.0}, "rate"),
    "endless rate": ({"rate": math.inf}, "rate"),
    "rate is not a number": ({"rate": math.nan}, "rate"),
    "no time": ({"transition_timeout": 0.0}, "transition_timeout"),
    "no such feedback": ({"measured": ("measured_js", "measured_xy")}, "measured_xy"),
    "a command as feedback": ({"measured": ("measured_js", "servo_jp")}, "servo_jp"),
    "blind": ({"measured": ("measured_cp",)}, "measured_js"),
    "no such move": ({"native_moves": frozenset({"move_jr"})}, "move_jr"),
    "twists without limits": ({"cartesian_limits": None}, "cartesian_limits"),
    "wrenches without limits": (
        {"cartesian_limits": CartesianLimits(1.0, 1.0, 1.0, 1.0)},
        "a force above zero",
    ),
    "joints without joints": (
        {"joints": (), "limits": (), "modes": frozenset[Mode](), "measured": ("measured_js",)},
        "measured_js without joints",
    ),
}


@pytest.mark.parametrize("case", INCOHERENT)
def test_capabilities_that_contradict_each_other_are_refused(case: str) -> None:
    changes, text = INCOHERENT[case]
    with pytest.raises(ValueError, match=text):
        two_joints(**changes)


@pytest.mark.parametrize(
    "numbers",
    [
        (1.0, -1.0, 1, 1, 1, 1),
        (math.nan, 1.0, 1, 1, 1, 1),
        (-1.0, 1.0, 0, 1, 1, 1),
        (-1.0, 1.0, 1, math.nan, 1, 1),
        (-1.0, 1.0, 1, 1, 1, -1),
    ],
)
def test_limits_that_limit_nothing_are_refused(numbers: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="limit"):
        JointLimits(*numbers)


def test_a_device_with_nothing_is_possible() -> None:
    assert set(offered(ScriptedDevice(FakeClock(), Capabilities(measured=()), False))) == STATE


def test_units_are_given_for_all_joints_or_none() -> None:
    with pytest.raises(ValueError, match="2 joint_units for 0 joints"):
        Capabilities(measured=(), joint_units=("rad", "m"))


def test_capabilities_by_position_are_as_before_there_were_units() -> None:
    given = Capabilities("arm", "A1", ("x",), (LIMIT,), CartesianLimits(1.0, 1.0, 1.0, 1.0))
    assert given.cartesian_limits == CartesianLimits(1.0, 1.0, 1.0, 1.0)
    assert given.joint_units == ()

"""The command table against the lists of the CRTK specification and crtk_msgs."""

import pytest

from crtk_drivers.commands import COMMANDS, Direction, Level, Payload, find

PUBLISHED = {
    "measured_js": Payload.JOINT_STATE,
    "setpoint_js": Payload.JOINT_STATE,
    "goal_js": Payload.JOINT_STATE,
    "measured_cp": Payload.POSE,
    "setpoint_cp": Payload.POSE,
    "goal_cp": Payload.POSE,
    "measured_cp_array": Payload.POSES,
    "measured_cv": Payload.TWIST,
    "setpoint_cv": Payload.TWIST,
    "goal_cv": Payload.TWIST,
    "measured_cf": Payload.WRENCH,
    "setpoint_cf": Payload.WRENCH,
    "operating_state": Payload.OPERATING_STATE,
    "jacobian": Payload.MATRIX,
    "trajectory_j/ratio": Payload.NUMBER,
    "trajectory_j/ratio_v": Payload.NUMBER,
    "trajectory_j/ratio_a": Payload.NUMBER,
}
COMMANDED = {
    "servo_jp": Payload.JOINT_STATE,
    "servo_jr": Payload.JOINT_STATE,
    "servo_jv": Payload.JOINT_STATE,
    "servo_jf": Payload.JOINT_STATE,
    "interpolate_jp": Payload.JOINT_STATE,
    "interpolate_jr": Payload.JOINT_STATE,
    "interpolate_jv": Payload.JOINT_STATE,
    "interpolate_jf": Payload.JOINT_STATE,
    "move_jp": Payload.JOINT_STATE,
    "move_jr": Payload.JOINT_STATE,
    "servo_cp": Payload.POSE,
    "servo_cr": Payload.POSE,
    "interpolate_cp": Payload.POSE,
    "interpolate_cr": Payload.POSE,
    "move_cp": Payload.POSE,
    "move_cr": Payload.POSE,
    "servo_cv": Payload.TWIST,
    "interpolate_cv": Payload.TWIST,
    "servo_cf": Payload.WRENCH,
    "interpolate_cf": Payload.WRENCH,
    "servo_js": Payload.JOINT_SERVO,
    "servo_cs": Payload.CARTESIAN_SERVO,
    "state_command": Payload.TEXT,
    "hold": Payload.EMPTY,
    "free": Payload.EMPTY,
    "use_gravity_compensation": Payload.FLAG,
    "body/set_cf_orientation_absolute": Payload.FLAG,
    "trajectory_j/set_ratio": Payload.NUMBER,
    "trajectory_j/set_ratio_v": Payload.NUMBER,
    "trajectory_j/set_ratio_a": Payload.NUMBER,
}
SERVICES = {
    "forward_kinematics": Payload.FORWARD_KINEMATICS,
    "inverse_kinematics": Payload.INVERSE_KINEMATICS,
}


@pytest.mark.parametrize(
    ("direction", "names"),
    [
        (Direction.PUBLISHED, PUBLISHED),
        (Direction.COMMANDED, COMMANDED),
        (Direction.SERVICE, SERVICES),
    ],
)
def test_the_table_has_every_name_with_its_payload_and_no_other(
    direction: Direction, names: dict[str, Payload]
) -> None:
    rows = {name: row.payload for name, row in COMMANDS.items() if row.direction is direction}
    assert rows == names


def test_names_are_level_space_and_kind() -> None:
    for name, row in COMMANDS.items():
        assert row.name == name
        assert row.summary
        if row.space:
            assert name == f"{row.level}_{row.space}{row.kind}"


def test_motion_and_increments_are_told_apart() -> None:
    assert {name for name, row in COMMANDS.items() if row.is_relative} == {
        f"{level}_{space}r" for level in ("servo", "interpolate", "move") for space in "jc"
    }
    assert {row.level for row in COMMANDS.values() if row.is_motion} == {
        Level.SERVO,
        Level.INTERPOLATE,
        Level.MOVE,
    }
    assert not COMMANDS["hold"].is_motion


def test_a_name_may_carry_a_sub_namespace_of_the_specification() -> None:
    local = find("local/measured_cp")
    assert (local.name, local.base_name, local.frame) == (
        "local/measured_cp",
        "measured_cp",
        "local",
    )
    assert local.payload is Payload.POSE
    assert find("gripper/measured_js").frame == ""
    assert find("servo_jp") is COMMANDS["servo_jp"]
    assert find("trajectory_j/ratio").base_name == "trajectory_j/ratio"
    absent = "measured1_js measured10_js measured2_cp trajectory_j/servo_jp /measured_cp"
    absent += " elbow/measured_cp local/body/measured_cp measured_cx"
    for name in ("", *absent.split()):
        with pytest.raises(KeyError):
            find(name)


def test_redundant_sensors_have_numbers() -> None:
    assert find("measured2_js").payload is Payload.JOINT_STATE
    assert find("measured3_js").level is Level.MEASURED


def test_the_table_cannot_be_changed() -> None:
    with pytest.raises(TypeError):
        COMMANDS["servo_jp"] = COMMANDS["servo_jv"]  # type: ignore[index]

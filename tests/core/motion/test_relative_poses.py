"""servo_cr and move_cr: axes, accumulation, and what is refused."""

import math
from dataclasses import replace

import pytest

from crtk_drivers.device import Mode
from crtk_drivers.errors import Reason
from crtk_drivers.geometry.quaternions import quaternion_from_rotvec
from crtk_drivers.samples import Pose, Sample, vector
from rigs.scripted_engine import Rig, jp, pose, two_joints


def test_increments_between_two_cycles_are_summed_from_the_setpoint() -> None:
    rig = Rig().enabled()
    for _ in range(2):
        for _ in range(5):
            rig.engine.submit("servo_cr", pose(0.004, -0.006))
        rig.cycle()
    assert rig.written[-1].values == pytest.approx([0.04, -0.06])
    assert rig.engine.health().stream == "servo_cr"
    assert rig.setpoint()["velocity"] == []
    assert rig.value("setpoint_cp")[1] != 0


def test_a_sum_that_is_a_jump_or_out_of_reach_is_refused_in_the_io_thread() -> None:
    rig = Rig().enabled()
    for _ in range(5):
        rig.engine.submit("servo_cr", pose(0.05))
    rig.cycle()
    assert rig.written == []
    rig.engine.submit("servo_cr", pose(0.01))
    rig.cycle()
    assert [refusal.reason for refusal in rig.told.refusals] == [Reason.STEP_TOO_LARGE]
    assert rig.written[-1].values == pytest.approx([0.01, 0.0])


@pytest.mark.parametrize("name", ["servo_cr", "move_cr"])
def test_out_of_reach(name: str) -> None:
    rig = Rig().enabled()
    assert rig.refused(name, pose(0.0, y=0.01)).reason is Reason.UNREACHABLE
    assert not rig.engine.status.is_busy


def test_a_relative_move_beyond_a_limit_is_refused() -> None:
    rig = Rig().enabled()
    rig.servo(0.05, 0.0)
    rig.cycle()
    assert rig.refused("move_cr", pose(0.96)).reason is Reason.OUT_OF_RANGE


def test_a_relative_move_starts_from_the_setpoint_and_latches_its_goal() -> None:
    rig = Rig().enabled()
    rig.servo(0.05, 0.05)
    rig.cycle()
    move = rig.engine.submit("move_cr", pose(0.2, -0.3))
    found = rig.engine.latched("goal_cp")
    assert found is not None
    assert isinstance(found[0], Pose)
    assert found[0].position == pytest.approx([0.25, 0, 0])
    rig.cycle(200)
    assert move is not None
    assert move.wait(0.0)
    assert rig.written[-1].values == pytest.approx([0.25, -0.25])


def test_hardware_that_takes_poses_gets_poses() -> None:
    modes = frozenset({Mode.CARTESIAN_POSITION})
    rig = Rig(capabilities=two_joints(modes=modes), has_kinematics=False).enabled()
    for _ in range(3):
        rig.engine.submit("servo_cr", pose(0.01, 0.05))
        rig.cycle()
    turn = quaternion_from_rotvec(vector((0.0, 0.0, 0.15)))
    assert rig.written[-1].values == pytest.approx([0.03, 0.0, 0.0, *turn])


def test_a_native_move_gets_the_pose_in_the_kinematics_of_the_hardware() -> None:
    native = two_joints(native_moves=frozenset({"move_jp", "move_cp"}))
    rig = Rig(capabilities=native)
    read = rig.device.read

    def with_its_own(deadline: float) -> Sample | None:
        sample = read(deadline)
        assert sample is not None
        return replace(sample, values={**sample.values, "setpoint_cp": pose(0.003)})

    rig.device.read = with_its_own  # type: ignore[method-assign]
    rig.enabled()
    rig.engine.submit("move_cr", pose(0.2, 0.1))
    rig.cycle()
    goal = rig.device.goals[0].pose
    assert goal is not None
    assert goal.position == pytest.approx([0.203, 0, 0])


def test_the_axes_are_those_of_the_base_however_the_tool_is_turned() -> None:
    rig = Rig().enabled()
    rig.engine.submit("move_jp", jp(0.0, math.pi / 2.0 - 0.6))
    rig.cycle(300)
    rig.engine.submit("servo_cr", pose(0.01))
    rig.cycle()
    assert rig.written[-1].values == pytest.approx([0.01, math.pi / 2.0 - 0.6])

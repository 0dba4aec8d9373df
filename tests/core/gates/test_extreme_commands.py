"""Commands of 1e308: refused with a reason, not an exception, and their sums never reach the device."""

import numpy as np
import pytest

from crtk_drivers.device import Mode
from crtk_drivers.errors import Reason
from crtk_drivers.geometry.quaternions import quaternion_from_rotvec
from crtk_drivers.samples import JointState, Pose, Twist, vector
from rigs.scripted_engine import Rig, jp, two_joints

ZERO = vector(np.zeros(3))


def step(x: float, angle: float = 0.0) -> Pose:
    return Pose(vector((x, 0.0, 0.0)), quaternion_from_rotvec(vector((0.0, 0.0, angle))))


@pytest.fixture
def rig() -> Rig:
    return Rig().enabled()


@pytest.mark.parametrize("size", [1e308, -1e308, 1e155, 101.0])
@pytest.mark.parametrize(
    "name",
    [
        f"{frame}{level}_cr"
        for frame in ("", "body/", "spatial/")
        for level in ("servo", "interpolate", "move")
    ],
)
def test_increments_of_poses_are_bounded(rig: Rig, name: str, size: float) -> None:
    for angle in (0.0, 1.0):
        refusal = rig.refused(name, step(size, angle))
        assert refusal.reason is Reason.OUT_OF_RANGE


@pytest.mark.parametrize("size", [1e308, -1e308, 2.001])
@pytest.mark.parametrize("name", ["servo_jr", "interpolate_jr", "move_jr"])
def test_increments_of_joints_lead_at_most_through_their_range(
    rig: Rig, name: str, size: float
) -> None:
    assert rig.refused(name, jp(0.0, size)).reason is Reason.OUT_OF_RANGE


def test_increments_that_wait_together_are_summed_without_harm(rig: Rig) -> None:
    for _ in range(500):
        rig.engine.submit("interpolate_jr", jp(2.0, -2.0))
        rig.engine.submit("interpolate_jr", jp(2.0, -2.0))
        rig.cycle()
    goal, _ = rig.engine.latched("goal_js") or (None, None)
    assert isinstance(goal, JointState)
    assert goal.position.tolist() == [1.0, -1.0]
    assert all(np.isfinite(setpoint.values).all() for setpoint in rig.written)


def test_increments_of_poses_add_up_no_further_than_one_may_lead() -> None:
    """Hardware that takes poses has no inverse kinematics that would refuse the sum."""
    modes = frozenset({Mode.CARTESIAN_POSITION})
    rig = Rig(capabilities=two_joints(modes=modes), has_kinematics=False).enabled()
    for _ in range(20):
        rig.engine.submit("interpolate_cr", step(60.0))
        rig.cycle()
    goal, _ = rig.engine.latched("goal_cp") or (None, None)
    assert isinstance(goal, Pose)
    assert goal.position[0] == 60.0
    refusals = rig.told.refusals
    assert [refusal.reason for refusal in refusals] == [Reason.OUT_OF_RANGE] * 19
    rig.engine.submit("interpolate_cr", step(-59.0))
    rig.cycle()
    assert len(refusals) == 19, "back is always possible"


@pytest.mark.parametrize("name", ["servo_cp", "interpolate_cp", "move_cp"])
def test_places_beyond_any_are_refused(rig: Rig, name: str) -> None:
    for size in (1e308, 2e6):
        assert rig.refused(name, step(size)).reason is Reason.OUT_OF_RANGE


def test_twists_are_bounded_without_limits_of_the_tool() -> None:
    modes = frozenset({Mode.JOINT_POSITION, Mode.JOINT_VELOCITY})
    rig = Rig(capabilities=two_joints(cartesian_limits=None, modes=modes)).enabled()
    for size in (1e308, 2e6):
        twist = Twist(vector((size, size, 0.0)), ZERO)
        assert rig.refused("servo_cv", twist).reason is Reason.OUT_OF_RANGE

"""What is measured, what was sent, and how old it is."""

import numpy as np
import pytest

from crtk_drivers.device import Mode, Setpoint
from crtk_drivers.motion.feedback import Feedback
from crtk_drivers.motion.point import Point
from crtk_drivers.motion.told import Told
from crtk_drivers.samples import JointState, Pose, Sample, Stamp, vector
from crtk_drivers.state import OperatingState
from crtk_drivers.testing.clock import FakeClock
from rigs.scripted_engine import JOINTS, ScriptedDevice, two_joints

ON = OperatingState.ENABLED


class Bench:
    def __init__(self) -> None:
        self.clock = FakeClock()
        self.device = ScriptedDevice(self.clock, two_joints())
        self.feedback = Feedback(self.device, stale_after=0.05)
        self.told = Told(self.feedback)

    def measure(self, *position: float) -> None:
        self.device.position = np.array(position)
        sample = self.device.read(0.0)
        assert sample is not None
        self.feedback.take(sample)

    def setpoint(self, state: OperatingState = ON) -> JointState:
        found = self.told.get("setpoint_js", self.clock(), state)
        assert found is not None
        assert isinstance(found[0], JointState)
        return found[0]


@pytest.fixture
def bench() -> Bench:
    bench = Bench()
    bench.measure(0.1, 0.2)
    return bench


def test_before_the_first_sample_there_is_nothing() -> None:
    bench = Bench()
    for name in ("measured_js", "setpoint_js", "setpoint_cp", "jacobian"):
        assert bench.told.get(name, bench.clock(), ON) is None
    assert bench.feedback.sample_age(bench.clock()) == np.inf
    assert not bench.feedback.seed(bench.clock(), -np.inf)


def test_a_sample_is_valid_until_it_is_stale_and_keeps_its_stamp(bench: Bench) -> None:
    fresh = bench.told.get("measured_js", bench.clock(), ON)
    bench.clock.advance(0.049)
    later = bench.told.get("measured_js", bench.clock(), ON)
    bench.clock.advance(0.002)
    stale = bench.told.get("measured_js", bench.clock(), ON)
    assert fresh is not None
    assert later is not None
    assert stale is not None
    assert fresh[1] == later[1]
    assert fresh[1].wall_ns > 0
    assert stale[1].wall_ns == 0
    assert stale[1].monotonic == fresh[1].monotonic
    assert not bench.feedback.seed(bench.clock(), -np.inf)


def test_a_sample_without_values_leaves_those_that_were_known_and_their_age(bench: Bench) -> None:
    before = bench.told.get("measured_js", bench.clock(), ON)
    assert before is not None
    bench.clock.advance(0.03)
    bench.feedback.take(Sample(Stamp(1, bench.clock())))
    assert bench.told.get("measured_js", bench.clock(), ON) == before
    assert bench.setpoint().position.tolist() == [0.1, 0.2]
    bench.clock.advance(0.03)
    bench.feedback.take(Sample(Stamp(2, bench.clock())))
    stale = bench.told.get("measured_js", bench.clock(), ON)
    assert stale is not None
    assert stale[0] is before[0]
    assert stale[1].wall_ns == 0
    assert not bench.feedback.seed(bench.clock(), -np.inf)


def test_what_was_read_before_the_link_was_lost_is_not_valid(bench: Bench) -> None:
    bench.feedback.invalidate()
    found = bench.told.get("measured_cp", bench.clock(), ON)
    assert found is not None
    assert found[1].wall_ns == 0
    assert bench.feedback.sample_age(bench.clock()) == np.inf


def test_a_sample_without_values_after_a_loss_shows_that_the_link_is_alive_and_no_more(
    bench: Bench,
) -> None:
    bench.feedback.invalidate()
    bench.clock.advance(1.0)
    bench.feedback.take(Sample(Stamp(1, bench.clock())))
    assert bench.feedback.sample_age(bench.clock()) == 0.0
    found = bench.told.get("measured_cp", bench.clock(), ON)
    assert found is not None
    assert found[1].wall_ns == 0
    assert not bench.feedback.seed(bench.clock(), -np.inf)


def test_a_device_that_measures_nothing_itself_is_alive_while_samples_without_values_come() -> None:
    bench = Bench()
    for _ in range(3):
        bench.clock.advance(1.0)
        bench.feedback.take(Sample(Stamp(1, bench.clock())))
        assert bench.feedback.seed(bench.clock(), bench.clock())


def test_hold_keeps_a_position_that_was_sent_also_twice(bench: Bench) -> None:
    bench.feedback.sent(Point(Setpoint(Mode.JOINT_POSITION, vector((0.3, 0.3)))), 0.0)
    for _ in range(2):
        bench.feedback.hold()
        assert bench.setpoint().position.tolist() == [0.3, 0.3]


def test_after_a_velocity_the_device_is_where_it_comes_to_rest(bench: Bench) -> None:
    bench.feedback.sent(Point(Setpoint(Mode.JOINT_VELOCITY, vector((0.3, 0.3)))), 0.0)
    bench.feedback.hold()
    bench.measure(0.5, 0.6)
    assert bench.setpoint().position.tolist() == [0.5, 0.6]
    assert bench.setpoint().velocity.size == 0


def test_hardware_that_reports_its_setpoint_is_believed_when_we_send_none(bench: Bench) -> None:
    bench.device.native_setpoint = JointState(vector((0.7, 0.7)), effort=vector((1.0, 2.0)))
    bench.measure(0.1, 0.2)
    assert bench.setpoint().position.tolist() == [0.7, 0.7]
    bench.feedback.sent(Point(Setpoint(Mode.JOINT_POSITION, vector((0.3, 0.3)))), 0.0)
    assert bench.setpoint().position.tolist() == [0.3, 0.3]
    assert bench.setpoint().effort.tolist() == [1.0, 2.0]
    bench.feedback.hold()
    assert bench.setpoint().position.tolist() == [0.7, 0.7]
    assert bench.setpoint().name == JOINTS


def test_a_jump_is_seen_against_the_measurement_until_something_was_sent(bench: Bench) -> None:
    assert bench.feedback.before(Mode.JOINT_POSITION).tolist() == [0.1, 0.2]
    assert bench.feedback.before(Mode.CARTESIAN_POSITION)[:3].tolist() == [0.1, 0.0, 0.0]
    sent = vector((1, 2, 3, 0, 0, 0, 1))
    bench.feedback.sent(Point(Setpoint(Mode.CARTESIAN_POSITION, sent)), 0.0)
    assert bench.feedback.before(Mode.CARTESIAN_POSITION).tolist() == sent.tolist()
    assert bench.feedback.before(Mode.JOINT_VELOCITY).tolist() == [0.1, 0.2]


def test_the_cartesian_setpoint_is_the_pose_of_the_joint_setpoint(bench: Bench) -> None:
    bench.feedback.sent(Point(Setpoint(Mode.JOINT_POSITION, vector((0.3, 0.0)))), 0.0)
    found = bench.told.get("setpoint_cp", bench.clock(), ON)
    assert found is not None
    assert isinstance(found[0], Pose)
    assert found[0].position.tolist() == [0.3, 0.0, 0.0]
    assert found[1].wall_ns > 0
    bench.feedback.sent(Point(Setpoint(Mode.JOINT_VELOCITY, vector((0.3, 0.0)))), 0.0)
    found = bench.told.get("setpoint_cp", bench.clock(), ON)
    assert found is not None
    assert found[1].wall_ns == 0


def test_goals_are_latched_until_the_next(bench: Bench) -> None:
    goal = JointState(vector((0.5, 0.5)), name=JOINTS)
    bench.told.latch({"goal_js": goal})
    assert bench.told.latched("goal_js")[0] is goal
    assert bench.told.latched("goal_js")[1].wall_ns > 0


def test_a_sample_without_a_value_has_none_under_that_name(bench: Bench) -> None:
    pose = Pose(vector((0.0, 0.0, 0.0)), vector((0.0, 0.0, 0.0, 1.0)))
    bench.feedback.take(Sample(bench.clock.stamp(), {"measured_cp": pose}))
    assert bench.told.get("measured_js", bench.clock(), ON) is None
    assert bench.told.get("jacobian", bench.clock(), ON) is None
    assert bench.told.get("setpoint_cp", bench.clock(), ON) is None

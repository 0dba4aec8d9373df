"""Trajectories of ours on hardware that slows them down, smooths them, or has slower limits for moves."""

from typing import Any

import numpy as np
import pytest

from crtk_drivers.device import CartesianLimits, Following, JointLimits, Mode
from crtk_drivers.errors import MotionAborted
from crtk_drivers.motion.arriving import RESTS
from crtk_drivers.motion.executions import ARRIVAL_TIMEOUT, PACE_TIME
from crtk_drivers.motion.move import Move
from crtk_drivers.samples import JointState, Value, vector
from crtk_drivers.trajectory.profiles import JointProfile
from rigs.scripted_arm import ARM, BENT, LIMIT, PERIOD, TOOL, ArmRig
from rigs.scripted_engine import jp

SLOW = JointLimits(-6.0, 6.0, velocity=0.5, acceleration=2.0, jerk=40.0, effort=50.0)
GENTLE = JointLimits(-6.0, 6.0, velocity=1.05, acceleration=1.4, jerk=14.0, effort=50.0)
GENTLE_LINE = CartesianLimits(0.25, 3.0, 1.2, 5.0)
GOAL = BENT + 0.2
LINE = ARM.forward(BENT + 0.05)
STILL = vector(np.zeros(6))


class Hardware(ArmRig):
    """That is sent trajectories."""

    def __init__(self, **changes: Any) -> None:
        super().__init__(Mode.JOINT_POSITION, **changes)

    def moving(self, name: str = "move_jp", value: Value | None = None) -> Move:
        move = self.engine.submit(name, jp(*GOAL) if value is None else value)
        assert move is not None
        return move

    def cycles_of(self, move: Move) -> int:
        """Turn the clock until the move is over; return in how many cycles that was."""
        for count in range(1, 5000):
            self.cycle()
            if not move.is_busy():
                return count
        pytest.fail("the move does not end")

    @property
    def speeds(self) -> np.ndarray:
        """Of the joints from one setpoint to the next, rad/s."""
        return np.diff(self.path, axis=0) / PERIOD


@pytest.mark.parametrize("name", ["move_jp", "move_cp"])
def test_a_slower_pace_takes_longer_on_the_same_way(name: str) -> None:
    value = None if name == "move_jp" else LINE
    full, half = Hardware().enabled(), Hardware().enabled()
    half.device.slider = 0.5
    quick = full.cycles_of(full.moving(name, value))
    slow = half.cycles_of(half.moving(name, value))
    assert slow == pytest.approx(2 * quick, abs=2)
    np.testing.assert_allclose(half.path[1::2][: len(full.path) - 1], full.path[:-1], atol=1e-9)
    np.testing.assert_allclose(half.path[-1], full.path[-1], atol=1e-9)


def test_at_no_pace_a_move_waits_and_then_goes_on() -> None:
    rig = Hardware().enabled()
    move = rig.moving()
    rig.cycle(20)
    rig.device.slider = 0.0
    rig.cycle(2000)
    assert move.is_busy()
    np.testing.assert_array_equal(rig.path[-1], rig.path[-1000])
    assert abs(rig.path[-1] - GOAL).max() > 0.01
    rig.device.slider = 1.0
    rig.cycles_of(move)
    assert abs(rig.speeds).max() <= LIMIT.velocity + 1e-9
    gains = abs(np.diff(rig.speeds, axis=0)).max() / PERIOD
    assert gains <= LIMIT.acceleration + LIMIT.velocity / PACE_TIME, (
        "the pace is not taken over in a jump"
    )
    np.testing.assert_allclose(rig.path[-1], GOAL, atol=1e-12)


WAYS = {
    "move_jp": lambda: jp(*(BENT + 0.1)),
    "move_cp": lambda: ARM.forward(BENT + 0.15),
    "interpolate_jp": lambda: jp(*(BENT + 0.1)),
}


@pytest.mark.sweep(6)
@pytest.mark.parametrize("jitter", [0.0, 0.0002, 0.001])
@pytest.mark.parametrize("second", WAYS)
@pytest.mark.parametrize("first", ["move_jp", "move_cp"])
def test_a_motion_goes_on_from_a_move_whose_cycles_are_uneven(
    first: str, second: str, jitter: float
) -> None:
    for seed in range(5):
        rig = Hardware(move_limits=(GENTLE,) * 6, line_limits=GENTLE_LINE).enabled()
        random = np.random.default_rng(seed)

        def cycle(rig=rig, random=random) -> None:
            rig.cycle(period=PERIOD + random.uniform(-jitter, jitter))

        rig.moving(first, None if first == "move_jp" else ARM.forward(BENT + 0.3))
        for _ in range(50):
            cycle()
        rig.engine.submit(second, WAYS[second]())
        for _ in range(1500):
            cycle()
        offsets = rig.path - BENT
        assert not rig.engine.status.is_busy
        assert rig.told.refusals == []
        assert np.abs(offsets).max() < 0.45, "no swing"
        steps = np.abs(np.diff(rig.path, axis=0)).max()
        assert steps <= LIMIT.velocity * (PERIOD + jitter) * 1.02


@pytest.mark.parametrize("second", WAYS)
@pytest.mark.parametrize("first", ["move_jp", "move_cp"])
def test_a_motion_goes_on_from_a_move_that_is_slowed_down(first: str, second: str) -> None:
    rig = Hardware().enabled()
    rig.device.slider = 0.3
    rig.moving(first, None if first == "move_jp" else ARM.forward(BENT + 0.3))
    rig.cycle(150)
    told = rig.setpoint()["velocity"]
    np.testing.assert_allclose(told, rig.speeds[-1], rtol=0.05, atol=1e-3)
    rig.engine.submit(second, WAYS[second]())
    rig.cycle(3)
    np.testing.assert_allclose(rig.speeds[-3:], [rig.speeds[-4]] * 3, atol=0.08)


def test_an_acceleration_beyond_the_limits_is_no_run_up() -> None:
    limits = [JointLimits(-6.0, 6.0, velocity=1.05, acceleration=1.4, jerk=14.0, effort=50.0)]
    begin = (vector([0.0]), vector([0.5]), vector([-30.0]))
    profile = JointProfile(*begin, vector([0.3]), limits)
    way = [profile.at(time)[0][0] for time in np.linspace(0.0, profile.duration, 500)]
    assert min(way) > -0.01
    assert max(way) < 0.31


def test_a_move_ends_when_the_hardware_has_arrived() -> None:
    quick = Hardware().enabled()
    on_time = quick.cycles_of(quick.moving())
    rig = Hardware().enabled()
    rig.device.arrived = False
    move = rig.moving()
    rig.cycle(on_time + 50)
    assert move.is_busy()
    assert rig.engine.status.is_busy
    assert rig.path[-50:].tolist() == [list(GOAL)] * 50, "the goal is sent meanwhile"
    rig.device.arrived = True
    rig.cycle()
    assert move.wait(0.0)


@pytest.mark.parametrize("velocity", [(), (1.0,) * 6], ids=["unmeasured", "noisy"])
def test_a_move_does_not_wait_until_joints_settle_for_ever(velocity: tuple[float, ...]) -> None:
    """Each cycle takes them nearer still, by parts of a billionth."""
    rig = Hardware(following=Following((0.5,) * 6, (0.01,) * 6, lag=0.02)).enabled()
    move, here = rig.moving(), np.array(BENT)
    ended = JointProfile(vector(BENT), STILL, STILL, vector(GOAL), [LIMIT] * 6).duration
    for _ in range(round((ended + RESTS + 0.1) / PERIOD)):
        here += 0.25 * (rig.device.position - here)
        rig.device.extra["measured_js"] = JointState(vector(here), vector(velocity))
        rig.cycle()
    assert move.wait(0.0)


def test_hardware_that_does_not_arrive_ends_the_move_with_the_reason() -> None:
    rig = Hardware().enabled()
    rig.device.arrived = False
    move = rig.moving()
    rig.cycle(int((ARRIVAL_TIMEOUT + 1.0) / PERIOD))
    with pytest.raises(
        MotionAborted, match=f"not come to rest where move_jp ends in {ARRIVAL_TIMEOUT:g} s"
    ):
        move.wait(0.0)
    assert rig.device.calls.count("stop") == 1
    assert rig.engine.status.is_busy is False


def test_moves_keep_their_own_limits_and_streams_those_of_the_joints() -> None:
    rig = Hardware(move_limits=(SLOW,) * 6).enabled()
    rig.cycles_of(rig.moving())
    assert abs(rig.speeds).max() == pytest.approx(SLOW.velocity, rel=1e-6)
    assert abs(np.diff(rig.speeds, axis=0)).max() / PERIOD <= SLOW.acceleration * (1.0 + 1e-6)
    count = len(rig.path)
    for _ in range(150):
        rig.engine.submit("interpolate_jp", jp(*BENT))
        rig.cycle()
    assert abs(rig.speeds[count:]).max() > SLOW.velocity


def test_a_line_keeps_its_own_limits() -> None:
    slow = CartesianLimits(0.05, 0.2, 0.5, 2.0)
    rig = Hardware(line_limits=slow).enabled()
    rig.cycles_of(rig.moving("move_cp", LINE))
    way = np.array([pose.position for pose in rig.tool_path])
    speeds = np.linalg.norm(np.diff(way, axis=0), axis=1) / PERIOD
    assert speeds.max() <= slow.linear_velocity * (1.0 + 1e-3)
    assert speeds.max() > 0.5 * slow.linear_velocity
    assert slow.linear_velocity < TOOL.linear_velocity


def test_move_limits_are_one_for_each_joint() -> None:
    with pytest.raises(ValueError, match="2 move_limits for 6 joints"):
        Hardware(move_limits=(SLOW,) * 2)

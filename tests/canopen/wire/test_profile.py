"""Drives that plan their own moves (profile position), and drives that have only some of the modes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from typing_extensions import override

from crtk_driver_canopen import PLUGIN
from crtk_driver_canopen.modes import OpMode
from crtk_drivers.engine import Observer
from crtk_drivers.errors import CommandRefused, ConfigError, MotionAborted
from crtk_drivers.front import LocalDevice
from crtk_drivers.samples import Stamp
from crtk_drivers.session import Session
from crtk_drivers.state import Status
from crtk_sim_backends.process import RunningSim
from rigs.canopen_arm import arm_of, device_of, drives, patient_arm_on
from rigs.waiting import LONG, eventually

COUNT = 2
PP: dict[str, Any] = {"modes": ("pp",)}
BOTH: dict[str, Any] = {"modes": ("csp", "pp", "csv")}
PROFILE_VELOCITY, PROFILE_ACCELERATION = 0x6081, 0x6083
REACH_TIME = "crtk_driver_canopen.motion.REACH_TIME", 1.0
"""Seconds that a joint may stand in a move, in place of three."""


@pytest.fixture(scope="module")
def shared() -> Iterator[RunningSim]:
    """Drives with nothing but modes that make their own ramps, and interpolated position."""
    with drives(COUNT, modes="pp,pv,tq,ip,hm") as sim:
        yield sim


@pytest.fixture
def sim(shared: RunningSim) -> Iterator[RunningSim]:
    yield shared
    shared.control.clear()


@pytest.fixture(scope="module")
def whole() -> Iterator[RunningSim]:
    """Drives with all modes."""
    with drives(COUNT) as sim:
        yield sim


def near(arm: LocalDevice, goal: Any, within: float = 2e-3) -> bool:
    return bool(np.abs(arm.measured_js().position - np.asarray(goal)).max() < within)


def told(sim: RunningSim, index: int, node: int = 1) -> int:
    value: int = sim.control.call("object", node=node, index=index)
    return value


def velocities(sim: RunningSim) -> list[float]:
    status = sim.control.status()["drives"]
    return [status[str(node)]["axes"][0]["velocity"] for node in range(1, COUNT + 1)]


def moves(sim: RunningSim, least: float = 1e5) -> bool:
    return min(map(abs, velocities(sim))) > least


def stands(sim: RunningSim) -> bool:
    return max(map(abs, velocities(sim))) < 100.0


class Busy(Observer):
    """Keeps whether it was busy: a move may be over before a test looks."""

    busy = False

    @override
    def status_changed(self, status: Status, stamp: Stamp) -> None:
        self.busy |= status.is_busy


# ------------------------------------------------------------------------------------ moves of their own


def test_a_move_is_made_by_the_drives_and_is_busy_until_they_are_there(sim: RunningSim) -> None:
    with arm_of(patient_arm_on(sim, COUNT, PP)) as arm:
        assert "move_jp" in arm.engine.commands
        assert "servo_jp" not in arm.engine.commands
        arm.enable(LONG)
        told = Busy()
        arm.engine.add_observer(told)
        for goal in ([0.3, -0.2], [0.0, 0.0], [0.0, 0.0]):
            told.busy = False
            arm.move_jp(goal).wait(LONG)
            assert told.busy
            assert near(arm, goal)
            eventually(lambda: not arm.operating_state().is_busy, "it is not busy")
            goal_js = arm.goal_js()
            assert goal_js.position.tolist() == goal
            np.testing.assert_allclose(arm.setpoint_js().position, goal, atol=1e-3)
        assert arm.operating_state().state == "ENABLED"


def test_the_joints_go_straight_and_arrive_together(sim: RunningSim) -> None:
    with arm_of(patient_arm_on(sim, COUNT, PP)) as arm:
        arm.enable(LONG)
        arm.move_jp([0.0, 0.0]).wait(LONG)
        seen: list[np.ndarray] = []
        arm.engine.on_sample = lambda: seen.append(arm.measured_js(age=0).position)
        arm.move_jp([1.0, 0.25]).wait(LONG)
        way = np.array(seen)
        assert len(way) > 10
        between = way[(way[:, 0] > 0.1) & (way[:, 0] < 0.9)]
        np.testing.assert_allclose(between[:, 1], 0.25 * between[:, 0], atol=0.02)


def test_a_move_takes_over_from_one_that_runs(sim: RunningSim) -> None:
    with arm_of(patient_arm_on(sim, COUNT, PP)) as arm:
        arm.enable(LONG)
        arm.move_jp([0.0, 0.0]).wait(LONG)
        arm.trajectory_j.set_ratio_v(0.3)  # so that it is not there when the next one comes
        first = arm.move_jp([2.0, 2.0])
        eventually(lambda: moves(sim), "it moves")
        arm.trajectory_j.set_ratio_v(1.0)
        second = arm.move_jp([-0.5, 0.5])
        with pytest.raises(MotionAborted, match="move_jp"):
            first.wait(LONG)
        second.wait(LONG)
        assert near(arm, [-0.5, 0.5])


def test_joints_that_a_move_finds_in_motion_arrive_together(sim: RunningSim) -> None:
    with arm_of(patient_arm_on(sim, COUNT, PP)) as arm:
        arm.enable(LONG)
        arm.move_jp([0.0, 0.0]).wait(LONG)
        arm.trajectory_j.set_ratio_v(0.1)  # so that it is not far when the next one comes
        arm.move_jp([2.0, 2.0])
        eventually(lambda: moves(sim), "it moves")
        arm.trajectory_j.set_ratio_v(1.0)
        seen: list[np.ndarray] = []
        arm.engine.on_sample = lambda: seen.append(arm.measured_js(age=0).position)
        goal = np.array([-2.5, 1.2])
        arm.move_jp(goal).wait(LONG)
        left = np.abs(np.array(seen) - goal)
        there = int(np.flatnonzero(left[:, 1] >= 0.02)[-1])
        # With the velocity of its limit the second joint is there when the first has 1.7 rad to go.
        assert left[there, 0] < 0.9


def test_hold_stops_a_move_and_nothing_goes_on_after_it(sim: RunningSim) -> None:
    with arm_of(patient_arm_on(sim, COUNT, PP)) as arm:
        arm.enable(LONG)
        arm.move_jp([0.0, 0.0]).wait(LONG)
        arm.trajectory_j.set_ratio_v(0.3)  # so that it is not there before it is stopped
        move = arm.move_jp([2.5, 2.5])
        eventually(lambda: moves(sim), "it moves")
        arm.hold()
        with pytest.raises(MotionAborted):
            move.wait(LONG)
        eventually(lambda: device_of(arm).has_stopped and stands(sim), "it stands")
        stood = arm.measured_js().position
        assert (stood < 2.0).all()
        samples = arm.engine.health().samples
        eventually(lambda: arm.engine.health().samples > samples + 30, "samples come")
        assert near(arm, stood)
        arm.move_jp(stood - 0.1).wait(LONG)
        assert near(arm, stood - 0.1)


def test_disable_and_enable_in_a_move_leave_no_goal_behind(sim: RunningSim) -> None:
    with arm_of(patient_arm_on(sim, COUNT, PP)) as arm:
        arm.enable(LONG)
        arm.move_jp([0.0, 0.0]).wait(LONG)
        arm.move_jp([2.5, 2.5])
        eventually(lambda: moves(sim), "it moves")
        arm.disable(LONG)
        eventually(lambda: stands(sim), "it stands")
        stood = arm.measured_js().position
        arm.enable(LONG)
        samples = arm.engine.health().samples
        eventually(lambda: arm.engine.health().samples > samples + 30, "samples come")
        assert near(arm, stood, 0.02)


def test_ratios_are_those_of_the_drives_profiles(sim: RunningSim) -> None:
    with arm_of(patient_arm_on(sim, COUNT, PP)) as arm:
        arm.enable(LONG)
        arm.move_jp([0.0, 0.0]).wait(LONG)
        arm.move_jp([0.2, 0.1]).wait(LONG)
        fast = told(sim, PROFILE_VELOCITY), told(sim, PROFILE_ACCELERATION)
        assert told(sim, PROFILE_VELOCITY, 2) == pytest.approx(fast[0] / 2, rel=0.05)
        arm.engine.submit("trajectory_j/set_ratio_v", _number(0.5))
        arm.engine.submit("trajectory_j/set_ratio_a", _number(0.25))
        arm.move_jp([0.0, 0.0]).wait(LONG)
        slow = told(sim, PROFILE_VELOCITY), told(sim, PROFILE_ACCELERATION)
        assert slow[0] == pytest.approx(0.5 * fast[0], rel=0.01)
        assert slow[1] == pytest.approx(0.25 * fast[1], rel=0.01)


def _number(value: float) -> Any:
    from crtk_drivers.samples import Number

    return Number(value)


def test_a_slow_move_is_not_taken_for_one_that_stands(
    sim: RunningSim, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(*REACH_TIME)
    with arm_of(patient_arm_on(sim, COUNT, PP)) as arm:
        arm.enable(LONG)
        arm.move_jp([0.0, 0.0]).wait(LONG)
        arm.engine.submit("trajectory_j/set_ratio_v", _number(0.005))
        arm.move_jp([0.016, 0.008]).wait(LONG)  # takes longer than a joint may stand
        assert near(arm, [0.016, 0.008])


def test_a_drive_that_refuses_its_profile_ends_the_move_with_the_reason(sim: RunningSim) -> None:
    with arm_of(patient_arm_on(sim, COUNT, PP)) as arm:
        arm.enable(LONG)
        arm.move_jp([0.0, 0.0]).wait(LONG)
        sim.control.inject("sdo_abort", node=2, index=PROFILE_VELOCITY, sub=0, code=0x06090031)
        with pytest.raises(MotionAborted, match="value is too high"):
            arm.move_jp([0.3, 0.1]).wait(LONG)
        assert near(arm, [0.0, 0.0])
        assert arm.operating_state().state == "ENABLED"
        sim.control.clear()
        arm.move_jp([0.3, 0.1]).wait(LONG)
        assert near(arm, [0.3, 0.1])


def test_a_drive_that_cannot_get_there_ends_the_move(
    sim: RunningSim, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(*REACH_TIME)
    with arm_of(patient_arm_on(sim, COUNT, PP)) as arm:
        arm.enable(LONG)
        arm.move_jp([0.0, 0.0]).wait(LONG)
        highest = sim.control.call("object", node=2, index=0x607D, sub=2)
        sim.control.call("object", node=2, index=0x607D, sub=2, value=1000)
        sim.control.call("object", node=2, index=0x6067, value=1)
        sim.control.call("object", node=2, index=0x6068, value=60000)
        with pytest.raises(
            MotionAborted, match=r"joint_2 \(node 2\): it stands, but does not tell"
        ):
            arm.move_jp([0.2, 0.2]).wait(LONG)
        sim.control.call("object", node=2, index=0x607D, sub=2, value=highest)
        sim.control.call("object", node=2, index=0x6067, value=100)
        sim.control.call("object", node=2, index=0x6068, value=5)
        arm.move_jp([0.0, 0.0]).wait(LONG)


def test_a_fault_in_a_move_ends_it_and_its_end_moves_nothing(sim: RunningSim) -> None:
    with arm_of(patient_arm_on(sim, COUNT, PP)) as arm:
        arm.enable(LONG)
        arm.move_jp([0.0, 0.0]).wait(LONG)
        arm.trajectory_j.set_ratio_v(0.3)  # so that it is not there before the fault is
        move = arm.move_jp([2.5, 2.5])
        eventually(lambda: moves(sim), "it moves")
        arm.trajectory_j.set_ratio_v(1.0)
        sim.control.inject("fault", node=2, error="over_current")
        eventually(lambda: arm.operating_state().state == "FAULT", "it is in FAULT")
        with pytest.raises(MotionAborted):
            move.wait(LONG)
        eventually(lambda: stands(sim), "it stands")
        arm.enable(LONG)
        stood = arm.measured_js().position
        samples = arm.engine.health().samples
        eventually(lambda: arm.engine.health().samples > samples + 30, "samples come")
        assert near(arm, stood, 0.02)
        arm.move_jp([0.0, 0.0]).wait(LONG)


# ---------------------------------------------------------------------------- streams and moves in turn


def test_streams_and_moves_of_the_drives_follow_each_other_without_a_jump(
    whole: RunningSim,
) -> None:
    with arm_of(patient_arm_on(whole, COUNT, BOTH, moves="drives")) as arm:
        axes = device_of(arm).axes
        arm.enable(LONG)
        assert all(axis.mode is OpMode.CSP for axis in axes)
        arm.move_jp([0.0, 0.0]).wait(LONG)
        eventually(lambda: device_of(arm).takes_setpoints, "it can be moved again")
        assert all(axis.mode is OpMode.CSP for axis in axes)
        position = arm.setpoint_js().position
        for _ in range(20):
            position = position + 0.004
            arm.servo_jp(position)
            samples = arm.engine.health().samples
            eventually(lambda s=samples: arm.engine.health().samples > s, "a sample comes")
        arm.trajectory_j.set_ratio_v(0.1)  # so that it is not there before it is looked at
        arm.move_jp([0.5, 0.5])
        eventually(lambda: all(axis.mode is OpMode.PP for axis in axes), "the drives plan")
        eventually(lambda: moves(whole), "the drives move")

        def follows_velocities() -> bool:
            arm.servo_jv([0.2] * COUNT)
            return all(axis.mode is OpMode.CSV for axis in axes)

        eventually(follows_velocities, "it follows velocities")
        arm.trajectory_j.set_ratio_v(1.0)
        arm.move_jp([0.0, 0.0]).wait(LONG)
        assert near(arm, [0.0, 0.0])
        assert arm.operating_state().state == "ENABLED"


def test_the_arms_own_trajectory_is_used_unless_the_drives_are_to_plan(whole: RunningSim) -> None:
    with arm_of(patient_arm_on(whole, COUNT, BOTH)) as arm:
        arm.enable(LONG)
        arm.trajectory_j.set_ratio_v(0.1)  # so that it is not there before it is looked at
        move = arm.move_jp([0.3, 0.3])
        eventually(lambda: moves(whole), "it moves")
        assert all(axis.mode is OpMode.CSP for axis in device_of(arm).axes)
        move.wait(LONG)
        arm.trajectory_j.set_ratio_v(1.0)
        arm.move_jp([0.0, 0.0]).wait(LONG)


def test_hold_in_a_trajectory_slows_down_within_the_limits(whole: RunningSim) -> None:
    with arm_of(patient_arm_on(whole, COUNT, {"acceleration": 4.0})) as arm:
        arm.enable(LONG)
        arm.move_jp([0.0, 0.0]).wait(LONG)
        arm.move_jp([2.8, 2.8])
        eventually(lambda: arm.measured_js().position.min() > 0.3, "it moves")
        eventually(lambda: arm.measured_js().velocity.min() > 1.0, "it is at speed")
        before = arm.measured_js().position
        counters = device_of(arm).link.counters
        missed = counters.missed
        arm.hold()
        eventually(lambda: device_of(arm).has_stopped and stands(whole), "it stands")
        # From 1 rad/s with 4 rad/s², a joint needs an eighth of a radian at least. One that is not heard
        # for two cycles, of four PDOs each, stands where it was told to be.
        is_heard = counters.missed < missed + 8
        assert (arm.measured_js().position - before > 0.1).all() or not is_heard
        eventually(
            lambda: near(arm, arm.setpoint_js().position, 0.01), "it is where it is told to be"
        )
        arm.servo_jr([0.0, 0.0])
        arm.move_jp([0.0, 0.0]).wait(LONG)


# ------------------------------------------------------------------------------ drives with fewer modes


def test_positions_velocities_and_efforts_by_the_older_modes(sim: RunningSim) -> None:
    joint = {"modes": ("ip", "pv", "tq")}
    with arm_of(patient_arm_on(sim, COUNT, joint)) as arm:
        axes = device_of(arm).axes
        arm.enable(LONG)
        assert all(axis.mode is OpMode.IP for axis in axes)
        arm.move_jp([0.2, 0.2]).wait(LONG)
        eventually(lambda: near(arm, [0.2, 0.2]), "it is there")

        def moved() -> bool:
            arm.servo_jv([0.3] * COUNT)
            return bool((arm.measured_js().position > 0.25).all())

        eventually(moved, "it has moved")
        eventually(lambda: arm.engine.is_at_rest, "the stream ends, and none waits")
        eventually(lambda: stands(sim), "it stands")
        eventually(lambda: all(axis.mode is OpMode.IP for axis in axes), "it holds its position")

        def pushed() -> bool:
            arm.servo_jf([6.0] * COUNT)
            return (arm.measured_js().velocity > 0.1).all()

        eventually(pushed, "it gives way to the effort")
        eventually(lambda: stands(sim), "it stands again")
        assert arm.operating_state().state == "ENABLED"


@pytest.mark.parametrize(
    ("modes", "command", "value"),
    [(("pv",), "servo_jv", 0.3), (("pv", "tq"), "servo_jv", -0.3), (("tq",), "servo_jf", 6.0)],
)
def test_an_arm_without_positions_holds_in_what_it_has(
    sim: RunningSim, modes: tuple[str, ...], command: str, value: float
) -> None:
    with arm_of(patient_arm_on(sim, COUNT, {"modes": modes})) as arm:
        assert "servo_jp" not in arm.engine.commands
        arm.enable(LONG)
        before = arm.measured_js().position

        def gone() -> bool:
            getattr(arm, command)([value] * COUNT)
            return bool((np.abs(arm.measured_js().position - before) > 0.1).all())

        eventually(gone, "it moves")
        eventually(lambda: stands(sim), "it stands when the stream has ended")
        assert arm.operating_state().state == "ENABLED"
        arm.disable(LONG)
        arm.enable(LONG)


def test_a_drive_without_the_configured_mode_is_refused_with_those_it_has(sim: RunningSim) -> None:
    arm = LocalDevice(Session(PLUGIN, patient_arm_on(sim, COUNT)))
    try:
        arm._session.start()
        eventually(lambda: "does not have" in arm.operating_state().detail, "it is refused")
        detail = arm.operating_state().detail
        assert "cyclic synchronous position" in detail
        assert "Give `joints.joint_1.modes` of pp, pv, tq, ip" in detail
    finally:
        arm.close()


def test_joints_without_a_kind_of_mode_in_common_are_refused(sim: RunningSim) -> None:
    joints = patient_arm_on(sim, COUNT).model_dump()["joints"]
    joints["joint_1"]["modes"] = ("pp",)
    joints["joint_2"]["modes"] = ("csv",)
    with pytest.raises(ConfigError, match="nothing could be commanded"):
        patient_arm_on(sim, COUNT, joints=joints)


def test_what_is_not_offered_says_which_mode_is_missing(sim: RunningSim) -> None:
    with arm_of(patient_arm_on(sim, COUNT, PP)) as arm:
        arm.enable(LONG)
        with pytest.raises(CommandRefused, match="does not offer"):
            arm.engine.submit("servo_jp", arm.measured_js())

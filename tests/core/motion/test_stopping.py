"""Stops that are believed only when they are read back, and joints that do not follow."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest

from crtk_drivers.device import (
    Condition,
    Following,
    JointLimits,
    MoveProgress,
    Setpoint,
    Steps,
    StopPolicy,
)
from crtk_drivers.engine import EngineOptions
from crtk_drivers.errors import (
    CommandRefused,
    ConnectionLost,
    MotionAborted,
    ProtocolError,
    Reason,
    StopUnconfirmed,
)
from crtk_drivers.motion.move import Outcome
from crtk_drivers.options import LimitPolicy
from crtk_drivers.samples import JointState, Sample, vector
from crtk_drivers.state import OperatingState as S
from rigs.scripted_engine import PERIOD, Rig, jf, jp, jv, two_joints

FOLLOWING = Following(error=(0.05, 0.05), arrival=(0.01, 0.01), lag=0.05)
STOP_TIME = 0.2


class Runaway(Rig):
    """A device whose joints go on at `speed` until the stop number `heeds` has arrived."""

    def __init__(self, heeds: int, **changes: object) -> None:
        capabilities = two_joints(stop=StopPolicy(0.0, "test", STOP_TIME), **changes)
        super().__init__(EngineOptions(stream_timeout=10.0), capabilities)
        self.speed = np.array([0.3, 0.0])
        self.heeds = heeds
        device = self.device
        read, stop, self.stops = device.read, device.stop, 0
        self.runs = False

        def stopped() -> None:
            stop()
            self.stops += 1
            if self.stops >= self.heeds:
                self.runs = False

        def moved(deadline: float) -> Sample | None:
            if self.runs:
                device.position = device.position + self.speed * PERIOD
            sample = read(deadline)
            if sample is None:
                return None
            joints = vector(device.position)
            velocity = vector(self.speed if self.runs else np.zeros(2))
            return Sample(sample.stamp, {"measured_js": JointState(joints, velocity)})

        device.stop, device.read = stopped, moved  # type: ignore[method-assign]

    def running(self) -> Runaway:
        self.enabled()
        self.engine.submit("servo_jv", jv(0.3, 0.0))
        self.cycle()
        self.runs = True
        self.cycle(3)
        return self


@pytest.mark.parametrize("way", ["hold", "pause", "disable"])
def test_a_stop_that_was_lost_is_sent_again_until_the_joints_stand(way: str) -> None:
    rig = Runaway(heeds=3).running()
    if way == "hold":
        rig.engine.submit("hold")
    else:
        rig.engine.state_command(way)
    rig.cycle(60)
    assert not rig.runs
    assert rig.stops == 3


def test_a_stop_that_does_not_happen_is_a_fault_that_says_what_moves() -> None:
    rig = Runaway(heeds=10_000).running()
    rig.engine.submit("hold")
    rig.cycle(round(STOP_TIME / PERIOD) - 2)
    assert rig.state is S.ENABLED
    rig.cycle(5)
    assert rig.state is S.FAULT
    assert "slide at 0.300" in rig.engine.status.detail
    rig.heeds = rig.stops + 1
    rig.cycle(10)
    assert not rig.runs, "a stop is sent again in FAULT, too"
    rig.enabled()


@pytest.mark.parametrize(
    ("speed", "state"), [(0.024, S.ENABLED), (-0.024, S.ENABLED), (0.048, S.FAULT)]
)
def test_one_step_of_what_is_measured_is_no_motion(speed: float, state: S) -> None:
    """With a low velocity limit its third hundredth is less than the last count of the encoder."""
    slow = JointLimits(-1.0, 1.0, velocity=0.5, acceleration=10.0, jerk=100.0, effort=5.0)
    rig = Runaway(heeds=10_000, limits=(slow, slow), velocity_resolution=(0.024, 0.024)).running()
    rig.speed[0] = speed
    rig.engine.submit("hold")
    rig.cycle(round(STOP_TIME / PERIOD) + 5)
    assert rig.state is state


def test_steps_that_the_hardware_tells_when_it_is_connected_count_for_what_stands() -> None:
    slow = JointLimits(-1.0, 1.0, velocity=0.5, acceleration=10.0, jerk=100.0, effort=5.0)
    rig = Runaway(heeds=10_000, limits=(slow, slow)).running()
    type(rig.device).velocity_steps = property(lambda self: (0.024, 0.024))  # type: ignore[method-assign,assignment]
    try:
        rig.disconnect("gone")
        rig.runs = False
        rig.connect()
        rig.running()
        rig.speed[0] = 0.024
        rig.engine.submit("hold")
        rig.cycle(round(STOP_TIME / PERIOD) + 5)
        assert rig.state is S.ENABLED
    finally:
        del type(rig.device).velocity_steps


@pytest.mark.parametrize(("pace", "state"), [(0.1, S.ENABLED), (1.0, S.FAULT), (0.0, S.FAULT)])
def test_hardware_that_was_slowed_down_brakes_as_slowly(pace: float, state: S) -> None:
    """Ten times slower it takes ten times as long; what moves at no pace at all is slowed down by nobody."""
    rig = Runaway(heeds=10_000).running()
    type(rig.device).pace = property(lambda self: pace)  # type: ignore[method-assign,assignment]
    try:
        rig.engine.submit("hold")
        rig.cycle(round(8.0 * STOP_TIME / PERIOD))
        assert rig.state is state
        rig.cycle(round(3.0 * STOP_TIME / PERIOD))
    finally:
        del type(rig.device).pace
    assert rig.state is S.FAULT, "but not for ever"


def test_disable_that_leaves_it_moving_ends_in_fault() -> None:
    rig = Runaway(heeds=10_000).running()
    rig.engine.state_command("disable")
    rig.cycle(200)
    assert rig.device.calls.count("disable") == 1, "power is taken away all the same"
    assert rig.state is S.FAULT
    assert "a stop has not been carried out" in rig.engine.status.detail


def test_a_stop_is_confirmed_only_by_the_device_where_it_can_tell() -> None:
    rig = Runaway(heeds=1).running()
    type(rig.device).has_stopped = property(lambda self: False)  # type: ignore[method-assign,assignment]
    try:
        rig.engine.submit("hold")
        rig.cycle(60)
    finally:
        del type(rig.device).has_stopped
    assert rig.stops > 2
    assert rig.state is S.FAULT
    assert "the hardware has not confirmed it" in rig.engine.status.detail


def test_closing_waits_for_the_stop_and_says_when_it_did_not_come() -> None:
    rig = Runaway(heeds=2).running()
    rig.engine.shut_down()
    assert not rig.runs
    assert rig.device.calls[-1] == "close"
    assert rig.engine.status.state is S.DISABLED
    rig = Runaway(heeds=10_000).running()
    with pytest.raises(StopUnconfirmed, match=r"slide at 0\.300"):
        rig.engine.shut_down()
    assert rig.device.calls[-1] == "close"
    assert rig.engine.status.state is S.FAULT


@pytest.mark.parametrize("is_lost", [False, True])
def test_the_stop_of_an_alarm_is_read_back_at_the_end(is_lost: bool) -> None:
    rig = Runaway(heeds=10_000).running()
    rig.engine.alarm("the I/O thread is stuck")
    if is_lost:
        rig.engine.lose("unplugged")
    else:
        rig.engine.stop_for_good()
    with pytest.raises(StopUnconfirmed):
        rig.engine.shut_down()


@pytest.mark.parametrize("heeds", [1, 3])
def test_who_closes_and_is_held_up_for_longer_than_a_stop_takes_looks_before_he_judges(
    heeds: int,
) -> None:
    rig = Runaway(heeds=heeds).running()
    rig.engine.stop_for_good()
    rig.clock.advance(2.0 * STOP_TIME)
    rig.engine.shut_down()


def seen_later(rig: Runaway, reads: int) -> None:
    """Nothing is known of the joints until so many times later, as on a line of one question at a time."""
    read, left = rig.device.read, [reads]

    def later(deadline: float) -> Sample | None:
        left[0] -= 1
        return None if left[0] >= 0 else read(deadline)

    rig.device.read = later  # type: ignore[method-assign]


def test_who_closes_and_was_held_up_looks_until_something_is_seen() -> None:
    rig = Runaway(heeds=1).running()
    rig.engine.stop_for_good()
    rig.clock.advance(2.0 * STOP_TIME)
    seen_later(rig, 4)
    rig.engine.shut_down()


def test_who_was_held_up_looks_until_something_is_seen_before_he_says_that_it_did_not_stop() -> (
    None
):
    for heeds, state in ((1, S.ENABLED), (10_000, S.FAULT)):
        rig = Runaway(heeds=heeds).running()
        rig.engine.submit("hold")
        rig.cycle()
        rig.clock.advance(3.0 * STOP_TIME)
        seen_later(rig, 4)
        rig.cycle(4)
        assert rig.state is S.ENABLED
        rig.cycle(round(2.0 * STOP_TIME / PERIOD))
        assert rig.state is state


def test_a_link_that_is_lost_while_it_closes_is_a_stop_that_nobody_saw() -> None:
    rig = Runaway(heeds=10**6).running()

    def lost(deadline: float) -> None:
        raise ConnectionLost("no drive answers", where="here")

    rig.device.read = lost  # type: ignore[method-assign]
    with pytest.raises(StopUnconfirmed, match=r"could not be read back: .*no drive answers"):
        rig.engine.shut_down()
    assert rig.stops


def test_a_new_command_is_no_stop_that_failed() -> None:
    rig = Runaway(heeds=1).running()
    rig.engine.submit("hold")
    rig.cycle()
    rig.engine.submit("servo_jv", jv(0.3, 0.0))
    rig.cycle()
    rig.runs = True
    rig.cycle(100)
    assert rig.state is S.ENABLED


# ------------------------------------------------------------------------------------ following


class Stuck(Rig):
    """Joints that go where they are sent, `late` cycles later, the first not beyond `block`."""

    def __init__(self, late: int = 2, block: float = math.inf, **changes: object) -> None:
        options = EngineOptions(limits=LimitPolicy(max_step=0.5))
        super().__init__(options, two_joints(following=FOLLOWING, **changes))
        self.block = block
        pending: list[np.ndarray] = []

        def write(setpoint: Setpoint) -> None:
            self.device.calls.append("write")
            self.device.written.append(setpoint)
            pending.append(setpoint.values.copy())
            if len(pending) > late:
                goal = pending.pop(0)
                self.device.position = np.array([min(goal[0], self.block), goal[1]])

        self.device.write = write  # type: ignore[method-assign]


def test_a_joint_that_follows_late_is_no_fault_and_its_move_is_reached_when_it_is_there() -> None:
    rig = Stuck(writes_every_cycle=True).enabled()
    move = rig.engine.submit("move_jp", jp(0.5, 0.0))
    assert move is not None
    while move.outcome is Outcome.RUNNING:
        rig.cycle()
    assert move.outcome is Outcome.REACHED
    assert rig.device.position[0] == pytest.approx(0.5, abs=0.01)


def test_a_joint_that_is_stuck_is_a_fault_with_its_name_and_no_success() -> None:
    rig = Stuck(block=0.1).enabled()
    move = rig.engine.submit("move_jp", jp(0.5, 0.0))
    assert move is not None
    rig.cycle(200)
    assert rig.state is S.FAULT
    assert "slide does not follow: it is at 0.1000" in rig.engine.status.detail
    assert move.outcome is Outcome.ABORTED
    assert rig.device.position[0] <= 0.1
    sent = max(setpoint.values[0] for setpoint in rig.written)
    assert sent < 0.25, "how far it would jump when commands arrive again"


def test_a_joint_that_ends_beside_the_goal_is_not_reached() -> None:
    rig = Stuck(block=0.47).enabled()
    move = rig.engine.submit("move_jp", jp(0.5, 0.0))
    assert move is not None
    rig.cycle(1500)
    assert move.outcome is Outcome.ABORTED
    assert "slide is at 0.4700, not at 0.5000" in move.reason


def test_a_stream_that_is_not_followed_is_a_fault() -> None:
    rig = Stuck(block=0.02).enabled()
    for step in range(100):
        if rig.state is not S.ENABLED:
            break
        rig.servo(0.005 * step, 0.0)
        rig.cycle()
    assert rig.state is S.FAULT
    assert "slide does not follow" in rig.engine.status.detail


def test_a_native_move_that_says_done_is_looked_at() -> None:
    rig = Stuck(native_moves=frozenset({"move_jp"})).enabled()
    move = rig.engine.submit("move_jp", jp(0.5, 0.0))
    assert move is not None
    rig.cycle()
    rig.device.progress = MoveProgress.DONE
    rig.cycle(300)
    assert move.outcome is Outcome.ABORTED
    with pytest.raises(MotionAborted, match=r"slide is at 0\.0000, not at 0\.5000"):
        move.wait()


# ------------------------------------------------------------------------------------ the range


class Driven(Rig):
    """The first joint moves with the velocity that it was sent, and brakes with its deceleration."""

    LIMIT = JointLimits(-0.3, 0.3, velocity=1.5, acceleration=5.0, jerk=100.0, effort=5.0)

    def __init__(self) -> None:
        super().__init__(
            EngineOptions(stream_timeout=10.0, interpolate_timeout=10.0),
            two_joints(limits=(self.LIMIT, self.LIMIT)),
        )
        self.velocity = np.zeros(2)
        self.wanted = np.zeros(2)
        self.push = np.zeros(2)
        read = self.device.read

        def moved(deadline: float) -> Sample | None:
            change = np.clip(self.wanted - self.velocity, -0.05, 0.05) + self.push * PERIOD
            self.velocity = self.velocity + change
            self.device.position = self.device.position + self.velocity * PERIOD
            sample = read(deadline)
            assert sample is not None
            joints = JointState(vector(self.device.position), vector(self.velocity))
            return Sample(sample.stamp, {"measured_js": joints})

        def write(setpoint: Setpoint) -> None:
            self.device.calls.append("write")
            self.device.written.append(setpoint)
            if setpoint.mode.kind == "effort":
                self.push = setpoint.values.copy()
                self.wanted = self.velocity.copy()
            else:
                self.wanted = setpoint.values.copy()

        def stop() -> None:
            self.device.calls.append("stop")
            self.wanted, self.push = np.zeros(2), np.zeros(2)

        self.device.read, self.device.write, self.device.stop = moved, write, stop  # type: ignore[method-assign]


@pytest.mark.parametrize("name", ["servo_jv", "interpolate_jv"])
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("repeated", [True, False])
def test_no_velocity_leads_out_of_the_range(name: str, sign: float, repeated: bool) -> None:
    rig = Driven().enabled()
    furthest = 0.0
    for cycle in range(300):
        if repeated or cycle == 0:
            rig.engine.submit(name, jv(sign * 1.5, 0.0))
        rig.cycle()
        furthest = max(furthest, abs(rig.device.position[0]))
    assert 0.25 < furthest <= 0.3
    assert rig.state is S.ENABLED
    assert rig.engine.health().clamped or not repeated
    for _ in range(400):  # inwards it is free
        rig.engine.submit(name, jv(-sign * 1.0, 0.0))
        rig.cycle()
        if abs(rig.device.position[0]) < 0.2:
            break
    else:
        pytest.fail("it does not come back")


def test_an_effort_that_drives_a_joint_out_of_its_range_is_stopped_and_says_so() -> None:
    rig = Driven().enabled()
    furthest = 0.0
    for _ in range(300):
        with suppress(CommandRefused):
            rig.engine.submit("servo_jf", jf(4.0, 0.0))
        rig.cycle()
        furthest = max(furthest, abs(rig.device.position[0]))
    assert furthest < 0.32
    assert any(refusal.reason is Reason.OUT_OF_RANGE for refusal in rig.told.refusals)
    assert max(abs(rig.velocity)) < 1.7


# ---------------------------------------------------------------------------- what is not finite


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_sample_that_is_not_finite_is_none(bad: float) -> None:
    rig = Rig().enabled()
    _, stamp = rig.value("measured_js")
    rig.device.position = np.array([0.0, bad])
    rig.cycle(2)
    value, still = rig.value("measured_js")
    assert still == stamp, "the newest sample that can be used"
    assert np.isfinite(value.position).all()
    assert rig.engine.health().broken_samples == 2
    rig.cycle(10)
    assert rig.value("measured_js")[1] == 0, "stale by now"
    rig.cycle(60)
    assert rig.state is S.FAULT
    assert "measured_js position[1]" in rig.engine.status.detail
    rig.engine.state_command("enable")
    rig.cycle(150)
    assert rig.state is S.FAULT
    rig.device.position = np.zeros(2)
    rig.cycle()
    rig.enabled()


def test_one_bad_sample_does_no_harm() -> None:
    rig = Rig().enabled()
    rig.device.position = np.array([math.nan, 0.0])
    rig.cycle()
    rig.device.position = np.zeros(2)
    rig.cycle()
    assert rig.state is S.ENABLED
    assert rig.value("measured_js")[1] > 0


def test_an_error_in_the_motion_of_a_device_stops_it_and_keeps_its_link() -> None:
    rig = Rig().enabled()
    rig.device.fail["write"] = OverflowError("int too big to convert")
    rig.servo(0.01, 0.0)
    rig.cycle()
    assert rig.state is S.FAULT
    assert rig.engine.connected
    assert "close" not in rig.device.calls
    assert rig.told.refusals[-1].reason is Reason.INTERNAL_ERROR
    assert rig.told.refusals[-1].command == "servo_jp"
    assert rig.device.calls[-1] == "stop"
    del rig.device.fail["write"]
    rig.enabled()


def test_the_declared_error_can_be_replaced() -> None:
    wide = replace(LimitPolicy(max_step=0.5), following_error=1.0)
    rig = Stuck(block=0.1)
    other = Rig(EngineOptions(limits=wide), rig.device.declared)
    other.device.write = lambda setpoint: None  # type: ignore[method-assign]
    other.enabled()
    move = other.engine.submit("move_jp", jp(0.5, 0.0))
    assert move is not None
    other.cycle(200)
    assert other.state is S.ENABLED


def test_two_reasons_for_a_fault_do_not_take_turns_in_being_told() -> None:
    rig = Runaway(heeds=10_000).running()
    rig.device.reported = Condition(S.FAULT, "overload")
    rig.cycle(50)
    count = len(rig.told.statuses)
    rig.cycle(50)
    assert len(rig.told.statuses) == count
    assert rig.engine.status.detail == "overload"
    assert any("a stop has not been carried out" in text for text in rig.told.warnings)


def test_closing_after_the_link_was_lost_in_motion_says_that_nobody_saw_it_stand() -> None:
    rig = Runaway(heeds=10_000).running()
    rig.disconnect("the link is gone")
    with pytest.raises(StopUnconfirmed, match=r"slide at 0\.300 when it was last seen"):
        rig.engine.shut_down()
    assert rig.device.calls[-1] == "close"


@pytest.mark.parametrize("told", ["nothing", "nothing valid"])
def test_what_was_last_seen_to_move_is_not_forgotten_by_samples_that_tell_nothing(
    told: str,
) -> None:
    rig = Runaway(heeds=10_000).running()
    rests = {"measured_js": JointState(vector(rig.device.position), vector(np.zeros(2)))}
    stamp = rig.clock.stamp
    rig.device.read = lambda deadline: (  # type: ignore[method-assign]
        Sample(stamp(), {}) if told == "nothing" else Sample(replace(stamp(), wall_ns=0), rests)
    )
    rig.cycle(3)
    rig.disconnect("the link is gone")
    with pytest.raises(StopUnconfirmed, match=r"slide at 0\.300 when it was last seen"):
        rig.engine.shut_down()


def test_closing_after_the_link_was_lost_at_rest_is_no_error() -> None:
    rig = Rig().enabled()
    rig.disconnect("the link is gone")
    rig.engine.shut_down()


def test_the_setpoint_of_enable_is_measured_after_it() -> None:
    """With its torque a servo may count otherwise."""
    rig = Rig(capabilities=two_joints())
    rig.connect()

    def enable() -> Steps:
        rig.device.stamp = rig.clock.stamp()
        yield

    rig.device.procedures["enable"] = enable
    rig.engine.state_command("enable")
    rig.cycle(2)
    before = rig.state
    rig.cycle(3)
    assert (before, rig.state) == (S.DISABLED, S.DISABLED), "what is measured is of before"
    rig.device.position, rig.device.stamp = np.array([0.5, 0.0]), None
    rig.cycle()
    assert rig.state is S.ENABLED
    assert rig.setpoint()["position"] == [0.5, 0.0]


@pytest.mark.parametrize("command", ["enable", "resume"])
def test_a_joint_that_leaves_before_anything_is_sent_is_a_fault(command: str) -> None:
    rig = Rig(capabilities=two_joints(following=FOLLOWING)).enabled()
    if command == "resume":
        rig.command("pause")
        rig.device.position = np.array([0.3, 0.0])
        rig.cycle()
        rig.command("resume")
    rig.cycle(20)
    assert rig.state is S.ENABLED
    rig.device.position = rig.device.position + 0.06
    rig.cycle(2)
    assert rig.state is S.FAULT
    assert "slide does not follow" in rig.engine.status.detail


def test_a_free_joint_may_go_where_a_hand_moves_it() -> None:
    rig = Rig(capabilities=two_joints(following=FOLLOWING)).enabled()
    rig.engine.submit("free")
    rig.cycle(3)
    rig.device.position = rig.device.position + 0.3
    rig.cycle(20)
    assert rig.state is S.ENABLED


def test_a_setpoint_that_nobody_saw_carried_out_is_told_at_closing() -> None:
    rig = Rig().enabled()
    rig.servo(0.01, 0.0)
    rig.cycle()
    rig.disconnect("the link is gone")
    with pytest.raises(StopUnconfirmed, match="it was sent a motion, and not seen since"):
        rig.engine.shut_down()


def test_a_stream_that_rests_is_no_motion_at_closing() -> None:
    rig = Rig().enabled()
    for _ in range(40):
        rig.servo(0.0, 0.0)
        rig.cycle()
    rig.disconnect("the link is gone")
    rig.engine.shut_down()


LATE = replace(FOLLOWING, lag=1.0)


def late_rig() -> Rig:
    """A device that may take a second, and is there at once."""
    options = EngineOptions(limits=LimitPolicy(max_step=0.5))
    return Rig(options, two_joints(following=LATE)).enabled()


def test_a_stream_seen_at_its_end_is_no_motion() -> None:
    rig = late_rig()
    for step in range(10):
        rig.servo(0.01 * (step + 1), 0.0)
        rig.cycle()
    rig.cycle(5)
    assert rig.device.position[0] == pytest.approx(0.1)
    rig.disconnect("the link is gone")
    rig.engine.shut_down()


@pytest.mark.parametrize("back", [0.0, 0.005])
def test_a_stream_out_and_back_counts_until_its_lag_is_over(back: float) -> None:
    """The joints are where they are sent, but may not have begun to go there."""
    rig = late_rig()
    for position in (0.1, back):
        rig.servo(position, 0.0)
        rig.cycle()
    rig.cycle(5)
    assert rig.device.position[0] == pytest.approx(back)
    rig.disconnect("the link is gone")
    with pytest.raises(StopUnconfirmed, match="it was sent a motion, and not seen since"):
        rig.engine.shut_down()


def test_joints_beside_their_goal_count_as_on_their_way() -> None:
    rig = Stuck(late=100, writes_every_cycle=True).enabled()
    rig.servo(0.1, 0.0)
    rig.cycle(2)
    rig.disconnect("the link is gone")
    with pytest.raises(StopUnconfirmed, match="it was sent a motion, and not seen since"):
        rig.engine.shut_down()


def test_an_effort_lasts_until_its_stop_is_seen() -> None:
    rig = Rig().enabled()
    for _ in range(40):
        rig.engine.submit("servo_jf", jf(1.0, 0.0))
        rig.cycle()
    rig.disconnect("the link is gone")
    with pytest.raises(StopUnconfirmed, match="it was sent a motion"):
        rig.engine.shut_down()


def test_what_was_held_after_a_motion_is_no_motion() -> None:
    rig = Rig().enabled()
    rig.servo(0.01, 0.0)
    rig.cycle()
    rig.engine.submit("hold")
    rig.cycle(3)
    rig.disconnect("the link is gone")
    rig.engine.shut_down()


def test_a_freed_device_at_rest_has_no_motion_left() -> None:
    rig = Rig().enabled()
    for _ in range(5):
        rig.engine.submit("servo_jv", jv(0.1, 0.0))
        rig.cycle()
    rig.engine.submit("free")
    rig.cycle(40)
    rig.disconnect("the link is gone")
    rig.engine.shut_down()


def test_a_velocity_before_free_counts_until_it_rests() -> None:
    rig = Rig().enabled()
    rig.engine.submit("servo_jv", jv(0.1, 0.0))
    rig.cycle(2)
    rig.engine.submit("free")
    rig.cycle()
    rig.disconnect("the link is gone")
    with pytest.raises(StopUnconfirmed, match="it was sent a motion, and not seen since"):
        rig.engine.shut_down()


def test_a_stop_that_cannot_be_sent_again_is_unconfirmed() -> None:
    """The first one went out, but nothing answers it any more."""
    rig = Runaway(heeds=10_000).running()
    stop = rig.device.stop

    def once() -> None:
        stop()
        if rig.stops > 1:
            raise ProtocolError("no answer to stop", where="a")

    rig.device.stop = once  # type: ignore[method-assign]
    with pytest.raises(StopUnconfirmed, match=r"could not be read back.*no answer to stop"):
        rig.engine.shut_down()
    assert rig.stops == 2
    assert rig.device.calls[-1] == "close"


def test_a_freed_device_is_not_on_its_way_any_more(monkeypatch: pytest.MonkeyPatch) -> None:
    """A stream has ended short of its last setpoint, from where somebody pulls the joint away."""
    rig = Rig().enabled()
    monkeypatch.setattr(type(rig.device), "has_arrived", property(lambda _: False))
    rig.servo(0.01, 0.0)
    rig.cycle()
    rig.engine.submit("free")
    rig.cycle(40)
    rig.disconnect("the link is gone")
    rig.engine.shut_down()

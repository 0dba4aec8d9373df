"""The engine of one device, cycle by cycle, on a clock of its own."""

import itertools
import math
import re
import threading

import numpy as np
import pytest

from crtk_drivers.device import Condition, Mode
from crtk_drivers.engine import EngineOptions
from crtk_drivers.errors import (
    CommandRefused,
    ConnectionFailed,
    ConnectionLost,
    DeviceFault,
    MotionAborted,
    Reason,
)
from crtk_drivers.motion.move import Outcome
from crtk_drivers.options import LimitPolicy
from crtk_drivers.samples import JointState, Pose, Sample, Stamp, Twist, Wrench, vector
from crtk_drivers.state import OperatingState
from crtk_drivers.testing.clock import FakeClock
from rigs.scripted_engine import PERIOD, Rig, jf, jp, jv, pose, two_joints

S = OperatingState
THREE = vector((0.0, 0.0, 0.0))
UNIT = vector((0.0, 0.0, 0.0, 1.0))


# ------------------------------------------------------------------------------------- connection


def test_before_the_first_connection_it_is_connecting_and_says_where_and_since_when(
    caplog: pytest.LogCaptureFixture,
) -> None:
    rig = Rig()
    assert rig.state is S.FAULT
    assert rig.engine.status.connecting
    assert re.fullmatch(r"connecting to nowhere:1 since \d\d:\d\d:\d\d", rig.engine.status.detail)
    assert not caplog.records
    with pytest.raises(CommandRefused) as caught:
        rig.engine.state_command("enable")
    assert caught.value.reason is Reason.NOT_CONNECTED
    assert caught.value.where == "rig nowhere:1"


def test_a_connection_ends_in_disabled_with_nothing_written() -> None:
    rig = Rig().connect()
    rig.cycle(5)
    assert rig.state is S.DISABLED
    assert not rig.engine.status.connecting
    assert rig.device.calls == ["open"]


def test_a_failed_connection_is_a_fault_with_the_reason() -> None:
    rig = Rig()
    rig.device.fail["open"] = ConnectionFailed("no answer", where="nowhere:1")
    rig.connect()
    assert rig.state is S.FAULT
    assert "no answer" in rig.engine.status.detail
    assert not rig.engine.status.connecting
    assert not rig.engine.connected


def test_a_reconnection_ends_disabled_with_nothing_written_and_enable_starts_from_the_new_place() -> (
    None
):
    rig = Rig().enabled()
    rig.servo(0.05, 0.0)
    rig.cycle()
    writes = len(rig.written)
    rig.disconnect("cable pulled")
    assert rig.state is S.FAULT
    assert rig.device.calls[-2:] == ["stop", "close"]
    assert rig.value("measured_js")[1] == 0
    rig.device.position = np.array([0.5, 0.5])  # moved by hand in the meantime
    rig.connect()
    rig.cycle(20)
    assert rig.state is S.DISABLED
    assert len(rig.written) == writes
    rig.enabled()
    assert rig.setpoint()["position"] == [0.5, 0.5]
    assert len(rig.written) == writes
    assert rig.engine.health().reconnects == 1


def test_enable_waits_for_a_sample_of_this_connection() -> None:
    rig = Rig().enabled()
    rig.disconnect("cable pulled")
    rig.device.position, rig.device.silent = np.array([0.5, 0.5]), True
    rig.engine.connect(rig.clock() + 1.0)
    rig.engine.state_command("enable")
    rig.cycle(3)
    assert rig.state is S.DISABLED, "the setpoint would be a position from before the reconnection"
    rig.device.silent = False
    rig.cycle(2)  # in the first of them it is seen to stand
    assert rig.state is S.ENABLED
    assert rig.setpoint()["position"] == [0.5, 0.5]


def test_a_silent_device_is_lost_after_the_sample_timeout_and_its_stamps_are_zero_before() -> None:
    rig = Rig(EngineOptions(sample_timeout=0.2)).connect()
    assert rig.value("measured_js")[1] > 0
    rig.device.silent = True
    rig.cycle(6)
    _, stamp = rig.value("measured_js")
    assert stamp == 0
    with pytest.raises(ConnectionLost, match="old"):
        rig.cycle(20)


def test_a_device_that_repeats_an_old_sample_is_lost_too() -> None:
    rig = Rig(EngineOptions(sample_timeout=0.2)).connect()
    rig.device.stamp = rig.clock.stamp()
    rig.cycle(6)
    assert rig.value("measured_cp")[1] == 0
    with pytest.raises(ConnectionLost):
        rig.cycle(20)


def test_feedback_of_one_sample_carries_one_stamp() -> None:
    rig = Rig().connect()
    stamps = {rig.value(name)[1] for name in ("measured_js", "measured_cp", "jacobian")}
    assert len(stamps) == 1
    assert stamps != {0}


def test_a_link_that_is_lost_in_the_midst_of_a_procedure_is_lost_and_no_mere_fault() -> None:
    rig = Rig().connect()
    rig.device.fail["enable"] = ConnectionLost("reset by peer")
    rig.engine.state_command("enable")
    with pytest.raises(ConnectionLost):
        rig.cycle()
    rig.disconnect("reset by peer")
    assert rig.engine.transition_ended
    assert rig.state is S.FAULT


def test_a_device_that_fails_to_close_is_in_fault_all_the_same() -> None:
    rig = Rig().enabled()
    rig.device.fail |= {"stop": ConnectionLost("gone"), "close": OSError("bad descriptor")}
    with pytest.raises(OSError, match="bad descriptor"):
        rig.disconnect("cable pulled")
    assert (rig.state, rig.engine.status.detail) == (S.FAULT, "cable pulled")
    assert not rig.engine.connected


# ------------------------------------------------------------------------------- refusals, I1 to I16

BAD = {
    "I1 NaN": ("servo_jp", jp(math.nan, 0.0), Reason.NOT_FINITE, r"position\[0\] is nan"),
    "I1 infinite": ("servo_jv", jv(0.0, -math.inf), Reason.NOT_FINITE, r"velocity\[1\]"),
    "I1 pose": ("servo_cp", Pose(vector((0, math.nan, 0)), UNIT), Reason.NOT_FINITE, "position"),
    "I1 twist": ("servo_cv", Twist(THREE, vector((0, 0, math.inf))), Reason.NOT_FINITE, "angular"),
    "I1 wrench": ("servo_cf", Wrench(vector((math.nan, 0, 0)), THREE), Reason.NOT_FINITE, "force"),
    "I1 increment": ("servo_jr", jp(math.nan, 0.0), Reason.NOT_FINITE, "position"),
    "I2 short": ("servo_jp", jp(0.0), Reason.WRONG_SIZE, "1 values .* 2 joints"),
    "I2 long": ("move_jp", jp(0.0, 0.0, 0.0), Reason.WRONG_SIZE, "3 values"),
    "I2 twist": ("servo_cv", Twist(vector((0, 0)), vector((0,) * 4)), Reason.WRONG_SIZE, "linear"),
    "I2 pose": ("servo_cp", Pose(vector((0, 0)), UNIT), Reason.WRONG_SIZE, "2 values"),
    "I3 empty": ("servo_jp", jv(0.0, 0.0), Reason.EMPTY, "position is empty"),
    "I4 unknown": (
        "servo_jp",
        JointState(vector((0, 0)), name=("slide", "spin")),
        Reason.WRONG_NAMES,
        "spin",
    ),
    "I4 double": (
        "servo_jp",
        JointState(vector((0, 0)), name=("turn", "turn")),
        Reason.WRONG_NAMES,
        "turn",
    ),
    "I6 zero quaternion": (
        "servo_cp",
        Pose(THREE, vector((0, 0, 0, 0))),
        Reason.BAD_QUATERNION,
        "norm of 0",
    ),
    "I7 off by 0.2 %": (
        "servo_cp",
        Pose(THREE, vector((0, 0, 0, 1.002))),
        Reason.BAD_QUATERNION,
        "1.002",
    ),
    "I8 move": ("move_jp", jp(0.0, 1.5), Reason.OUT_OF_RANGE, r"turn at 1.5000 .*\[-1.0000, 1"),
    "I8 move by kinematics": ("move_cp", pose(1.5), Reason.OUT_OF_RANGE, "slide"),
    "I8 relative move": ("move_jr", jp(1.5, 0.0), Reason.OUT_OF_RANGE, "slide"),
    "I8 velocity": ("servo_jv", jv(0.0, 1.5), Reason.OUT_OF_RANGE, "exceeds 1.0000 rad/s"),
    "I8 effort": ("servo_jf", jf(5.1, 0.0), Reason.OUT_OF_RANGE, "5.1000 exceeds"),
    "I8 twist": ("servo_cv", Twist(vector((0.6, 0, 0)), THREE), Reason.OUT_OF_RANGE, "linear"),
    "I8 wrench": ("servo_cf", Wrench(THREE, vector((0, 3, 0))), Reason.OUT_OF_RANGE, "torque"),
    "I9 step": ("servo_jp", jp(0.0, 0.2), Reason.STEP_TOO_LARGE, "turn would jump by 0.2000"),
    "I9 increment": ("servo_jr", jp(-0.2, 0.0), Reason.STEP_TOO_LARGE, "slide would jump"),
    "I9 pose": ("servo_cp", pose(0.2), Reason.STEP_TOO_LARGE, "tool would jump"),
    "I10 frame": ("servo_cp", pose(0.0, frame="camera"), Reason.WRONG_FRAME, "'camera'"),
    "I10 frame of a twist": (
        "servo_cv",
        Twist(THREE, THREE, "tool"),
        Reason.WRONG_FRAME,
        "'tool'",
    ),
    "out of reach": ("move_cp", pose(0.0, y=1.0), Reason.UNREACHABLE, "y is out of reach"),
    "wrong type": ("servo_jp", pose(0.0), Reason.WRONG_TYPE, "got Pose"),
    "nothing": ("servo_jp", None, Reason.WRONG_TYPE, "got NoneType"),
    "unsupported": ("local/servo_cp", pose(0.0), Reason.UNSUPPORTED, "not offer"),
    "no such name": ("dance", None, Reason.UNSUPPORTED, "not offer"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_refused_with_a_reason_and_changes_nothing(case: str) -> None:
    name, value, reason, text = BAD[case]
    rig = Rig().enabled()
    before = rig.setpoint()
    refusal = rig.refused(name, value)
    assert refusal.reason is reason
    assert refusal.command == name
    assert refusal.remedy
    with pytest.raises(CommandRefused, match=text):
        rig.engine.submit(name, value)
    assert rig.state is S.ENABLED
    assert rig.setpoint() == before
    assert sum(rig.engine.health().refusals.values()) == 2


def test_names_in_another_order_are_sorted_and_absent_ones_are_fine() -> None:
    rig = Rig().enabled()
    rig.engine.submit("servo_jp", JointState(vector((0.02, 0.01)), name=("turn", "slide")))
    rig.cycle()
    assert rig.written[-1].values.tolist() == [0.01, 0.02]
    rig.servo(0.03, 0.04)
    rig.cycle()
    assert rig.written[-1].values.tolist() == [0.03, 0.04]


def test_a_quaternion_that_is_nearly_one_is_normalised() -> None:
    rig = Rig().enabled()
    goal = Pose(THREE, vector((0, 0, 0, 1.0005)))
    rig.engine.submit("move_cp", goal)
    found = rig.engine.latched("goal_cp")
    assert found is not None
    assert isinstance(found[0], Pose)
    assert np.linalg.norm(found[0].orientation) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("name", ["servo_jp", "servo_cp", "servo_jr"])
def test_a_servo_out_of_range_is_clamped_with_a_warning_that_the_setpoint_shows(name: str) -> None:
    rig = Rig().connect()
    rig.device.position = np.array([0.98, 0.0])
    rig.cycle()
    rig.enabled()
    value = {"servo_jp": jp(1.02, 0.0), "servo_cp": pose(1.02), "servo_jr": jp(0.04, 0.0)}[name]
    rig.engine.submit(name, value)
    rig.cycle()
    assert rig.written[-1].values.tolist() == [1.0, 0.0]
    assert rig.setpoint()["position"] == [1.0, 0.0]
    assert len(rig.told.warnings) == 1
    assert rig.told.warnings[0].startswith(f"{name}: slide at 1.02")
    assert rig.engine.health().clamped == 1


@pytest.mark.parametrize("name", ["servo_jp", "servo_cp", "servo_jr"])
def test_a_servo_out_of_range_is_refused_if_the_user_wants_that(name: str) -> None:
    rig = Rig(EngineOptions(limits=LimitPolicy(clamp_servo=False))).connect()
    rig.device.position = np.array([0.98, 0.0])
    rig.cycle()
    rig.enabled()
    value = {"servo_jp": jp(1.02, 0.0), "servo_cp": pose(1.02), "servo_jr": jp(0.04, 0.0)}[name]
    assert rig.refused(name, value).reason is Reason.OUT_OF_RANGE


def test_stamps_are_checked_only_if_the_user_wants_that() -> None:
    rig = Rig().enabled()
    rig.engine.submit("servo_jp", jp(0.0, 0.0), stamp_ns=1)
    rig = Rig(EngineOptions(limits=LimitPolicy(max_command_age=0.5))).enabled()
    now = Stamp.now().wall_ns
    rig.engine.submit("servo_jp", jp(0.0, 0.0), stamp_ns=now)
    rig.engine.submit("servo_jp", jp(0.0, 0.0), stamp_ns=0)
    rig.cycle()
    old = rig.refused("servo_jp", jp(0.0, 0.0), stamp_ns=now - 10**10)
    early = rig.refused("servo_jp", jp(0.0, 0.0), stamp_ns=now + 10**10)
    assert (old.reason, early.reason) == (Reason.TOO_OLD, Reason.FROM_FUTURE)


def test_a_state_command_too_old_sets_nothing_going_and_stops_everything() -> None:
    options = EngineOptions(limits=LimitPolicy(max_command_age=0.5))
    rig = Rig(options, two_joints(needs_homing=True)).connect()
    now = Stamp.now().wall_ns

    def refused(text: str, age: float) -> Reason:
        with pytest.raises(CommandRefused) as caught:
            rig.engine.state_command(text, now - int(age * 1e9))
        assert rig.told.refusals[-1] is caught.value
        assert caught.value.stamp_ns == now - int(age * 1e9)
        rig.cycle()
        return caught.value.reason

    assert refused("enable", 3600.0) is Reason.TOO_OLD
    assert refused("enable", -3600.0) is Reason.FROM_FUTURE
    assert rig.state is S.DISABLED
    rig.engine.state_command("enable", now)
    rig.cycle(count=5)
    assert refused("home", 3600.0) is Reason.TOO_OLD
    for text, state in (("pause", S.PAUSED), ("unhome", S.PAUSED), ("disable", S.DISABLED)):
        rig.engine.state_command(text, 1)
        rig.cycle(2)  # it is seen to stand first
        assert rig.state is state
        if text == "unhome":
            assert refused("resume", 3600.0) is Reason.TOO_OLD


@pytest.mark.parametrize("state", [S.PAUSED, S.FAULT])
def test_the_detail_follows_what_the_hardware_says(state: OperatingState) -> None:
    rig = Rig().enabled()
    rig.device.reported = Condition(state, "the program was stopped")
    rig.cycle()
    rig.device.reported = Condition(state, "the pendant has control")
    rig.cycle()
    assert rig.engine.status.detail == "the pendant has control"
    rig.device.reported = Condition()
    rig.cycle()
    assert rig.engine.status.detail == "the pendant has control", "why it stopped is kept"


@pytest.mark.parametrize("state", [S.DISABLED, S.PAUSED, S.FAULT])
@pytest.mark.parametrize(
    ("name", "value"),
    [("servo_jp", jp(0.0, 0.0)), ("move_cp", pose(0.1)), ("servo_jv", jv(0, 0)), ("free", None)],
)
def test_motion_is_refused_unless_enabled(state: OperatingState, name: str, value: object) -> None:
    rig = Rig().enabled()
    rig.device.reported = Condition(state, "because")
    rig.cycle()
    refusal = rig.refused(name, value)
    assert refusal.reason is Reason.NOT_ENABLED
    assert f"{state} (because)" in str(refusal)
    assert "state_command" in refusal.remedy


@pytest.mark.parametrize(
    "text", ["Enable", " enable", "enable\n", "", "fault", "x" * 5000, "énable"]
)
def test_a_state_command_must_match_exactly(text: str) -> None:
    rig = Rig().connect()
    announced = len(rig.told.statuses)
    with pytest.raises(CommandRefused) as caught:
        rig.engine.state_command(text)
    rig.cycle()
    assert caught.value.reason is Reason.UNKNOWN_COMMAND
    assert "enable, disable, pause, resume, home, unhome" in caught.value.remedy
    assert caught.value.where == rig.engine.where
    assert len(str(caught.value)) < 400
    assert rig.state is S.DISABLED
    assert len(rig.told.statuses) == announced + 1, "every state command has an answer"


def test_of_a_flood_the_newest_wins() -> None:
    rig = Rig().enabled()
    for index in range(20_000):
        rig.servo(index * 1e-6, 0.0)
    rig.cycle()
    assert [setpoint.values[0] for setpoint in rig.written] == [pytest.approx(0.019999)]


def test_what_is_refused_is_counted_by_reason_and_random_names_do_not_fill_the_table() -> None:
    rig = Rig().enabled()
    for index in range(50):
        with pytest.raises(CommandRefused):
            rig.engine.submit(f"nonsense{index}")
    rig.refused("servo_jp", jp(0.0))
    assert rig.engine.health().refusals == {"unknown: unsupported": 50, "servo_jp: wrong_size": 1}


def test_a_value_that_is_changed_after_it_was_checked_does_not_change_the_goal() -> None:
    rig = Rig().enabled()
    mine = np.array([0.1, 0.1])
    rig.engine.submit("move_jp", JointState(position=mine))
    mine[:] = 99.0
    rig.cycle(100)
    assert rig.written[-1].values.tolist() == [0.1, 0.1]


# ---------------------------------------------------------------------------------------- streams


def test_nothing_is_written_on_enable_and_the_setpoint_is_where_the_device_is() -> None:
    rig = Rig().connect()
    rig.device.position = np.array([0.3, -0.3])
    rig.cycle()
    rig.enabled()
    rig.cycle(5)
    assert rig.written == []
    assert rig.setpoint() == {"position": [0.3, -0.3], "velocity": [], "effort": []}


def test_a_disabled_device_is_seeded_anew_after_it_was_moved() -> None:
    rig = Rig().enabled()
    rig.servo(0.05, 0.05)
    rig.cycle()
    rig.command("disable")
    rig.device.position = np.array([0.8, 0.8])
    rig.cycle()
    rig.enabled()
    assert rig.setpoint()["position"] == [0.8, 0.8]
    assert rig.refused("servo_jp", jp(0.05, 0.05)).reason is Reason.STEP_TOO_LARGE


@pytest.mark.parametrize(
    ("policy", "state"), [("hold", S.ENABLED), ("pause", S.PAUSED), ("fault", S.FAULT)]
)
@pytest.mark.parametrize("name", ["servo_jp", "servo_jv"])
def test_a_stream_that_stops(policy: str, state: OperatingState, name: str) -> None:
    rig = Rig(EngineOptions(stream_timeout=0.1, on_stream_timeout=policy)).enabled()
    value = {"servo_jp": jp(0.01, 0.0), "servo_jv": jv(0.1, 0.0)}[name]
    rig.engine.submit(name, value)
    rig.cycle(9)
    assert rig.engine.health().stream == name
    rig.cycle(4)
    assert rig.state is state
    assert rig.engine.health().stream == ""
    assert rig.engine.health().stream_timeouts == 1
    velocity = name == "servo_jv"
    assert ("stop" in rig.device.calls) is (velocity or policy != "hold")
    assert rig.setpoint()["velocity"] == []
    if policy != "hold":
        assert name in rig.engine.status.detail
    rig.cycle(20)
    assert len(rig.written) == 1


def test_a_refused_stream_does_not_count_as_alive() -> None:
    rig = Rig(EngineOptions(stream_timeout=0.1, on_stream_timeout="pause")).enabled()
    rig.engine.submit("servo_jv", jv(0.1, 0.0))
    for _ in range(12):
        with pytest.raises(CommandRefused):
            rig.engine.submit("servo_jv", jv(math.nan, 0.0))
        rig.cycle()
    assert rig.state is S.PAUSED


def test_increments_are_added_up_between_two_cycles() -> None:
    rig = Rig().enabled()
    for _ in range(5):
        rig.engine.submit("servo_jr", jp(0.002, -0.004))
    rig.cycle()
    assert rig.written[-1].values.tolist() == pytest.approx([0.01, -0.02])
    rig.engine.submit("servo_jr", jp(0.002, 0.0))
    rig.cycle()
    assert rig.written[-1].values.tolist() == pytest.approx([0.012, -0.02])


def test_increments_that_add_up_to_a_jump_are_refused_in_the_io_thread() -> None:
    rig = Rig().enabled()
    for _ in range(5):
        rig.engine.submit("servo_jr", jp(0.05, 0.0))
    rig.cycle()
    assert rig.written == []
    assert [refusal.reason for refusal in rig.told.refusals] == [Reason.STEP_TOO_LARGE]


def test_a_stream_that_outruns_the_velocity_limit_is_refused_and_a_slower_one_is_not() -> None:
    rig = Rig().enabled()
    for index in range(1, 60):  # 1.0 rad/s, the limit, for 0.6 s
        rig.servo(index * PERIOD * 1.0, 0.0)
        rig.cycle()
    assert rig.told.refusals == []
    assert len(rig.written) == 59
    rig = Rig().enabled()
    for index in range(1, 40):
        try:
            rig.servo(index * PERIOD * 2.0, 0.0)
        except CommandRefused:
            break
        rig.cycle()
    assert rig.told.refusals[0].reason is Reason.STEP_TOO_LARGE
    assert "faster" in rig.told.refusals[0].message
    assert rig.written[-1].values[0] < 0.3


def test_two_kinds_of_stream_do_not_alternate() -> None:
    rig = Rig(EngineOptions(mode_switch_dwell=0.1)).enabled()
    for _ in range(5):
        rig.servo(0.0, 0.0)
        rig.cycle()
        assert rig.refused("servo_jf", jf(0.1, 0.1)).reason is Reason.MODE_SWITCH
    assert rig.engine.health().refusals == {"servo_jf: mode_switch": 5}
    rig.cycle(15)
    rig.engine.submit("servo_jf", jf(0.1, 0.1))
    rig.cycle()
    assert rig.written[-1].mode is Mode.JOINT_EFFORT
    assert rig.refused("servo_jp", jp(0.0, 0.0)).reason is Reason.MODE_SWITCH
    rig.engine.submit("hold")
    rig.servo(0.0, 0.0)  # hold ends a stream at once


SETPOINTS = {
    "servo_jp": (jp(0.01, 0.02), [0.01, 0.02], [], []),
    "servo_cp": (pose(0.01, 0.02), [0.01, 0.02], [], []),
    "servo_jr": (jp(0.01, 0.02), [0.01, 0.02], [], []),
    "servo_jv": (jv(0.01, 0.02), [], [0.01, 0.02], []),
    "servo_jf": (jf(0.01, 0.02), [], [], [0.01, 0.02]),
    "servo_cv": (Twist(vector((0.1, 0, 0)), THREE), [], [], []),
}


@pytest.mark.parametrize("name", SETPOINTS)
def test_the_setpoint_holds_what_the_level_says(name: str) -> None:
    value, position, velocity, effort = SETPOINTS[name]
    rig = Rig().enabled()
    rig.engine.submit(name, value)
    rig.cycle()
    state, stamp = rig.value("setpoint_js")
    assert state.name == ("slide", "turn")
    assert stamp == rig.value("measured_js")[1]
    assert rig.setpoint() == {
        "position": pytest.approx(position),
        "velocity": velocity,
        "effort": effort,
    }
    _, cartesian_stamp = rig.value("setpoint_cp")
    assert (cartesian_stamp != 0) is bool(position), "valid under position commands only"


def test_the_setpoint_of_a_move_holds_position_and_velocity_of_the_trajectory() -> None:
    rig = Rig().enabled()
    rig.engine.submit("move_jp", jp(0.5, 0.0))
    rig.cycle(30)
    setpoint = rig.setpoint()
    assert 0.0 < setpoint["position"][0] < 0.5
    assert setpoint["velocity"][0] > 0.1
    assert setpoint["position"] == rig.written[-1].values.tolist()
    assert rig.value("setpoint_cp")[1] != 0


@pytest.mark.parametrize("state", [S.DISABLED, S.FAULT])
def test_the_setpoint_is_not_valid_unless_enabled_or_paused(state: OperatingState) -> None:
    rig = Rig().enabled()
    assert rig.value("setpoint_js")[1] != 0
    rig.device.reported = Condition(state)
    rig.cycle()
    assert rig.value("setpoint_js")[1] == 0
    assert rig.value("setpoint_cp")[1] == 0
    assert rig.value("measured_js")[1] != 0


def test_a_device_that_wants_its_setpoint_every_cycle_gets_it_only_while_enabled() -> None:
    rig = Rig(capabilities=two_joints(writes_every_cycle=True)).enabled()
    rig.cycle(3)
    assert rig.written == [], "nothing is sent before a command"
    rig.servo(0.01, 0.0)
    rig.cycle(5)
    assert [setpoint.values[0] for setpoint in rig.written] == [0.01] * 5
    rig.command("pause")
    rig.cycle(5)
    assert len(rig.written) == 5


# ------------------------------------------------------------------------------------------ moves


def test_a_move_raises_busy_reaches_its_goal_and_latches_it() -> None:
    rig = Rig().enabled()
    move = rig.engine.submit("move_jp", jp(0.1, -0.1))
    assert move is not None
    assert rig.engine.status.is_busy
    assert rig.told.goals == ["goal_js", "goal_cp"]
    rig.cycle(100)
    assert move.wait(0.0)
    assert not rig.engine.status.is_busy
    assert rig.written[-1].values.tolist() == [0.1, -0.1]
    found = rig.engine.latched("goal_js")
    assert found is not None
    assert isinstance(found[0], JointState)
    assert found[0].position.tolist() == [0.1, -0.1]
    assert found[0].name == ("slide", "turn")
    assert found[1].wall_ns != 0


def test_busy_rises_and_falls_for_a_move_that_goes_nowhere_and_for_one_that_is_refused() -> None:
    rig = Rig().enabled()
    before = len(rig.told.statuses)
    rig.engine.submit("move_jp", jp(0.0, 0.0))
    rig.cycle(2)
    assert rig.told.busy[before:] == [True, False]
    with pytest.raises(CommandRefused):
        rig.engine.submit("move_jp", jp(9.0, 0.0))
    assert rig.told.busy[before:] == [True, False, True, False]


def test_every_announcement_has_a_later_stamp_than_the_one_before() -> None:
    rig = Rig().enabled()
    for _ in range(20):
        rig.engine.submit("move_jp", jp(0.0, 0.0))
        rig.cycle(2)
        with pytest.raises(CommandRefused):
            rig.engine.submit("move_jp", jp(9.0, 0.0))
        rig.engine.state_command("enable")
    stamps = [stamp.wall_ns for _, stamp in rig.told.statuses]
    assert len(stamps) > 80
    assert all(later > earlier for earlier, later in itertools.pairwise(stamps))


@pytest.mark.parametrize("cycles", [0, 5])
@pytest.mark.parametrize(
    ("name", "value"),
    [("servo_jp", None), ("hold", None), ("free", None), ("move_jp", jp(-0.1, 0.0))],
)
def test_what_pre_empts_a_move_ends_its_handle_and_leaves_busy_right(
    name: str, value: object, cycles: int
) -> None:
    rig = Rig().enabled()
    move = rig.engine.submit("move_jp", jp(0.2, 0.0))
    assert move is not None
    rig.cycle(cycles)  # it waits, or it runs
    if name == "servo_jp":
        value = JointState(position=rig.value("setpoint_js")[0].position)
    second = rig.engine.submit(name, value)  # type: ignore[arg-type]
    rig.cycle()
    assert move.outcome is Outcome.PREEMPTED
    with pytest.raises(MotionAborted, match=f"pre-empted: by {name}"):
        move.wait(0.0)
    assert rig.engine.status.is_busy is (second is not None)
    rig.cycle(100)
    assert not rig.engine.status.is_busy


def test_a_move_accepted_as_the_one_before_ends_keeps_busy_up_in_between() -> None:
    rig = Rig().enabled()
    first = rig.engine.submit("move_jp", jp(0.0, 0.0))
    assert first is not None
    announced = len(rig.told.statuses)
    finish = first.finish

    def accept_the_next(outcome: Outcome, reason: str = "") -> None:
        rig.engine.submit("move_jp", jp(0.1, 0.0))
        finish(outcome, reason)

    first.finish = accept_the_next  # type: ignore[method-assign]
    rig.cycle()
    assert first.wait(0.0)
    assert rig.engine.status.is_busy
    rig.cycle(100)
    assert rig.told.busy[announced:] == [False]


def test_an_effort_is_let_go_when_nobody_sees_any_more_where_it_takes_the_joints() -> None:
    rig = Rig().enabled()
    rig.engine.submit("servo_jf", jf(1.0, 0.0))
    rig.cycle()
    rig.device.silent = True
    rig.device.calls.clear()
    for _ in range(round(0.15 / PERIOD)):
        rig.engine.submit("servo_jf", jf(1.0, 0.0))
        rig.cycle()
    assert "stop" in rig.device.calls
    assert {told.reason for told in rig.told.refusals} == {Reason.NOT_MEASURED}
    written = len(rig.device.written)
    rig.engine.submit("servo_jf", jf(1.0, 0.0))
    rig.cycle(3)
    assert len(rig.device.written) == written, "none is sent until joints are measured again"
    rig.device.silent = False
    rig.cycle(20)
    rig.engine.submit("servo_jf", jf(0.5, 0.0))
    rig.cycle()
    assert rig.device.written[-1].values.tolist() == [0.5, 0.0]


@pytest.mark.parametrize("what", ["poses alone", "what was read last, as invalid"])
def test_a_sample_without_new_joints_does_not_show_where_an_effort_takes_them(
    monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    rig = Rig().enabled()
    last = rig.device.read(0.0)
    assert last is not None

    def read(_: float) -> Sample:
        now = rig.clock.stamp()
        if what == "poses alone":
            return Sample(now, {"measured_cp": last.values["measured_cp"]})
        return Sample(Stamp(0, now.monotonic), last.values)

    monkeypatch.setattr(rig.device, "read", read)
    for _ in range(round(0.15 / PERIOD)):
        rig.engine.submit("servo_jf", jf(1.0, 0.0))
        rig.cycle()
    assert "stop" in rig.device.calls
    assert {told.reason for told in rig.told.refusals} == {Reason.NOT_MEASURED}


def test_how_far_an_unseen_joint_may_have_gone_on_counts_towards_the_end_of_its_range(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rig = Rig().enabled()
    upper = rig.device.capabilities.limits[0].upper
    seen = JointState(vector((upper - 0.16, 0.0)), vector((0.5, 0.0)))
    stamp = rig.clock.stamp()
    monkeypatch.setattr(rig.device, "read", lambda _: Sample(stamp, {"measured_js": seen}))
    rig.engine.submit("servo_jf", jf(0.0, 0.0))
    rig.cycle()
    assert not rig.told.refusals
    rig.cycle(round(0.08 / PERIOD))
    assert [told.reason for told in rig.told.refusals] == [Reason.OUT_OF_RANGE]


def test_a_move_that_is_taken_in_the_cycle_in_which_an_effort_is_refused_ends(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rig = Rig().enabled()
    rig.engine.submit("servo_jf", jf(1.0, 0.0))
    rig.cycle()
    state, stamp = JointState(vector((0.0, 0.0)), vector((5.0, 0.0))), rig.clock.stamp
    monkeypatch.setattr(rig.device, "read", lambda _: Sample(stamp(), {"measured_js": state}))
    move = rig.engine.submit("move_jp", jp(0.1, 0.0))
    assert move is not None
    rig.cycle()
    assert rig.told.refusals[-1].reason is Reason.OUT_OF_RANGE
    assert move.outcome is Outcome.ABORTED
    assert not rig.engine.status.is_busy


def test_a_move_that_ends_while_it_is_still_being_accepted_leaves_nothing_busy(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rig = Rig().enabled()
    take, lies_there, has_cycled = rig.engine._arbiter.take, threading.Event(), threading.Event()
    here = jp(*rig.device.position)
    client = threading.Thread(target=rig.engine.submit, args=("move_jp", here))

    def accepted_so_far(name: str) -> None:
        lies_there.set()
        has_cycled.wait(0.5)  # in vain: the cycle waits for the client to have told that it is busy

    def take_it() -> object:
        client.start()
        assert lies_there.wait(10.0)
        return take()

    monkeypatch.setattr(rig.told, "latched", accepted_so_far)
    monkeypatch.setattr(rig.engine._arbiter, "take", take_it)
    rig.cycle()
    has_cycled.set()
    client.join(10.0)
    assert rig.told.busy[-2:] == [True, False]


def test_a_stream_that_replaces_a_move_before_it_begins_leaves_nothing_busy() -> None:
    rig = Rig().enabled()
    rig.engine.submit("interpolate_jp", jp(0.1, 0.0))
    rig.cycle(3)
    move = rig.engine.submit("move_jp", jp(0.2, 0.0))
    rig.engine.submit("interpolate_jp", jp(0.1, 0.0))
    rig.cycle()
    assert move is not None
    assert move.outcome is Outcome.PREEMPTED
    assert not rig.engine.status.is_busy


def test_a_move_goes_on_after_a_late_cycle_without_burst_or_jump() -> None:
    rig = Rig().enabled()
    rig.engine.submit("move_jp", jp(0.5, 0.0))
    rig.cycle(20)
    before, writes = rig.written[-1].values[0], len(rig.written)
    rig.cycle(period=0.15)
    assert len(rig.written) == writes + 1
    assert rig.written[-1].values[0] - before <= 2.0 * PERIOD * 1.0 + 1e-9
    rig.cycle(100)
    assert rig.written[-1].values.tolist() == [0.5, 0.0]


LEAVING = {
    "disable": S.DISABLED,
    "pause": S.PAUSED,
    "condition": S.FAULT,
    "alarm": S.FAULT,
    "disconnect": S.FAULT,
    "shut down": S.DISABLED,
    "fault": S.FAULT,
}


@pytest.mark.parametrize("cycles", [0, 5])
@pytest.mark.parametrize("way", LEAVING)
def test_a_move_ends_however_enabled_is_left(way: str, cycles: int) -> None:
    rig = Rig().enabled()
    move = rig.engine.submit("move_jp", jp(0.2, 0.0))
    assert move is not None
    rig.cycle(cycles)
    if way in ("disable", "pause"):
        rig.command(way)
    elif way == "condition":
        rig.device.reported = Condition(S.FAULT, "protective stop")
        rig.cycle()
    elif way == "alarm":
        rig.engine.alarm("stuck")
    elif way == "disconnect":
        rig.disconnect("lost")
    elif way == "shut down":
        rig.engine.shut_down()
    else:
        rig.device.fail["write"] = DeviceFault("overload")
        rig.cycle(2)
    assert move.outcome is Outcome.ABORTED
    assert move.reason
    with pytest.raises(MotionAborted):
        move.wait()
    assert rig.state is LEAVING[way]
    assert not rig.engine.status.is_busy
    assert "stop" in rig.device.calls


def test_no_move_is_accepted_while_enabled_is_being_left() -> None:
    """A client that is quicker than the I/O thread must not leave a move that nobody will end."""
    rig = Rig().enabled()
    end, outcomes = rig.engine._motion.end, []

    def end_and_submit(reason: str) -> None:
        end(reason)
        try:
            rig.engine.submit("move_jp", jp(0.1, 0.0))
        except CommandRefused as refusal:
            outcomes.append(refusal.reason)

    rig.engine._motion.end = end_and_submit  # type: ignore[method-assign]
    rig.device.reported = Condition(S.FAULT, "e-stop")
    rig.cycle()
    assert outcomes == [Reason.NOT_ENABLED]
    assert not rig.engine.status.is_busy


@pytest.mark.parametrize(
    "error", [DeviceFault("broken"), CommandRefused("move_jp", Reason.LOCAL_CONTROL, "pendant")]
)
def test_a_native_move_that_the_hardware_does_not_start_ends_its_handle(error: Exception) -> None:
    rig = Rig(capabilities=two_joints(native_moves=frozenset({"move_jp"}))).enabled()
    rig.device.fail["move"] = error
    move = rig.engine.submit("move_jp", jp(0.1, 0.0))
    assert move is not None
    rig.cycle()
    assert move.outcome is Outcome.ABORTED
    assert not rig.engine.status.is_busy
    assert "stop" in rig.device.calls
    assert rig.state is (S.FAULT if isinstance(error, DeviceFault) else S.ENABLED)


def test_a_move_that_is_refused_on_its_way_ends_and_is_refused_once() -> None:
    rig = Rig().enabled()
    move = rig.engine.submit("move_jp", jp(0.5, 0.0))
    assert move is not None
    rig.cycle(5)
    rig.device.fail["write"] = CommandRefused("move_jp", Reason.LOCAL_CONTROL, "pendant")
    rig.cycle(10)
    assert move.outcome is Outcome.ABORTED
    assert len(rig.told.refusals) == 1
    assert not rig.engine.status.is_busy


def test_a_move_brings_back_a_joint_that_lies_outside_its_limits() -> None:
    rig = Rig().connect()
    rig.device.position = np.array([1.5, 0.0])
    rig.cycle()
    rig.enabled()
    move = rig.engine.submit("move_jp", jp(0.5, 0.0))
    assert move is not None
    rig.cycle(400)
    assert move.wait(0.0)
    path = [1.5, *(setpoint.values[0] for setpoint in rig.written)]
    assert max(path) == 1.5
    assert max(abs(b - a) for a, b in itertools.pairwise(path)) < 2 * PERIOD


def test_a_servo_command_refused_in_the_io_thread_leaves_a_move_running() -> None:
    rig = Rig().enabled()
    move = rig.engine.submit("move_jp", jp(0.5, 0.0))
    assert move is not None
    rig.cycle(5)
    for _ in range(3):
        rig.engine.submit("servo_jr", jp(0.09, 0.0))
    rig.cycle()
    assert rig.told.refusals[-1].reason is Reason.STEP_TOO_LARGE
    rig.cycle(150)
    assert move.wait(0.0)


# --------------------------------------------------------------------------------- hold and free


@pytest.mark.parametrize("state", [S.DISABLED, S.PAUSED, S.FAULT])
def test_hold_is_welcome_where_nothing_moves_and_leaves_nothing_behind(
    state: OperatingState,
) -> None:
    rig = Rig().enabled()
    rig.device.reported = Condition(state)
    rig.cycle()
    calls = list(rig.device.calls)
    rig.engine.submit("hold")
    rig.cycle(2)
    assert rig.device.calls == calls
    rig.device.reported = Condition()
    rig.engine.state_command("disable")
    rig.cycle()
    calls = list(rig.device.calls)
    rig.enabled()
    rig.cycle(3)
    assert rig.device.calls == [*calls, "enable"], "no hold from before reaches an enabled device"


def test_hold_ends_homing_and_is_refused_only_where_nobody_is_there_to_obey() -> None:
    rig = Rig(capabilities=two_joints(needs_homing=True)).enabled()
    rig.device.procedures["home"] = lambda: (None for _ in range(50))
    rig.command("home")
    assert rig.engine.status.is_busy
    del rig.device.calls[:]
    rig.engine.submit("hold")
    rig.cycle()
    assert rig.device.calls == ["stop"]
    assert rig.engine.transition_ended
    assert not rig.engine.status.is_busy
    assert rig.state is S.ENABLED
    rig.disconnect("gone")
    with pytest.raises(CommandRefused, match="gone"):
        rig.engine.submit("hold")


def test_pause_ends_homing() -> None:
    rig = Rig(capabilities=two_joints(needs_homing=True)).enabled()
    rig.device.procedures["home"] = lambda: (None for _ in range(50))
    rig.command("home")
    rig.command("pause")
    assert rig.state is S.PAUSED
    assert not rig.engine.status.is_busy


@pytest.mark.parametrize("running", ["enable", "unhome", "pause", "disable"])
def test_hold_is_welcome_during_every_other_state_command(running: str) -> None:
    rig = Rig(capabilities=two_joints(needs_homing=True))
    rig.device.homed = True
    rig.connect()
    if running != "enable":
        rig.enabled()
    rig.device.procedures[running] = lambda: (None for _ in range(5))
    rig.command(running)
    assert not rig.engine.transition_ended
    rig.engine.submit("hold")
    rig.cycle(10)
    assert rig.engine.transition_ended


def test_hold_stops_a_velocity_and_the_setpoint_says_so() -> None:
    rig = Rig().enabled()
    rig.engine.submit("servo_jv", jv(0.1, 0.0))
    rig.cycle()
    rig.engine.submit("hold")
    rig.cycle()
    assert rig.device.calls[-1] == "stop"
    assert rig.setpoint()["velocity"] == []
    assert rig.engine.health().stream == ""
    rig.cycle(20)
    assert rig.engine.health().stream_timeouts == 0


def test_a_freed_arm_is_stopped_before_it_obeys_again() -> None:
    rig = Rig().enabled()
    closed: list[bool] = []

    def procedure() -> object:
        try:
            while True:
                yield
        finally:
            closed.append(True)

    rig.device.procedures["free"] = procedure  # type: ignore[assignment]
    rig.engine.submit("free")
    rig.cycle(3)
    rig.device.position = np.array([0.7, 0.0])
    rig.cycle()
    assert rig.setpoint()["position"] == [0.7, 0.0], "the setpoint follows the hand"
    rig.servo(0.71, 0.0)
    rig.cycle()
    assert closed == [True]
    assert rig.device.calls[-2:] == ["stop", "write"]


# --------------------------------------------------------------------- condition, faults and alarms


def test_the_hardware_can_only_make_the_state_worse() -> None:
    rig = Rig().enabled()
    for state in (S.PAUSED, S.DISABLED, S.FAULT):
        rig.device.reported = Condition(state, f"is {state}")
        rig.cycle()
        assert (rig.state, rig.engine.status.detail) == (state, f"is {state}")
    rig.device.reported = Condition()
    rig.cycle(50)
    assert rig.state is S.FAULT, "a fault is never cleared by itself"
    assert rig.engine.status.detail == "is FAULT"


def test_an_emergency_stop_ends_homing() -> None:
    rig = Rig(capabilities=two_joints(needs_homing=True)).enabled()
    rig.device.procedures["home"] = lambda: (None for _ in range(90))
    rig.command("home")
    assert rig.engine.status.is_busy
    rig.device.reported = Condition(S.FAULT, "e-stop")
    rig.cycle(2)
    assert rig.state is S.FAULT
    assert not rig.engine.status.is_busy
    assert not rig.engine.status.is_homed
    assert rig.device.calls[-1] == "stop"
    assert rig.engine.transition_ended


def test_a_fault_while_writing_stops_the_device() -> None:
    rig = Rig().enabled()
    rig.device.fail["write"] = DeviceFault("joint 2 is too hot")
    rig.servo(0.01, 0.0)
    rig.cycle()
    assert (rig.state, rig.engine.status.detail) == (S.FAULT, "joint 2 is too hot")
    assert rig.device.calls[-1] == "stop"
    del rig.device.fail["write"]
    rig.cycle(5)
    assert rig.written == []


def test_an_alarm_is_a_fault_that_stops_the_device_and_survives_the_return_of_the_thread() -> None:
    rig = Rig().enabled()
    rig.engine.submit("servo_jv", jv(0.1, 0.0))
    rig.cycle()
    writes = len(rig.written)
    rig.engine.alarm("the I/O thread is stuck")
    assert (rig.state, rig.engine.status.detail) == (S.FAULT, "the I/O thread is stuck")
    assert rig.device.calls[-1] == "stop"
    rig.cycle(30)
    assert rig.state is S.FAULT
    assert len(rig.written) == writes
    assert rig.engine.health().stream == ""
    rig.enabled()


def test_an_alarm_in_the_midst_of_a_cycle_keeps_the_rest_of_it_from_the_device() -> None:
    rig = Rig().enabled()
    rig.engine.submit("move_jp", jp(0.5, 0.0))
    rig.cycle(5)
    writes = len(rig.written)
    limit = rig.engine._motion._limiter.limit

    def alarm_then_limit(*arguments: object) -> object:
        rig.engine.alarm("stuck")
        return limit(*arguments)  # type: ignore[arg-type]

    rig.engine._motion._limiter.limit = alarm_then_limit  # type: ignore[assignment,method-assign]
    rig.cycle()
    assert len(rig.written) == writes
    assert rig.state is S.FAULT


def test_an_alarm_announces_the_fault_though_the_device_cannot_stop() -> None:
    rig = Rig().enabled()
    rig.device.fail["stop"] = OSError("no")
    with pytest.raises(OSError, match="no"):
        rig.engine.alarm("stuck")
    assert rig.state is S.FAULT


def test_an_observer_that_fails_harms_nobody() -> None:
    class Broken(type(Rig().told)):  # type: ignore[misc]
        def status_changed(self, status: object, stamp: Stamp) -> None:
            raise RuntimeError("my fault")

    rig = Rig()
    rig.engine.add_observer(Broken())
    last = type(rig.told)()
    rig.engine.add_observer(last)
    rig.enabled()
    assert rig.state is S.ENABLED
    assert last.states == rig.told.states


def test_shutting_down_stops_an_enabled_device_and_closes_it_even_if_that_fails() -> None:
    rig = Rig().enabled()
    rig.device.fail["stop"] = ConnectionLost("gone")
    with pytest.raises(ConnectionLost):
        rig.engine.shut_down()
    assert rig.device.calls[-2:] == ["stop", "close"]
    assert not rig.engine.connected
    rig = Rig().connect()
    rig.engine.shut_down()
    assert rig.device.calls == ["open", "close"]


def test_a_waiting_client_is_released_by_the_shutdown() -> None:
    rig = Rig().enabled()
    move = rig.engine.submit("move_jp", jp(0.5, 0.0))
    assert move is not None
    ended: list[BaseException] = []

    def wait() -> None:
        try:
            move.wait()
        except MotionAborted as error:
            ended.append(error)

    client = threading.Thread(target=wait)
    client.start()
    rig.engine.shut_down()
    client.join(5.0)
    assert "shut down" in str(ended[0])


def test_late_cycles_are_counted() -> None:
    rig = Rig().connect()
    rig.cycle(50)
    assert rig.engine.health().late_cycles == 0
    rig.cycle(period=0.1)
    health = rig.engine.health()
    assert health.late_cycles == 1
    assert health.worst_cycle == pytest.approx(0.1)
    assert health.rate_expected == 100.0
    assert FakeClock(5.0)() == 5.0


def test_what_is_told_of_a_device_names_it_once_and_says_once_what_to_do(
    caplog: pytest.LogCaptureFixture,
) -> None:
    rig = Rig()
    where, remedy = rig.engine.where, "Check the address."
    lost = ConnectionFailed("cannot connect: refused", where=where, remedy=remedy)
    rig.device.fail["open"] = lost
    with pytest.raises(ConnectionFailed):
        rig.engine.connect(rig.clock() + 1.0)
    status = rig.engine.status
    assert status.detail == "cannot connect: refused. Check the address."
    assert (status.cause, status.remedy) == ("cannot connect: refused", remedy)
    assert [record.getMessage() for record in caplog.records] == [
        f"{where}: FAULT: {status.detail}"
    ]
    with pytest.raises(CommandRefused) as refused:
        rig.engine.submit("servo_jp", jp(0.0, 0.0))
    assert str(refused.value) == (
        f"{where}: servo_jp refused (not_enabled): the device is FAULT (cannot connect: refused). "
        "Remove the cause, then send enable on state_command."
    )
    assert where not in rig.engine.health().last_refusal
    rig.disconnect(lost.statement, lost.remedy)
    assert rig.engine.status == status, "the same again is no news"


SAMPLES_HALF_A_SECOND = EngineOptions(sample_timeout=0.5)


def test_a_thread_that_was_stuck_takes_what_it_finds_for_new_and_looks_for_more() -> None:
    rig = Rig(SAMPLES_HALF_A_SECOND).enabled()
    old = rig.clock.stamp()
    rig.device.silent = True
    rig.cycle(period=2.0)  # it was stuck, and finds nothing at first
    rig.device.silent, rig.device.stamp = False, old
    rig.cycle(10)  # what was made meanwhile
    assert rig.engine.connected
    rig.device.stamp = None
    rig.cycle(100)
    assert rig.engine.connected


@pytest.mark.parametrize("brings", ["nothing", "old samples"])
def test_a_thread_that_was_stuck_is_excused_once(brings: str) -> None:
    rig = Rig(SAMPLES_HALF_A_SECOND).enabled()
    rig.device.silent, rig.device.stamp = brings == "nothing", rig.clock.stamp()
    rig.cycle(period=2.0)
    begin = rig.clock()
    with pytest.raises(ConnectionLost, match="the newest sample is"):
        rig.cycle(100)
    assert rig.clock() - begin == pytest.approx(0.5, abs=0.02)


def test_cycles_that_are_all_too_slow_do_not_hide_that_nothing_comes() -> None:
    rig = Rig(SAMPLES_HALF_A_SECOND).enabled()
    rig.device.silent = True
    with pytest.raises(ConnectionLost, match="the newest sample is"):
        rig.cycle(3, period=0.6)

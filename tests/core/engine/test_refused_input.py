"""What the engine refuses, with its reason, and changes nothing."""

import math

import numpy as np
import pytest

from crtk_drivers.device import Condition
from crtk_drivers.engine import EngineOptions, intake
from crtk_drivers.errors import (
    CommandRefused,
    Reason,
)
from crtk_drivers.options import LimitPolicy
from crtk_drivers.samples import JointState, Pose, Twist, Wrench, vector
from crtk_drivers.state import OperatingState
from rigs.scripted_arm import ARM, BENT, ArmRig
from rigs.scripted_engine import Rig, jf, jp, jv, pose, two_joints

S = OperatingState
THREE = vector((0.0, 0.0, 0.0))
UNIT = vector((0.0, 0.0, 0.0, 1.0))


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


def test_stamps_are_checked_only_if_the_user_wants_that(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig().enabled()
    rig.engine.submit("servo_jp", jp(0.0, 0.0), stamp_ns=1)
    rig = Rig(EngineOptions(limits=LimitPolicy(max_command_age=0.5))).enabled()
    rig.tells_time_to(intake, monkeypatch)
    now = rig.wall_ns()
    rig.engine.submit("servo_jp", jp(0.0, 0.0), stamp_ns=now)
    rig.engine.submit("servo_jp", jp(0.0, 0.0), stamp_ns=0)
    rig.cycle()
    old = rig.refused("servo_jp", jp(0.0, 0.0), stamp_ns=now - 10**10)
    early = rig.refused("servo_jp", jp(0.0, 0.0), stamp_ns=now + 10**10)
    assert (old.reason, early.reason) == (Reason.TOO_OLD, Reason.FROM_FUTURE)


def test_a_state_command_too_old_sets_nothing_going_and_stops_everything(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    options = EngineOptions(limits=LimitPolicy(max_command_age=0.5))
    rig = Rig(options, two_joints(needs_homing=True)).connect()
    rig.tells_time_to(intake, monkeypatch)
    now = rig.wall_ns()

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


def test_inverse_kinematics_say_that_nobody_knows_where_the_joints_are() -> None:
    rig = ArmRig()
    with pytest.raises(CommandRefused, match="has not reported its joint positions"):
        rig.engine.inverse_kinematics(ARM.forward(BENT))
    assert rig.engine.inverse_kinematics(ARM.forward(BENT), BENT) == pytest.approx(BENT)

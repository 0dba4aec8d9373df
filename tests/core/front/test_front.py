"""The plain Python front, over a session with the loopback device."""

import inspect
import logging
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest

import crtk_drivers
from crtk_drivers.device import Steps
from crtk_drivers.errors import (
    CommandRefused,
    ConnectionFailed,
    DataTimeout,
    KinematicsError,
    MotionAborted,
    Reason,
    TransitionFailed,
)
from crtk_drivers.front import LocalDevice
from crtk_drivers.samples import JointState, Pose, Twist, Wrench, vector
from crtk_drivers.session import Session
from crtk_drivers.state import OperatingState, StateCommand
from crtk_drivers.testing.loopback import PLUGIN, LoopbackConfig, LoopbackDevice
from rigs.waiting import LONG, eventually


@pytest.fixture
def arm() -> Iterator[LocalDevice]:
    session = Session(PLUGIN, LoopbackConfig(rate=200.0, needs_homing=True))
    with LocalDevice(session) as arm:
        session.start()
        arm.measured_js(wait=5.0)
        yield arm


def device_of(arm: LocalDevice) -> LoopbackDevice:
    device = arm.engine.device
    assert isinstance(device, LoopbackDevice)
    return device


def test_the_offered_names_are_methods(arm: LocalDevice) -> None:
    for name in arm.crtk_commands:
        owner = arm
        for part in name.split("/"):
            owner = getattr(owner, part)
        assert callable(owner)
        assert inspect.getdoc(owner)
    assert arm.local.measured_cp().frame_id == "base"


def test_a_name_that_is_not_offered_is_absent_and_says_what_is_missing(arm: LocalDevice) -> None:
    assert not hasattr(arm, "use_gravity_compensation")
    with pytest.raises(AttributeError, match=r"does not offer use_gr.* It would need gravity"):
        arm.use_gravity_compensation(True)
    with pytest.raises(AttributeError, match="does not offer body/measured_cp"):
        arm.body.measured_cp()


def test_a_name_that_is_none_of_crtk_says_which_are(arm: LocalDevice) -> None:
    with pytest.raises(
        AttributeError, match=r"loopback has no dance\. It moves by move_cp, .*move_jp"
    ):
        arm.dance()
    with pytest.raises(AttributeError, match=r"has no mov_jp\. Did you mean move_jp"):
        arm.mov_jp([0.0])
    with pytest.raises(AttributeError, match="no attribute '_dance'"):
        arm._dance()


def test_ratios_are_numbers_that_are_told_when_they_change(arm: LocalDevice) -> None:
    assert arm.trajectory_j.ratio() == 1.0
    arm.trajectory_j.set_ratio(0.5)
    arm.trajectory_j.set_ratio_a(0.25)
    told = (arm.trajectory_j.ratio_v(), arm.trajectory_j.ratio_a(), arm.trajectory_j.ratio())
    assert told == (0.5, 0.25, 0.25)
    for bad in (0.0, 1.1, float("nan"), -0.5):
        with pytest.raises(CommandRefused, match="is no ratio"):
            arm.trajectory_j.set_ratio(bad)
    with pytest.raises(CommandRefused, match="cannot make a number"):
        arm.trajectory_j.set_ratio("fast")
    assert arm.trajectory_j.ratio() == 0.25


def test_the_readme_example(arm: LocalDevice) -> None:
    arm.enable()
    assert arm.is_enabled()
    goal = arm.setpoint_js().position + 0.05
    assert arm.move_jp(goal).wait(LONG)
    assert arm.setpoint_jp() == pytest.approx(goal)
    assert arm.goal_js().position == pytest.approx(goal)
    assert arm.wait_for_busy(False, LONG)
    assert not arm.is_busy()
    arm.disable()
    assert arm.operating_state().state is OperatingState.DISABLED


def test_values_may_be_lists_arrays_or_payloads(arm: LocalDevice) -> None:
    arm.enable()
    for value in ([0.01] * 4, np.full(4, 0.01), JointState(position=vector([0.01] * 4))):
        arm.servo_jp(value)
    arm.hold()
    arm.servo_cv([0.01, 0, 0, 0, 0, 0])
    arm.servo_cv(Twist(vector((0.01, 0, 0)), vector((0, 0, 0))))
    arm.hold()
    arm.servo_cp([*arm.measured_cp().position, 0, 0, 0, 1])


@pytest.mark.parametrize("value", ["text", None, [[0.0]], {"a": 1}, 3.0, [None] * 4])
def test_what_is_no_payload_is_refused_and_counted(arm: LocalDevice, value: object) -> None:
    arm.enable()
    with pytest.raises(CommandRefused) as caught:
        arm.servo_jp(value)
    assert caught.value.reason in (Reason.WRONG_TYPE, Reason.NOT_FINITE)
    assert caught.value.remedy
    assert sum(arm.health().refusals.values()) == 1


@pytest.mark.parametrize("numbers", [3, 6, 8])
def test_a_pose_has_seven_numbers(arm: LocalDevice, numbers: int) -> None:
    arm.enable()
    with pytest.raises(CommandRefused, match="7 numbers"):
        arm.move_cp([0.0] * numbers)


def test_feedback_waits_for_what_is_fresh_and_age_zero_takes_what_there_is(
    arm: LocalDevice,
) -> None:
    value, stamp = arm.measured_js(extra=True)
    assert value.position.shape == (4,)
    assert abs(stamp - time.time()) < 60.0
    assert arm.measured_jp().tolist() == value.position.tolist()
    device_of(arm).silent = True
    assert arm.wait_for_operating_state("FAULT", 5.0)
    begin = time.monotonic()
    with pytest.raises(DataTimeout, match=r"measured_js: nothing valid .* FAULT"):
        arm.measured_js(wait=0.05)
    assert time.monotonic() - begin >= 0.05
    assert arm.measured_js(age=0).position.shape == (4,)


def test_a_goal_that_was_never_set_times_out(arm: LocalDevice) -> None:
    with pytest.raises(DataTimeout, match="goal_js: no value yet"):
        arm.goal_js(wait=0.01)


def test_state_commands_wait_and_raise(arm: LocalDevice) -> None:
    with pytest.raises(CommandRefused, match="resume is invalid in DISABLED"):
        arm.resume()
    arm.enable()
    arm.enable()
    assert not arm.is_homed()
    arm.home()
    assert arm.is_homed()
    arm.pause()
    arm.resume()
    arm.unhome()
    assert not arm.is_homed()


def test_a_refusal_of_somebody_elses_state_command_is_none_of_ours(arm: LocalDevice) -> None:
    def somebody_else() -> Steps:
        with pytest.raises(CommandRefused, match="enable is running"):
            arm.engine.state_command("resume")
        yield

    device_of(arm)._transition = somebody_else  # type: ignore[method-assign]
    arm.enable()
    assert arm.is_enabled()


def test_a_state_command_that_ends_elsewhere_says_where_and_why(arm: LocalDevice) -> None:
    device = device_of(arm)
    device.transition_time = 30.0
    with pytest.raises(TransitionFailed, match=r"enable did not end in 0.05 s"):
        arm.enable(timeout=0.05)

    def lose_the_link() -> Steps:
        device.reachable = False
        while True:
            yield

    device._transition = lose_the_link  # type: ignore[method-assign]
    with pytest.raises(TransitionFailed, match=r"disable ended in FAULT: .*the link is gone"):
        arm.disable()


def test_an_instant_of_busy_is_not_missed(arm: LocalDevice) -> None:
    arm.enable()
    seen: list[bool] = []
    waiting = threading.Thread(target=lambda: seen.append(arm.wait_for_busy(True, 5.0)))
    waiting.start()
    while waiting.is_alive():
        with pytest.raises(CommandRefused):
            arm.move_jp([9.0] * 4)
    waiting.join()
    assert seen == [True]
    assert arm.wait_for_busy(False, LONG)
    assert not arm.wait_for_busy(True, 0.01)


def test_kinematics(arm: LocalDevice) -> None:
    joints = [0.1, 0.2, 0.3, 0.4]
    pose = arm.forward_kinematics(joints)
    assert arm.inverse_kinematics(pose) == pytest.approx(joints)
    assert arm.inverse_kinematics(pose, joints) == pytest.approx(joints)
    assert arm.jacobian().values.shape == (6, 4)
    with pytest.raises(KinematicsError):
        arm.inverse_kinematics(Pose(pose.position, vector((1, 0, 0, 0))))
    with pytest.raises(CommandRefused, match="3 values"):
        arm.forward_kinematics([0.0] * 3)
    with pytest.raises(CommandRefused, match="nan"):
        arm.inverse_kinematics(pose, [np.nan] * 4)


@pytest.mark.parametrize(
    ("ask", "words"),
    [
        (lambda arm: arm.forward_kinematics("x"), "forward_kinematics refused .* of str"),
        (lambda arm: arm.forward_kinematics([[0.0] * 4]), "forward_kinematics refused .* of list"),
        (lambda arm: arm.forward_kinematics(None), "forward_kinematics refused"),
        (lambda arm: arm.inverse_kinematics([9, 9, 9]), "inverse_kinematics refused .* of list"),
        (lambda arm: arm.inverse_kinematics(object()), "inverse_kinematics refused .* of object"),
        (
            lambda arm: arm.inverse_kinematics([0, 0, 0, 0, 0, 0, 1], "x"),
            "inverse_kinematics refused .* of str",
        ),
    ],
)
def test_what_is_no_pose_and_no_joints_is_refused_by_kinematics(
    arm: LocalDevice, ask: Callable[[LocalDevice], object], words: str
) -> None:
    with pytest.raises(CommandRefused, match=words) as refusal:
        ask(arm)
    assert refusal.value.remedy
    assert "loopback" in refusal.value.where


def test_closing_ends_a_move_and_the_threads() -> None:
    before = set(threading.enumerate())
    session = Session(PLUGIN, LoopbackConfig())
    arm = LocalDevice(session)
    session.start()
    arm.measured_js(wait=5.0)
    arm.enable()
    move = arm.move_jp([0.9] * 4)
    arm.close()
    arm.close()
    with pytest.raises(MotionAborted, match="shut down"):
        move.wait()
    with pytest.raises(CommandRefused, match="DISABLED"):
        arm.servo_jp([0.0] * 4)
    assert set(threading.enumerate()) <= before


def logged_refusals(caplog: pytest.LogCaptureFixture) -> list[tuple[int, str]]:
    records = [record for record in caplog.records if record.name == "crtk_drivers.front.local"]
    return [(record.levelno, record.getMessage()) for record in records]


def test_a_refusal_that_raises_is_logged_once_in_a_while(
    arm: LocalDevice, caplog: pytest.LogCaptureFixture
) -> None:
    arm.enable()
    with caplog.at_level(logging.INFO, "crtk_drivers.front"):
        for _ in range(50):
            with pytest.raises(CommandRefused):
                arm.servo_jp([0.0] * 5)
    ((level, text),) = logged_refusals(caplog)
    assert "5 values in position for 4 joints" in text
    assert level == logging.INFO, "a warning is printed where logging is not set up"


@pytest.mark.parametrize("waits", [True, False], ids=["raises", "raises nowhere"])
def test_a_refusal_of_the_io_thread_is_a_warning_unless_it_raises(
    arm: LocalDevice,
    caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
    waits: bool,
) -> None:
    def enable() -> Steps:
        yield
        raise CommandRefused("state_command", Reason.LOCAL_CONTROL, "somebody else is there")

    monkeypatch.setitem(arm.engine._transitions._procedures, StateCommand.ENABLE, enable)
    with caplog.at_level(logging.INFO, "crtk_drivers.front"):
        if waits:
            with pytest.raises(CommandRefused, match="somebody else is there"):
                arm.enable(LONG)
        else:
            arm.enable(timeout=0.0)
            eventually(lambda: logged_refusals(caplog), "it is logged")
    ((level, text),) = logged_refusals(caplog)
    assert "somebody else is there" in text
    assert level == (logging.INFO if waits else logging.WARNING)


PROGRAM = """
import crtk_drivers

with crtk_drivers.connect("virtual") as arm:
    for refused in (arm.free, arm.pause, lambda: arm.servo_jp([0.0]), lambda: arm.servo_jp("here")):
        try:
            refused()
        except crtk_drivers.CommandRefused:
            print("caught")
    arm.move_jp([0.0])
"""


def test_a_program_without_logging_shows_a_refusal_once() -> None:
    ended = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, timeout=100, check=False
    )
    assert ended.returncode == 1
    assert ended.stdout == "caught\n" * 4
    assert ended.stderr.startswith("Traceback"), "nothing of what was caught"
    assert ended.stderr.count("move_jp refused (not_enabled)") == 1


def test_payloads_of_another_kind_are_refused(arm: LocalDevice) -> None:
    arm.enable()
    with pytest.raises(CommandRefused, match="cannot make a twist of Wrench"):
        arm.servo_cv(Wrench(vector((0, 0, 0)), vector((0, 0, 0))))
    with pytest.raises(CommandRefused, match="too large"):
        arm.servo_jp([10**400, 0, 0, 0])


def test_ros_is_not_imported() -> None:
    program = "import sys, crtk_drivers; sys.exit('rclpy' in sys.modules)"
    subprocess.run([sys.executable, "-c", program], check=True, timeout=100)


def test_connect_tries_for_the_open_timeout() -> None:
    """Without `timeout`, which is 10 s where neither is given."""
    begin = time.monotonic()
    joints = {"a": {"id": 1, "model": "xm430-w350"}}
    with pytest.raises(ConnectionFailed, match=r"it was tried for 0\.5 s"):
        crtk_drivers.connect("dynamixel", port="/dev/null", joints=joints, open_timeout=0.5)
    assert time.monotonic() - begin < 8.0
    with pytest.raises(ConnectionFailed, match=r"it was tried for 0\.2 s"):
        crtk_drivers.connect(
            "dynamixel", port="/dev/null", joints=joints, open_timeout=30.0, timeout=0.2
        )

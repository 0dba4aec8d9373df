"""A script that was written for the device in its own process runs unchanged against the far one."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

import crtk_drivers
from crtk_drivers import CommandRefused, JointState, Pose
from crtk_drivers.errors import DataTimeout, KinematicsError, MotionAborted, Reason
from crtk_drivers.state import OperatingState
from rigs.loopback_client import far_device
from rigs.loopback_node import SLOWLY
from rigs.waiting import LONG, eventually


@contextmanager
def local() -> Iterator[Any]:
    with crtk_drivers.connect("loopback") as arm:
        yield arm


@contextmanager
def remote() -> Iterator[Any]:
    with far_device("/client_script") as far:
        yield far.arm


def refused(call: Callable[[], Any]) -> Reason:
    """The reason of a refusal, which a stream over ROS tells at its next command."""
    try:
        eventually(lambda: call() is NotImplemented, "never")
    except CommandRefused as refusal:
        return refusal.reason
    raise AssertionError("not refused")


@pytest.mark.parametrize("open_arm", [local, remote])
def test_the_same_script(open_arm: Callable[[], Any]) -> None:
    with open_arm() as arm:
        # what it offers
        assert "use_gravity_compensation" not in arm.crtk_commands
        with pytest.raises(AttributeError, match="does not offer use_gravity_compensation"):
            arm.use_gravity_compensation(True)

        # before enable
        assert arm.operating_state().state is OperatingState.DISABLED
        # One that is not sent below: the driver tells every two seconds of a stream that is refused.
        assert refused(lambda: arm.servo_jv([0.0] * 4)) is Reason.NOT_ENABLED
        assert refused(lambda: arm.move_jp([0.0] * 4)) is Reason.NOT_ENABLED
        with pytest.raises(CommandRefused) as refusal:
            arm.resume()
        assert refusal.value.reason is Reason.INVALID_TRANSITION

        arm.enable()
        assert arm.is_enabled()
        assert arm.is_homed()
        assert not arm.is_busy()

        # feedback
        state, stamp = arm.measured_js(extra=True)
        assert isinstance(state, JointState)
        assert stamp > 0.0
        assert arm.measured_jp().shape == arm.setpoint_jp().shape == (4,)
        assert isinstance(arm.measured_cp(), Pose)
        assert isinstance(arm.local.measured_cp(age=0), Pose)
        assert arm.measured_cv().vector.shape == arm.measured_cf().vector.shape == (6,)
        assert arm.jacobian().values.shape == (6, 4)
        with pytest.raises(DataTimeout):
            arm.goal_js(wait=0.1)

        # moves
        start = arm.setpoint_js().position
        move = arm.move_jp(start + np.array([0.1, 0.0, 0.0, 0.2]))
        assert move.wait(is_busy=True)
        assert move.wait(LONG)
        assert np.allclose(arm.setpoint_jp(), [0.1, 0.0, 0.0, 0.2], atol=1e-3)
        assert np.allclose(arm.goal_js().position, [0.1, 0.0, 0.0, 0.2])
        assert arm.move_jr([0.0, 0.05, 0.0, 0.0]).wait(LONG)
        pose = arm.setpoint_cp(wait=LONG)
        goal = Pose(pose.position + np.array([0.0, 0.0, 0.05]), pose.orientation, pose.frame_id)
        assert arm.move_cp(goal).wait(LONG)
        assert refused(lambda: arm.move_jp([7.0, 0.0, 0.0, 0.0])) is Reason.OUT_OF_RANGE
        assert refused(lambda: arm.move_jp([0.0])) is Reason.WRONG_SIZE
        assert refused(lambda: arm.move_cp("there")) is Reason.WRONG_TYPE

        # pre-empted and held
        arm.trajectory_j.set_ratio(SLOWLY)
        eventually(lambda: arm.trajectory_j.ratio() == SLOWLY, "neither is over before it is ended")
        first = arm.move_jp([-0.9, 0.0, 0.0, 0.0])
        second = arm.move_jp([0.9, 0.0, 0.0, 0.0])
        with pytest.raises(MotionAborted, match="pre-empted"):
            first.wait(LONG)
        arm.hold()
        with pytest.raises(MotionAborted):
            second.wait(LONG)
        arm.trajectory_j.set_ratio(1.0)

        # streams
        eventually(lambda: np.abs(arm.measured_jv()).max() < 1e-3, "it stands")
        begin = arm.setpoint_jp()
        for step in range(1, 11):
            arm.servo_jp(begin + 0.001 * step)
        eventually(lambda: np.allclose(arm.measured_jp(), begin + 0.01, atol=1e-3), "it follows")

        # kinematics
        there = arm.forward_kinematics([0.1, 0.2, 0.3, 0.4])
        assert np.allclose(arm.inverse_kinematics(there, [0.0] * 4), [0.1, 0.2, 0.3, 0.4])
        with pytest.raises(KinematicsError):
            arm.inverse_kinematics(Pose(np.zeros(3), np.array([0.5, 0.5, 0.5, 0.5])))

        # the other states
        arm.pause()
        assert arm.operating_state().state is OperatingState.PAUSED
        arm.resume()
        arm.home()
        with pytest.raises(CommandRefused, match="needs no homing"):
            arm.unhome()
        arm.free()
        arm.hold()
        arm.disable()
        assert not arm.is_enabled()
        assert not arm.wait_for_operating_state("ENABLED", timeout=0.05)
        assert arm.wait_for_busy(False, timeout=LONG)

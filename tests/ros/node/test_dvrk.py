"""A class with the endpoints of dVRK's arms, and the calls of their scripts, over DDS on a simulated arm.

The class is our own: dvrk_python is not part of this project. It asks for the same names in the same
namespaces with the same types, by the client of release 1.4, which dvrk_python needs.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from std_msgs.msg import Bool, Float64

import crtk_drivers.client.compat.v1_4 as crtk
from crtk_drivers import plugins
from crtk_drivers.engine import Engine
from crtk_drivers.geometry.conversions import as_pose, have_kdl, to_kdl
from crtk_drivers.geometry.quaternions import matrix_from_quaternion
from crtk_drivers.samples import Pose, Wrench
from crtk_drivers.session import Session
from rigs.loopback_node import served
from rigs.waiting import LONG, eventually

ARM = [
    "operating_state",
    "setpoint_js",
    "setpoint_cp",
    "measured_js",
    "measured_cp",
    "measured_cv",
    "hold",
    "free",
    "servo_jp",
    "servo_jr",
    "servo_cp",
    "servo_jf",
    "move_jp",
    "move_jr",
    "move_cp",
    "forward_kinematics",
    "inverse_kinematics",
]
BODY = ["measured_cf", "servo_cf", "jacobian"]
LOCAL = ["measured_cp", "setpoint_cp", "forward_kinematics"]
PLACE = {"position": [1.0, 2.0, 0.5], "rpy": [0.0, 0.0, math.pi / 2.0], "frame_id": "cart"}


class Part:
    """What an arm has in a sub-namespace."""

    def __init__(self, ral: Any, features: list[str]) -> None:
        add(crtk.utils(self, ral, LONG), features)


class Arm:
    def __init__(self, ral: Any, name: str) -> None:
        self.ral = ral.create_child(name)
        add(crtk.utils(self, self.ral, LONG), ARM)
        self.body = Part(self.ral.create_child("body"), BODY)
        self.spatial = Part(self.ral.create_child("spatial"), BODY)
        self.local = Part(self.ral.create_child("local"), LOCAL)
        self.absolute = self.latched("/body/set_cf_orientation_absolute", Bool)
        self.gravity = self.latched("/use_gravity_compensation", Bool)
        self.set_ratio = self.latched("/trajectory_j/set_ratio", Float64)
        self.ratios: list[float] = []
        self.ral.subscriber(
            "/trajectory_j/ratio", Float64, lambda message: self.ratios.append(message.data)
        )

    def latched(self, name: str, kind: type) -> Any:
        return self.ral.publisher(name, kind, latch=True, queue_size=1)


def add(utils: Any, features: list[str]) -> None:
    for name in features:
        getattr(utils, f"add_{name}")()


@pytest.fixture(scope="module", params=["its own base", "a base on a cart"])
def engine(request: pytest.FixtureRequest) -> Iterator[Engine]:
    plugin = plugins.device("virtual")
    placed = {} if request.param == "its own base" else {"base": PLACE}
    # A busy machine is no fault; where the driver is held up, the next command that it hears is further on.
    patient = {"sample_timeout": 5.0, "limits": {"max_step": 1.0}}
    session = Session(plugin, plugin.load_config({"rate": 100.0, **patient, **placed}, {}))
    with served(session, f"/dvrk_{bool(placed)}/PSM1"):
        yield session.engine


@pytest.fixture(scope="module")
def arm(engine: Engine) -> Iterator[Any]:
    placed = engine.capabilities.base_pose is not None
    ral = crtk.ral("dvrk_script", f"dvrk_{placed}")
    arm = Arm(ral, "PSM1")
    ral.spin()
    ral.check_connections(LONG)
    assert arm.enable(LONG)  # type: ignore[attr-defined]
    assert arm.home(LONG)  # type: ignore[attr-defined]
    eventually(lambda: engine.transition_ended, "it is at home")
    yield arm
    assert arm.disable(LONG)  # type: ignore[attr-defined]
    ral.shutdown()


def moved(pose: Any, dz: float) -> Any:
    plain = as_pose(pose)
    higher = Pose(plain.position + np.array([0.0, 0.0, dz]), plain.orientation)
    return to_kdl(higher) if have_kdl() else higher


def valid(read: Callable[[], tuple[Any, float]]) -> Any:
    """A value whose stamp is not 0, as dVRK's scripts wait for it."""
    eventually(lambda: read()[1] > 0.0, "it is valid")
    return read()[0]


def test_moves_and_streams(arm: Any) -> None:
    start = np.copy(valid(arm.setpoint_jp))
    goal = np.copy(start)
    goal[0] += 0.1
    goal[1] -= 0.1
    assert arm.move_jp(goal).wait()
    assert arm.move_jp(goal).wait(), "where it is already"
    eventually(lambda: arm.measured_jp()[0] == pytest.approx(goal, abs=5e-3), "it is there")
    assert arm.move_jp(start).wait()
    assert arm.move_cp(moved(valid(arm.setpoint_cp), 0.02)).wait()

    begin = np.copy(valid(arm.setpoint_jp))
    rate = arm.ral.create_rate(100.0)
    for step in range(30):
        begin[0] += 0.001
        arm.servo_jp(begin, np.full(begin.size, 0.1))
        if step % 10 == 0:
            assert valid(arm.measured_jp).size == begin.size
        rate.sleep()
    eventually(lambda: abs(arm.setpoint_jp()[0][0] - begin[0]) < 1e-3, "the stream has arrived")
    arm.hold()


def test_local_is_the_arm_s_own_base(arm: Any, engine: Engine) -> None:
    joints = np.copy(valid(arm.setpoint_jp))
    own, plain = as_pose(valid(arm.local.setpoint_cp)), as_pose(valid(arm.setpoint_cp))
    if engine.capabilities.base_pose is None:
        expected = plain.position
    else:
        x, y, z = plain.position - np.array(PLACE["position"])
        expected = np.array([y, -x, z])  # turned back by 90 degrees about z
    assert own.position == pytest.approx(expected, abs=1e-6)
    computed = as_pose(arm.local.forward_kinematics(joints))
    assert computed.position == pytest.approx(own.position, abs=1e-6)
    measured = as_pose(valid(arm.local.measured_cp))
    assert measured.position == pytest.approx(own.position, abs=0.01)


def test_a_share_of_the_speed(arm: Any) -> None:
    for ratio in (0.5, 1.0):
        arm.set_ratio.publish(Float64(data=ratio))
        eventually(lambda: arm.ratios[-1:] == [ratio], "the arm has taken it")  # noqa: B023


def test_a_force_in_the_axes_that_are_asked_for(arm: Any, engine: Engine) -> None:
    arm.gravity.publish(Bool(data=True))
    push = np.array([0.0, 0.0, -3.0, 0.0, 0.0, 0.0])

    def pushed(expected: Callable[[], np.ndarray]) -> Callable[[], bool]:
        def look() -> bool:
            arm.body.servo_cf(push)
            found = engine.feedback("setpoint_cf")
            assert found is not None
            assert isinstance(found[0], Wrench)
            return bool(found[1].wall_ns and np.allclose(found[0].force, expected(), atol=0.05))

        return look

    def along_the_tool() -> np.ndarray:
        pose = as_pose(arm.measured_cp()[0])
        force: np.ndarray = matrix_from_quaternion(pose.orientation) @ push[:3]
        return force

    try:
        eventually(pushed(along_the_tool), "along the tool's axes")
        arm.absolute.publish(Bool(data=True))
        eventually(pushed(lambda: push[:3]), "along the base's axes")
        assert along_the_tool()[2] > 2.0, "which are not the tool's: it points down"
        assert arm.body.measured_cf()[0].shape == (6,)
        assert arm.spatial.jacobian().shape == (6, 6)
    finally:
        arm.absolute.publish(Bool(data=False))
        arm.hold()
    eventually(lambda: not engine.health().stream, "the stream is over")


def test_hold_ends_free(arm: Any, engine: Engine) -> None:
    arm.free()
    eventually(lambda: engine._motion.is_free, "it is free")
    arm.hold()
    eventually(lambda: not engine._motion.is_free, "it holds")
    begin = time.monotonic()
    assert arm.move_jr(np.zeros(6)).wait()
    assert time.monotonic() - begin < LONG

"""Scripts written for the official CRTK Python client, over DDS against the node."""

from __future__ import annotations

import time
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
import rclpy
from sensor_msgs.msg import Joy
from std_msgs.msg import Empty

import crtk_drivers.client.compat as crtk
import crtk_drivers.client.compat.v1_4 as crtk14
from crtk_drivers.client.compat import utilities
from crtk_drivers.commands import COMMANDS
from crtk_drivers.device import Steps
from crtk_drivers.engine import Engine
from crtk_drivers.errors import DeviceFault
from crtk_drivers.geometry.conversions import as_pose, have_kdl, to_kdl
from crtk_drivers.samples import Pose
from crtk_drivers.session import Session
from crtk_drivers.testing.loopback import LoopbackConfig, LoopbackDevice
from rigs.loopback_client import Node
from rigs.loopback_node import serve
from rigs.waiting import LONG, eventually

NAMESPACE = "client_compat"
FEATURES = [
    "measured_js",
    "measured_cp",
    "measured_cv",
    "measured_cf",
    "setpoint_js",
    "setpoint_cp",
    "jacobian",
    "goal_js",
    "servo_jp",
    "servo_jr",
    "servo_jv",
    "servo_jf",
    "servo_cp",
    "servo_cv",
    "move_jp",
    "move_jr",
    "move_cp",
    "hold",
    "free",
    "forward_kinematics",
    "inverse_kinematics",
]


@pytest.fixture(scope="module")
def served() -> Iterator[Session]:
    with (
        serve(LoopbackConfig(), f"/{NAMESPACE}", []) as (session, _serving),
        patch.object(utilities, "WAIT", LONG),
    ):
        yield session


@pytest.fixture
def ral(served: Session) -> Iterator[crtk.ral]:
    ral = crtk.ral("compat_test", NAMESPACE)
    yield ral
    ral.shutdown()
    assert not rclpy.ok()


class Arm:
    """As the official documentation populates a class."""

    class Local:
        def __init__(self, ral: Any, module: Any) -> None:
            self.crtk_utils = module.utils(self, ral)
            self.crtk_utils.add_measured_cp()

    def __init__(self, ral: Any, module: Any = crtk) -> None:
        self.ral = ral
        self.crtk_utils = module.utils(self, ral)
        self.crtk_utils.add_operating_state()
        for name in FEATURES:
            getattr(self.crtk_utils, f"add_{name}")()
        self.local = self.Local(ral.create_child("local"), module)
        ral.check_connections(LONG)
        ral.spin()


def z_plus(pose: Any, dz: float) -> Any:
    """A frame above another, of whichever type poses are here."""
    plain = as_pose(pose)
    higher = Pose(plain.position + np.array([0.0, 0.0, dz]), plain.orientation)
    return to_kdl(higher) if have_kdl() else higher


def test_a_script_of_before_1_4(ral: crtk.ral) -> None:
    arm: Any = Arm(ral)
    assert arm.enable(LONG)
    assert arm.is_enabled()
    assert not arm.is_disabled()
    assert arm.operating_state() == "ENABLED"
    assert arm.home(LONG)
    assert arm.is_homed()

    position, velocity, effort, stamp = arm.measured_js()
    assert position.shape == velocity.shape == effort.shape == (4,)
    assert abs(stamp - ral.to_sec(ral.now())) < 5.0
    jp, stamp = arm.measured_jp(extra=True)
    assert stamp > 0.0
    goal = np.copy(jp)
    goal[:] = [0.05, 0.02, 0.0, 0.1]
    handle = arm.move_jp(goal)
    assert handle.wait(is_busy=True)
    assert handle.wait(timeout=LONG)
    assert not handle.is_busy()
    eventually(lambda: np.allclose(arm.setpoint_jp(), goal, atol=1e-3), "it is sent there")
    eventually(lambda: np.allclose(arm.goal_jp(age=0.0), goal), "the goal is told")
    assert arm.move_jr(np.array([0.0, 0.01, 0.0, 0.0])).wait()
    assert arm.move_cp(z_plus(arm.setpoint_cp(), 0.05)).wait()
    eventually(
        lambda: abs(as_pose(arm.measured_cp(age=0.05)).position[2] - 0.05) < 5e-3, "it is there"
    )
    assert as_pose(arm.local.measured_cp()).position.shape == (3,)
    assert arm.measured_cv().shape == arm.measured_cf().shape == (6,)
    assert arm.jacobian().shape == (6, 4)

    begin = arm.setpoint_jp()
    rate = ral.create_rate(200.0)
    for step in range(20):
        arm.servo_jp(begin + 0.0005 * step)
        rate.sleep()
    pose = arm.forward_kinematics(jp)
    assert np.allclose(arm.inverse_kinematics(jp, pose), jp, atol=1e-9)
    assert arm.inverse_kinematics(jp, pose, extra=True)[1] is True
    arm.hold()
    assert arm.pause(LONG)
    assert arm.resume(LONG)
    assert arm.disable(LONG)


def test_a_script_of_1_4(ral: crtk.ral) -> None:
    arm: Any = Arm(ral, crtk14)
    assert arm.enable(LONG)
    pose, stamp = arm.setpoint_cp(wait_timeout=LONG)
    assert as_pose(pose).position.shape == (3,)
    assert isinstance(stamp, float)
    eventually(lambda: arm.setpoint_cp()[1] > 0.0, "the setpoint is valid")
    assert arm.measured_jp()[0].shape == (4,)
    *parts, stamp = arm.measured_js()
    assert [part.shape for part in parts] == [(4,)] * 3
    for goal in (0.02, 0.0):
        assert arm.enable(LONG)
        assert arm.home(LONG)
        assert arm.move_jp(np.full(4, goal)).wait()
        eventually(lambda: abs(arm.measured_jp()[0] - goal).max() < 5e-3, "it is there")  # noqa: B023
    arm.servo_jp(np.zeros(4), np.zeros(4))
    assert arm.jacobian().shape == (6, 4)
    assert arm.disable(LONG)


def test_waiting_for_a_refused_move_ends_at_once(ral: crtk.ral) -> None:
    arm: Any = Arm(ral)
    assert arm.disable(LONG)
    begin = time.monotonic()
    assert not arm.move_jp(np.zeros(4)).wait(timeout=LONG)
    assert time.monotonic() - begin < LONG / 2.0, "it waited"
    assert not arm.resume(LONG)


def test_enable_waits_for_a_device_that_starts_late(ral: crtk.ral, served: Session) -> None:
    device, engine = served.engine.device, served.engine
    assert isinstance(device, LoopbackDevice)
    arm: Any = Arm(ral, crtk14)
    device.reachable = False
    try:
        assert arm.wait_for_operating_state("FAULT", LONG)
        begin = time.monotonic()
        assert not arm.enable(0.2), "it is not reached in time"
        assert time.monotonic() - begin >= 0.2, "it gave up before"
        before = refused(engine)
        with ThreadPoolExecutor(1) as pool:
            enabled = pool.submit(arm.enable, LONG)
            eventually(lambda: refused(engine) > before, "enable is refused while nothing is there")
            device.reachable = True
            assert enabled.result(LONG)
    finally:
        device.reachable = True
    assert arm.is_enabled()
    assert refused(engine) == before + 1, "it was sent again only once the device was there"
    assert arm.disable(LONG)


@contextmanager
def enabling_late(arm: Any, served: Session) -> Iterator[tuple[Future[bool], list[str]]]:
    """An `enable` that waits for a device that is not there yet, and the state commands that come."""
    device, engine = served.engine.device, served.engine
    assert isinstance(device, LoopbackDevice)
    heard: list[str] = []
    hearers = engine.hearers
    device.reachable = False
    try:
        assert arm.wait_for_operating_state("FAULT", LONG)
        before = refused(engine)
        engine.hearers = (*hearers, lambda _name, value, _stamp: heard.append(value.value))
        with ThreadPoolExecutor(1) as pool:
            enabled = pool.submit(arm.enable, 3.0)
            eventually(lambda: refused(engine) > before, "enable is refused while nothing is there")
            yield enabled, heard
    finally:
        device.reachable, engine.hearers = True, hearers
        assert arm.disable(LONG)


def test_a_late_enable_gives_way_to_disable(ral: crtk.ral, served: Session) -> None:
    """Whoever sends it: that it is refused, since the device is not there, is heard by all."""
    arm: Any = Arm(ral, crtk14)
    with enabling_late(arm, served) as (enabled, heard):
        arm.state_command("disable")
        assert not enabled.result(2.0), "it does not wait any longer"
        served.engine.device.reachable = True  # type: ignore[attr-defined]
        assert arm.wait_for_operating_state("DISABLED", LONG)
        assert heard == ["enable", "disable"]


def test_late_enable_goes_on_beside_another_enable(ral: crtk.ral, served: Session) -> None:
    arm: Any = Arm(ral, crtk14)
    with enabling_late(arm, served) as (enabled, heard):
        before = refused(served.engine)
        arm.state_command("enable")
        eventually(lambda: refused(served.engine) > before, "that of somebody else is refused, too")
        served.engine.device.reachable = True  # type: ignore[attr-defined]
        assert enabled.result(LONG)
        assert heard == ["enable"] * 3, "it is sent again once the device is there"


def too_hot(device: LoopbackDevice) -> Steps:
    raise DeviceFault("a drive is too hot")
    yield


def test_a_late_enable_leaves_later_disables_alone(
    ral: crtk.ral, served: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The device comes back and cannot be enabled; somebody clears that: it is not for `enable` any more."""
    arm: Any = Arm(ral, crtk14)
    device = served.engine.device
    assert isinstance(device, LoopbackDevice)
    with enabling_late(arm, served) as (enabled, heard):
        monkeypatch.setattr(LoopbackDevice, "_transition", too_hot)
        device.reachable = True
        eventually(lambda: "too hot" in served.engine.status.detail, "it is in FAULT")
        monkeypatch.undo()
        assert heard == ["enable"] * 2, "it is sent again, once"
        arm.state_command("disable")
        assert arm.wait_for_operating_state("DISABLED", LONG)
        assert not enabled.result(LONG)
        assert heard == ["enable", "enable", "disable"]
        assert arm.is_disabled()


def test_a_late_enable_that_fails_says_so(
    ral: crtk.ral,
    served: Session,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    arm: Any = Arm(ral, crtk14)
    with enabling_late(arm, served) as (enabled, heard):
        monkeypatch.setattr(LoopbackDevice, "_transition", too_hot)
        served.engine.device.reachable = True  # type: ignore[attr-defined]
        assert not enabled.result(LONG)
        monkeypatch.undo()
        assert arm.operating_state() == "FAULT"
        assert heard == ["enable"] * 2
    assert "enable: it is in FAULT" in caplog.text


def refused(engine: Engine) -> int:
    return engine.health().refusals.get("state_command: not_connected", 0)


def test_what_the_official_client_lacks(ral: crtk.ral) -> None:
    utils = crtk.utils(object.__new__(Arm), ral)
    for name in COMMANDS:
        assert callable(getattr(utils, f"add_{name}")), name
    with pytest.raises(AttributeError, match="no such CRTK command"):
        utils.add_teleport()


def test_what_is_missing_is_named(ral: crtk.ral) -> None:
    class Holder:
        pass

    utils = crtk.utils(Holder(), ral)
    utils.add_measured_js()
    ral.check_connections(LONG)  # so that nothing but the other is waited for, in vain
    utils.add_use_gravity_compensation()
    with pytest.raises(
        TimeoutError, match=f"nobody listens to /{NAMESPACE}/use_gravity_compensation"
    ):
        ral.check_connections(0.5)
    with pytest.raises(RuntimeWarning, match="measured_js already exists"):
        utils.add_measured_js()


def test_no_data(ral: crtk.ral) -> None:
    class Holder:
        measured_cp: Any
        move_jp: Any

    holder = Holder()
    utils = crtk.utils(holder, ral)
    utils.add_measured_cp()
    utils.add_move_jp()
    for kind in (RuntimeWarning, TimeoutError):
        with pytest.raises(kind, match=r"no data on .*ral\.spin"):
            holder.measured_cp(wait=0.1)
    with pytest.raises(RuntimeWarning, match="no CRTK operating state"):
        holder.move_jp(np.zeros(4)).wait()


def test_two_handles_on_one_namespace(ral: crtk.ral) -> None:
    class Holder:
        def __init__(self) -> None:
            self.layer = ral.create_child("local")
            crtk.utils(self, self.layer).add_measured_cp()

    one, other = Holder(), Holder()
    assert len({id(endpoint) for endpoint in ral.all_endpoints()}) == 1
    ral.check_connections(LONG)
    ral.spin()
    for holder in (one, other):
        arm: Any = holder
        assert as_pose(arm.measured_cp()).position.shape == (3,)


def test_the_rest_of_the_layer(ral: crtk.ral) -> None:
    assert ral.ros_version() == 2
    assert ral.node_name() == "compat_test"
    assert ral.namespace() == NAMESPACE
    assert ral.create_child("jaw").namespace() == f"{NAMESPACE}/jaw"
    before = ral.now()
    elapsed = ral.now() - before
    assert elapsed < ral.create_duration(5.0)
    assert 0.0 <= ral.to_sec(elapsed) < 5.0
    assert ral.to_sec(ral.create_time()) == 0.0
    message = Joy(buttons=[0, 1])
    message.header.stamp = before.to_msg()
    assert ral.get_timestamp(message).nanoseconds == before.nanoseconds
    ended: list[str] = []
    ral.on_shutdown(lambda: ended.append("now"))

    heard: list[Any] = []
    subscriber = ral.subscriber("note", Empty, heard.append)
    publisher = ral.publisher("note", Empty)
    assert ral.get_topic_name(publisher) == subscriber.topic_name == f"/{NAMESPACE}/note"
    ral.check_connections(LONG)

    def run(word: str) -> None:
        publisher.publish(Empty())
        eventually(lambda: bool(heard), "the note arrives")
        ended.append(word)

    ral.spin_and_execute(run, "done")
    assert ended == ["done", "now"]
    assert ral.is_shutdown()


def test_a_pedal(ral: crtk.ral) -> None:
    pedal = crtk.joystick_button(ral, "pedal", index=1)
    values: list[int] = []
    pedal.set_callback(values.append)
    assert pedal.value() is None
    with Node("feet") as feet:
        publisher = feet.node.create_publisher(Joy, f"/{NAMESPACE}/pedal", 10)
        ral.check_connections(LONG)
        ral.spin()
        feet.node.create_timer(0.05, lambda: publisher.publish(Joy(buttons=[0, 1])))
        assert pedal.wait(timeout=LONG, value=1)
    eventually(lambda: pedal.value() == 1, "it is kept")
    assert values
    eventually(lambda: not pedal.wait(timeout=0.1), "nobody is heard any more")


def test_arguments_of_ros_are_taken_off(served: Session) -> None:
    rest = crtk.ral.parse_argv(["left", "--ros-args", "-r", "__ns:=/lab"])
    assert rest == ["left"]
    ral = crtk.ral("argued", rest[0])
    assert ral.add_namespace("measured_js") == "/lab/left/measured_js"
    ral.shutdown()

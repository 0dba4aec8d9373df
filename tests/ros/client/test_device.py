"""The client's feedback, state, commands and errors, over DDS against the node."""

from __future__ import annotations

import math
import pydoc
import threading
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from rclpy.qos import qos_profile_sensor_data
from std_msgs.msg import String as Text

from crtk_drivers.client import connect
from crtk_drivers.commands import COMMANDS, Direction
from crtk_drivers.errors import (
    CommandRefused,
    ConnectionFailed,
    CrtkError,
    DataTimeout,
    KinematicsError,
    Reason,
)
from crtk_drivers.samples import JointState, Matrix, Pose, Twist, Wrench
from crtk_drivers.state import OperatingState, Status
from rigs.loopback_client import Far, Node, far_device
from rigs.waiting import LONG, eventually


@pytest.fixture(scope="module")
def shared_far() -> Iterator[Far]:
    with far_device("/client_device") as far:
        yield far


@pytest.fixture
def far(shared_far: Far) -> Far:
    shared_far.reset()
    return shared_far


def test_it_offers_what_the_device_offers(far: Far) -> None:
    assert dict(far.arm.crtk_commands) == dict(far.engine.commands)


def test_every_name_that_is_offered_can_be_used(far: Far) -> None:
    for name, command in far.engine.commands.items():
        space, _, last = name.rpartition("/")
        method = getattr(getattr(far.arm, space) if space else far.arm, last)
        assert callable(method), name
        if name == "operating_state" or name.startswith("goal_"):
            continue
        if command.direction is Direction.PUBLISHED:
            assert method(age=0, wait=LONG) is not None
    far.arm.check_connections()


def test_help_and_dir_know_what_is_made_at_its_first_use(far: Far) -> None:
    with connect(far.namespace, timeout=LONG) as arm:
        assert {"move_jp", "measured_jp", "body", "trajectory_j"} <= set(dir(arm))
        assert "move_jp" not in vars(arm)
        text = pydoc.render_doc(arm, renderer=pydoc.plaintext)
        for name, summary in arm.summaries().items():
            assert f"{name.replace('/', '.')} " in text
            assert summary in text
        assert "move_jp" not in vars(arm)
        assert "-> 'Move'" in pydoc.render_doc(arm.move_jp, renderer=pydoc.plaintext)
        assert "axes of the tool, at" in " ".join((arm.body.servo_cv.__doc__ or "").split())


def test_repr_says_the_state_and_waits_for_nothing(far: Far) -> None:
    arm = connect(far.namespace, timeout=LONG)
    name = f"<RemoteDevice {far.namespace!r}"
    assert repr(arm) == f"{name} (its operating state was not asked for yet)>"
    assert repr(arm.body).startswith(f"<RemoteDevice '{far.namespace}/body'")
    arm.operating_state()
    assert repr(arm) == f"{name} DISABLED>"
    arm.close()
    assert repr(arm) == f"{name} closed>"
    assert "measured_js" not in dir(arm)


def test_repr_outlives_the_node_of_somebody_else(far: Far) -> None:
    with Node("owner_of_a_node") as owner:
        arm = connect(far.namespace, timeout=LONG, node=owner.node)
        arm.operating_state()
        owner.executor.remove_node(owner.node)
        owner.node.destroy_node()
        assert repr(arm) == f"<RemoteDevice {far.namespace!r} closed>"
    assert repr(arm) == f"<RemoteDevice {far.namespace!r} closed>"
    dir(arm)


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("measured_js", JointState),
        ("setpoint_js", JointState),
        ("measured_cp", Pose),
        ("measured_cv", Twist),
        ("measured_cf", Wrench),
        ("jacobian", Matrix),
    ],
)
def test_feedback_has_the_types_of_the_local_device(far: Far, name: str, kind: type) -> None:
    value = getattr(far.arm, name)(age=0, wait=LONG)
    assert type(value) is kind


def test_feedback_is_what_the_device_measured(far: Far) -> None:
    far.arm.enable()
    far.arm.move_jp([0.1, 0.2, 0.0, 0.3]).wait(LONG)
    eventually(
        lambda: np.allclose(far.arm.measured_jp(), [0.1, 0.2, 0.0, 0.3], atol=1e-3), "arrived"
    )
    value, stamp = far.arm.measured_js(extra=True)
    assert value.name == ("x", "y", "z", "yaw")
    assert abs(stamp - time.time()) < 5.0
    assert far.arm.measured_jv().shape == far.arm.measured_jf().shape == (4,)
    local = far.arm.local
    eventually(
        lambda: np.allclose(local.measured_cp().position, value.position[:3], atol=1e-3), "too"
    )
    assert np.allclose(far.arm.goal_js().position, [0.1, 0.2, 0.0, 0.3])
    assert np.allclose(far.arm.goal_cp().position, [0.1, 0.2, 0.0])
    assert far.arm.jacobian().values.shape == (6, 4)


def test_values_cannot_be_changed(far: Far) -> None:
    with pytest.raises(ValueError, match=r"read-only"):
        far.arm.measured_jp()[0] = 1.0


def nothing_for(seconds: float, far: Far) -> bool:
    """Wait for newer data, and return whether there was none."""
    begin = time.monotonic()
    try:
        far.arm.measured_js(wait=seconds)
    except DataTimeout as error:
        return "age=0" in str(error) and time.monotonic() - begin >= seconds
    return False


def test_data_that_is_too_old_is_not_taken(far: Far) -> None:
    far.arm.measured_js()
    far.device.silent = True
    with pytest.raises(DataTimeout, match=r"measured_js: nothing valid and newer than 0.05 s"):
        eventually(lambda: far.arm.measured_js(age=0.05, wait=0.0) is None, "never")
    eventually(lambda: nothing_for(0.2, far), "what was on its way has arrived")
    assert far.arm.measured_js(age=0).position.size == 4
    far.device.silent = False
    assert far.arm.measured_js(wait=LONG).position.size == 4


def test_waiting_ends_with_the_first_valid_value(far: Far) -> None:
    far.device.silent = True
    with pytest.raises(DataTimeout):
        eventually(lambda: far.arm.measured_cp(wait=0.0) is None, "never")
    threading.Timer(0.3, lambda: setattr(far.device, "silent", False)).start()
    assert far.arm.measured_cp(wait=LONG).position.size == 3


def test_a_command_that_is_not_offered_is_named(far: Far) -> None:
    missing = [name for name in COMMANDS if name not in far.engine.commands]
    assert missing
    for name in missing:
        with pytest.raises(AttributeError, match=f"/client_device does not offer {name}"):
            getattr(far.arm, name)
        assert not hasattr(far.arm, name)
    with pytest.raises(AttributeError, match=r"/client_device/body does not offer servo_cp"):
        far.arm.body.servo_cp  # noqa: B018 - asking is the test
    with pytest.raises(AttributeError, match=r"has no attribute 'nonsense'"):
        far.arm.nonsense  # noqa: B018 - asking is the test
    with pytest.raises(AttributeError, match=r"Did you mean move_jp .*crtk_commands has all"):
        far.arm.mov_jp  # noqa: B018 - asking is the test
    with pytest.raises(AttributeError, match=r"nothing in gripper"):
        far.arm.gripper  # noqa: B018 - asking is the test
    with pytest.raises(ConnectionFailed, match=r"does not offer use_gravity_compensation"):
        far.arm.add("measured_js", "use_gravity_compensation")


def test_state_commands(far: Far) -> None:
    arm = far.arm
    assert arm.operating_state() == Status(OperatingState.DISABLED, is_homed=True)
    arm.enable()
    assert arm.is_enabled()
    assert far.engine.status.state == "ENABLED"
    arm.enable()
    arm.pause()
    assert far.engine.status.state == "PAUSED"
    arm.resume()
    arm.home()
    with pytest.raises(CommandRefused, match="needs no homing"):
        arm.unhome()
    assert arm.is_homed()
    eventually(lambda: not arm.is_busy(), "the pulse of what was refused is over")
    arm.disable()
    assert not arm.is_enabled()


def test_an_invalid_state_command_is_refused_as_by_the_local_device(far: Far) -> None:
    with pytest.raises(
        CommandRefused, match=r"resume is invalid in DISABLED. From DISABLED"
    ) as info:
        far.arm.resume()
    assert info.value.reason is Reason.INVALID_TRANSITION
    with pytest.raises(CommandRefused, match=r"not a state command"):
        far.arm.state_command("explode")


def test_waiting_for_a_state_has_a_timeout(far: Far) -> None:
    assert not far.arm.wait_for_operating_state("ENABLED", timeout=0.1)
    assert not far.arm.wait_for_busy(True, timeout=0.1)
    assert far.arm.wait_for_busy(False, timeout=0.1)
    far.arm.state_command("enable", timeout=0.0)
    assert far.arm.wait_for_operating_state("ENABLED", timeout=LONG)


def test_a_refused_stream_raises_at_its_next_command(far: Far) -> None:
    def stream() -> bool:
        far.arm.servo_jp([0.0, 0.0, 0.0, 0.0])
        return False

    with pytest.raises(CommandRefused, match=r"servo_jp refused .*DISABLED") as info:
        eventually(stream, "never")
    assert info.value.reason is Reason.NOT_ENABLED


def test_what_is_no_payload_is_refused_before_it_is_sent(far: Far) -> None:
    far.arm.enable()
    for name, value in {
        "servo_jp": "a text",
        "servo_cp": [1.0, 2.0],
        "servo_cv": [0.0] * 5,
        "move_cp": np.zeros((3, 3)),
    }.items():
        with pytest.raises(CommandRefused, match=f"{name} refused .wrong_type.* Pass") as info:
            getattr(far.arm, name)(value)
        assert info.value.where == "/client_device"
    with pytest.raises(CommandRefused, match=r"the payload is a pose"):
        far.arm.servo_cp(JointState(position=np.zeros(4)))


def test_streams_move_the_device(far: Far) -> None:
    far.arm.enable()
    for step in range(20):
        far.arm.servo_jr([0.0003, 0.0, 0.0, 0.0])
        assert step >= 0
    eventually(lambda: abs(far.arm.measured_jp()[0] - 0.006) < 1e-4, "all increments arrived")
    eventually(lambda: far.engine.health().stream == "", "the stream has ended")
    time.sleep(0.15)  # two streams may not mix

    def velocity() -> bool:
        far.arm.servo_jv([0.0, 0.05, 0.0, 0.0])
        return bool(far.arm.measured_jp()[1] > 0.005)

    eventually(velocity, "it moves with the velocity")


def until_refused(far: Far, name: str, send: Callable[[], None], words: str) -> None:
    """Send a command until its refusal is raised, and wait until none is on its way any more."""
    sent: list[str] = []
    refused: list[str] = []
    end = far.arm.on_refusal(lambda refusal: refused.append(refusal.command))

    def step() -> bool:
        sent.append(name)
        send()  # returns when no refusal was told soon, which need not mean that none comes
        return False

    with pytest.raises(CommandRefused, match=words):
        eventually(step, "the refusal")
    eventually(lambda: refused.count(name) == len(sent), "each is refused, and none later")
    end()


def test_hold_and_free(far: Far) -> None:
    until_refused(far, "free", far.arm.free, r"free refused .*DISABLED")
    far.arm.enable()
    far.arm.free()
    far.arm.hold()


def test_kinematics(far: Far) -> None:
    pose = far.arm.forward_kinematics([0.1, 0.2, 0.3, 0.0])
    assert np.allclose(pose.position, [0.1, 0.2, 0.3])
    assert np.allclose(far.arm.inverse_kinematics(pose, [0.0] * 4), [0.1, 0.2, 0.3, 0.0])
    tilted = Pose(np.zeros(3), np.array([0.5, 0.5, 0.5, 0.5]))
    with pytest.raises(KinematicsError, match=r"turns about z only"):
        far.arm.inverse_kinematics(tilted)
    with pytest.raises(CommandRefused, match="of str"):
        far.arm.forward_kinematics("x")
    with pytest.raises(CommandRefused, match="of list"):
        far.arm.inverse_kinematics([9, 9, 9])


def test_events(far: Far) -> None:
    states: list[Status] = []
    refusals: list[CommandRefused] = []
    poses: list[float] = []
    end = [
        far.arm.on_status(states.append),
        far.arm.on_refusal(refusals.append),
        far.arm.on("measured_cp", lambda value, stamp: poses.append(stamp)),
    ]
    far.arm.enable()
    eventually(lambda: any(s.state is OperatingState.ENABLED for s in states), "the state is told")
    with pytest.raises(CommandRefused):
        far.arm.move_jp([9.0, 0.0, 0.0, 0.0])
    eventually(lambda: any(r.command == "move_jp" for r in refusals), "the refusal is told")
    eventually(lambda: len(set(poses)) > 3, "the poses are told")
    for stop in end:
        stop()
    far.arm.disable()
    told = [status.state for status in states]
    assert OperatingState.DISABLED not in told[told.index(OperatingState.ENABLED) :]


def test_a_callback_cannot_wait_for_what_it_holds_up(far: Far) -> None:
    problems: list[Exception] = []

    def impatient(value: object, stamp: float) -> None:
        try:
            far.arm.measured_js(age=1e-9, wait=LONG)
        except CrtkError as error:
            problems.append(error)

    far.arm.measured_js()
    stop = far.arm.on("measured_cp", impatient)
    eventually(lambda: bool(problems), "it is told so at once")
    stop()
    assert "inside a callback" in str(problems[0])


def test_many_threads_at_once(far: Far) -> None:
    problems: list[BaseException] = []

    def use() -> None:
        try:
            for _ in range(50):
                assert far.arm.measured_js().position.size == 4
                far.arm.operating_state()
                far.arm.forward_kinematics([0.0] * 4)
        except BaseException as error:
            problems.append(error)

    threads = [threading.Thread(target=use) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(LONG)
        assert not thread.is_alive()
    assert not problems


def test_settings_are_numbers(far: Far) -> None:
    far.arm.trajectory_j.set_ratio(0.5)
    far.arm.trajectory_j.set_ratio_a(0.25)
    eventually(lambda: far.arm.trajectory_j.ratio() == 0.25, "the lesser of the two")
    eventually(lambda: far.arm.trajectory_j.ratio_v() == 0.5, "that of the velocity stays")

    until_refused(
        far,
        "trajectory_j/set_ratio",
        lambda: far.arm.trajectory_j.set_ratio(2.0),
        "is no ratio",
    )
    far.arm.trajectory_j.set_ratio(1.0)
    eventually(lambda: far.arm.trajectory_j.ratio() == 1.0, "both")


def test_commands_in_the_frame_of_the_tool(far: Far) -> None:
    far.arm.enable()
    far.arm.move_jp([0.0, 0.0, 0.0, math.pi / 2]).wait(LONG)
    far.arm.body.move_cr([0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]).wait(LONG)
    goal = [0.0, 0.1, 0.0, math.pi / 2]
    eventually(lambda: np.allclose(far.arm.setpoint_jp(age=0), goal, atol=1e-6), "arrived")
    assert far.arm.body.jacobian(age=0).values.shape == (6, 4)


def test_what_is_not_published_reliably_is_heard_too(far: Far) -> None:
    """As cameras do, and devices of other makers may."""
    with Node("hasty") as other:
        told = other.node.create_publisher(Text, "/hasty/told", qos_profile_sensor_data)
        eventually(lambda: far.arm._space.link.publishers("/hasty/told") == 1, "it is found")
        heard = threading.Event()
        end = far.arm.on_message("/hasty/told", lambda message: heard.set())

        def tell() -> bool:
            told.publish(Text(data="here"))
            return heard.is_set()

        eventually(tell, "it is heard")
        end()

"""Move handles and state commands of the client when they do not go as hoped, and two clients at once."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState as JointStateMessage

from crtk_drivers.client import RemoteDevice, connect, move_handle
from crtk_drivers.client.goals import arrival_of
from crtk_drivers.client.inbox import Inbox
from crtk_drivers.client.move_handle import RemoteMove
from crtk_drivers.commands import find
from crtk_drivers.device import Condition
from crtk_drivers.errors import CommandRefused, MotionAborted, Reason, TransitionFailed
from crtk_drivers.motion.move import Outcome
from crtk_drivers.samples import JointState, Pose, vector
from crtk_drivers.state import OperatingState, Status
from rigs.loopback_client import Far, far_device
from rigs.loopback_node import slowly
from rigs.waiting import LONG, eventually

HERE = [0.0, 0.0, 0.0, 0.0]
THERE = [0.1, 0.0, 0.05, 0.2]
FAR_AWAY = [0.9, 0.0, 0.0, 0.0]


@pytest.fixture(scope="module")
def shared_far() -> Iterator[Far]:
    with far_device("/client_moves") as far:
        yield far


@pytest.fixture
def far(shared_far: Far) -> Far:
    shared_far.reset()
    return shared_far


@pytest.fixture(scope="module")
def second(shared_far: Far) -> Iterator[RemoteDevice]:
    with connect(shared_far.namespace) as other:
        other.add("move_jp", "operating_state", "hold")
        yield other


def test_a_setpoint_of_before_the_end_tells_of_no_stop_away_from_the_goal(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Status and setpoint are two topics: the thread that hears them may be stopped in between."""
    monkeypatch.setattr(move_handle, "SETTLE_TIME", 0.0)
    begun = time.monotonic()
    for at, outcome in ((True, Outcome.REACHED), (False, Outcome.ABORTED)):
        told: list[tuple[bool, float]] = [(False, begun)]
        move = RemoteMove(
            "move_jp",
            stamp_ns=1,
            was_busy=False,
            refused_before=False,
            at_goal=lambda told=told: told[-1][0],  # type: ignore[misc]
            lost=lambda: "",
            told_at=lambda told=told: told[-1][1],  # type: ignore[misc]
        )
        for busy in (True, False):
            move.status_changed(Status(OperatingState.ENABLED, is_homed=True, is_busy=busy))
        time.sleep(1e-3)
        assert move.is_busy()
        told.append((at, time.monotonic()))
        assert not move.is_busy()
        assert move.outcome is outcome


def test_a_stop_before_anything_of_the_way_was_told_is_no_arrival(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Somebody else's hold, while the device tells no valid setpoint yet, or not the goal."""
    monkeypatch.setattr(move_handle, "ACCEPT_TIME", -1.0)  # busy was seen for long enough
    monkeypatch.setattr(move_handle, "SETTLE_TIME", 0.0)
    told: list[tuple[bool | None, float]] = [(None, time.monotonic())]
    move = RemoteMove(
        "move_jr",
        stamp_ns=1,
        was_busy=False,
        refused_before=False,
        at_goal=lambda: told[-1][0],
        lost=lambda: "",
        told_at=lambda: told[-1][1],
    )
    for busy in (True, False):
        move.status_changed(Status(OperatingState.ENABLED, is_homed=True, is_busy=busy))
    time.sleep(1e-3)
    assert move.is_busy()
    told.append((False, time.monotonic()))
    assert not move.is_busy()
    assert move.outcome is Outcome.ABORTED


def test_a_setpoint_that_is_not_valid_tells_of_no_arrival() -> None:
    """A link that was late for a moment makes one setpoint invalid, perhaps the newest one."""
    inbox = Inbox("/arm/setpoint_js", JointStateMessage)
    message = JointStateMessage(position=HERE)
    message.header.stamp.sec = 1
    inbox.receive(serialize_message(message))
    valid = inbox.latest
    message.header.stamp.sec = 0
    inbox.receive(serialize_message(message))
    arrival = arrival_of(find("move_jp"), inbox, JointState(vector(THERE)), None, 1)
    assert arrival.at_goal() is False
    assert valid is not None
    assert arrival.told_at() == valid.arrived


def test_a_move_reaches_its_goal(far: Far) -> None:
    far.arm.enable()
    move = far.arm.move_jp(THERE)
    assert move.wait(is_busy=True)
    assert move.wait(LONG)
    assert move.outcome is Outcome.REACHED
    assert not move.is_busy()
    assert np.allclose(far.arm.setpoint_jp(), THERE, atol=1e-3)


def test_a_move_to_where_it_is(far: Far) -> None:
    far.arm.enable()
    assert far.arm.move_jp(HERE).wait(LONG)
    assert far.arm.move_jp(HERE).wait(LONG)


def test_relative_and_cartesian_moves(far: Far) -> None:
    far.arm.enable()
    assert far.arm.move_jr([0.02, 0.0, 0.0, 0.0]).wait(LONG)
    assert far.arm.move_jr([0.02, 0.0, 0.0, 0.0]).wait(LONG)
    eventually(
        lambda: np.allclose(far.arm.setpoint_jp(), [0.04, 0.0, 0.0, 0.0], atol=1e-6), "the end"
    )
    eventually(
        lambda: np.allclose(far.arm.setpoint_cp().position, [0.04, 0.0, 0.0], atol=1e-6), "too"
    )
    pose = far.arm.setpoint_cp()
    goal = Pose(pose.position + np.array([0.0, 0.0, 0.05]), pose.orientation, pose.frame_id)
    assert far.arm.move_cp(goal).wait(LONG)
    goal_jp = [0.04, 0.0, 0.05, 0.0]
    eventually(lambda: np.allclose(far.arm.setpoint_jp(), goal_jp, atol=1e-3), "the joints, too")


def test_a_refused_move_raises_from_the_call(far: Far) -> None:
    with pytest.raises(CommandRefused, match=r"/client_moves: move_jp refused .*DISABLED") as info:
        far.arm.move_jp(THERE)
    assert info.value.reason is Reason.NOT_ENABLED
    far.arm.enable()
    with pytest.raises(CommandRefused, match=r"x at 5.0000 is outside") as info:
        far.arm.move_jp([5.0, 0.0, 0.0, 0.0])
    assert info.value.reason is Reason.OUT_OF_RANGE


def test_a_refusal_that_the_driver_holds_back_is_waited_for(far: Far) -> None:
    far.arm.enable()
    for _ in range(2):  # the driver tells the second one only when two seconds are over
        with pytest.raises(CommandRefused):
            far.arm.move_jp([-5.0, 0.0, 0.0, 0.0])
    assert far.arm.move_jp(THERE).wait(LONG)


def test_a_newer_move_takes_its_place(far: Far) -> None:
    far.arm.enable()
    with slowly(far.engine):
        first = far.arm.move_jp(FAR_AWAY)
    second = far.arm.move_jp(HERE)
    with pytest.raises(MotionAborted, match=r"pre-empted: by move_jp"):
        first.wait(LONG)
    assert second.wait(LONG)
    assert np.allclose(far.arm.setpoint_jp(), HERE, atol=1e-3)


def test_hold_ends_a_move(far: Far) -> None:
    far.arm.enable()
    with slowly(far.engine):
        move = far.arm.move_jp(FAR_AWAY)
        far.arm.hold()
        with pytest.raises(MotionAborted, match=r"pre-empted: by hold"):
            move.wait(LONG)


def test_a_fault_ends_a_move(far: Far) -> None:
    far.arm.enable()
    with slowly(far.engine):
        move = far.arm.move_jp(FAR_AWAY)
        far.device.reported = Condition(OperatingState.FAULT, "stuck")
        with pytest.raises(MotionAborted, match=r"aborted: the device is FAULT"):
            move.wait(LONG)


def test_waiting_has_a_timeout(far: Far) -> None:
    far.arm.enable()
    with slowly(far.engine):
        move = far.arm.move_jp(FAR_AWAY)
        assert not move.wait(timeout=0.05)
        assert move.is_busy()
        assert move.outcome is Outcome.RUNNING


def test_another_clients_hold_ends_a_move(far: Far, second: RemoteDevice) -> None:
    far.arm.enable()
    with slowly(far.engine):
        move = far.arm.move_jp(FAR_AWAY)
        second.hold()
        with pytest.raises(MotionAborted, match=r"stopped away from its goal"):
            move.wait(LONG)


@pytest.mark.parametrize(
    ("name", "way"),
    [
        ("move_jr", [0.9, 0.0, 0.0, 0.0]),
        ("move_cr", [0.9, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]),
        ("body/move_cr", [0.9, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]),
    ],
)
def test_another_clients_hold_ends_a_relative_move(
    far: Far, second: RemoteDevice, name: str, way: list[float]
) -> None:
    far.arm.enable()
    space, _, base = name.rpartition("/")
    begins = getattr(far.arm.child(space) if space else far.arm, base)
    with slowly(far.engine):
        move = begins(way)
        second.hold()
        with pytest.raises(MotionAborted, match=r"stopped away from its goal"):
            move.wait(LONG)


def test_another_clients_refusal_is_not_mine(far: Far, second: RemoteDevice) -> None:
    far.arm.enable()
    move = far.arm.move_jp([0.5, 0.0, 0.0, 0.0])
    with pytest.raises(CommandRefused):
        second.move_jp([0.0, 0.0]).wait(LONG)
    assert move.wait(LONG)


def test_two_clients_see_the_same(far: Far, second: RemoteDevice) -> None:
    second.enable()
    assert far.arm.wait_for_operating_state("ENABLED", LONG)
    assert second.move_jp(THERE).wait(LONG)
    eventually(
        lambda: np.allclose(far.arm.setpoint_jp(), THERE, atol=1e-3), "the first sees it too"
    )


def test_slow_transitions() -> None:
    with far_device("/client_slow", transition_time=0.6, needs_homing=True) as far:
        arm = far.arm
        far.device.transition_time = 4.0
        with pytest.raises(TransitionFailed, match=r"enable did not end in time: .* DISABLED"):
            arm.enable(timeout=0.2)
        with pytest.raises(CommandRefused, match=r"enable is running"):
            arm.enable()
        far.device.transition_time = 0.6
        move = arm.move_jp([0.01, 0.0, 0.0, 0.0])
        assert move.wait(LONG)
        assert arm.is_enabled()
        assert not arm.is_homed()
        begin = time.monotonic()
        arm.home()
        assert arm.is_homed()
        assert time.monotonic() - begin >= 0.5
        arm.unhome()
        assert not arm.is_homed()
        arm.home(timeout=0.0)
        assert arm.move_jp(np.zeros(4)).wait(LONG)
        assert arm.is_homed()
        far.device.transition_time = 0.0
        arm.disable()
        far.device.transition_time = 4.0
        other = threading.Thread(target=_refused_for_somebody_else, args=(far,))
        other.start()
        arm.enable()  # a refusal of somebody else's is none of ours
        other.join()
        arm.disable()
        far.device.transition_time = 4.0
        other = threading.Thread(target=_lost_meanwhile, args=(far,))
        other.start()
        with pytest.raises(TransitionFailed, match=r"enable ended in FAULT.*/diagnostics"):
            arm.enable()
        other.join()


def _lost_meanwhile(far: Far) -> None:
    _until_enabling(far)
    far.device.reachable = False


def _until_enabling(far: Far) -> None:
    """Of a `disable`, which is sent twice, the second may be carried out late."""
    transitions = far.engine._transitions
    eventually(lambda: transitions.leads_to is OperatingState.ENABLED, "enable is running")


def _refused_for_somebody_else(far: Far) -> None:
    _until_enabling(far)
    with pytest.raises(CommandRefused):
        far.engine.state_command("resume", stamp_ns=5)
    far.device.transition_time = 0.0  # it may end

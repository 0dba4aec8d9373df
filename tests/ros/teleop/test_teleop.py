"""Two devices on ROS 2, one of which leads the other one, and a pedal."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sensor_msgs.msg import Joy

from crtk_drivers.cli.reaching import Interrupted
from crtk_drivers.client import RemoteDevice
from crtk_drivers.client.ros_link import Link
from crtk_drivers.client.teleop import Teleoperation, TopicPedal, reached_sides, topic_pedals
from crtk_drivers.client.teleop.side import Listened, nothing
from crtk_drivers.device import Condition, Mode
from crtk_drivers.errors import CommandRefused, ConfigError, Reason
from crtk_drivers.geometry.quaternions import quaternion_from_rotvec
from crtk_drivers.motion.teleop import Phase, TeleopSettings
from crtk_drivers.samples import Pose, vector
from crtk_drivers.session import Session
from crtk_drivers.state import OperatingState
from crtk_drivers.testing.loopback import LoopbackConfig
from rigs.loopback_node import serve
from rigs.programs import COMMAND, Start
from rigs.waiting import LONG, eventually

LEADER, FOLLOWER, PEDAL = "/teleop_hand", "/teleop_arm", "/teleop_pedals/engage"


class Foot:
    """A pedal that tells its state again and again, unless it is unplugged."""

    def __init__(self) -> None:
        self.pressed = False
        self.plugged = True
        self._link = Link("feet")
        self._publisher = self._link.node.create_publisher(Joy, PEDAL, 10)
        self._link.node.create_timer(0.02, self._tell)
        self._link.start()

    def _tell(self) -> None:
        if self.plugged:
            message = Joy(buttons=[int(self.pressed)])
            message.header.stamp = self._link.node.get_clock().now().to_msg()
            self._publisher.publish(message)

    def close(self) -> None:
        self._link.close()


@dataclass
class Table:
    """All that stands on it."""

    sessions: dict[str, Session]
    link: Link
    leader: RemoteDevice
    follower: RemoteDevice
    foot: Foot

    def device(self, namespace: str) -> Any:
        return self.sessions[namespace].engine.device


@pytest.fixture(scope="module")
def table() -> Iterator[Table]:
    foot = Foot()
    try:
        with (
            serve(LoopbackConfig(address="hand"), LEADER, []) as (hand, _),
            serve(LoopbackConfig(address="arm"), FOLLOWER, []) as (arm, _),
            reached_sides(LEADER, FOLLOWER, LONG) as (link, leader, follower),
        ):
            yield Table({LEADER: hand, FOLLOWER: arm}, link, leader, follower, foot)
    finally:
        foot.close()


@contextmanager
def running(table: Table, **given: Any) -> Iterator[Teleoperation]:
    """A teleoperation that runs, with both sides enabled and the pedal let go."""
    values = {"leader": LEADER, "follower": FOLLOWER, "engage": {"topic": PEDAL}}
    settings = TeleopSettings(**{**values, **given})
    if "timeout" not in given:
        settings = settings.model_copy(update={"timeout": LONG})
    table.foot.pressed, table.foot.plugged = False, True
    for device in (table.leader, table.follower):
        device.enable()
    loop = Teleoperation(settings, table.leader, table.follower, topic_pedals(table.link, settings))
    stop = threading.Event()
    thread = threading.Thread(target=loop.run, args=(stop, lambda coupled: None), name="teleop")
    thread.start()
    try:
        phase(loop, Phase.RELEASED)
        yield loop
    finally:
        stop.set()
        thread.join()
        problem = loop.end()
        table.device(FOLLOWER).reported = Condition()
        loop.close()
    assert problem == ""


def phase(loop: Teleoperation, wanted: Phase) -> None:
    eventually(lambda: loop.coupled.phase is wanted, f"{wanted}; it is {loop.coupled}")


def couple(table: Table, loop: Teleoperation) -> None:
    table.foot.pressed = False
    phase(loop, Phase.RELEASED)
    table.foot.pressed = True
    phase(loop, Phase.FOLLOWING)


def position(device: RemoteDevice) -> Any:
    return device.measured_cp(age=0, wait=LONG).position


def at(device: RemoteDevice, wanted: Any) -> bool:
    return bool(np.allclose(position(device), wanted, atol=1e-3))


def stands(device: RemoteDevice) -> bool:
    return float(np.linalg.norm(device.measured_cv(age=0, wait=LONG).linear)) < 1e-3


def test_the_follower_goes_the_way_of_the_leader_and_the_clutch_lets_it_stand(table: Table) -> None:
    with running(table, scale=0.5) as loop:
        couple(table, loop)
        start, here = position(table.follower), position(table.leader)
        table.leader.move_jp([*(here + vector((0.04, 0.0, -0.02))), 0.0]).wait(LONG)
        goal = start + vector((0.02, 0.0, -0.01))
        eventually(lambda: at(table.follower, goal), "half of the way")

        table.foot.pressed = False
        phase(loop, Phase.RELEASED)
        table.leader.move_jp([*(here - 0.2), 0.5]).wait(LONG)
        couple(table, loop)
        assert at(table.follower, goal), "where the hand was put meanwhile moves nothing"


def test_a_fault_of_the_follower_holds_both_and_they_begin_again_without_a_jump(
    table: Table,
) -> None:
    with running(table) as loop:
        couple(table, loop)
        table.leader.interpolate_jv([0.05, 0.0, 0.0, 0.0])
        table.device(FOLLOWER).reported = Condition(OperatingState.FAULT, "too hot")
        phase(loop, Phase.HELD)
        # A command that it refused in FAULT may be heard of before that.
        eventually(
            lambda: loop.coupled.trouble == f"{FOLLOWER} is FAULT", "the fault is what is told"
        )
        eventually(lambda: stands(table.leader), "the leader is held")
        eventually(lambda: stands(table.follower), "so is the follower")
        there = position(table.follower)

        table.device(FOLLOWER).reported = Condition()
        table.follower.enable()
        eventually(lambda: "let the pedal go first" in loop.coupled.reason, "it must be let go")
        table.leader.move_jp([0.3, 0.3, 0.3, 1.0]).wait(LONG)
        assert loop.coupled.phase is Phase.HELD
        couple(table, loop)
        assert at(table.follower, there)


def test_a_pedal_that_was_unplugged_must_be_pressed_anew(table: Table) -> None:
    with running(table, timeout=2.0) as loop:
        couple(table, loop)
        table.foot.plugged = False
        phase(loop, Phase.HELD)
        assert f"{PEDAL} is not heard" in loop.coupled.reason
        table.foot.plugged = True
        eventually(lambda: "let the pedal go first" in loop.coupled.reason, "it is heard again")
        couple(table, loop)


def test_what_the_follower_refuses_ends_it(table: Table) -> None:
    with running(table) as loop:
        couple(table, loop)
        tilted = Pose(vector((0.0, 0.0, 0.0)), quaternion_from_rotvec(vector((0.1, 0.0, 0.0))))
        send = table.follower.sender("servo_cp")

        def refused() -> (
            bool
        ):  # of another program, as it would be of ours; now and then one is told
            send(tilted)
            return loop.coupled.phase is Phase.HELD

        eventually(refused, "they are held")
        assert "refused: " in loop.coupled.trouble


def test_a_refusal_of_what_was_sent_before_a_hold_comes_too_late_to_count(table: Table) -> None:
    """A driver tells the last of many when two seconds are over: they may be coupled anew by then."""
    side = Listened(table.follower, ("measured_cp",), (), ("servo_cp",), ("hold",), nothing)
    refusal = CommandRefused("servo_cp", Reason.NOT_ENABLED, "the device is FAULT (too hot)")
    sent = time.time_ns()
    side.send("hold")
    for stamp, told in (
        (sent, ""),
        (time.time_ns(), refusal.detail),
        (sent - 3_600_000_000_000, refusal.detail),  # of a clock that was set back
        (0, refusal.detail),
    ):
        side._refused(refusal.of(stamp))
        assert side.read().refusal == told
    side.close()


def test_a_leader_that_feels_is_free_while_nothing_is_coupled(table: Table) -> None:
    with running(table, force={"gain": 0.01}) as loop:
        hand = table.device(LEADER)
        eventually(lambda: hand.last_setpoint is not None, "it is sent something")
        eventually(lambda: hand.last_setpoint.mode is Mode.JOINT_EFFORT, "no force")
        assert not hand.last_setpoint.values.any()
        assert loop.coupled.phase is Phase.RELEASED


@pytest.mark.parametrize("mode", ["rate", "velocity"])
def test_velocities(table: Table, mode: str) -> None:
    with running(table, mode=mode, scale=0.5, limits={"jump": 0.5}) as loop:
        couple(table, loop)
        start = position(table.follower)
        if mode == "rate":
            table.leader.move_jp([*(position(table.leader) + vector((0.0, 0.1, 0.0))), 0.0])

        def moves() -> bool:
            if mode == "velocity":  # which ends when it is not asked for again
                table.leader.interpolate_jv([0.0, 0.1, 0.0, 0.0])
            return bool(position(table.follower)[1] > start[1] + 0.005)

        eventually(moves, "it moves")
        table.foot.pressed = False
        phase(loop, Phase.RELEASED)
        table.leader.hold()
        eventually(lambda: stands(table.follower), "it stands")


def test_a_device_that_lacks_what_it_takes_is_refused(table: Table) -> None:
    pedal = {"engage": {"topic": PEDAL}}
    settings = TeleopSettings(leader=LEADER, follower=FOLLOWER, **pedal)
    with pytest.raises(ConfigError, match="does not offer servo_cp"):
        Teleoperation(settings, table.leader, table.follower.child("local"), {})


# -------------------------------------------------------------------------------- the command


def lab_file(folder: Path, pedal: str = f'topic = "{PEDAL}"') -> Path:
    path = folder / "lab.toml"
    path.write_text(
        f'[teleop]\nleader = "{LEADER}"\nfollower = "{FOLLOWER}"\ntimeout = 2.0\n'
        f"[teleop.engage]\n{pedal}\n"
    )
    return path


def test_the_command_runs_until_it_is_interrupted_and_says_that_both_are_held(
    table: Table, tmp_path: Path, start: Start
) -> None:
    table.foot.pressed, table.foot.plugged = False, True
    log = tmp_path / "log"
    with (
        log.open("w") as told,
        start(
            *(COMMAND, "teleop", str(lab_file(tmp_path)), "--enable", "--timeout", str(LONG)),
            stderr=told.fileno(),
        ) as process,
    ):
        try:
            eventually(lambda: process.poll() or "RELEASED" in log.read_text(), "both are ready")
            assert process.poll() is None, log.read_text()
            table.foot.pressed = True
            eventually(lambda: "FOLLOWING" in log.read_text(), "they are coupled")
            process.send_signal(signal.SIGINT)
            assert process.wait(LONG) == 0, log.read_text()
        finally:
            process.kill()
    assert "both are held" in log.read_text()


def test_an_interrupt_that_is_lost_on_its_way_ends_it_all_the_same(
    table: Table, tmp_path: Path, run_far: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in a message that rclpy makes in C++: it tells that it could not, and of no interrupt."""
    table.foot.pressed, table.foot.plugged = False, True
    read, lost = TopicPedal.read, []

    def losing(pedal: TopicPedal) -> Any:
        if not lost:
            with suppress(Interrupted):
                signal.raise_signal(signal.SIGINT)
            lost.append(True)
        return read(pedal)

    monkeypatch.setattr(TopicPedal, "read", losing)
    code, _, told = run_far("teleop", str(lab_file(tmp_path)), "--timeout", str(LONG))
    assert lost
    assert code == 0, told
    assert "both are held" in told


def test_a_key_needs_a_terminal(table: Table, tmp_path: Path, run_far: Any) -> None:
    code, _, told = run_far("teleop", str(lab_file(tmp_path, 'key = "space"')))
    assert code == 2
    assert "no terminal" in told

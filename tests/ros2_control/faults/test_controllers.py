"""Controllers and hardware of a robot: switches, refusals, what somebody else does to them."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import numpy as np
import pytest

from crtk_drivers.errors import CommandRefused, CrtkError, MotionAborted
from crtk_drivers.ros.senders import Sender
from crtk_drivers.state import OperatingState
from crtk_sim_backends.process import RunningSim
from crtk_sim_backends.ros2_control import SIM
from rigs.ros2_control_bench import (
    EFFORT,
    POSITION,
    TRAJECTORY,
    VELOCITY,
    Ros2ControlBench,
    driver_of,
)
from rigs.waiting import eventually

pytestmark = pytest.mark.ros

START = (0.0, 0.4, 0.8, 0.2, 0.6, 0.0)
HARDWARE = ["sim_system"]


@pytest.fixture(scope="module")
def robot() -> Iterator[RunningSim]:
    """A robot of old releases, whose forward controllers keep a command while they are inactive."""
    with SIM.spawn(keeps_commands=True) as sim:
        yield sim


@pytest.fixture
def sim(robot: RunningSim) -> Iterator[RunningSim]:
    yield robot
    robot.control.clear()
    for kind in ("load", "give_joints", "hardware_mended", "all_inactive"):
        robot.control.inject(kind)
    robot.control.call("place", positions=START)


@pytest.fixture
def bench(sim: RunningSim) -> Iterator[Ros2ControlBench]:
    with driver_of(sim, hardware=HARDWARE) as bench:
        yield bench


def commanding(bench: Ros2ControlBench) -> list[str]:
    """Return the active controllers that command joints."""
    return [name for name in bench.told("active") if name != "joint_state_broadcaster"]


def stream(bench: Ros2ControlBench, name: str, value: float, until: str) -> None:
    """Send a stream for all joints until one controller is active, and a little longer."""
    values = [value] * 6

    def sent() -> bool:
        getattr(bench.arm, name)(values)
        return commanding(bench) == [until]

    eventually(sent, f"{until} is active")


def test_nothing_is_activated_by_a_connection(bench: Ros2ControlBench) -> None:
    assert commanding(bench) == []
    assert bench.arm.operating_state().detail == ""
    bench.arm.enable()
    assert commanding(bench) == [POSITION]
    bench.arm.disable()
    assert commanding(bench) == []


def test_each_mode_has_its_controller_and_a_switch_is_one_call(sim: RunningSim) -> None:
    # No stream ends, which is another switch, because this test is held up.
    with driver_of(sim, hardware=HARDWARE, stream_timeout=2.0) as bench:
        bench.arm.enable()
        before = bench.arm.health().device["switches"]
        stream(bench, "servo_jv", 0.1, VELOCITY)
        bench.arm.hold()
        stream(bench, "servo_jf", 0.0, EFFORT)
        eventually(lambda: commanding(bench) == [POSITION], "efforts end in a position, held")
        eventually(lambda: bench.arm.health().device["switches"] == before + 3, "three switches")
        assert bench.arm.is_enabled()


def test_an_old_command_of_a_controller_moves_nothing_when_it_is_activated(
    bench: Ros2ControlBench,
) -> None:
    bench.arm.enable()
    bench.arm.move_jp(np.array(START) + 0.2).wait()
    bench.arm.disable()
    bench.sim.control.call("place", positions=START)
    eventually(
        lambda: np.allclose(bench.arm.measured_jp(), START, atol=1e-3), "it was moved by hand"
    )
    bench.arm.enable()
    samples = bench.arm.health().samples
    eventually(lambda: bench.arm.health().samples > samples + 30, "time passes")
    assert bench.positions == pytest.approx(START, abs=5e-3)


def test_commands_are_in_the_order_of_the_controller(bench: Ros2ControlBench) -> None:
    bench.inject("other_order")
    bench.state(OperatingState.DISABLED)
    bench.arm.enable()
    goal = np.array(START) + np.array((0.1, 0.0, 0.0, 0.0, 0.0, -0.1))
    bench.arm.move_jp(goal).wait()
    assert bench.positions == pytest.approx(goal, abs=0.02)


def test_a_controller_that_refuses_is_a_fault_with_its_reason(bench: Ros2ControlBench) -> None:
    bench.inject("refuse_activation", controller=POSITION)
    with pytest.raises(CrtkError, match=f"{POSITION} failed to activate"):
        bench.arm.enable()
    bench.state(OperatingState.FAULT, "failed to activate")
    bench.sim.control.clear()
    bench.arm.enable()


def test_a_switch_is_believed_when_the_list_shows_it(sim: RunningSim) -> None:
    with driver_of(sim, service_timeout=1.0) as bench:
        bench.inject("feign_activation", controller=POSITION)
        with pytest.raises(CrtkError, match="was to become active, and is inactive"):
            bench.arm.enable()


def test_a_switch_that_fails_in_a_stream_is_a_fault(bench: Ros2ControlBench) -> None:
    bench.arm.enable()
    bench.inject("refuse_activation", controller=VELOCITY)

    def refused() -> bool:
        try:
            bench.arm.servo_jv([0.1] * 6)
        except CommandRefused:
            return True
        return False

    eventually(refused, "the stream ends")
    bench.state(OperatingState.FAULT, VELOCITY)
    bench.sim.control.clear()
    bench.arm.enable()
    assert commanding(bench) == [POSITION]


@pytest.mark.parametrize("takes_over", [False, True])
def test_the_joints_of_somebody_elses_controller_are_taken_only_if_that_is_configured(
    sim: RunningSim, takes_over: bool
) -> None:
    with driver_of(sim, take_over=takes_over) as bench:
        bench.inject("take_joints")
        if takes_over:
            bench.arm.enable()
            assert commanding(bench) == [POSITION]
        else:
            with pytest.raises(CrtkError, match="admittance_controller has the joints"):
                bench.arm.enable()
            assert commanding(bench) == ["admittance_controller"]


def test_a_controller_that_is_unloaded_is_a_fault_and_may_come_back(
    bench: Ros2ControlBench,
) -> None:
    bench.arm.enable()
    bench.inject("unload", controller=POSITION)
    bench.state(OperatingState.FAULT, f"controller {POSITION} is gone")
    with pytest.raises(CrtkError, match="there is no controller"):
        bench.arm.enable()
    bench.inject("load", controller=POSITION)
    bench.arm.enable()


def test_hardware_is_brought_to_active_by_enable_and_away_by_disable(sim: RunningSim) -> None:
    with driver_of(sim, hardware=HARDWARE, on_disable="hardware") as bench:
        bench.inject("hardware_error", to="inactive")
        bench.arm.enable()
        assert bench.told("hardware") == "active"
        bench.arm.disable()
        assert bench.told("hardware") == "inactive"
        bench.arm.enable()
        assert commanding(bench) == [POSITION]


def test_hardware_that_is_not_there_is_named(sim: RunningSim) -> None:
    with driver_of(sim, hardware=["another"]) as bench:
        with pytest.raises(CrtkError, match="no hardware component another") as caught:
            bench.arm.enable()
        assert "sim_system" in str(caught.value)


def test_services_that_answer_late_are_waited_for_and_silent_ones_are_told(sim: RunningSim) -> None:
    with driver_of(sim, service_timeout=1.5) as bench:
        bench.inject("late_services", seconds=0.1)  # of which enable asks eight
        bench.arm.enable()
        bench.arm.disable()
        bench.sim.control.clear()
        bench.inject("silent_services", service="switch_controller")
        with pytest.raises(CrtkError, match="switch_controller did not answer in"):
            bench.arm.enable()
        bench.sim.control.clear()
        bench.arm.enable()


def test_with_two_nodes_that_tell_of_our_joints_nothing_is_enabled(bench: Ros2ControlBench) -> None:
    bench.inject("rival")
    eventually(
        lambda: any("joint_state_publisher" in note.text for note in bench.arm.health().notes),
        "the other node is named",
    )
    with pytest.raises(CrtkError, match="joint_state_publisher tells of our joints too"):
        bench.arm.enable()
    assert commanding(bench) == []


def test_another_node_is_named_though_the_graph_knows_it_later(
    bench: Ros2ControlBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = Sender.node_name.fget
    assert name is not None
    is_known = threading.Event()
    monkeypatch.setattr(
        Sender, "node_name", property(lambda self: name(self) if is_known.is_set() else "")
    )
    bench.inject("rival")

    def told(words: str) -> bool:
        return any(words in note.text for note in bench.arm.health().notes)

    eventually(lambda: told("tells of our joints too"), "there is another node")
    assert not told("joint_state_publisher")
    is_known.set()
    eventually(lambda: told("joint_state_publisher"), "the other node is named")


def test_who_else_commands_our_controllers_is_told(sim: RunningSim) -> None:
    with driver_of(sim) as first, driver_of(sim):
        told = "/crtk_ros2_control can command our controllers, too"  # once its name is discovered, too
        eventually(
            lambda: (
                told in [note.text for note in first.arm.health().notes if note.key == "commands"]
            ),
            "another driver is told of",
        )


def test_what_is_in_the_way_of_joints_is_not_pushed_for_ever(bench: Ros2ControlBench) -> None:
    bench.arm.enable()
    bench.inject("block", joint=0)
    with pytest.raises(CrtkError):
        bench.arm.move_jp(np.array(START) + np.array((1.0, 0.0, 0.0, 0.0, 0.0, 0.0))).wait()
    bench.state(OperatingState.FAULT, "joint_1")
    eventually(
        lambda: np.allclose(bench.told("command"), bench.positions, atol=0.021),
        "it holds where it is",
    )


class TestMovesAsGoals:
    """move_jp as a goal of the trajectory controller."""

    @pytest.fixture
    def bench(self, sim: RunningSim) -> Iterator[Ros2ControlBench]:
        with driver_of(sim, moves="trajectory", **CONTROLLERS) as bench:
            bench.arm.enable()
            yield bench

    def test_a_move_is_a_goal_and_a_stream_after_it_is_forwarded(
        self, bench: Ros2ControlBench
    ) -> None:
        goal = np.array(START) + 0.2
        bench.arm.move_jp(goal).wait()
        assert commanding(bench) == [TRAJECTORY]
        assert bench.positions == pytest.approx(goal, abs=0.02)
        stream(bench, "servo_jv", 0.1, VELOCITY)
        bench.arm.hold()

    def test_hold_cancels_it(self, bench: Ros2ControlBench) -> None:
        move = bench.arm.move_jp(np.array(START) + 2.0)
        eventually(lambda: bench.positions[0] > 0.1, "it moves")
        bench.arm.hold()
        with pytest.raises(MotionAborted):
            move.wait()
        eventually(lambda: not np.any(np.abs(bench.told("velocities")) > 1e-3), "it stands")
        assert bench.positions[0] < 1.9
        assert bench.arm.is_enabled()

    def test_another_one_replaces_it(self, bench: Ros2ControlBench) -> None:
        first = bench.arm.move_jp(np.array(START) + 2.0)
        eventually(lambda: bench.positions[0] > 0.1, "it moves")
        bench.arm.move_jp(START).wait()
        assert bench.positions == pytest.approx(START, abs=0.02)
        with pytest.raises(MotionAborted):
            first.wait()

    def test_one_that_the_controller_ends_is_told(self, bench: Ros2ControlBench) -> None:
        move = bench.arm.move_jp(np.array(START) + 2.0)
        eventually(lambda: bench.positions[0] > 0.1, "it moves")
        bench.inject("deactivate", controller=TRAJECTORY)
        with pytest.raises(MotionAborted):
            move.wait()
        bench.state(OperatingState.FAULT, TRAJECTORY)

    def test_one_that_no_stop_could_reach_ends_with_the_next_connection(
        self, sim: RunningSim
    ) -> None:
        # It takes half a minute for a radian.
        joints = [{**joint, "velocity": 0.05} for joint in SLOW]
        with driver_of(sim, moves="trajectory", joints=joints, **IMPATIENT, **CONTROLLERS) as bench:
            bench.arm.enable()
            bench.arm.move_jp(np.array(START) + 1.0)
            eventually(lambda: bench.positions[0] > 0.005, "it moves")
            cut_off(bench)
            bench.sim.control.clear()
            bench.connected()
            eventually(lambda: not np.any(np.abs(bench.told("velocities")) > 1e-3), "it stands")
            assert bench.positions[0] < 0.9


CONTROLLERS = {
    "position_controller": POSITION,
    "velocity_controller": VELOCITY,
    "trajectory_controller": TRAJECTORY,
    "allow_untimed": True,
}


SLOW = [
    {"name": f"joint_{number}", "lower": -3.0, "upper": 3.0, "velocity": 1.5, "acceleration": 1.0}
    for number in range(1, 7)
]
"""Joints that take long to slow down."""


IMPATIENT = {
    "sample_timeout": 1.5,
    "stop_time": 1.0,
    "open_timeout": 2.0,
    "service_timeout": 1.0,
}


def cut_off(bench: Ros2ControlBench) -> None:
    """Have the network cut for so long that the driver gives up and cannot come back."""
    bench.inject("disconnect")
    bench.state(OperatingState.FAULT)
    eventually(
        lambda: "newest sample" not in bench.session.engine.status.detail, "no stop is sent now"
    )


def stream_until_lost(bench: Ros2ControlBench, fault: str) -> None:
    """Stream velocities, and go on while a fault makes the driver lose the link."""
    stream(bench, "servo_jv", 0.0, VELOCITY)

    def sent(value: float) -> bool:
        try:
            bench.arm.servo_jv([value] * 6)
        except CrtkError:
            return True
        return False

    eventually(lambda: sent(0.7) or bench.told("command")[0] > 0.69, "it is fast")
    bench.inject(fault)
    eventually(lambda: sent(0.7), "the link is lost")
    bench.state(OperatingState.FAULT)


def test_velocities_come_to_zero_though_the_link_is_lost_meanwhile(sim: RunningSim) -> None:
    with driver_of(sim, joints=SLOW, sample_timeout=1.5) as bench:
        bench.arm.enable()
        stream_until_lost(bench, "broadcaster_stops")
        eventually(lambda: not np.any(bench.told("command")), "zeros were sent")
        assert bench.told("follows") == "velocity"
        bench.sim.control.clear()
        bench.connected()


def test_velocities_that_no_stop_could_reach_end_with_the_next_connection(sim: RunningSim) -> None:
    with driver_of(sim, joints=SLOW, **IMPATIENT) as bench:
        bench.arm.enable()
        stream_until_lost(bench, "disconnect")
        cut_off(bench)
        assert bench.told("command")[0] > 0.1
        bench.sim.control.clear()
        eventually(lambda: not np.any(bench.told("command")), "zeros were sent")
        bench.connected()

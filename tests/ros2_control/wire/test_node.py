"""The node on the robot's side, without a robot."""

import time
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from crtk_driver_ros2_control.foreign.node import ForeignNode
from crtk_driver_ros2_control.outgoing import IDLE
from rigs.waiting import eventually

pytestmark = pytest.mark.ros


def resident() -> float:
    """Return how much memory this process has, in MB."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6


def test_a_node_that_ends_gives_its_memory_back() -> None:
    def once() -> None:
        pumped: list[float] = []

        def pump() -> float:
            pumped.append(time.monotonic())
            return IDLE

        node = ForeignNode(
            namespace="/nobody/",
            joint_states="/nobody/joint_states",
            forward=("p", "v", "e"),
            trajectory="t",
            domain=None,
            heard=lambda data, sender: None,
            pump=pump,
            ending=1.0,
        )
        node.start()
        eventually(lambda: pumped, "it runs")
        assert node.stop(10.0)

    for _ in range(3):
        once()
    before = resident()
    for _ in range(15):
        once()
    assert resident() - before < 8.0, "MB, of 15 nodes"

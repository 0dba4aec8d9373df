"""What the tests of a UR arm's faults have in common."""

from __future__ import annotations

import socket
from collections.abc import Sequence
from typing import Any

import numpy as np

from rigs.ur_bench import FAR, LONG, PROTECTIVE_STOP, QUICK_WATCHDOG, UrBench

POWER_OFF, POWER_ON, IDLE, RUNNING = 3, 4, 5, 7
STOPPED, PLAYING = 1, 2
SAMPLE_TIMEOUT = 1.5
CONFIG = {
    "sample_timeout": SAMPLE_TIMEOUT,
    "open_timeout": 2.0,
    "watchdog_frequency": QUICK_WATCHDOG,
}


def dashboard(bench: UrBench, command: str) -> str:
    with socket.create_connection((bench.sim.host, 29999), LONG) as peer:
        lines = peer.makefile("rw", newline="\n")
        lines.readline()
        lines.write(f"{command}\n")
        lines.flush()
        return lines.readline().strip()


def restart_safety(bench: UrBench) -> None:
    assert dashboard(bench, "restart safety") == "Restarting safety"


def unlock(bench: UrBench) -> None:
    bench.arm.unlock_protective_stop(timeout=LONG)


def start_moving(bench: UrBench, goal: Sequence[float] = FAR) -> Any:
    move = bench.arm.move_jp(goal)
    bench.until_moving()
    return move


def assert_enables_at_rest(bench: UrBench) -> None:
    """Enable (or resume) must work, move nothing, and start from where the arm is."""
    if bench.control == "ur_rtde" and bench.outputs("safety_mode") == PROTECTIVE_STOP:
        unlock(bench)  # what a network held up may end so
    with bench.nothing_moves():
        bench.enable()
        np.testing.assert_allclose(bench.arm.setpoint_jp(), bench.q(), atol=1e-3)
    assert bench.outputs("runtime_state") == PLAYING
    assert bench.arm.move_jr([-0.1, 0.0, 0.0, 0.0, 0.0, 0.0]).wait(LONG)


def travel_after_death(bench: UrBench, speed: float) -> float:
    """The farthest that the arm may go after the driver died, rad.

    It goes on for the declared time, then it stops as the controller does.
    """
    link_timeout = bench.engine.capabilities.stop.link_timeout
    return speed * link_timeout + speed * speed / (2.0 * 2.0)

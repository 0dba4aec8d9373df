"""The driver while the speed slider is down: what it is told is carried out more slowly, and ends in time."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
import pytest

from rigs.ur_bench import LONG, UrBench, eventually, ur_bench

SLIDERS = [1.0, 0.5, 0.1, 0.01, 0.0]


@pytest.fixture(scope="module")
def shared() -> Iterator[UrBench]:
    with ur_bench({"control": "native"}) as bench:
        yield bench


@pytest.fixture(params=SLIDERS, ids=lambda slider: f"{100 * slider:g} %")
def slider(request) -> float:
    return float(request.param)


@pytest.fixture
def bench(shared: UrBench, slider: float) -> Iterator[UrBench]:
    shared.reset()
    shared.sim.control.inject("speed_slider", fraction=slider)
    eventually(lambda: shared.device.pace == pytest.approx(slider), "the slider is seen")
    ramped = shared.outputs("timestamp") + 0.25
    eventually(lambda: shared.outputs("timestamp") > ramped, "the controller is as slow")
    yield shared
    shared.sim.control.clear("speed_slider")


def stream(bench: UrBench, send, seconds: float, *, moves: bool = False) -> float:
    """Send for some seconds of the controller; the largest joint speed that it aimed at, rad/s.

    Where the arm `moves`, until that has been seen: who is held up looks when the stream has ended.
    """
    fastest, end = 0.0, bench.outputs("timestamp") + seconds
    deadline = time.monotonic() + LONG
    while bench.outputs("timestamp") < end or (moves and not fastest):
        assert time.monotonic() < deadline, "never: its time goes on, and it moves"
        send()
        fastest = max(fastest, *map(abs, bench.outputs("target_qd")))
        time.sleep(0.01)
    return fastest


@pytest.mark.sweep(4)
@pytest.mark.parametrize("command", ["servo_jv", "servo_cv", "servo_jp"])
def test_a_stream_is_slowed_down_and_ends(bench, slider, command):
    twist = [0.0, 0.0, 0.0, 0.0, 0.0, 0.3]
    send = {
        "servo_jv": lambda: bench.arm.servo_jv([0.0] * 5 + [0.3]),
        "servo_cv": lambda: bench.arm.servo_cv(twist),
        "servo_jp": lambda: bench.arm.servo_jp(bench.q() + 0.004 * np.eye(6)[5]),
    }[command]
    fastest = stream(bench, send, 0.6, moves=slider > 0.0)
    assert fastest <= 0.3 * slider * 1.1 + 1e-3
    assert (fastest > 0.0) == (slider > 0.0)
    bench.arm.hold()
    eventually(lambda: bench.engine._stopping.confirmed, "the stop is read back")
    assert bench.status.state == "ENABLED", bench.status
    assert bench.device._link.program_runs
    assert bench.log.states in ([], ["ENABLED"])
    assert not bench.device._link.replaced


@pytest.mark.sweep(2)
def test_a_stream_of_velocities_that_ends_is_no_motion_that_goes_on(bench, slider):
    before = bench.arm.health().stream_timeouts
    stream(bench, lambda: bench.arm.servo_jv([0.0] * 5 + [0.3]), 0.3)
    # Not by its time-outs alone: a test that is held up lets it end, and begins it anew.
    eventually(lambda: not bench.arm.health().stream, "it has ended")
    assert bench.arm.health().stream_timeouts > before
    eventually(lambda: bench.engine._stopping.confirmed, "the stop is read back")
    with bench.nothing_moves():
        bench.cycles(50)
    bench.sim.control.clear("speed_slider")
    with bench.nothing_moves():
        bench.cycles(150)
    assert bench.status.state == "ENABLED"


@pytest.mark.sweep(2)
def test_a_move_arrives_once_the_slider_is_up_again(bench, slider):
    goal = list(bench.q())
    goal[0] += 0.2  # with the slider at 10 %, on its way for longer than a test is held up
    move = bench.arm.move_jp(goal)
    if slider <= 0.1:
        assert not move.wait(0.3)
    bench.sim.control.clear("speed_slider")
    assert move.wait(LONG)
    assert bench.q()[0] == pytest.approx(goal[0], abs=1e-3)

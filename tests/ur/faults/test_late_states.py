"""A network that delivers everything, but late: what is measured is stamped as old as it may be.

Answers to requests, and the control program, tell what a state was made after: `crtk_driver_ur.rtde.echoes`.
"""

import statistics
import threading
from collections.abc import Iterator

import pytest

from crtk_drivers.errors import Reason, TransitionFailed
from rigs.ur_bench import LENIENT, LONG, UrBench, eventually
from rigs.ur_proxy import Proxy, bench_at_proxy

LATE = 0.3
"""Seconds."""

SHORT = 0.08
"""Seconds."""

TICK = 0.12
"""Seconds: the controller does not tell when within 0.01 it made a state, and the time of a simulated one may
be late by 0.1."""

PUSH = [0.0, 0.0, -1.0, 0.0, 0.0, 0.0]
"""N and N m."""


@pytest.fixture(scope="module")
def world() -> Iterator[tuple[UrBench, Proxy]]:
    with bench_at_proxy({"control": "native"}) as world:
        yield world


@pytest.fixture
def late(world) -> Iterator[tuple[UrBench, Proxy]]:
    bench, proxy = world
    proxy.clear()
    bench.reset()
    yield bench, proxy
    proxy.clear()


def younger(bench: UrBench, proxy: Proxy) -> float:
    """Return by how much the newest sample is stamped as younger than it is, s.

    By when it came to the proxy; one that is newer, of which this may hear, came later.
    """
    found = bench.engine.feedback("measured_js")
    assert found is not None
    return float(found[1].monotonic - proxy.came[bench.device.robot_state.timestamp])


def is_valid(bench: UrBench) -> bool:
    found = bench.engine.feedback("measured_js")
    return found is not None and found[1].wall_ns > 0


def is_told(bench: UrBench) -> bool:
    return any("s old when they come" in note.text for note in bench.device.notes)


def test_states_that_come_late_are_stamped_as_old_as_they_are(late):
    bench, proxy = late
    eventually(lambda: is_valid(bench), "they are valid at first")
    proxy.lag[False] = LATE
    age = lambda: bench.device.counters["state age (s)"]  # noqa: E731
    eventually(lambda: is_told(bench) and age() >= LATE - TICK, "they come again, late")
    for _ in range(10):
        assert -LENIENT < younger(bench, proxy) <= TICK
        bench.cycles(1)
    eventually(lambda: not is_valid(bench), "they do not count")
    bench.arm.servo_cf(PUSH)
    eventually(lambda: bench.log.refusals, "efforts are refused")
    assert bench.log.refusals[0].reason is Reason.NOT_MEASURED
    proxy.clear()
    eventually(lambda: is_valid(bench), "they are valid again")


def test_a_short_delay_makes_no_stamp_younger(late):
    """Also one that is short beside the time of a stream."""
    bench, proxy = late
    eventually(lambda: is_valid(bench), "they are valid at first")
    proxy.lag[False] = SHORT
    age = lambda: bench.device.counters["state age (s)"]  # noqa: E731
    eventually(lambda: age() > SHORT / 2.0, "they come late")
    found = []
    for _ in range(20):
        bench.cycles(1)
        found.append(younger(bench, proxy))
    assert statistics.median(found) < SHORT / 2.0


@pytest.mark.parametrize("begins", ["in mid-stream", "before it connects"])
def test_late_states_are_not_fresh_while_disabled(late, begins):
    """No program of ours runs on the controller, which could tell what it has seen."""
    bench, proxy = late
    bench.arm.disable(timeout=LONG)
    eventually(lambda: is_valid(bench), "they are valid at first")
    proxy.lag[False] = LATE
    if begins == "before it connects":
        before = bench.device._stream
        before.close()
        eventually(lambda: bench.device._stream not in (None, before), "connected again")
    eventually(lambda: is_told(bench) and not is_valid(bench), "they do not count")
    for _ in range(10):
        assert -LENIENT < younger(bench, proxy) <= TICK
        bench.cycles(1)
    proxy.clear()
    eventually(lambda: is_valid(bench), "they are valid again")


def test_late_commands_make_no_state_old(late):
    bench, proxy = late

    def as_before() -> bool:
        """Begin anew where the controller was held up: its clock is behind then, which late answers hide."""
        proxy.clear()
        eventually(lambda: is_valid(bench), "they are valid at first")
        proxy.lag[True] = LATE
        bench.cycles(150)
        return bench.device.counters["state age (s)"] < LATE and is_valid(bench)

    eventually(as_before, "valid states beside late commands")


def test_states_that_were_late_for_a_moment_do_not_end_enable(late, monkeypatch):
    bench, proxy = late
    bench.arm.disable(timeout=LONG)
    configure, configured = bench.device._configure, threading.Event()

    def configuring():
        yield from configure()  # first: each of its many requests would take as long as the lag
        proxy.lag[False] = LATE
        yield from bench.device._robot.until(lambda: is_told(bench))
        proxy.clear()
        configured.set()

    monkeypatch.setattr(bench.device, "_configure", configuring)
    bench.arm.state_command("enable", timeout=0)
    assert configured.wait(LONG)
    bench.until_state("ENABLED")


@pytest.mark.slow  # that they are stamped as old is its quick brother
def test_nothing_is_enabled_whose_states_come_late(late):
    bench, proxy = late
    bench.arm.disable(timeout=LONG)
    proxy.lag[False] = LATE
    with pytest.raises(TransitionFailed, match="s old when they come"), bench.nothing_moves():
        bench.arm.enable(timeout=LONG)
    assert bench.status.state != "ENABLED"
    proxy.clear()
    with bench.nothing_moves():
        bench.enable()
    assert bench.arm.move_jr([-0.05, 0.0, 0.0, 0.0, 0.0, 0.0]).wait(LONG)

"""A network that delivers everything, but late: what is measured is stamped as old as it may be.

The driver's own control program tells which packages it has seen; see `crtk_driver_ur.native.echoes`.
"""

import time
from collections.abc import Iterator

import pytest

from crtk_drivers.errors import Reason, TransitionFailed
from rigs.ur_bench import LONG, UrBench, eventually
from rigs.ur_proxy import Proxy, bench_at_proxy

LATE = 0.3
"""Seconds."""

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


def age(bench: UrBench) -> float:
    """Return how old the newest sample says that it is, s."""
    found = bench.engine.feedback("measured_js")
    assert found is not None
    return time.monotonic() - found[1].monotonic


def is_valid(bench: UrBench) -> bool:
    found = bench.engine.feedback("measured_js")
    return found is not None and found[1].wall_ns > 0


def is_told(bench: UrBench) -> bool:
    return any("s old when they come" in note.text for note in bench.device.notes)


def test_states_that_come_late_are_stamped_as_old_as_they_are(late):
    bench, proxy = late
    eventually(lambda: is_valid(bench), "they are valid at first")
    proxy.lag[False] = LATE
    eventually(lambda: is_told(bench), "they come again, late")  # at first none comes
    assert LATE <= age(bench) < LATE + 0.5
    assert not is_valid(bench)
    bench.arm.servo_cf(PUSH)
    eventually(lambda: bench.log.refusals, "efforts are refused")
    assert bench.log.refusals[0].reason is Reason.NOT_MEASURED
    proxy.clear()
    eventually(lambda: is_valid(bench), "they are valid again")


def test_late_commands_make_no_state_old(late):
    bench, proxy = late
    proxy.lag[True] = LATE
    begin = bench.device.counters["state age (s)"]
    bench.cycles(300)
    assert begin < LATE
    assert bench.device.counters["state age (s)"] < LATE
    assert is_valid(bench)


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

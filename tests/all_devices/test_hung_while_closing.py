"""An I/O thread that hangs in a motion while its driver is closed, by each driver that moves something."""

from __future__ import annotations

import threading
import time

import pytest

from bench.reliability.activities import STANDING
from bench.reliability.disturbed import STUCK
from bench.reliability.rig import PATIENCE, SLACK, Rig
from bench.reliability.rigs import RIGS
from crtk_drivers.engine.threads import WATCHDOG_PERIOD
from crtk_drivers.errors import CrtkError, StopUnconfirmed
from rigs.fault_rigs import FaultRigs

LONG_CLOSE = 120.0
"""Seconds for which `close` waits for the thread: what stops the hardware meanwhile is not its end."""

CELLS = [
    (rig.name, activity)
    for rig in RIGS.values()
    for activity in rig.activities
    if activity not in STANDING
]


def _hang(rig: Rig) -> float:
    """Let the I/O thread hang as of now, and return when (monotonic s)."""
    rig.disturbed.begin(STUCK)
    return time.monotonic()


@pytest.mark.sweep(9)
@pytest.mark.parametrize(("driver", "activity"), CELLS)
def test_a_hung_thread_is_stopped_while_closing(
    rigs: FaultRigs, driver: str, activity: str
) -> None:
    rig = rigs.of(driver)
    raised: list[CrtkError] = []

    def close() -> None:
        try:
            rig.driver._runtime.close(LONG_CLOSE)
        except CrtkError as error:
            raised.append(error)

    closing = threading.Thread(target=close)
    try:
        rig.ready()
        stopped = threading.Event()
        stop = rig.disturbed.inner.stop

        def heard() -> None:
            if threading.current_thread().name == "watchdog":
                stopped.set()
            stop()

        rig.disturbed.inner.stop = heard  # type: ignore[method-assign]
        rig.begin_activity(activity)
        began = _hang(rig)
        rig.stop_activity()
        closing.start()
        within = rig.stall_limit + WATCHDOG_PERIOD + SLACK
        rig.until(stopped.is_set, within, "the watchdog has stopped it")
        told = time.monotonic() - began
        rig.until_still(rig.engine.time_to_stop + PATIENCE)
        assert closing.is_alive(), "it was closed before"
        assert told < within
        rest = rig.look().joints
        rig.disturbed.end()
        rig.until(lambda: not closing.is_alive(), PATIENCE, "it is closed")
        # What lost its link as it hung has moved when it was last seen.
        assert all(isinstance(error, StopUnconfirmed) for error in raised), raised
        rig.run(0.3)
        assert abs(rig.look().joints - rest).max() <= 4.0 * rig.tolerance
    finally:
        rig.disturbed.end()
        if closing.ident is not None:
            closing.join(PATIENCE)
        rigs.drop()


@pytest.mark.sweep(9)
@pytest.mark.parametrize("driver", sorted({driver for driver, _ in CELLS}))
def test_a_thread_that_hangs_for_good_is_unconfirmed(rigs: FaultRigs, driver: str) -> None:
    rig = rigs.of(driver)
    activity = next(name for name in rig.activities if name not in STANDING)
    try:
        rig.ready()
        rig.begin_activity(activity)
        _hang(rig)
        rig.stop_activity()
        with pytest.raises(StopUnconfirmed, match="did not end"):
            rig.driver._runtime.close(rig.stall_limit + SLACK)
        rig.until_still()
    finally:
        rig.disturbed.end()
        rigs.drop()

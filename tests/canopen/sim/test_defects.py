"""Defects of a simulated drive, without a wire."""

import pytest

from crtk_sim_backends.canopen.defects import AxisDefects
from rigs.canopen_drive import COUNTS, PV, Bench

QUICK_STOP = 0x02


@pytest.mark.parametrize(("factor", "lasts"), [(1.0, 0.05), (4.0, 0.2)])
def test_a_quick_stop_takes_longer(factor: float, lasts: float) -> None:
    """From 20 revolutions/s: 0.05 s with 6085 (400 1/s²)."""
    bench = Bench(defects=AxisDefects(slow_stop=factor))
    bench.write(0x60FF, 0, 20 * COUNTS, "i")
    bench.enable(PV)
    bench.until(lambda: bench.velocity() > 19.8 * COUNTS)
    bench.control(QUICK_STOP)
    start = bench.now
    bench.until(lambda: bench.velocity() < 0.1 * COUNTS)
    assert bench.now - start == pytest.approx(lasts, rel=0.3)


@pytest.mark.parametrize(("ignores", "status"), [(0, 0x08), (1, 0x27)])
def test_a_heartbeat_that_stays_away_may_be_ignored(ignores: int, status: int) -> None:
    bench = Bench(defects=AxisDefects(ignores_watchdog=ignores))
    bench.write(0x1016, 1, 127 << 16 | 100)
    bench.write(0x6007, 0, 1, "h")
    bench.write(0x1029, 1, 1, "B")
    bench.start()
    bench.enable()
    bench.frame(0x77F, b"\x05")
    bench.run(0.5)
    assert bench.statusword & status == status


def test_what_is_told_changes_at_rest_and_the_motor_does_not() -> None:
    bench = Bench(defects=AxisDefects(position_noise=0.01))
    bench.start()
    found = set()
    for _ in range(20):
        bench.run(0.01)
        found.add(bench.read(0x6064, 0, "i"))
    assert len(found) > 10
    assert bench.axis.motor.position == 0.0

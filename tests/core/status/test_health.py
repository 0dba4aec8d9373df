"""Counters, and the picture of them."""

import threading

import pytest

from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.status.health import HealthRecorder


def test_rate_and_late_cycles_come_from_the_times_of_the_cycles() -> None:
    recorder = HealthRecorder(rate_expected=100.0, late_after=0.02)
    now = 0.0
    for _ in range(150):
        now += 0.01
        recorder.cycle(now)
    health = recorder.snapshot(0.001, {})
    assert health.rate == pytest.approx(100.0)
    assert (health.cycles, health.late_cycles) == (150, 0)
    recorder.cycle(now + 0.05)
    health = recorder.snapshot(0.001, {})
    assert (health.late_cycles, health.worst_cycle) == (1, pytest.approx(0.05))


def test_the_time_without_a_connection_is_no_late_cycle() -> None:
    recorder = HealthRecorder(100.0, 0.02)
    recorder.cycle(1.0)
    recorder.pause()
    recorder.cycle(100.0)
    assert recorder.snapshot(0.0, {}).late_cycles == 0


def test_a_snapshot_does_not_change_afterwards() -> None:
    recorder = HealthRecorder(100.0, 0.02)
    device = {"lost": 1.0}
    before = recorder.snapshot(0.0, device)
    recorder.refused(CommandRefused("hold", Reason.NOT_CONNECTED, "no"))
    device["lost"] = 2.0
    assert before.refusals == {}
    assert before.device == {"lost": 1.0}
    assert before.rate == 0.0
    after = recorder.snapshot(0.0, device)
    assert after.refusals == {"hold: not_connected": 1}
    assert "hold refused" in after.last_refusal


def test_refusals_from_many_threads_are_all_counted() -> None:
    recorder = HealthRecorder(100.0, 0.02)
    refusal = CommandRefused("servo_jp", Reason.EMPTY, "no")

    def refuse() -> None:
        for _ in range(500):
            recorder.refused(refusal)

    threads = [threading.Thread(target=refuse) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert recorder.snapshot(0.0, {}).refusals == {"servo_jp: empty": 2000}

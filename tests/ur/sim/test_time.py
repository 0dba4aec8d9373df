"""The controller's time: faster or slower than real time, and honest when the machine is too slow."""

import logging
import os
import signal
import time
from contextlib import closing

import pytest

from crtk_sim_backends.ur import SIM, ConfigError, SimConfig
from crtk_sim_backends.ur.motion.arm import SUDDEN_CHANGE
from crtk_sim_backends.ur.pace import Pace, Statistics
from rigs.ur_clients import DashboardClient, RtdeClient, own_address
from rigs.waiting import LONG, eventually


@pytest.mark.parametrize("speed", [0.5, 1.0, 10.0])
def test_periods_are_planned_at_the_pace_and_small_delays_made_up_for(speed):
    statistics = Statistics()
    pace = Pace(0.002, speed, statistics)
    wall = 0.002 / speed
    pace.begin(100.0)
    assert pace.wake == pytest.approx(100.0 + wall)
    pace.started(pace.wake)
    assert pace.wake == pytest.approx(100.0 + 2 * wall)
    late = pace.wake + 3 * wall
    pace.started(late)
    assert pace.wake == pytest.approx(late + wall / 2), "made up for at twice the pace"
    for _ in range(6):
        pace.started(pace.wake)
    assert pace.wake == pytest.approx(100.0 + 9 * wall), "and then as planned at first"
    assert (statistics.skipped, statistics.worst_delay) == (0, pytest.approx(3 * wall))


def test_a_period_counts_as_late_from_a_millisecond_on():
    statistics = Statistics()
    pace = Pace(0.008, 1.0, statistics)
    pace.begin(0.0)
    pace.started(0.0089)
    assert statistics.late == 0
    pace.started(0.0171)
    assert statistics.late == 1


def test_periods_of_a_long_delay_are_left_out_and_counted():
    statistics = Statistics()
    pace = Pace(0.002, 1.0, statistics)
    pace.begin(0.0)
    pace.started(0.502)
    assert statistics.skipped == 250
    assert pace.wake == pytest.approx(0.504)


@pytest.mark.parametrize(("late", "leaps"), [(0.002, False), (0.05, True), (0.5, True)])
def test_targets_may_leap_where_periods_are_made_up_for_or_left_out(late, leaps):
    with closing(SIM.serve(SimConfig(host=own_address()), None)) as server:
        arm = server.controller.plant.arm
        server._pace.begin(100.0)
        server._do_period(server._pace.due + late)
        goal, violations = [q + 0.5 for q in arm.target_q], []
        for _ in range(100):
            arm.servo(goal, 0.03, 300.0)
            violations.append(arm.step())
        assert (SUDDEN_CHANGE in violations) is not leaps


def test_a_machine_that_is_too_slow_is_told_with_the_speed_that_it_reaches(caplog):
    pace = Pace(0.002, 10.0, Statistics())
    pace.begin(0.0)
    with caplog.at_level(logging.WARNING):
        for number in range(1, 2500):  # twice as long as wanted for each
            pace.started(0.0004 * number)
        assert not caplog.records, "nothing is said before a second is over"
        for number in range(2500, 30_000):
            pace.started(0.0004 * number)
    assert pace.reached == pytest.approx(5.0, rel=0.01)
    assert "passes 5 times as fast as real time, not 10 times" in caplog.text
    assert len(caplog.records) == 2, "in 12 s, once in ten"


@pytest.mark.parametrize("speed", [0.05, 0.0, -1.0, 101.0, float("nan"), float("inf")])
def test_an_impossible_speed_is_refused(speed):
    with pytest.raises(ConfigError, match=r"speed must lie in \[0.1, 100\]"):
        SimConfig(speed=speed)


def test_at_ten_times_the_speed_minutes_pass_in_seconds_without_a_lost_period():
    with SIM.spawn(speed=10.0) as sim, RtdeClient(sim.host) as client:
        client.setup_outputs("timestamp", 125)
        assert client.start()
        began, (first,) = time.monotonic(), client.data()
        (last,) = client.wait_for(lambda values: values[0] > first + 20.0, LONG)
        assert time.monotonic() - began < last - first
        speed = sim.control.status()["speed"]
        assert speed["wanted"] == 10.0
        assert speed["reached"] > 1.0


def test_at_a_tenth_of_the_speed_the_time_passes_slowly():
    with SIM.spawn(speed=0.1) as sim:
        before, first = time.monotonic(), sim.control.status()["time"]
        eventually(lambda: sim.control.status()["time"] > first + 0.05)
        last, after = sim.control.status()["time"], time.monotonic()
        # A delay of up to 0.1 s may be made up for.
        assert last - first <= 0.1 * (after - before + 0.1) + 0.002


def switches(pid):
    """How often a process has waited."""
    with open(f"/proc/{pid}/status") as status:
        return next(int(line.split()[1]) for line in status if line.startswith("voluntary"))


def test_periods_that_nobody_waits_for_are_done_with_the_next():
    with SIM.spawn() as sim, RtdeClient(sim.host) as client:
        client.setup_outputs("timestamp", 125)
        assert client.start()
        (first,), waited = client.data(), switches(sim.pid)
        (last,) = client.wait_for(lambda values: values[0] > first + 0.5, LONG)
        assert switches(sim.pid) - waited < 0.5 * (last - first) / 0.002


def test_time_that_the_machine_does_not_give_is_counted(caplog):
    with SIM.spawn(speed=10.0) as sim:
        eventually(lambda: sim.control.status()["time"] > 1.0)
        os.kill(sim.pid, signal.SIGSTOP)
        time.sleep(0.5)  # for so long others have the machine
        os.kill(sim.pid, signal.SIGCONT)
        eventually(lambda: sim.control.status()["speed"]["reached"] < 9.5)
        assert sim.control.status()["statistics"]["skipped"] > 0
    assert "ur simulator: the machine does not keep up" in caplog.text


def test_a_protective_stop_is_locked_for_five_seconds_of_the_controller():
    with SIM.spawn(speed=20.0) as sim, DashboardClient(sim.host) as dashboard:
        before = 0.0

        def is_locked():  # unless whoever asks was held up for so long, a quarter of a second
            nonlocal before
            before = sim.control.status()["time"]
            sim.control.inject("protective_stop")
            return "until 5s" in dashboard.ask("unlock protective stop")

        eventually(is_locked)
        eventually(lambda: "releasing" in dashboard.ask("unlock protective stop"))
        assert sim.control.status()["time"] - before >= 5.0

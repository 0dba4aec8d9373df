"""The driver at a simulated Raven: what arrives, what is lost on the way, and what nobody can know."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from crtk_driver_raven import PLUGIN
from crtk_driver_raven.device import LATE, NUMBERS
from crtk_drivers.errors import CommandRefused, ConfigError, Reason
from crtk_drivers.samples import Pose, vector
from crtk_drivers.state import OperatingState
from rigs.raven_bench import PACKET, STAYS, RavenBench, raven
from rigs.waiting import eventually

ENABLED, DISABLED = OperatingState.ENABLED, OperatingState.DISABLED
PAUSED, FAULT = OperatingState.PAUSED, OperatingState.FAULT
MM = 1e-3
FAR = 1e6
"""µm."""


@pytest.fixture(scope="module")
def shared() -> Iterator[RavenBench]:
    with raven() as bench:
        yield bench


@pytest.fixture
def running(shared: RavenBench) -> Iterator[RavenBench]:
    """An enabled driver; DISABLED afterwards, and without faults."""
    shared.enabled()
    yield shared
    shared.sim.control.clear()
    shared.connected()
    shared.disabled()


def arrived(status: dict[str, Any], arm: str) -> np.ndarray:
    """Return where an arm of the simulator is, in µm along the axes of packets."""
    x, y, z = status[arm]
    return np.array((-y, z, -x) if arm == "gold" else (y, -z, -x))


def settled(running: RavenBench, arm: str) -> np.ndarray:
    """Return how far an arm is from where it was led, once packets that lead nowhere have been used."""
    return running.at_rest(arm) - arrived(running.used(1), arm)


def far(running: RavenBench, arm: str) -> None:
    """Let an arm be led further than it gets in a test."""
    goal = running.led(arm) + np.array((FAR, 0.0, 0.0))
    getattr(running.front, arm).interpolate_cp(Pose(vector(goal / 1e6), STAYS))


def missing(running: RavenBench, arm: str) -> float:
    return float(np.abs(settled(running, arm)).max())


def test_each_arm_goes_where_it_is_led(running: RavenBench) -> None:
    before = running.sim.control.status()
    apart = {arm: settled(running, arm) for arm in ("gold", "green")}
    running.lead("gold", (MM, 0.0, 0.0), 3)
    running.lead("green", (0.0, -0.5 * MM, MM))
    after = running.used(3)
    assert np.subtract(after["gold"], before["gold"]).tolist() == [0, -3000, 0]
    assert np.subtract(after["green"], before["green"]).tolist() == [-1000, 0, 500]
    for arm, earlier in apart.items():
        assert settled(running, arm) == pytest.approx(earlier)
    assert after["wrong_checksum"] == after["wrong_size"] == 0


def test_an_arm_turns_about_the_axes_of_packets(running: RavenBench) -> None:
    before = np.array(running.sim.control.status()["gold_turn"])
    turn = vector((0.0, 0.0, np.sin(0.02), np.cos(0.02)))
    running.front.gold.servo_cr(Pose(vector((0.0, 0.0, 0.0)), turn))

    def turned(status: dict[str, Any]) -> bool:
        return abs(float(np.dot(before, status["gold_turn"]))) < np.cos(0.0199)

    after = running.until(turned, "turned by 0.04 rad")["gold_turn"]
    assert after[0] - before[0] == pytest.approx(-np.sin(0.02), abs=1e-3), "its x is their -z"


def test_poses_are_led_to_smoothly_from_where_it_was_led(running: RavenBench) -> None:
    goal = running.at_rest("gold") + np.array((0.0, 2000.0, 0.0))
    apart = missing(running, "gold")

    def is_there() -> bool:
        running.front.gold.interpolate_cp(Pose(vector(goal / 1e6), STAYS))
        return bool(np.abs(running.led("gold") - goal).max() < 2.0)

    eventually(is_there, "led there")
    assert missing(running, "gold") == pytest.approx(apart)


def test_a_jaw_is_opened_by_increments(running: RavenBench) -> None:
    before = running.sim.control.status()["green_grasp"]
    running.front.green.jaw_increment(0.05)
    running.until(lambda status: status["green_grasp"] == before + 50.0, "50 mrad")
    assert running.sim.control.status()["gold_grasp"] == 0.0


def test_what_is_told_is_where_it_was_led(running: RavenBench) -> None:
    running.lead("gold", (0.0, MM, 0.0))
    engine = running.session.children["gold"]
    assert "measured_cp" not in engine.commands
    value, _ = engine.feedback("setpoint_cp")
    assert 1e6 * value.position == pytest.approx(running.led("gold"), abs=1.0)
    notes = running.session.engine.device.notes
    assert [note.key for note in notes] == ["one way"]


@pytest.mark.parametrize(("command", "state"), [("disable", DISABLED), ("pause", PAUSED)])
def test_the_pedal_goes_up(running: RavenBench, command: str, state: OperatingState) -> None:
    getattr(running.front, command)()
    running.state(state)
    status = running.until(lambda status: status["run_level"] == 2, "the pedal is up")
    assert status["timeouts"] == 0
    with pytest.raises(CommandRefused) as refused:
        running.front.gold.jaw_increment(0.01)
    assert refused.value.reason is Reason.NOT_ENABLED


def test_a_lost_packet_costs_its_way_and_that_of_the_next(running: RavenBench) -> None:
    """Raven drops what follows a gap, too; nobody tells the driver."""
    before, skipped = missing(running, "gold"), running.sim.control.status()["skipped"]
    far(running, "gold")
    running.sim.control.inject("next", lost=1)
    running.until(lambda status: status["skipped"] == skipped + 1, "a gap is seen")
    running.front.gold.hold()
    cost = missing(running, "gold") - before
    assert 0.0 <= cost <= 2.0 * LATE * PACKET
    assert running.session.engine.status.state is ENABLED


def test_doubled_packets_lead_nowhere_twice(running: RavenBench) -> None:
    before = missing(running, "green")
    running.sim.control.inject("duplicate", every=1)
    repeated = running.sim.control.status()["repeated"]
    running.lead("green", (0.3 * MM, 0.0, 0.0), 10)
    assert missing(running, "green") == pytest.approx(before)
    assert running.sim.control.status()["repeated"] > repeated


def test_packets_that_are_overtaken_are_lost(running: RavenBench) -> None:
    before = missing(running, "gold")
    running.sim.control.inject("late", every=4, by=2)
    running.lead("gold", (0.0, 0.0, MM), 5)
    running.sim.control.clear("late")
    status = running.used(3)
    assert status["out_of_sequence"] > 0
    assert missing(running, "gold") > before
    assert running.session.engine.status.state is ENABLED


def test_a_stream_that_ends_leads_no_further(running: RavenBench) -> None:
    before, here = running.front.gold.health().stream_timeouts, running.led("gold")
    running.front.gold.servo_cr(Pose(vector((0.0, 1.5 * MM, 0.0)), STAYS))
    eventually(lambda: running.front.gold.health().stream_timeouts > before, "the stream is over")
    assert (running.at_rest("gold") - here).tolist() == [0.0, 1500.0, 0.0]
    position = running.used(1)["gold"]
    status = running.used(20)
    assert status["gold"] == position
    assert status["run_level"] == 3, "packets go on, the pedal is down"


def test_a_stream_that_is_too_fast_is_refused_and_stopped(running: RavenBench) -> None:
    here = running.at_rest("gold")
    running.front.gold.servo_cr(Pose(vector((0.0, 10.0 * MM, 0.0)), STAYS))
    eventually(lambda: running.front.gold.health().refusals, "refused")
    assert running.at_rest("gold").tolist() == here.tolist()
    assert running.session.engine.status.state is ENABLED
    running.lead("gold", (0.0, MM, 0.0))


def test_a_stop_leads_no_further_and_that_is_all_that_is_known(running: RavenBench) -> None:
    start, before = running.sim.control.status()["green"], running.led("green")
    far(running, "green")
    running.until(lambda status: status["green"] != start, "it moves")
    running.front.green.hold()
    led = running.at_rest("green")
    position = running.used(1)["green"]
    assert np.abs(led - before).max() < FAR
    assert running.used(20)["green"] == position
    assert running.session.children["green"].status.state is ENABLED


def test_an_emergency_stop_of_raven_is_not_known(running: RavenBench) -> None:
    position = running.used(1)["gold"]
    running.sim.control.inject("emergency_stop")
    running.until(lambda status: status["run_level"] == 0, "stopped")
    running.lead("gold", (MM, 0.0, 0.0))
    assert running.used(3)["gold"] == position
    assert running.session.engine.status.state is ENABLED


def test_a_pedal_that_was_lifted_leads_nothing_when_it_is_down_again(running: RavenBench) -> None:
    far(running, "gold")
    running.front.disable()
    position = running.until(lambda status: status["run_level"] == 2, "up")["gold"]
    running.enabled()
    assert running.used(20)["gold"] == position


def test_the_watchdog_lifts_the_pedal_without_the_io_thread(running: RavenBench) -> None:
    running.session.engine.device.left()
    running.until(lambda status: not status["engaged"], "lifted")
    assert running.sim.control.status()["timeouts"] == 0


def test_where_nobody_listens_it_is_lost_and_comes_back_disabled(running: RavenBench) -> None:
    running.sim.control.inject("closed")
    running.state(FAULT)
    eventually(lambda: not running.session.children["gold"].connected, "its arms are lost, too")
    running.sim.control.clear("closed")
    running.state(DISABLED)
    running.until(lambda status: status["run_level"] == 2, "the pedal is up")
    running.used(3)


def test_where_nobody_listens_it_is_not_connected() -> None:
    with raven() as running:
        running.sim.control.inject("closed")
        running.state(FAULT, "nobody listens")


def test_without_packets_raven_lifts_its_pedal_and_the_driver_does_not_know() -> None:
    with raven({"timeout": 0.3}) as running:
        running.enabled()
        running.sim.control.inject("loss", every=1, burst=1)
        running.until(lambda status: status["timeouts"] == 1, "it waited long enough")
        assert running.session.engine.status.state is ENABLED


def test_a_driver_that_ends_lifts_the_pedal() -> None:
    with raven() as running:
        running.enabled()
        running.front.close()
        status = running.until(lambda status: not status["engaged"], "lifted")
        assert status["timeouts"] == 0


@pytest.mark.sweep(4)
@pytest.mark.parametrize("ahead", [0, -1, -500, -999, -1500, 1, 500, 100_000])
def test_whatever_number_raven_has_packets_are_used(ahead: int) -> None:
    """It drops what does not follow its number: a driver that begins must not have to know that."""
    with raven() as first:
        sim = first.sim
        first.front.close()
        number = time.time_ns() // 1_000_000 % NUMBERS - ahead
        sim.control.inject("forgetful", number=number)
        second = RavenBench(sim)
        second.session.start()
        try:
            second.connected()
            assert second.used(5)["out_of_sequence"] <= 1, "but for the first one"
        finally:
            second.front.close()


def test_a_real_one_needs_an_address() -> None:
    with pytest.raises(ConfigError, match="host: is required"):
        PLUGIN.check_real(PLUGIN.config())

"""Faults of a NetFT sensor and its network: what the driver makes of each, and that it comes back by itself.

The faults are those of the table F1 to F20 in the documentation that concern a sensor, and every kind of the
simulator.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from crtk_driver_ati_netft.services import SensorBias
from crtk_drivers.device import Severity
from crtk_drivers.state import OperatingState
from crtk_sim_backends.netft import SIM, RunningSim
from crtk_sim_backends.netft.injection import KINDS
from rigs.netft_bench import FREE_PORTS, NetFtBench, driver_at, eventually, netft_bench

LOAD = [1.0, -2.0, 3.0, 0.1, -0.2, 0.3]
LOAD_TEXT = "constant:1,-2,3,0.1,-0.2,0.3"
ENABLED, DISABLED, FAULT = OperatingState.ENABLED, OperatingState.DISABLED, OperatingState.FAULT


@pytest.fixture(scope="module")
def box() -> Iterator[RunningSim]:
    """A Net Box with a load at rest; one for all tests."""
    with SIM.spawn(load=LOAD_TEXT, **FREE_PORTS) as sim:
        yield sim


@pytest.fixture
def bench(box: RunningSim) -> Iterator[NetFtBench]:
    """A new driver for each test, enabled, at a box without faults."""
    box.control.clear()
    with driver_at(box) as bench:
        bench.until_load(LOAD)
        bench.front.enable()
        yield bench
    box.control.clear()


def rises(bench: NetFtBench, counter: str, before: float | None = None) -> None:
    before = bench.counter(counter) if before is None else before
    eventually(lambda: bench.counter(counter) > before, f"{counter} rises above {before}")


def stands(bench: NetFtBench, counter: str) -> None:
    """The counter must not rise while measurements go on."""
    before = bench.counter(counter)
    for _ in range(3):
        rises(bench, "received")
    assert bench.counter(counter) == before


def comes_back(bench: NetFtBench) -> None:
    """Connected again by itself: DISABLED, and the bias is not known any more."""
    bench.was(DISABLED)
    eventually(lambda: bench.front.health().reconnects >= 1, "reconnected")
    bench.connected()
    bench.until_load(LOAD)
    assert bench.device.sensor_bias is SensorBias.UNKNOWN
    severity, text = bench.note("bias") or (None, "")
    assert severity is Severity.WARNING
    assert "unknown" in text
    assert bench.session.engine.status.state is DISABLED
    bench.front.enable()


def has_run(bench: NetFtBench) -> None:
    """A restart is seen by the box's clock, which must have moved on by more than its tolerance."""
    eventually(lambda: bench.sim.control.outputs("ft_sequence")["ft_sequence"] > 7000, "a second")


# F5, F8: the network loses, repeats, delays and damages datagrams. Counted, and nothing stops.


COUNTED = {
    "loss": ({"every": 7}, "lost"),
    "duplicate": ({"every": 7}, "duplicates"),
    "late": ({"every": 7, "by": 3}, "late"),
    "short": ({"every": 7, "size": 20}, "malformed"),
    "long": ({"every": 7, "size": 4}, "malformed"),
    "empty": ({"every": 7}, "malformed"),
}


@pytest.mark.parametrize("kind", COUNTED)
def test_what_the_network_does_is_counted_and_stops_nothing(bench, kind) -> None:
    parameters, counter = COUNTED[kind]
    bench.sim.control.inject(kind, **parameters)
    rises(bench, counter)
    np.testing.assert_allclose(bench.load(), LOAD, atol=1e-5)
    bench.sim.control.clear()
    eventually(lambda: not bench.sim.control.status()["faults"], "cleared")
    rises(bench, "received")
    rises(bench, "received")
    stands(bench, counter)
    assert bench.front.is_enabled()
    assert bench.front.health().reconnects == 0


def test_every_lost_record_is_counted_once(bench) -> None:
    before = bench.counter("lost")
    sent = bench.sim.control.status()["counters"]
    bench.sim.control.inject("loss", every=5, burst=2)
    rises(bench, "lost")
    eventually(lambda: bench.counter("lost") > before + 100, "a hundred lost")
    bench.sim.control.clear()
    now = bench.sim.control.status()["counters"]
    unsent = (now["records"] - sent["records"]) - (now["datagrams"] - sent["datagrams"])
    eventually(lambda: bench.counter("lost") - before >= unsent, "counted")
    assert bench.counter("lost") - before == unsent


def test_strangers_are_not_listened_to(bench) -> None:
    bench.sim.control.inject("foreign", every=2)
    for _ in range(5):
        rises(bench, "received")
        np.testing.assert_allclose(bench.load(), LOAD, atol=1e-5)
    assert bench.counter("malformed") == 0
    assert bench.counter("takeovers") == 0
    assert bench.front.is_enabled()


def test_damaged_records_do_not_end_the_driver(bench) -> None:
    bench.sim.control.inject("corrupt", every=20)
    for _ in range(20):
        rises(bench, "received")
    bench.sim.control.clear()
    bench.connected()
    bench.until_load(LOAD)


def test_nothing_but_nonsense_ends_the_connection_until_it_is_over(bench) -> None:
    bench.sim.control.inject("short", every=1, size=7)
    bench.was(FAULT)
    bench.sim.control.clear()
    comes_back(bench)


# F9, F20: restarts, reboots, and another client.


def test_a_stream_that_begins_anew_is_no_loss(bench) -> None:
    before = bench.counter("lost")
    eventually(lambda: bench.counter("received") > 500, "runs")
    series = bench.counter("series")
    bench.sim.control.inject("restart")
    rises(bench, "series", series)
    rises(bench, "received")
    assert bench.counter("lost") == before
    assert bench.front.is_enabled()
    assert bench.front.health().reconnects == 0


def test_the_record_number_wraps_without_a_gap(bench) -> None:
    series = bench.counter("series")
    bench.sim.control.inject("restart", sequence=2**32 - 50)
    rises(bench, "series", series)
    lost, series = bench.counter("lost"), bench.counter("series")
    received = bench.counter("received")
    eventually(lambda: bench.counter("received") > received + 200, "beyond the wrap")
    assert bench.counter("lost") == lost
    assert bench.counter("series") == series


@pytest.mark.parametrize(("seconds", "detail"), [(0.0, "restarted"), (0.3, "restarted"), (1.5, "")])
def test_a_reboot_is_noticed_and_the_bias_unknown(bench, seconds, detail) -> None:
    has_run(bench)
    bench.front.sensor_bias()
    bench.until_load([0.0] * 6)
    assert bench.device.sensor_bias is SensorBias.SET
    bench.sim.control.inject("reboot", seconds=seconds)
    bench.was(FAULT, detail)
    comes_back(bench)


def test_a_reboot_with_another_scale_is_read_anew(bench) -> None:
    has_run(bench)
    try:
        bench.sim.control.inject("reboot", seconds=0.2, scale=0.5)
        bench.was(FAULT)
        comes_back(bench)
        assert bench.device.info.scale.counts_per_force == 500_000
    finally:
        bench.sim.control.inject("reboot", seconds=0.0, scale=2.0)


def test_a_stolen_stream_is_taken_back_and_told(bench) -> None:
    def is_noticed() -> bool:
        """A stream that comes late when it is asked for again may have been away, and is not told."""
        bench.sim.control.inject("takeover")
        rises(bench, "received")
        rises(bench, "received")
        return bench.counter("takeovers") >= 1

    eventually(is_noticed, "noticed")
    assert "another client" in (bench.note("bias") or (None, ""))[1]
    assert bench.front.is_enabled()
    assert bench.front.health().reconnects == 0


# F2, F16, F17: silence.


@pytest.mark.parametrize("kind", ["unplugged", "stall"])
def test_a_silent_sensor_is_a_fault_and_comes_back_by_itself(box, kind) -> None:
    box.control.clear()
    with driver_at(box, {"sample_timeout": 1.0}) as bench:
        bench.until_load(LOAD)
        bench.front.enable()
        box.control.inject(kind)
        bench.was(FAULT)
        assert bench.session.engine.feedback("measured_cf")[1].wall_ns == 0
        box.control.clear()
        comes_back(bench)


def test_a_short_silence_is_bridged(bench) -> None:
    bench.sim.control.inject("stall", duration=1.0)
    eventually(lambda: not bench.sim.control.status()["faults"], "over")
    rises(bench, "received")
    assert bench.front.health().reconnects == 0
    assert bench.front.is_enabled()


def test_a_closed_port_is_a_fault_and_comes_back_by_itself(bench) -> None:
    bench.sim.control.inject("closed", port="all")
    bench.was(FAULT)
    bench.sim.control.clear()
    comes_back(bench)


def test_requests_that_are_lost_are_repeated(box) -> None:
    box.control.clear()
    box.control.inject("deaf", duration=0.5)
    with driver_at(box) as bench:
        bench.until_load(LOAD)


def test_a_killed_box_is_a_fault_and_a_new_one_at_its_place_is_taken() -> None:
    with netft_bench({}, load=LOAD_TEXT) as bench:
        bench.front.enable()
        ports = {f"{name}_port": number for name, number in bench.sim.ports.items()}
        host = bench.sim.host
        bench.sim.kill()
        bench.was(FAULT)
        with SIM.spawn(host=host, load=LOAD_TEXT, **ports):
            comes_back(bench)


# The transducer and its electronics.


def test_a_frozen_transducer_is_a_fault_with_invalid_data(bench) -> None:
    bench.sim.control.inject("frozen")
    bench.state(FAULT, "frozen")
    eventually(lambda: bench.session.engine.feedback("measured_cf")[1].wall_ns == 0, "invalid")
    assert bench.front.health().reconnects == 0
    bench.sim.control.clear()
    eventually(lambda: not bench.device.source.frozen, "thawed")
    bench.connected()
    bench.front.enable()
    bench.until_load(LOAD)


STATUS = [
    ("netbox", 0xC0000000, FAULT, "CPU or RAM error"),
    ("netbox", 0x80000004, FAULT, "temperature"),
    ("netbox", 0x80010000, ENABLED, "monitor condition latched"),
    ("axia", 0x80000002, FAULT, "supply"),
    ("axia", 0x00010000, ENABLED, "monitor condition latched"),
    ("axia", 0x10000000, ENABLED, "simulated error"),
    ("axia", 0x00000008, ENABLED, "busy"),
]


@pytest.fixture(scope="module")
def boxes() -> Iterator[Callable[[str], RunningSim]]:
    """One box of each family that is asked for."""
    running: dict[str, RunningSim] = {}

    def of(profile: str) -> RunningSim:
        if profile not in running:
            running[profile] = SIM.spawn(profile=profile, load=LOAD_TEXT, **FREE_PORTS)
        running[profile].control.clear()
        return running[profile]

    yield of
    for sim in running.values():
        sim.stop()


@pytest.mark.parametrize(("profile", "bits", "state", "text"), STATUS)
def test_status_bits_mean_what_they_mean_in_their_family(boxes, profile, bits, state, text) -> None:
    sim = boxes(profile)
    with driver_at(sim) as bench:
        bench.front.enable()
        sim.control.inject("status", bits=bits)
        key = "status" if state is FAULT else "notice"
        _, told = eventually(lambda: bench.note(key), "told")
        assert text in told
        bench.state(state)
        assert bench.front.health().reconnects == 0
        sim.control.clear()
        eventually(lambda: bench.note(key) is None, "over")
        bench.until_load(LOAD)
        if state is FAULT:
            bench.front.enable()


@pytest.mark.parametrize("profile", ["netbox", "axia", "schunk", "onrobot"])
def test_saturation_is_published_and_flagged(boxes, profile) -> None:
    sim = boxes(profile)
    named = {"profile": profile} if profile == "onrobot" else {}
    with driver_at(sim, named) as bench:
        bench.front.enable()
        sim.control.inject("saturation", axis=2)
        severity, _ = eventually(lambda: bench.note("saturation"), "told")
        assert severity is Severity.ERROR
        eventually(lambda: bench.load()[2] > 200.0, "published")
        eventually(lambda: bench.session.engine.feedback("measured_cf")[1].wall_ns > 0, "valid")
        assert bench.front.is_enabled()
        sim.control.clear()
        bench.until_load(LOAD)
        eventually(lambda: bench.note("saturation") is None, "over")


def test_a_load_beyond_the_range_saturates_by_itself(bench) -> None:
    bench.sim.control.inject("push", wrench=[0.0, 0.0, 2000.0, 0.0, 0.0, 0.0])
    eventually(lambda: bench.note("saturation"), "told")
    bench.until_load([*LOAD[:2], 1.1 * 990.0, *LOAD[3:]])
    _, told = eventually(lambda: bench.note("overload"), "overload told")
    assert "Fz" in told
    bench.sim.control.clear()
    bench.until_load(LOAD)


def test_a_clock_that_drifts_is_followed(bench) -> None:
    eventually(lambda: bench.counter("tick_rate") > 0, "fitted")
    bench.sim.control.inject("drift", ppm=2000.0)
    eventually(lambda: abs(bench.counter("tick_rate") - 7014.0) < 3.5, "the rate is followed")
    assert bench.front.is_enabled()
    assert bench.counter("lost") == 0


def test_every_kind_of_fault_leaves_a_driver_that_measures(box) -> None:
    """Each for a moment, with what must be given; those above say what follows in detail."""
    needed = {
        "status": {"bits": 4},
        "push": {"wrench": [1.0] * 6},
        "drift": {"ppm": 10.0},
        "web_answer": {"answer": "slow"},
        "web_tag": {"tag": "cfgfu", "text": "1"},
        "delay": {"seconds": 0.01},
        "reboot": {"seconds": 0.05},
    }
    box.control.clear()
    with driver_at(box) as bench:
        for kind, table in KINDS.items():
            parameters = dict(needed.get(kind, {}))
            if table.lasting:
                parameters["duration"] = 0.05
            box.control.inject(kind, **parameters)
            rises(bench, "received")
            eventually(lambda: not box.control.status()["faults"], "over")
            eventually(lambda: not box.control.status()["unreachable"], "reachable")
            bench.connected()
            bench.until_load(LOAD)


@pytest.mark.parametrize("bias", ["continues", "stops"])
def test_a_bias_in_the_sensor_is_verified_whatever_the_stream_does(bias) -> None:
    with netft_bench(load=LOAD_TEXT, bias=bias) as bench:
        bench.until_load(LOAD)
        assert "left over" in bench.front.sensor_bias()
        bench.until_load([0.0] * 6)
        assert bench.sim.control.outputs("bias")["bias"] == pytest.approx(LOAD, abs=1e-3)
        bench.front.sensor_unbias()
        bench.until_load(LOAD)
        assert bench.sim.control.outputs("bias")["bias"] == [0.0] * 6

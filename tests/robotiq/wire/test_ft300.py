"""The force sensor at its simulator: what it measures, and what becomes of a stream that goes wrong."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from crtk_driver_robotiq.ft300 import PLUGIN
from crtk_drivers.errors import CommandRefused, ConfigError, Reason, TransitionFailed
from crtk_drivers.kit import software_bias
from crtk_drivers.samples import Wrench, vector
from crtk_drivers.state import OperatingState
from crtk_sim_backends.robotiq.ft300 import SIM, RunningSim
from rigs.ft300_bench import FREE_PORTS, LOAD, Ft300Bench, bench, configuration
from rigs.waiting import LONG, eventually

FAULT, DISABLED = OperatingState.FAULT, OperatingState.DISABLED
NONE = [0.0] * 6


@pytest.fixture(scope="module")
def shared() -> Iterator[RunningSim]:
    with SIM.spawn(**FREE_PORTS) as sim:
        yield sim


@pytest.fixture(scope="module")
def driven(shared: RunningSim) -> Iterator[Ft300Bench]:
    with Ft300Bench(shared, configuration(shared, link="serial")) as running:
        yield running


@pytest.fixture
def running(driven: Ft300Bench) -> Iterator[Ft300Bench]:
    """A driver that reads the stream of its serial line; unloaded, without a bias."""
    yield driven
    driven.sim.control.clear()
    driven.sim.control.inject("carry")
    driven.connected()
    driven.front.unbias()


def test_it_measures_what_acts_on_it(running: Ft300Bench) -> None:
    running.sim.control.inject("load", **LOAD)
    running.measures(list(LOAD.values()))
    running.measures(list(LOAD.values()), "raw/measured_cf")
    value, stamp = running.session.engine.feedback("measured_cf")
    assert value.frame_id == "ft_sensor"
    assert 0.0 < time.monotonic() - stamp.monotonic < LONG
    before = running.front.health().samples
    running.samples(20)
    assert running.front.health().samples > before
    assert running.counter("corrupt") < 10, "more than is lost where a reader is held up"


def test_a_load_of_a_lab_adds_to_what_acts(running: Ft300Bench) -> None:
    assert PLUGIN.sim_load is not None
    wrench = Wrench(vector([0.0, 0.0, -5.0]), vector([0.0, 0.5, 0.0]))
    PLUGIN.sim_load(running.sim, wrench)
    running.sim.control.inject("load", fx=10.0)
    running.measures([10.0, 0.0, -5.0, 0.0, 0.5, 0.0])


def test_it_tells_who_it_is(running: Ft300Bench) -> None:
    notes = {note.key: note.text for note in running.session.engine.device.notes}
    assert notes["sensor"] == "FT 300, serial FTS-0815, firmware FT1.05, of 2021"


def test_a_bias_makes_the_present_load_zero_and_is_removed(running: Ft300Bench) -> None:
    running.sim.control.inject("load", **LOAD)
    running.measures(list(LOAD.values()))
    assert "software bias [" in running.front.bias()
    running.measures(NONE)
    running.measures(list(LOAD.values()), "raw/measured_cf")
    assert running.counter("bias_fz") == pytest.approx(30.0, abs=0.5)
    running.front.unbias()
    running.measures(list(LOAD.values()))
    assert "[0, 0, 0] N" in running.front.get_bias()


def test_a_bias_while_the_load_changes_is_refused(
    running: Ft300Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is set from 0.3 s of measurements, and checked in those that follow."""
    monkeypatch.setattr(software_bias, "CHECKED", 1.0)
    running.front.set_bias(Wrench(vector([1.0, 0.0, 0.0]), vector([0.0] * 3)))
    request = running.session.engine.request("bias")
    eventually(lambda: running.counter("bias_fx") != 1.0, "averaged")
    running.sim.control.inject("load", fz=200.0)
    with pytest.raises(TransitionFailed, match="the load changed"):
        request.wait(LONG)
    assert running.counter("bias_fx") == 1.0


@pytest.mark.parametrize(
    ("force", "frame", "reason"),
    [
        ([np.nan, 0.0, 0.0], "", Reason.NOT_FINITE),
        ([2e6, 0.0, 0.0], "", Reason.OUT_OF_RANGE),
        ([1.0, 0.0, 0.0], "flange", Reason.WRONG_FRAME),
    ],
)
def test_a_bias_that_cannot_be_is_refused(
    running: Ft300Bench, force: list[float], frame: str, reason: Reason
) -> None:
    with pytest.raises(CommandRefused) as refused:
        running.front.set_bias(Wrench(vector(force), vector([0.0] * 3), frame))
    assert refused.value.reason is reason
    assert running.counter("bias_fx") == 0.0


def test_an_overload_is_told(running: Ft300Bench) -> None:
    running.sim.control.inject("load", mz=31.0)

    def is_told() -> bool:
        return any(note.key == "overload" for note in running.session.engine.device.notes)

    eventually(is_told, "told")
    assert running.counter("peak_of_rated") == pytest.approx(1.03, abs=0.02)


@pytest.mark.parametrize(
    ("kind", "parameters", "counter"),
    [
        ("bad_crc", {"every": 3}, "corrupt"),
        ("cut", {"every": 4}, "corrupt"),
        ("noise", {}, "strange_bytes"),
        ("left_out", {"every": 1}, "lost"),
    ],
)
def test_what_is_damaged_is_left_out_and_counted(
    running: Ft300Bench, kind: str, parameters: dict[str, Any], counter: str
) -> None:
    running.sim.control.inject("load", **LOAD)
    running.measures(list(LOAD.values()))
    before = running.counter(counter)
    running.sim.control.inject(kind, **parameters)
    if kind == "left_out":  # some tenths of a second without any
        had = running.sim.control.status()["measurements"]
        eventually(lambda: running.sim.control.status()["measurements"] > had + 10, "left out")
        running.sim.control.clear(kind)
    eventually(lambda: running.counter(counter) > before, "counted")
    running.samples(10)
    running.measures(list(LOAD.values()))


def test_a_sensor_that_repeats_itself_is_in_fault(running: Ft300Bench) -> None:
    running.front.enable()
    running.sim.control.inject("frozen")
    running.state(FAULT, "frozen")

    def stamp() -> int:
        return int(running.session.engine.feedback("measured_cf")[1].wall_ns)

    eventually(lambda: stamp() == 0, "invalid")
    with pytest.raises(TransitionFailed, match="frozen"):
        running.front.enable()
    running.sim.control.clear("frozen")
    eventually(lambda: stamp() != 0, "valid again")  # its frame takes the time of the line
    running.front.enable()
    running.front.disable()


@pytest.mark.parametrize("kind", ["other_master", "unpowered", "disconnect"])
def test_a_stream_that_ends_is_begun_anew(running: Ft300Bench, kind: str) -> None:
    running.front.enable()
    running.sim.control.inject(kind)
    running.state(FAULT)
    running.sim.control.clear()
    running.state(DISABLED)
    running.samples(5)


@pytest.mark.parametrize("link", ["serial", "tool"])
@pytest.mark.parametrize("source", ["stream", "registers"])
def test_first_of_all_a_stream_is_ended_that_still_runs(link: str, source: str) -> None:
    """Its driver died before it could: a sensor that streams answers nothing."""
    left = {"streams": True}
    with bench(link, source=source, simulated=left) as running:
        status = running.sim.control.status()
        assert status["stream_ends"] == 1
        assert status["streams"] is (source == "stream")
        running.samples(5)
        sim = running.sim
        running.front.close()
        eventually(lambda: not sim.control.status()["streams"], "quiet again")


def test_closing_by_modbus_is_no_fault() -> None:
    with bench("modbus") as running:
        running.front.close()
        assert running.session.engine.status.state is not FAULT


def test_behind_a_gateway_a_stream_cannot_be_ended_and_that_is_said() -> None:
    with SIM.spawn(**FREE_PORTS, streams=True) as sim:
        config = configuration(sim, link="modbus", open_timeout=0.5)
        running = Ft300Bench(sim, config)
        running.session.start()
        try:
            running.state(FAULT, "does not answer")
            assert "gateway" in running.session.engine.status.remedy
        finally:
            running.front.close()


def test_something_else_at_its_address_is_told() -> None:
    from crtk_sim_backends.robotiq.epick import SIM as EPICK

    with EPICK.spawn(**FREE_PORTS) as sim:
        running = Ft300Bench(sim, configuration(sim, link="tool", open_timeout=1.0))
        running.session.start()
        try:
            running.state(FAULT, "exception 2")
            assert "FT 300" in running.session.engine.status.remedy
        finally:
            running.front.close()


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(ConfigError, match="passes no stream on"), SIM.spawn(**FREE_PORTS) as sim:
        configuration(sim, link="modbus", source="stream")

"""The driver at a simulated unit: what it measures, its two zeros, and what goes wrong."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from crtk_driver_optoforce import PLUGIN
from crtk_drivers.errors import CommandRefused, ConfigError, Reason, TransitionFailed
from crtk_drivers.samples import Wrench, vector
from crtk_drivers.state import OperatingState
from crtk_sim_backends.optoforce import SIM, RunningSim
from rigs.optoforce_bench import LOAD, configuration, optoforce
from rigs.sensor_bench import SensorBench
from rigs.waiting import LONG, eventually

ENABLED, DISABLED, FAULT = OperatingState.ENABLED, OperatingState.DISABLED, OperatingState.FAULT
FORCE = [LOAD["fx"], LOAD["fy"], LOAD["fz"], 0.0, 0.0, 0.0]
NONE = [0.0] * 6


@pytest.fixture(scope="module")
def shared() -> Iterator[RunningSim]:
    with SIM.spawn() as sim:
        yield sim


@pytest.fixture(scope="module")
def driven(shared: RunningSim) -> Iterator[SensorBench]:
    with optoforce(shared) as running:
        yield running


@pytest.fixture
def running(driven: SensorBench) -> Iterator[SensorBench]:
    """A driver at a sensor of three axes, unloaded, DISABLED, without a bias afterwards."""
    yield driven
    driven.sim.control.clear()
    driven.sim.control.inject("carry")
    driven.connected()
    driven.front.unbias()
    driven.front.sensor_unbias()
    driven.front.disable()


def test_it_measures_what_acts_on_it(running: SensorBench) -> None:
    running.sim.control.inject("load", **LOAD)
    running.measures(FORCE)
    running.measures(FORCE, "raw/measured_cf")
    value, stamp = running.session.engine.feedback("measured_cf")
    assert value.frame_id == "ft_sensor"
    assert 0.0 < time.monotonic() - stamp.monotonic < LONG
    # But for what is lost where a reader is held up.
    assert running.counter("corrupt") < 10
    assert running.counter("strange_bytes") < 100
    running.note("sensor", "serial number ISE0A129")


def test_a_load_of_a_lab_adds_to_what_acts(running: SensorBench) -> None:
    assert PLUGIN.sim_load is not None
    PLUGIN.sim_load(running.sim, Wrench(vector([0.0, 0.0, -5.0]), vector([0.0] * 3)))
    running.sim.control.inject("load", fx=10.0)
    running.measures([10.0, 0.0, -5.0, 0.0, 0.0, 0.0])


def test_six_axes_are_measured() -> None:
    with SIM.spawn(sensor="6-axis") as sim, optoforce(sim, sensor="6-axis") as running:
        sim.control.inject("load", **LOAD)
        running.measures(list(LOAD.values()))


def test_rate_and_filter_are_written() -> None:
    with SIM.spawn() as sim, optoforce(sim, rate=333, low_pass=None) as running:
        status = sim.control.status()
        assert (status["period"], status["filter"]) == (3, 0)
        running.samples(20)
    with SIM.spawn() as sim, optoforce(sim, rate=1000, low_pass=500.0) as running:
        status = sim.control.status()
        assert (status["period"], status["filter"]) == (1, 1)
        before = running.counter("received")
        eventually(lambda: running.counter("received") > before + 500, "500 measurements")


def test_the_software_bias_makes_the_present_load_zero(running: SensorBench) -> None:
    running.sim.control.inject("load", **LOAD)
    running.measures(FORCE)
    assert "software bias [" in running.front.bias()
    running.measures(NONE)
    running.measures(FORCE, "raw/measured_cf")
    running.front.unbias()
    running.measures(FORCE)
    assert "[0, 0, 0] N" in running.front.get_bias()


@pytest.mark.parametrize(("word", "said"), [(0x0400, "not detected"), (0x0200, "Fx is overloaded")])
def test_what_cannot_be_measured_is_no_bias(running: SensorBench, word: int, said: str) -> None:
    running.sim.control.inject("status", word=word)
    eventually(lambda: running.session.engine.device.notes[0].severity > 1, "it is told")
    with pytest.raises(TransitionFailed, match=said):
        running.front.bias()
    assert "[0, 0, 0] N" in running.front.get_bias()
    running.sim.control.clear("status")
    eventually(lambda: running.session.engine.device.notes[0].severity < 2, "it is over")


def test_a_bias_in_another_frame_is_refused(running: SensorBench) -> None:
    with pytest.raises(CommandRefused) as refused:
        running.front.set_bias(Wrench(vector([1.0, 0.0, 0.0]), vector([0.0] * 3), "flange"))
    assert refused.value.reason is Reason.WRONG_FRAME
    assert "[0, 0, 0] N" in running.front.get_bias()


def test_the_unit_is_zeroed_and_zeroed_again(running: SensorBench) -> None:
    """It refuses a zero that follows another one: it is told otherwise in between."""
    running.sim.control.inject("load", **LOAD)
    running.measures(FORCE)
    for _ in range(2):
        running.front.sensor_bias()
        assert running.sim.control.status()["zeroed"]
        running.measures(NONE, "raw/measured_cf")
    running.front.sensor_unbias()
    running.measures(FORCE, "raw/measured_cf")


@pytest.mark.parametrize(("kind", "said"), [("deaf", "does not answer"), ("refuses", "error 2")])
def test_a_zero_that_is_not_confirmed_is_told(running: SensorBench, kind: str, said: str) -> None:
    running.sim.control.inject(kind)
    with pytest.raises(TransitionFailed, match=said):
        running.front.sensor_bias()
    assert not running.sim.control.status()["zeroed"]


def test_a_lost_connection_loses_the_zero_and_that_is_told(running: SensorBench) -> None:
    running.front.sensor_bias()
    running.sim.control.inject("disconnect")
    running.state(FAULT)
    running.sim.control.clear("disconnect")
    running.state(DISABLED)
    running.note("zero", "its own zero with it")
    assert not running.sim.control.status()["zeroed"]
    running.front.sensor_bias()
    assert not [note for note in running.session.engine.device.notes if note.key == "zero"]


@pytest.mark.parametrize(
    ("kind", "parameters", "counter"),
    [
        ("bad_sum", {"every": 3}, "corrupt"),
        ("cut", {"every": 4}, "corrupt"),
        ("noise", {}, "strange_bytes"),
        ("left_out", {"every": 3}, "lost"),
        ("doubled", {"every": 3}, "doubled"),
    ],
)
def test_what_is_damaged_is_left_out_and_counted(
    running: SensorBench, kind: str, parameters: dict[str, Any], counter: str
) -> None:
    running.front.enable()
    running.sim.control.inject("load", **LOAD)
    running.measures(FORCE)
    before = running.counter(counter)
    running.sim.control.inject(kind, **parameters)
    eventually(lambda: running.counter(counter) > before, "counted")
    running.samples(10)
    running.measures(FORCE)
    assert running.session.engine.status.state is ENABLED


@pytest.mark.parametrize(
    ("word", "said"),
    [(0x2000, "data acquisition"), (0x4000, "cannot talk"), (0x0800, "sensor failure")],
)
def test_an_error_of_the_unit_is_a_fault(running: SensorBench, word: int, said: str) -> None:
    running.front.enable()
    running.sim.control.inject("status", word=word)
    running.state(FAULT, said)
    eventually(lambda: running.session.engine.feedback("measured_cf")[1].wall_ns == 0, "invalid")
    with pytest.raises(TransitionFailed, match=said):
        running.front.enable()
    running.sim.control.clear("status")
    eventually(lambda: not running.session.engine.device.condition.reason, "over")
    running.front.enable()


def test_an_overload_is_told_and_no_fault(running: SensorBench) -> None:
    running.front.enable()
    running.sim.control.inject("load", fx=100.0)
    running.note("saturation", "Fx is overloaded")
    running.measures([75.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert running.session.engine.status.state is ENABLED
    eventually(lambda: running.session.engine.feedback("measured_cf")[1].wall_ns, "valid")


@pytest.mark.parametrize("how", ["invalid", "fault"])
def test_an_overload_may_count_for_more(shared: RunningSim, driven: SensorBench, how: str) -> None:
    with SIM.spawn() as sim, optoforce(sim, on_saturation=how) as running:
        running.front.enable()
        sim.control.inject("load", fz=-100.0)
        eventually(
            lambda: running.session.engine.feedback("measured_cf")[1].wall_ns == 0, "invalid"
        )
        if how == "fault":
            running.state(FAULT, "Fz is overloaded")


@pytest.mark.parametrize("kind", ["stopped", "frozen", "silence", "disconnect"])
def test_what_brings_nothing_new_is_lost_and_found_again(running: SensorBench, kind: str) -> None:
    running.front.enable()
    running.sim.control.inject(kind)
    running.state(FAULT)
    running.sim.control.clear(kind)
    running.state(DISABLED)
    running.samples(5)


def test_a_unit_that_was_restarted_is_set_anew() -> None:
    with SIM.spawn() as sim, optoforce(sim, rate=1000) as running:
        running.front.enable()
        eventually(lambda: sim.control.status()["number"] > 200, "some measurements")
        sim.control.inject("restart")
        eventually(lambda: sim.control.status()["period"] == 1, "set to 1000 Hz again")
        running.state(DISABLED)
        running.samples(5)


def test_four_sensors_are_behind_one_unit() -> None:
    with SIM.spawn(sensor="4x3-axis") as sim, optoforce(sim, sensor="4x3-axis") as running:
        names = [f"sensor_{number}" for number in range(1, 5)]
        assert list(running.session.children) == names
        sim.control.inject("load", fz=-10.0, sensor=3)
        for name in names:
            loaded = name == "sensor_3"
            running.measures([0.0, 0.0, -10.0 if loaded else 0.0, 0.0, 0.0, 0.0], child=name)
        value, _ = running.session.children["sensor_3"].feedback("measured_cf")
        assert value.frame_id == "ft_sensor_3"
        running.front.sensor_3.bias()
        running.measures(NONE, child="sensor_3")
        sim.control.inject("load", fy=90.0, sensor=2)
        running.note("saturation", "Fy is overloaded (sensor 2)")
        running.front.enable()
        sim.control.inject("status", word=0x0402)
        running.state(FAULT, "sensor not detected")
        assert "(sensor 2)" in running.session.engine.status.detail


def test_another_sensor_than_was_said_is_told() -> None:
    with SIM.spawn(sensor="6-axis") as sim:
        running = SensorBench(PLUGIN, sim, configuration(sim, scale=(0.1,) * 3))
        running.session.start()
        try:
            running.state(FAULT, "measures 6 axes, not 3")
            assert "6-axis" in running.session.engine.status.remedy
        finally:
            running.front.close()


def test_one_that_tells_no_serial_number_measures_too() -> None:
    with SIM.spawn(mute=True) as sim, optoforce(sim) as running:
        running.samples(5)
        assert not [note for note in running.session.engine.device.notes if note.key == "sensor"]


@pytest.mark.parametrize(("given", "missing"), [({}, "port"), ({"port": "/dev/x"}, "scale")])
def test_what_only_a_real_sensor_needs_is_asked_for(given: dict[str, str], missing: str) -> None:
    with pytest.raises(ConfigError, match=f"{missing}: is required"):
        PLUGIN.check_real(PLUGIN.config(**given))


def test_a_bias_needs_numbers(running: SensorBench) -> None:
    with pytest.raises(CommandRefused) as refused:
        running.front.set_bias(Wrench(vector([np.nan, 0.0, 0.0]), vector([0.0] * 3)))
    assert refused.value.reason is Reason.NOT_FINITE

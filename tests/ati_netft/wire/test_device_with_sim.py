"""The NetFT driver at a simulated sensor box: families, sensors, modes, settings, tool, and commands."""

from __future__ import annotations

import io
import signal
import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import yaml

from crtk_driver_ati_netft import tools
from crtk_driver_ati_netft.tools import UPWARDS, CalibrateOptions, ConfigureOptions, InfoOptions
from crtk_drivers.geometry.quaternions import quaternion_from_matrix, rotvec_from_quaternion
from crtk_sim_backends.netft import SIM, RunningSim
from crtk_sim_backends.netft.profiles import PRESETS, PROFILES
from rigs.netft_bench import (
    FREE_PORTS,
    LONG,
    NetFtBench,
    configuration,
    driver_at,
    eventually,
    netft_bench,
)
from rigs.programs import COMMAND
from rigs.warm_start import Process, server

LOAD = [1.0, -2.0, 3.0, 0.1, -0.2, 0.3]
LOAD_TEXT = "constant:1,-2,3,0.1,-0.2,0.3"


def cgi(sim: RunningSim, page: str) -> None:
    with urllib.request.urlopen(
        f"http://{sim.host}:{sim.ports['http']}/{page}", timeout=LONG
    ) as reply:
        assert reply.status == 200


def measures_at(bench: NetFtBench, rate: float) -> None:
    eventually(lambda: abs(bench.counter("record_rate") / rate - 1.0) < 0.02, f"{rate} Hz")


@pytest.fixture(scope="module")
def box() -> Iterator[RunningSim]:
    with SIM.spawn(load=LOAD_TEXT, **FREE_PORTS) as sim:
        yield sim


# Families and sensors.


@pytest.mark.parametrize("profile", ["netbox", "axia", "schunk"])
def test_the_family_is_found_on_its_page(profile) -> None:
    with netft_bench(profile=profile, load=LOAD_TEXT) as bench:
        assert bench.device.profile.name == profile
        bench.until_load(LOAD)
        assert bench.device.info.internal_rate == PROFILES[profile].rates[0]
        measures_at(bench, bench.sim.control.status()["rdt_rate"])


def test_an_onrobot_sensor_is_named_and_set_over_rdt() -> None:
    config = {"profile": "onrobot", "sensor": {"rdt_rate": 200, "filter_code": 4}}
    with netft_bench(config, preset="hex_e", load=LOAD_TEXT) as bench:
        bench.until_load(LOAD, tolerance=1e-4)
        status = bench.sim.control.status()
        assert (status["rdt_rate"], status["filter_code"]) == (200, 4)
        bench.front.sensor_bias()
        bench.until_load([0.0] * 6, tolerance=1e-4)
        bench.front.sensor_unbias()
        bench.until_load(LOAD, tolerance=1e-4)


@pytest.mark.parametrize("preset", PRESETS)
def test_every_sensor_measures_si_and_knows_its_range(preset) -> None:
    config = {"profile": "onrobot"} if preset == "hex_e" else {}
    load = "constant:1,-2,3,0.01,-0.02,0.03"
    with netft_bench(config, preset=preset, load=load) as bench:
        bench.until_load([1.0, -2.0, 3.0, 0.01, -0.02, 0.03], tolerance=1e-4)
        if preset != "hex_e":
            table = PRESETS[preset]
            assert bench.device.info.calibration_serial == table.serial
            torque = 0.001 if table.torque_unit == "Nmm" else 1.0
            wanted = np.array(table.rated) * np.repeat((1.0, torque), 3)
            np.testing.assert_allclose(bench.device.info.rated, wanted)


# Rates and modes.


@pytest.mark.parametrize(
    ("profile", "mode"),
    [("netbox", "realtime"), ("axia", "single"), ("axia", "buffered"), ("onrobot", "realtime")],
)
def test_the_full_rate_arrives_without_a_gap(profile, mode) -> None:
    config = {"mode": mode, **({"profile": profile} if profile == "onrobot" else {})}
    with netft_bench(config, profile=profile, rdt_rate=0) as bench:
        recorded = bench.record(0.5)
        # Where this machine stood still for 0.1 s, the driver has asked for the stream anew.
        begins = recorded["sequence"][1:] == 1
        for name in ("sequence", "ticks"):
            assert ((np.diff(recorded[name].astype(np.int64)) == 1) | begins).all()
        assert bench.counter("lost") == 0
        if mode == "buffered":
            assert bench.sim.control.status()["stream"]["size"] == 10


@pytest.mark.parametrize(
    ("profile", "wanted", "got"),
    [("netbox", 150, 152), ("netbox", 7000, 7000), ("axia", 500, 527), ("schunk", 1000, 1130)],
)
def test_a_rate_becomes_the_next_that_the_box_has(profile, wanted, got) -> None:
    with netft_bench({"sensor": {"rdt_rate": wanted}}, profile=profile) as bench:
        assert bench.device.info.rdt_rate == got
        measures_at(bench, got)


def test_the_measurement_number_wraps_without_a_gap() -> None:
    with netft_bench(rdt_rate=0, ft_sequence=2**32 - 3000, load=LOAD_TEXT) as bench:
        eventually(lambda: bench.sim.control.outputs()["ft_sequence"] < 2**31, "wrapped")
        received = bench.counter("received")
        eventually(lambda: bench.counter("received") > received + 1000, "beyond it")
        assert bench.counter("restarts") == 0
        assert bench.counter("lost") == 0
        bench.until_load(LOAD)


# Settings of the sensor.


def test_settings_are_written_and_read_back(box) -> None:
    transform = [0.0, 0.0, 0.1, 0.0, 0.0, np.pi / 2]
    sensor = {
        "configuration": 3,
        "rdt_rate": 500,
        "filter_code": 7,
        "buffer_size": 25,
        "tool_transform": transform,
    }
    with driver_at(box, {"sensor": sensor, "mode": "buffered"}) as bench:
        info = bench.device.info
        assert (info.active_configuration, info.rdt_rate, info.filter_code) == (3, 500, 7)
        np.testing.assert_allclose(info.transform, transform, atol=1e-6)
        status = bench.sim.control.status()
        assert (status["configuration"], status["buffer_size"]) == (3, 25)
        assert status["stream"]["size"] == 25
        # About a point 0.1 m along z, in axes turned by a quarter about z.
        fx, fy, fz, tx, ty, tz = LOAD
        bench.until_load([fy, -fx, fz, ty - 0.1 * fx, -(tx + 0.1 * fy), tz], tolerance=1e-4)
    cgi(box, "setting.cgi?setcfgsel=0&setuserfilter=0")
    cgi(box, "comm.cgi?comrdtrate=1000&comrdtbsiz=10")


def test_the_internal_rate_of_an_axia_is_set() -> None:
    with netft_bench({"sensor": {"internal_rate": 1978}}, profile="axia", rdt_rate=0) as bench:
        assert bench.device.info.internal_rate == 1978
        eventually(lambda: abs(bench.counter("tick_rate") - 1978.0) < 10.0, "measures at it")


def test_a_latched_monitor_condition_is_told_and_cleared(box) -> None:
    with driver_at(box) as bench:
        cgi(box, "moncon.cgi?setmce=1&mce0=1&mcx0=2&mcc0=1&mcv0=2000000&mco0=4")
        try:
            _, told = eventually(lambda: bench.note("notice"), "told")
            assert "monitor condition" in told
            cgi(box, "moncon.cgi?mce0=0")
            bench.front.clear_latch()
            eventually(lambda: bench.note("notice") is None, "cleared")
        finally:
            cgi(box, "moncon.cgi?setmce=0&mce0=0")


def test_the_low_pass_of_the_box_leaves_a_load_at_rest(box) -> None:
    with driver_at(box, {"sensor": {"filter_code": 8}}) as bench:
        bench.until_load(LOAD, tolerance=1e-4)
    cgi(box, "setting.cgi?setuserfilter=0")


# Commands for people.


class Hand(io.StringIO):
    """Turns the simulated tool to the next pose each time that Enter is waited for."""

    def __init__(self, sim: RunningSim, rotations: Any) -> None:
        super().__init__()
        self._sim = sim
        self._rotations = iter(rotations)

    def readline(self, *_: Any) -> str:
        rx, ry, rz = rotvec_from_quaternion(quaternion_from_matrix(next(self._rotations)))
        tool = f"gravity:mass=0.8,x=0.01,y=-0.02,z=0.06,rx={rx},ry={ry},rz={rz}"
        self._sim.control.call("load", text=f"{tool} + constant:1,-2,3,0.1,0.2,-0.3 + noise:0.02")
        return "\n"


def test_a_tool_is_found_from_poses(monkeypatch, tmp_path) -> None:
    with SIM.spawn(preset="mini45", rdt_rate=7000, **FREE_PORTS) as sim:
        hand = Hand(sim, UPWARDS.values())
        monkeypatch.setattr(sys, "stdin", hand)
        output = tmp_path / "tool.yaml"
        options = CalibrateOptions(seconds=0.2, output=str(output))
        assert tools.calibrate(configuration(sim), options) == 0
    found = yaml.safe_load(output.read_text())
    assert found["tool"]["mass"] == pytest.approx(0.8, abs=0.002)
    np.testing.assert_allclose(found["tool"]["center_of_mass"], [0.01, -0.02, 0.06], atol=5e-4)
    np.testing.assert_allclose(found["bias"], [1, -2, 3, 0.1, 0.2, -0.3], atol=0.01)


@pytest.mark.parametrize("profile", ["netbox", "axia", "schunk", "onrobot"])
def test_info_tells_what_it_is(capsys, profile) -> None:
    with SIM.spawn(profile=profile, load=LOAD_TEXT, **FREE_PORTS) as sim:
        named = {"profile": "onrobot"} if profile == "onrobot" else {}
        assert tools.info(configuration(sim, **named), InfoOptions(seconds=0.1)) == 0
    text = capsys.readouterr().out
    assert profile in text
    assert "3 ± 0 N" in text
    if profile != "onrobot":
        assert "SIM00001" in text
        assert PROFILES[profile].product in text


def test_configure_writes_and_prints(box, capsys) -> None:
    assert tools.configure(configuration(box), ConfigureOptions(rdt_rate=150)) == 0
    assert "152" in capsys.readouterr().out
    assert box.control.status()["rdt_rate"] == 152
    cgi(box, "comm.cgi?comrdtrate=1000")


def run(*arguments: str) -> Process:
    return server().start_text(COMMAND, *arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE)


def test_info_at_a_simulator_from_the_command_line() -> None:
    with run("ati-netft", "info", "--sim", "--seconds", "0.1") as child:
        out, err = child.communicate(timeout=LONG)
        assert child.returncode == 0, err
    assert "ATI Net F/T (simulated)" in out


@pytest.mark.real_time  # reads what a command prints
def test_the_simulator_alone_from_the_command_line() -> None:
    ports = ["--rdt-port", "0", "--tcp-port", "0", "--http-port", "0"]
    with run("sim", "ati-netft", "--preset", "nano17", *ports) as child:
        try:
            assert child.stderr is not None
            told = ""
            while "Ctrl-C" not in told:
                line = child.stderr.readline()
                assert line, told
                told += line
            assert "rdt" in told
            child.send_signal(signal.SIGINT)
            _, err = child.communicate(timeout=LONG)
            assert child.returncode == 0, err
        finally:
            child.kill()

"""A simulated sensor on a simulated arm feels the weight of its tool, turned as the arm is."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import crtk_drivers
from crtk_driver_ati_netft import PLUGIN
from crtk_drivers.config import from_assignments, load
from crtk_drivers.errors import ConfigError, CrtkError
from crtk_drivers.labs import device_command, load_lab
from crtk_drivers.labs.carried import Carried
from crtk_drivers.labs.lab_file import CarriedEntry
from crtk_drivers.labs.sim_coupling import Coupling, Followed, Told, Weight
from crtk_drivers.plugins import RunningSim
from crtk_drivers.samples import Pose
from rigs.netft_bench import driver_at, eventually, netft_bench
from rigs.ur_watchdog import rarely_fed
from rigs.waiting import LONG

MASS, CENTER = 0.8, (0.0, 0.02, 0.06)
QUARTER = (0.0, 0.0, float(np.sqrt(0.5)), float(np.sqrt(0.5)))
"""The sensor's x axis along the y axis of the tool."""

PULL = MASS * 9.80665


def pose_of(arm: Any) -> Pose:
    pose: Pose = arm.measured_cp(age=0.0, wait=LONG)
    return pose


def coupled(sim: RunningSim, carried: Carried, look: Callable[[], Pose | None]) -> Coupling:
    """Return what lets a sensor feel its tool."""

    def told() -> Told | None:
        pose = look()
        return None if pose is None else (pose, 1)

    assert PLUGIN.sim_load is not None
    return Coupling(sim, Followed("arm", "ft", Weight(sim, PLUGIN.sim_load, carried)), told)


def test_the_weight_turns_as_the_arm_does() -> None:
    """Held against what the driver itself takes off for a tool, and against a table for one pose."""
    settings = {
        "tool": {"mass": MASS, "center_of_mass": CENTER},
        "mounting": [0.0, 0.0, float(np.pi / 2.0)],
        "orientation_timeout": 5.0,
    }
    with (
        rarely_fed(),
        crtk_drivers.connect("ur", sim=True, model="ur5e") as arm,
        netft_bench(settings) as bench,
        coupled(bench.sim, Carried(MASS, CENTER, QUARTER), lambda: pose_of(arm)),
    ):
        arm.enable()
        bench.device.follow(arm)
        arm.trajectory_j.set_ratio(0.5)  # a busy machine leaves the arm behind its setpoints
        for turn in (0.0, 0.4, -0.5):
            goal = arm.measured_js(wait=LONG).position + np.repeat((0.0, turn), 3)
            arm.move_jp(goal).wait(LONG)
            bench.until_load([0.0] * 6, tolerance=0.02)
            raw = bench.front.raw.measured_cf(age=0.2, wait=LONG)
            assert np.linalg.norm(raw.force) == pytest.approx(PULL, abs=0.02)
            # The sensor's x axis is the tool's y axis, its y axis the opposite of the tool's x axis.
            turned = pose_of(arm).orientation
            x, y, z, w = turned.tolist()
            down = [-2 * (x * z - y * w), -2 * (y * z + x * w), 2 * (x * x + y * y) - 1]
            assert raw.force == pytest.approx(
                [PULL * down[1], -PULL * down[0], PULL * down[2]], abs=0.02
            )


def test_it_survives_that_the_arm_or_the_driver_is_started_again() -> None:
    upright = Pose(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
    over = Pose(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
    told: dict[str, Pose | None] = {"pose": None}

    def look() -> Pose | None:
        if "gone" in told:
            raise CrtkError("the arm is not there")
        return told["pose"]

    with netft_bench() as bench, coupled(bench.sim, Carried(MASS), look):
        told["pose"] = upright
        bench.until_load([0.0, 0.0, -PULL, 0.0, 0.0, 0.0], tolerance=1e-3)
        told["gone"] = None
        told["pose"] = over
        bench.front.close()
        with driver_at(bench.sim) as again:
            again.until_load([0.0, 0.0, -PULL, 0.0, 0.0, 0.0], tolerance=1e-3)
            del told["gone"]
            again.until_load([0.0, 0.0, PULL, 0.0, 0.0, 0.0], tolerance=1e-3)


@pytest.mark.slow
def test_it_goes_on_after_its_simulator_hung(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    upright = Pose(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
    told = {"pose": upright}
    with netft_bench() as bench, coupled(bench.sim, Carried(MASS), lambda: told["pose"]):
        bench.until_load([0.0, 0.0, -PULL, 0.0, 0.0, 0.0], tolerance=1e-3)
        bench.sim.suspend()
        told["pose"] = Pose(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
        eventually(lambda: "does not follow the arm: no answer" in caplog.text, "it is told")
        bench.sim.resume()
        bench.until_load([0.0, 0.0, PULL, 0.0, 0.0, 0.0], tolerance=1e-3)
        # What was asked while it hung it does in any case; that it answers again is another matter.
        eventually(
            lambda: caplog.text.count("ft: its simulator follows the arm") == 2, "it answers"
        )
        told["pose"] = upright
        bench.until_load([0.0, 0.0, -PULL, 0.0, 0.0, 0.0], tolerance=1e-3)


def test_it_ends_with_its_simulator() -> None:
    with netft_bench() as bench:
        upright = Pose(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
        coupling = coupled(bench.sim, Carried(MASS), lambda: upright)
        with coupling:
            bench.until_load([0.0, 0.0, -PULL, 0.0, 0.0, 0.0], tolerance=1e-3)
            bench.sim.stop()
            eventually(lambda: not coupling.runs, "it has ended")


ARM = '[devices.arm]\nplugin = "{}"\n{}\n'
FT = """[devices.ft]
plugin = "ati-netft"
on = "arm"
tool = {{ mass = 0.8, center_of_mass = [0, 0.02, 0.06] }}
mounting = {{ rpy = [0, 0, 1.5] }}
{}
"""
REAL = 'settings = { host = "192.168.1.10" }'


@pytest.mark.parametrize(
    ("arm", "ft", "sim", "felt_on"),
    [
        (ARM.format("ur", REAL), FT.format(REAL.replace("10", "20")), False, ""),
        (ARM.format("ur", REAL), FT.format(REAL.replace("10", "20")), True, "/arm"),
        (ARM.format("ur", REAL), FT.format("sim = true"), False, ""),
        (ARM.format("ur", "sim = true"), FT.format(REAL), False, ""),
        (ARM.format("ur", "sim = true"), FT.format("sim = true"), False, "/arm"),
        (ARM.format("virtual", ""), FT.format("sim = true"), False, "/arm"),
    ],
    ids=["real", "--sim", "real arm", "real sensor", "simulated", "model"],
)
def test_only_what_is_simulated_is_coupled(
    arm: str, ft: str, sim: bool, felt_on: str, tmp_path: Path
) -> None:
    path = tmp_path / "lab.toml"
    path.write_text(arm + ft)
    device = load_lab(path, sim=sim).devices["ft"]
    assert (device.coupled.on if device.coupled else "") == felt_on
    command = device_command(device, tmp_path / "ft.yaml")
    given = [command[at + 1] for at, text in enumerate(command) if text == "--sim-carried"]
    assert bool(given) is bool(felt_on)
    if felt_on:
        # What the command line gives is what the lab file has, with the namespace of the arm.
        entry = load(CarriedEntry, from_assignments(CarriedEntry, given, "--sim-carried"))
        assert entry == device.coupled
        assert entry.carriers == (felt_on,)


def test_a_sensor_whose_arm_is_not_started_is_not_coupled(tmp_path: Path) -> None:
    path = tmp_path / "lab.toml"
    path.write_text(ARM.format("virtual", "") + FT.format("sim = true"))
    assert load_lab(path, only=("ft",)).devices["ft"].coupled is None


TRACKER = """[devices.polaris]
plugin = "ndi"
settings.tools = [{{ name = "a", part_number = "A" }}, {{ name = "b", serial_number = "34AB" }}]
{}
"""
TRACKED = """sim = true
stands = { position = [1.6, 0.2, 0.5], rpy = [0, 1.5708, 0] }
markers.a = { on = "arm", mounting = { position = [0.02, -0.05, 0.11] } }
"""


@pytest.mark.parametrize(
    ("arm", "tracker", "markers"),
    [
        ("sim = true", TRACKED, ["a"]),
        (REAL, TRACKED, []),
        ("sim = true", 'sim = true\nmarkers.a = { on = "arm" }', []),
        ("sim = true", TRACKED.replace("sim = true", 'settings.host = "192.168.1.30"'), []),
        ("sim = true", f'{TRACKED}markers.b = {{ on = "arm" }}', ["a"]),
    ],
    ids=["simulated", "real arm", "stands nowhere", "real tracker", "unknown to the simulator"],
)
def test_only_simulated_markers_are_coupled(
    arm: str, tracker: str, markers: list[str], tmp_path: Path
) -> None:
    path = tmp_path / "lab.toml"
    path.write_text(TRACKER.format(tracker) + ARM.format("ur", arm))
    lab = load_lab(path)
    device = lab.devices["polaris"]
    assert list(lab.devices) == ["arm", "polaris"], "what carries comes first"
    assert list(device.coupled.markers if device.coupled else ()) == markers
    command = device_command(device, tmp_path / "polaris.yaml")
    given = [command[at + 1] for at, text in enumerate(command) if text == "--sim-carried"]
    if not markers:
        assert not given
        return
    # What the command line gives is what the lab file has, with the namespace of the arm.
    entry = load(CarriedEntry, from_assignments(CarriedEntry, given, "--sim-carried"))
    assert entry == device.coupled
    assert entry.carriers == ("/arm",)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ('markers.c = { on = "arm" }', "no tool 'c' that it sees.*There is: a, b"),
        ('markers.a = { on = "leg" }', "there is no device 'leg'"),
        ("markers.a = {}", "on"),
        ("stands = { position = [1, 0, 0] }", "stands: needs `markers`"),
    ],
)
def test_a_marker_that_is_wrong_is_told(text: str, told: str, tmp_path: Path) -> None:
    path = tmp_path / "lab.toml"
    path.write_text(ARM.format("ur", "sim = true") + TRACKER.format(f"sim = true\n{text}"))
    with pytest.raises(ConfigError, match=told):
        load_lab(path)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("tool = { mass = 1.0 }", "tool: needs `on`"),
        ("mounting = { rpy = [0, 0, 1] }", "mounting: needs `on`"),
        ('on = "arm"\ntool = { mas = 1.0 }', "mass"),
        ('on = "arm"\ntool = { mass = -1.0 }', "mass"),
        ('on = "arm"\nmounting = { rpy = [0, 0] }', "rpy"),
    ],
)
def test_what_is_wrong_is_told(text: str, told: str, tmp_path: Path) -> None:
    path = tmp_path / "lab.toml"
    path.write_text(
        ARM.format("virtual", "") + f'[devices.ft]\nplugin = "ati-netft"\nsim = true\n{text}\n'
    )
    with pytest.raises(ConfigError, match=told):
        load_lab(path)

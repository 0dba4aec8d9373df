"""``crtk-driver lab new --scan``: a lab file of what answers, simulators at the other end of the wires."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from crtk_driver_canopen import finding as canopen_finding
from crtk_driver_canopen import plugin as canopen
from crtk_driver_dynamixel import finding as dynamixel_finding
from crtk_driver_robotiq import finding as robotiq_finding
from crtk_drivers import plugins
from crtk_drivers.cli import lab_scan, main
from crtk_drivers.cli.lab_scan import lab_text
from crtk_drivers.kit import adapters
from crtk_drivers.labs import load_lab
from crtk_drivers.plugins import FoundDevice
from crtk_sim_backends.canopen import SIM as CANOPEN
from crtk_sim_backends.dynamixel import SIM as DYNAMIXEL


@pytest.fixture(scope="module")
def tty() -> Iterator[str]:
    with DYNAMIXEL.spawn(servos="3:xm430-w350,5:xl330-m288@52,9:ax-12a", timing="none") as running:
        yield next(iter(running.ttys.values()))


@pytest.fixture(scope="module")
def hub() -> Iterator[str]:
    with CANOPEN.spawn(first_node=4, nodes=2) as running:
        yield f"crtk:{running.paths['crtk']}"


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ask few, and wait for drives that others keep from the processor."""
    monkeypatch.setattr(dynamixel_finding, "BAUDS", (57_600, 1_000_000))
    monkeypatch.setattr(dynamixel_finding, "IDS", range(1, 11))
    monkeypatch.setattr(robotiq_finding, "ADDRESSES", range(8, 11))
    monkeypatch.setattr(canopen_finding, "WAIT", 1.0)


@pytest.fixture
def nothing_there(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(adapters, "BY_ID", tmp_path / "none")
    monkeypatch.setattr(adapters, "_NAMES", ("no such adapter*",))
    monkeypatch.setattr(canopen_finding, "_INTERFACES", tmp_path / "none")


def test_what_answers_is_in_the_file(
    tty: str, hub: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "lab.toml"
    assert main(["lab", "new", str(path), "--scan", "--at", tty, "--at", hub]) == 0
    told = capsys.readouterr()
    assert "xm430-w350 (id 3), xl330-m288 (id 5), ax-12a (id 9)" in told.err
    unknown = (
        "ati-netft, copley, dvrk, force-dimension, galil, haply, inputs, ndi, onrobot, openhaptics, "
        "optoforce, raven, robotiq-epick, ros2-control, schunk, schunk-fts, ur, weiss-wsg"
    )
    assert f"Cannot be looked for, so enter their addresses: {unknown}." in told.err
    assert "crtk-driver lab check" in told.out
    devices: dict[str, Any] = tomllib.loads(path.read_text())["devices"]
    assert list(devices) == ["canopen", "dynamixel"]
    settings = devices["dynamixel"]["settings"]
    assert (settings["port"], settings["baud"]) == (tty, 1_000_000)
    assert settings["joints"] == {
        "joint_1": {"id": 3, "model": "xm430-w350"},
        "joint_2": {"id": 5, "model": "xl330-m288"},
        "joint_3": {"id": 9, "model": "ax-12a", "protocol": 1},
    }
    bus = devices["canopen"]["settings"]["bus"]
    assert f"{bus['interface']}:{bus['channel']}" == hub
    joints = devices["canopen"]["settings"]["joints"]
    assert [joint["node"] for joint in joints.values()] == [4, 5]
    assert main(["lab", "check", str(path)]) == 2, "a drive does not tell its limits"
    assert "joints.joint_2.velocity: is required" in capsys.readouterr().err


def test_a_chain_of_servos_can_be_brought_up_at_once(tty: str, tmp_path: Path) -> None:
    path = tmp_path / "lab.toml"
    assert main(["lab", "new", str(path), "--scan", "--at", tty]) == 0
    (device,) = load_lab(path).devices.values()
    assert device.config.joints["joint_2"].id == 5


@pytest.mark.usefixtures("nothing_there")
def test_where_nothing_is_found_that_is_told_and_nothing_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "lab.toml"
    assert main(["lab", "new", str(path), "--scan"]) == 1
    told = capsys.readouterr().err
    assert "canopen: there is no place to look at" in told
    assert "dynamixel: there is no place to look at" in told
    assert "Nothing was found" in told
    assert not path.exists()


def test_a_place_that_cannot_be_opened_does_not_keep_the_others_from_it(
    hub: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "lab.toml"
    assert main(["lab", "new", str(path), "--scan", "--at", "/dev/no-such", "--at", hub]) == 0
    assert "not possible: " in capsys.readouterr().err
    assert list(tomllib.loads(path.read_text())["devices"]) == ["canopen"]


def test_a_finder_that_returns_something_else_is_named_and_keeps_no_other_from_it(
    hub: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    finder = plugins.device("dynamixel").finder
    canopen_finder = plugins.device("canopen").finder
    assert finder is not None
    wrong = replace(finder, look=lambda place: [{"port": place}])  # type: ignore[list-item]
    monkeypatch.setattr(
        lab_scan, "_finders", lambda: ({"wrong": wrong, "canopen": canopen_finder}, [])
    )
    path = tmp_path / "lab.toml"
    places = ["--at", "/dev/ttyUSB0", "--at", hub]
    assert main(["lab", "new", str(path), "--scan", *places]) == 0
    told = capsys.readouterr().err
    assert "the finder of wrong returned dict, must return FoundDevice objects" in told
    assert list(tomllib.loads(path.read_text())["devices"]) == ["canopen"]


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--at", "/dev/ttyUSB0"], "Add --scan"),
        (["--scan", "--at", "http://192.168.1.1"], "neither a serial port nor a CAN bus"),
    ],
)
def test_what_cannot_be_meant_is_refused(
    arguments: list[str], told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["lab", "new", str(tmp_path / "lab.toml"), *arguments]) == 2
    assert told in capsys.readouterr().err


def test_a_file_that_is_there_is_told_before_anything_is_looked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "lab.toml"
    path.write_text("mine")
    assert main(["lab", "new", str(path), "--scan", "--at", "/dev/no-such"]) == 2
    told = capsys.readouterr().err
    assert "is there already" in told
    assert "looking" not in told
    assert path.read_text() == "mine"


def test_can_interfaces_that_are_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, kind, flags in (("can0", 280, "0x40081"), ("can1", 280, "0x40080"), ("eth0", 1, "1")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "type").write_text(f"{kind}\n")
        (tmp_path / name / "flags").write_text(f"{flags}\n")
    monkeypatch.setattr(canopen_finding, "_INTERFACES", tmp_path)
    finder = canopen.PLUGIN.finder
    assert finder is not None
    assert list(finder.places()) == ["can0"]


def test_adapters_have_their_lasting_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "usb-ROBOTIS_1").touch()
    monkeypatch.setattr(adapters, "BY_ID", tmp_path)
    finder = plugins.device("dynamixel").finder
    assert finder is not None
    assert list(finder.places()) == [str(tmp_path / "usb-ROBOTIS_1")]


def test_any_text_that_hardware_tells_makes_a_file_that_is_read() -> None:
    settings = {"port": 'a "b" \\ é', "odd key": 1, "on": True, "in": {"x": [1, 2]}, "after": 2.5}
    found = {"ati-netft": [FoundDevice(settings, "a\n[b]\0\x7f"), FoundDevice({}, "")]}
    devices = tomllib.loads(lab_text(found))["devices"]
    assert devices["ati_netft"]["settings"] == settings
    assert devices["ati_netft_2"]["plugin"] == "ati-netft"

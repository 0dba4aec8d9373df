"""``crtk-driver robotiq info`` and ``calibrate`` at a simulated gripper."""

from __future__ import annotations

import socket

import pytest

from crtk_driver_robotiq import tools
from crtk_driver_robotiq.registers import COUNTS
from crtk_drivers.cli import main

SIM = [
    "--sim",
    *(f"--sim-set={name}_port=0" for name in ("tool", "modbus", "controller", "urcap")),
]


@pytest.fixture
def brisk(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a person is given time for, at full speed: nobody looks on."""
    monkeypatch.setattr(tools, "SLOW", COUNTS)


def test_info_tells_what_it_reports(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["robotiq", "info", *SIM]) == 0
    told = capsys.readouterr().out
    assert "2F-85" in told
    assert "done" in told
    assert "fault                   none" in told


@pytest.mark.sweep(2)
@pytest.mark.usefixtures("brisk")
@pytest.mark.parametrize("link", ["serial", "urcap"])
def test_calibrate_measures_the_band(link: str, capsys: pytest.CaptureFixture[str]) -> None:
    band = ["--sim-set=band_open=13", "--sim-set=band_closed=228"]
    assert main(["robotiq", "calibrate", "--move", f"--link={link}", *SIM, *band]) == 0
    assert "open_count = 13\nclosed_count = 228" in capsys.readouterr().out


def test_calibrate_moves_nothing_without_leave(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["robotiq", "calibrate", *SIM]) == 2
    assert "--move" in capsys.readouterr().out


@pytest.mark.usefixtures("brisk")
def test_calibrate_tells_what_is_in_the_way(capsys: pytest.CaptureFixture[str]) -> None:
    thing = "--sim-set=object_width=0.02"
    assert main(["robotiq", "calibrate", "--move", *SIM, thing]) == 1
    assert "met something" in capsys.readouterr().out


def test_calibrate_does_not_activate(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["robotiq", "calibrate", "--move", *SIM, "--sim-set=activated=false"]) == 1
    assert "not activated" in capsys.readouterr().out


@pytest.mark.parametrize("link", ["controller", "urcap"])
def test_scan_sends_no_serial_frames_there(link: str, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(0.0)
        port = server.getsockname()[1]
        words = [f"--link={link}", "--host=127.0.0.1", f"--tcp-port={port}"]
        assert main(["robotiq", "scan", *words]) == 1
        assert "by `info`" in capsys.readouterr().out
        with pytest.raises(BlockingIOError):
            server.accept()

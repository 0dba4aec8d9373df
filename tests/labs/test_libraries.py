"""A device of a lab whose library is missing, or whose driver dies, is known at once."""

from __future__ import annotations

import os
import signal
import tempfile
import time
from pathlib import Path

import pytest

from crtk_drivers.cli import main
from crtk_drivers.labs.bench import conductor
from crtk_drivers.labs.bench.bed import Process
from crtk_drivers.labs.bench.conducting import DeviceOrder
from crtk_drivers.labs.bench.door import DoorClosed

LAB = """[devices.gantry]
plugin = "loopback"

[devices.arm]
plugin = "ur"
settings = { host = "127.0.0.9", control = "ur_rtde" }
"""


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A lab in whose environment ur-rtde is not installed."""
    monkeypatch.setattr("crtk_driver_ur.plugin.find_spec", lambda _: None)
    monkeypatch.setenv("COLUMNS", "200")
    path = tmp_path / "lab.toml"
    path.write_text(LAB)
    return path


@pytest.mark.parametrize("words", [["lab", "check"], ["up"], ["bench"]], ids=" ".join)
@pytest.mark.parametrize("sim", [[], ["--sim"]], ids=["real", "simulated"])
def test_a_missing_library_is_known_before_anything_starts(
    lab: Path, words: list[str], sim: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*words, str(lab), *sim]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "lab.toml:4: arm: ur-rtde is not installed" in said
    assert "--extra ur" in said or "crtk-drivers[ur]" in said
    assert {path.name for path in lab.parent.iterdir()} == {"lab.toml"}


@pytest.mark.parametrize("plugin", ["canopen", "copley", "dynamixel", "galil"])
def test_joints_that_a_simulator_brings_may_be_missing(
    plugin: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "lab.toml"
    path.write_text(f'[devices.arm]\nplugin = "{plugin}"\nsim = true\n')
    assert main(["lab", "check", str(path)]) == 0
    assert "can be used" in capsys.readouterr().out
    path.write_text(f'[devices.arm]\nplugin = "{plugin}"\n')
    assert main(["lab", "check", str(path)]) == 2


def test_bench_does_not_wait_for_a_dead_driver(tmp_path: Path) -> None:
    order = DeviceOrder("gantry", "loopback", {}, False, {}, None)
    with (
        tempfile.TemporaryDirectory() as doors,
        conductor.hosted(order, Path(doors), tmp_path, (), lambda: None) as host,
    ):
        os.kill(host.pid(Process.DRIVER), signal.SIGKILL)
        began = time.monotonic()
        with pytest.raises(DoorClosed, match="process ended with exit code -9"):
            host.about()
        assert time.monotonic() - began < 0.5 * conductor.START_TIMEOUT

"""Commands of a lab file that cannot be run are refused before anything is started."""

from __future__ import annotations

import stat
import sys
from pathlib import Path

import pytest

from crtk_drivers.cli import main
from crtk_drivers.errors import ConfigError
from crtk_drivers.labs import load_lab
from crtk_drivers.labs.lab_commands import require_commands

GANTRY = '[devices.gantry]\nplugin = "loopback"\n'
SENSOR = '[devices.ft]\nplugin = "ati-netft"\nsettings = { host = "127.0.0.9" }\n'


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("COLUMNS", "300")
    return tmp_path / "lab.toml"


def script(path: Path, text: str, mode: int = 0o755) -> None:
    path.write_text(text)
    path.chmod(mode)


@pytest.mark.parametrize("words", [["lab", "check"], ["up"], ["bench"]], ids=" ".join)
@pytest.mark.parametrize(
    ("command", "why"),
    [
        ('[""]', "names no program"),
        ('["nowhere-at-all", "off"]', "there is no program 'nowhere-at-all' in PATH"),
        ('["./nowhere"]', "there is no program './nowhere'"),
        ('["/"]', "there is no program '/'"),
    ],
)
def test_power_off_that_cannot_run_is_refused(
    lab: Path, words: list[str], command: str, why: str, capsys: pytest.CaptureFixture[str]
) -> None:
    lab.write_text(f"{GANTRY}power_off = {command}\n")
    assert main([*words, str(lab)]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "lab.toml:3: " in said
    assert why in said
    assert [path.name for path in lab.parent.iterdir()] == ["lab.toml"], "nothing was begun"


@pytest.mark.parametrize("words", [["lab", "check"], ["up"]], ids=" ".join)
def test_a_program_that_cannot_run_is_refused(
    lab: Path, words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    lab.write_text(f'{GANTRY}[programs.teleop]\ncommand = ["teleop.py"]\n')
    assert main([*words, str(lab)]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "lab.toml:4: cannot be run: there is no program 'teleop.py' in PATH" in said


@pytest.mark.parametrize(
    ("text", "mode", "why"),
    [
        ("#!/bin/sh\n", 0o644, "is not executable"),
        ("echo off\n", 0o755, "is a script without #!"),
        ("", 0o755, "is a script without #!"),
        ("#!\n", 0o755, "names no program after #!"),
        ("#!/nowhere/python\n", 0o755, "there is no program '/nowhere/python'"),
        ("#!/usr/bin/env nowhere-at-all\n", 0o755, "there is no program 'nowhere-at-all' in PATH"),
    ],
)
def test_a_script_that_cannot_run_is_refused(lab: Path, text: str, mode: int, why: str) -> None:
    script(lab.parent / "off", text, mode)
    lab.write_text(f'{GANTRY}power_off = ["./off"]\n')
    with pytest.raises(ConfigError, match=why) as caught:
        require_commands(load_lab(lab))
    assert f"{lab}:3" in str(caught.value)


@pytest.mark.parametrize("text", ["#!/bin/sh\n", "#! /usr/bin/env -S A=b sh -e\n"])
def test_a_command_that_can_run_is_taken(lab: Path, text: str) -> None:
    """A script beside the lab file, whatever folder this process is in; one that may not be read."""
    script(lab.parent / "off", text)
    lab.write_text(f'{GANTRY}power_off = ["./off", "now"]\n[programs.p]\ncommand = ["true"]\n')
    require_commands(load_lab(lab))
    (lab.parent / "off").chmod(stat.S_IXUSR)
    require_commands(load_lab(lab))
    lab.write_text(f'{GANTRY}power_off = ["{sys.executable}"]\n')
    require_commands(load_lab(lab))


def test_what_is_never_run_may_be_missing(lab: Path) -> None:
    """The power of a simulated device, and programs where the bench alone is meant."""
    lab.write_text(f'{SENSOR}power_off = ["nowhere"]\n[programs.p]\ncommand = ["nowhere"]\n')
    require_commands(load_lab(lab, sim=True), programs=False)
    for sim, programs in ((False, False), (True, True)):
        with pytest.raises(ConfigError, match="there is no program 'nowhere'"):
            require_commands(load_lab(lab, sim=sim), programs=programs)

"""``crtk-driver check ur``: what would refuse `enable` is found before, at the simulated controller."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from crtk_drivers.cli import check_command, main
from crtk_drivers.cli.check_command import Finding
from crtk_drivers.engine import Engine
from crtk_sim_backends.ur import SIM
from rigs.waiting import eventually

PATIENT = ["--sample-timeout", "10", "--open-timeout", "60"]
"""A busy machine is no fault."""

CASES = {
    "another model": ({"model": "ur10e"}, ["this is no ur5e", "Set `model` to the arm"]),
    "another model, without power": (
        {"model": "ur10e", "powered_on": False},
        ["this is no ur5e", "the links of the controller's arm"],
    ),
    "local control": ({"remote": False}, ["the teach pendant has control", "remote control"]),
}


@pytest.mark.parametrize(("options", "words"), CASES.values(), ids=CASES)
def test_check_says_what_would_refuse_enable(
    capsys: pytest.CaptureFixture[str], options: Mapping[str, Any], words: list[str]
) -> None:
    with SIM.spawn(**options) as sim:
        assert main(["check", "ur", "--host", sim.host, "--model", "ur5e", *PATIENT]) == 1
    text = " ".join(capsys.readouterr().out.split())
    assert re.search(r"enable +failed", text)
    for each in words:
        assert each in text
    assert "not ready: " in text


def test_check_sees_more_than_a_stop_that_enable_unlocks(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with SIM.spawn() as sim:
        sim.control.inject("protective_stop")
        sim.control.inject("local_control")
        unlocks = ["--set", "enable_unlocks=true"]
        assert main(["check", "ur", "--host", sim.host, *unlocks, *PATIENT]) == 1
    text = " ".join(capsys.readouterr().out.split())
    assert re.search(r"enable +failed +the teach pendant has control", text)


@pytest.mark.parametrize("calibration", ["auto", "nominal", "its own"])
def test_check_lets_a_calibrated_arm_pass(
    calibration: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with SIM.spawn(calibration=3.0) as sim:
        options = [] if calibration == "auto" else ["--set", f"calibration={calibration}"]
        if calibration == "its own":
            file = tmp_path / "ur.yaml"
            assert main(["ur", "info", "--host", sim.host, "--output", str(file)]) == 0
            options = ["--config", str(file)]
        assert main(["check", "ur", "--host", sim.host, *options, *PATIENT]) == 0
    assert re.search(r"enable +ok", capsys.readouterr().out)


def test_check_says_it_once_where_the_state_is_fault(capsys: pytest.CaptureFixture[str]) -> None:
    with SIM.spawn() as sim:
        sim.control.inject("emergency_stop")
        assert main(["check", "ur", "--host", sim.host, *PATIENT]) == 1
    text = " ".join(capsys.readouterr().out.split())
    assert text.count("emergency stop on the teach pendant") == 1
    assert "not ready: 1 of" in text


@pytest.mark.parametrize("unlocks", [True, False])
def test_a_fault_is_not_ready(capsys: pytest.CaptureFixture[str], unlocks: bool) -> None:
    with SIM.spawn() as sim:
        sim.control.inject("protective_stop")
        setting = ["--set", f"enable_unlocks={str(unlocks).lower()}"]
        assert main(["check", "ur", "--host", sim.host, *setting, *PATIENT]) == 1
    text = " ".join(capsys.readouterr().out.split())
    assert re.search(r"operating state failed FAULT: .*protective stop", text)
    assert "not ready: 1 of" in text


def test_a_link_lost_while_the_rate_is_measured_is_not_ready(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with SIM.spawn() as sim:
        measure = check_command._check_rate

        def lose(engine: Engine) -> Iterator[Finding]:
            sim.stop()
            eventually(lambda: not engine.connected, "the link is lost")
            return measure(engine)

        monkeypatch.setattr(check_command, "_check_rate", lose)
        assert main(["check", "ur", "--host", sim.host, *PATIENT]) == 1
    text = " ".join(capsys.readouterr().out.split())
    assert re.search(r"operating state failed FAULT: ", text)
    assert "not ready: 1 of" in text

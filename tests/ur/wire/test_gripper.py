"""A gripper at the tool of an arm: its line is switched on, and it is a device of its own behind the arm."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import crtk_drivers
from crtk_driver_ur.config import ToolLineConfig, UrConfig
from crtk_driver_ur.tool_line import script_of
from crtk_drivers.cli import main
from crtk_drivers.config import AttachedConfig, from_values, load
from crtk_drivers.errors import ConfigError, PluginError
from rigs.waiting import LONG, eventually

PATIENT = {"sample_timeout": 3.0, "watchdog_frequency": 2.0}


def test_the_program_that_switches_the_line_on() -> None:
    assert script_of(ToolLineConfig()) == (
        "sec crtk_tool_line():\n"
        "  set_tool_voltage(24)\n"
        "  set_tool_communication(True, 115200, 0, 1, 1.5, 3.5)\n"
        "end\n"
    )
    other = ToolLineConfig(voltage=12, baud=1000000, parity="even", stop_bits=2)
    assert "set_tool_communication(True, 1000000, 2, 2, 1.5, 3.5)" in script_of(other)


def test_the_name_alone_stands_for_the_table() -> None:
    config = load(UrConfig, from_values({"gripper": "robotiq"}))
    assert config.gripper == AttachedConfig(plugin="robotiq")


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"model": "ur5", "gripper": "robotiq"}, "CB3"),
        ({"model": "ur5", "tool_line": {}}, "CB3"),
        ({"gripper": "ati-netft"}, "cannot hang at the tool"),
        ({"gripper": {"plugin": "robotiq", "settings": {"modell": "2f-85"}}}, "modell"),
        ({"gripper": {"plugin": "robotiq", "setting": {}}}, "setting"),
    ],
)
def test_what_cannot_hang_there_is_refused(values: dict[str, Any], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        crtk_drivers.connect("ur", host="127.0.0.1", **values)


def test_an_unknown_gripper_is_told() -> None:
    with pytest.raises(PluginError, match="robotik"):
        crtk_drivers.connect("ur", host="127.0.0.1", gripper="robotik")


@pytest.fixture(scope="module")
def shared() -> Iterator[Any]:
    with crtk_drivers.connect("ur", sim=True, gripper="robotiq", **PATIENT) as arm:
        yield arm


@pytest.fixture
def arm(shared: Any) -> Any:
    """Both connected, the fingers open and with nothing between them."""
    shared.sim.control.clear()
    shared.sim.tool.control.clear()
    shared.enable()
    eventually(lambda: shared.gripper.operating_state().state != "FAULT", "reached")
    shared.gripper.enable()
    shared.gripper.move_jp([0.06]).wait(LONG)
    return shared


def opening(arm: Any) -> float:
    return float(arm.sim.tool.control.status()["opening"])


def test_it_grips_while_the_arm_moves(arm: Any) -> None:
    arm.sim.tool.control.inject("object", width=0.03)
    goal = arm.setpoint_jp() + 0.1 * np.eye(6)[5]
    move, grip = arm.move_jp(goal), arm.gripper.move_jp([0.0])
    assert move.wait(LONG)
    assert grip.wait(LONG)
    eventually(arm.gripper.state.holds, "held")
    assert arm.gripper.measured_js().position[0] == pytest.approx(0.03, abs=0.003)


def test_its_state_is_its_own(arm: Any) -> None:
    arm.gripper.disable()
    assert arm.is_enabled()
    arm.gripper.enable()
    arm.sim.tool.control.inject("gripper_fault", code=0xE)
    assert arm.gripper.wait_for_operating_state("FAULT", LONG)
    assert arm.is_enabled()
    arm.sim.tool.control.clear()
    arm.gripper.enable()


def test_an_emergency_stop_takes_its_power_and_nothing_opens(arm: Any) -> None:
    arm.sim.tool.control.inject("object", width=0.03)
    arm.gripper.move_jp([0.0]).wait(LONG)
    eventually(arm.gripper.state.holds, "held")
    arm.sim.control.inject("emergency_stop")
    assert arm.gripper.wait_for_operating_state("FAULT", LONG)
    arm.sim.control.clear()
    arm.enable()
    assert arm.gripper.wait_for_operating_state("DISABLED", LONG)
    assert opening(arm) < 0.034


def test_the_command_line_takes_its_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["ur", "--help"]) == 0
    assert "--gripper" in capsys.readouterr().out
    assert main(["ur", "info", "--sim", "--gripper", "robotik"]) != 0


def test_both_simulators_end_with_the_session() -> None:
    with crtk_drivers.connect("ur", sim=True, gripper="robotiq", timeout=LONG, **PATIENT) as arm:
        running: Any = arm.sim
        assert running.running
        assert running.tool.running
    assert not running.running
    assert not running.tool.running

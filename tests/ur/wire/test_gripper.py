"""A gripper at the tool of an arm: its line is switched on, and it is a device of its own behind the arm."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np
import pytest
from typing_extensions import override

import crtk_drivers
from crtk_driver_ur.config import ToolLineConfig, UrConfig
from crtk_driver_ur.tool_line import ToolLine, script_of
from crtk_drivers.cli import main
from crtk_drivers.config import AttachedConfig, from_values, load
from crtk_drivers.errors import ConfigError, DataTimeout, PluginError, TransitionFailed
from crtk_drivers.testing import LoopbackDevice
from rigs.ur_bench import BRISK, lenient
from rigs.ur_watchdog import rarely_fed
from rigs.waiting import LONG, eventually

PATIENT = {"frequency": 125.0, "sample_timeout": 3.0}


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
        ({"gripper": {"plugin": "robotiq", "name": "hand"}}, "name"),
        (
            {"gripper": {"plugin": "robotiq", "payload_of_grip": {"empty": {"mass": 1.0}}}},
            "holding",
        ),
        (
            {
                "gripper": {
                    "plugin": "robotiq",
                    "payload_of_grip": {
                        "empty": {"mass": 1.0, "tcp": [0, 0, 0.1, 0, 0, 0]},
                        "holding": {"mass": 2.0},
                    },
                }
            },
            "of neither",
        ),
        (
            {
                "gripper": {
                    "plugin": "robotiq-ft300",
                    "payload_of_grip": {"empty": {"mass": 1.0}, "holding": {"mass": 2.0}},
                }
            },
            "does not tell whether it holds",
        ),
    ],
)
def test_what_cannot_hang_there_is_refused(values: dict[str, Any], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        crtk_drivers.connect("ur", host="127.0.0.1", **values)


class _AtTool(LoopbackDevice):
    """A gripper of somebody else, that names its place as pyserial does."""

    @property
    @override
    def address(self) -> str:
        return "socket://127.0.0.9:54321"


def test_a_device_at_the_line_may_name_it_as_a_socket() -> None:
    """Else its line stays off, and its connection is refused."""
    device = _AtTool()
    line = ToolLine(None, device, "127.0.0.9", {"baud": 9600}, has_line=True)
    assert line.device is not device
    assert ToolLine(None, device, "127.0.0.8", has_line=True).device is device
    with pytest.raises(ConfigError, match="rate"):
        ToolLine(None, device, "127.0.0.9", {"rate": 9600}, has_line=True)


def test_an_unknown_gripper_is_told() -> None:
    with pytest.raises(PluginError, match="robotik"):
        crtk_drivers.connect("ur", host="127.0.0.1", gripper="robotik")


@contextmanager
def connected(gripper: str | dict[str, Any], **values: Any) -> Iterator[Any]:
    """An arm with a gripper, of which a busy machine makes no fault."""
    hung = {"plugin": gripper} if isinstance(gripper, str) else gripper
    hung = {**hung, "settings": {"sample_timeout": 2.0, **hung.get("settings", {})}}
    values = {**PATIENT, **values}
    with (
        lenient(),
        rarely_fed(),
        crtk_drivers.connect(
            "ur", sim=True, sim_options=BRISK, gripper=hung, timeout=LONG, **values
        ) as arm,
    ):
        yield arm


def enable_after(arm: Any) -> None:
    """Enable once the driver has seen what has just ended at the controller."""
    before = arm.health().samples
    eventually(lambda: arm.health().samples > before + 1, "samples of now")
    arm.enable(timeout=LONG)


@pytest.fixture(scope="module")
def shared() -> Iterator[Any]:
    with connected("robotiq") as arm:
        yield arm


@pytest.fixture
def arm(shared: Any) -> Any:
    """Both connected, the fingers open and with nothing between them."""
    shared.sim.control.clear()
    shared.sim.tool.control.clear()
    shared.enable()
    eventually(lambda: shared.gripper.operating_state().state != "FAULT", "reached")
    shared.gripper.measured_js(age=0.5, wait=LONG)
    shared.gripper.enable()
    shared.gripper.move_jp([0.06]).wait(LONG)
    return shared


def told(gripper: Any) -> bool | None:
    """Return whether it holds something; None as long as that is not known, where its line was held up."""
    with suppress(DataTimeout):
        return bool(gripper.state.holds())
    return None


def opening(arm: Any) -> float:
    return float(arm.sim.tool.control.status()["opening"])


def test_it_grips_while_the_arm_moves(arm: Any) -> None:
    arm.sim.tool.control.inject("object", width=0.03)
    goal = arm.setpoint_jp() + 0.1 * np.eye(6)[5]
    move, grip = arm.move_jp(goal), arm.gripper.move_jp([0.0])
    assert move.wait(LONG)
    assert grip.wait(LONG)
    eventually(lambda: told(arm.gripper), "held")
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
    eventually(lambda: told(arm.gripper), "held")
    arm.sim.control.inject("emergency_stop")
    assert arm.gripper.wait_for_operating_state("FAULT", LONG)
    arm.sim.control.clear()
    enable_after(arm)
    assert arm.gripper.wait_for_operating_state("DISABLED", LONG)
    assert opening(arm) < 0.034


def test_the_command_line_takes_its_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["ur", "--help"]) == 0
    assert "--gripper" in capsys.readouterr().out
    assert main(["ur", "info", "--sim", "--gripper", "robotik"]) != 0


def test_a_gripper_has_the_line_that_it_wants() -> None:
    """An OnRobot gripper hears at 1 000 000 bit/s only."""
    with connected("onrobot") as arm:
        gripper: Any = arm.gripper
        arm.enable()
        eventually(lambda: gripper.operating_state().state == "DISABLED", "reached")
        arm.sim.tool.control.inject("object", width=0.03)
        gripper.enable()
        assert gripper.move_jp([0.0]).wait(LONG)
        eventually(lambda: told(gripper), "held")
        assert gripper.state.tool().startswith("RG2")


@pytest.mark.slow
def test_a_schunk_gripper_grips_there_as_well() -> None:
    with connected("schunk") as arm:
        gripper: Any = arm.gripper
        arm.enable()
        eventually(lambda: gripper.operating_state().state == "DISABLED", "reached")
        arm.sim.tool.control.inject("object", width=0.03)
        gripper.enable()
        assert gripper.move_jp([0.0]).wait(LONG)
        eventually(lambda: told(gripper), "held")


def test_both_simulators_end_with_the_session() -> None:
    with connected("robotiq") as arm:
        running: Any = arm.sim
        assert running.running
        assert running.tool.running
    assert not running.running
    assert not running.tool.running


JAW = {
    "plugin": "robotiq",
    "name": "jaw",
    "own_state": False,
    "settings": {"unit": "rad"},
    "payload_of_grip": {
        "empty": {"mass": 0.9, "center_of_gravity": [0.0, 0.0, 0.05], "tcp": [0, 0, 0.15, 0, 0, 0]},
        "holding": {
            "mass": 1.4,
            "center_of_gravity": [0.0, 0.0, 0.08],
            "tcp": [0, 0, 0.2, 0, 0, 0],
        },
    },
}


@pytest.fixture(scope="module")
def jawed() -> Iterator[Any]:
    """An arm whose gripper is a jaw without a state, and tells the arm what it carries."""
    with connected(JAW, power_off_on_disable=False) as arm:
        arm.enable()
        eventually(lambda: arm.jaw.engine.status.state == "ENABLED", "enabled with the arm")
        yield arm
        arm.sim.tool.control.clear()


def carries(arm: Any, mass: float, tool: float) -> None:
    """Wait until the controller has this payload, and the arm this tool."""
    state = lambda: arm.engine.device.robot_state  # noqa: E731
    eventually(lambda: state().payload == pytest.approx(mass), f"{mass} kg, only {state().payload}")
    eventually(lambda: state().tcp_offset[2] == pytest.approx(tool), f"a tool of {tool} m")


def test_a_stop_of_the_arm_ends_the_activation_of_its_jaw_though_neither_is_enabled(
    jawed: Any,
) -> None:
    jawed.disable()
    jaw = jawed.jaw.engine
    eventually(lambda: jaw.status.state == "DISABLED", "disabled with the arm")
    activation = jaw.request("activate")
    moves = lambda: jawed.sim.tool.control.status()["state"] == "activating"  # noqa: E731
    eventually(moves, "it is being activated")
    jawed.disable()
    with pytest.raises(TransitionFailed, match="broken off: by disable of ur"):
        activation.wait(LONG)
    jawed.enable()
    eventually(lambda: jaw.status.state == "ENABLED", "enabled with the arm")


def test_a_jaw_as_programs_for_dvrk_expect_it(jawed: Any) -> None:
    assert "state_command" not in jawed.jaw.crtk_commands
    jawed.jaw.move_jp([0.5]).wait(LONG)
    assert jawed.jaw.measured_js().position[0] == pytest.approx(0.5, abs=0.01)
    assert jawed.jaw.measured_js().name == ("opening",)


def test_payload_and_tool_follow_what_is_gripped(jawed: Any) -> None:
    jawed.jaw.move_jp([0.7]).wait(LONG)
    carries(jawed, 0.9, 0.15)
    jawed.sim.tool.control.inject("object", width=0.03)
    jawed.jaw.move_jp([0.0]).wait(LONG)
    carries(jawed, 1.4, 0.2)
    goal = jawed.setpoint_jp() + 0.05 * np.eye(6)[5]
    assert jawed.move_jp(goal).wait(LONG)
    jawed.jaw.move_jp([0.7]).wait(LONG)
    carries(jawed, 0.9, 0.15)


def test_what_is_lost_while_the_arm_moves_is_told_when_it_rests(jawed: Any) -> None:
    jawed.sim.tool.control.inject("object", width=0.03)
    jawed.jaw.move_jp([0.0]).wait(LONG)
    carries(jawed, 1.4, 0.2)
    before = jawed.health().refusals
    move = jawed.move_jp(jawed.setpoint_jp() + 0.3 * np.eye(6)[5])
    jawed.sim.tool.control.inject("object_lost")
    eventually(lambda: told(jawed.jaw) is False, "lost")
    assert move.wait(LONG)
    carries(jawed, 0.9, 0.15)
    assert jawed.health().refusals == before


def test_an_arm_that_was_away_is_told_again_what_it_carries(jawed: Any) -> None:
    """Its controller may have been without power, and forgotten it."""
    jawed.jaw.move_jp([0.7]).wait(LONG)
    carries(jawed, 0.9, 0.15)
    heard: list[str] = []
    before_it = jawed.engine.hearers
    jawed.engine.hearers = (*before_it, lambda name, value, stamp: heard.append(name))
    before = jawed.health().reconnects
    jawed.sim.control.inject("disconnect", port="rtde")
    eventually(lambda: jawed.health().reconnects > before, "lost")
    jawed.sim.control.clear("disconnect")
    eventually(lambda: "payload" in heard, "told again")
    jawed.engine.hearers = before_it

    def has_ended() -> bool:
        with suppress(DataTimeout):  # as long as no state has come by the new connection
            return jawed.state.program_running() is False
        return False

    jawed.sim.control.inject("stop_program")  # which its watchdog would do in two seconds
    eventually(has_ended, "the controller has ended our program")
    enable_after(jawed)


def test_untouched_where_nobody_asked(arm: Any) -> None:
    before = arm.engine.device.robot_state.payload
    arm.sim.tool.control.inject("object", width=0.03)
    arm.gripper.move_jp([0.0]).wait(LONG)
    eventually(lambda: told(arm.gripper), "held")
    assert arm.engine.device.robot_state.payload == before


# A controller whose time passes at half speed has a sensor that is late all the time.
# tests/robotiq/wire/test_ft300.py has the stream without a controller.
@pytest.mark.slow
def test_a_force_sensor_at_the_tool_has_the_line_at_its_rate() -> None:
    with connected("robotiq-ft300") as arm:
        eventually(lambda: arm.gripper.engine.has_sample, "measured")
        arm.gripper.enable()
        before = arm.gripper.health().samples
        eventually(lambda: arm.gripper.health().samples > before + 20, "a stream")

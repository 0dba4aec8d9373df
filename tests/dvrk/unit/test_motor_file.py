"""What driving needs of dVRK's file, and what is refused, with the place."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from crtk_driver_dvrk.motor_file import read_motors
from crtk_driver_dvrk.plugin import TYPICAL
from crtk_drivers.errors import ConfigError
from rigs.dvrk_bench import PSM, ZERO

Change = Callable[[dict[str, Any]], object]


def changed(path: Path, change: Change) -> str:
    """Write the simulated arm's file with a change, and return its path."""
    found = copy.deepcopy(PSM)
    change(found["robots"][0])
    io = path / "io.json"
    io.write_text(json.dumps(found))
    return str(io)


def drive(robot: dict[str, Any]) -> dict[str, Any]:
    """That of the third actuator."""
    found: dict[str, Any] = robot["actuators"][2]["drive"]
    return found


def test_the_motors_of_the_simulated_arm() -> None:
    motors = read_motors(TYPICAL["io"])
    assert [(motor.board, motor.axis) for motor in motors] == [
        (6, 0), (6, 1), (6, 2), (6, 3), (7, 0), (7, 1), (7, 2)]  # fmt: skip
    assert [motor.zero for motor in motors] == ZERO
    assert [motor.is_linear for motor in motors] == [False, False, True] + [False] * 4
    assert motors[0].most == 1.34
    assert (motors[2].apart, motors[2].latency) == (0.01, 0.05)


def test_soft_limits_are_those_of_the_encoder(tmp_path: Path) -> None:
    limits = {"lower": -0.1, "upper": 0.2}
    io = changed(
        tmp_path, lambda r: r["actuators"][0]["encoder"].update(position_limits_soft=limits)
    )
    assert (read_motors(io)[0].lower, read_motors(io)[0].upper) == (-0.1, 0.2)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda r: r.update(number_of_brakes=3), "has 3 brakes"),
        (lambda r: r.update(brakes=[{"board_id": 6, "axis_id": 3}]), "has 1 brakes"),
        (lambda r: r.update(only_IO=True), "only_IO"),
        (lambda r: drive(r).pop("maximum_current"), "maximum_current: Field required"),
        (lambda r: drive(r).update(maximum_current=0.0), "maximum_current"),
        (lambda r: drive(r).update(maximum_current=7.0), "the converter does not have"),
        (lambda r: drive(r).pop("current_to_bits"), "current_to_bits: Field required"),
        (lambda r: drive(r)["current_to_bits"].update(scale=-5242.88), "contradict"),
        (lambda r: drive(r)["current_to_bits"].update(scale=0.0), "contradict"),
        (lambda r: drive(r)["current_to_bits"].update(offset=70_000.0), "the converter does not have"),
        (lambda r: drive(r)["current_to_bits"].update(offset=33_768.0), "is 0.191 A for the other"),
        (lambda r: drive(r).pop("effort_to_current"), "effort_to_current: Field required"),
        (lambda r: drive(r)["effort_to_current"].update(scale=0.0), "its scale must not be 0"),
        (lambda r: drive(r)["effort_to_current"].update(offset=0.1), "and its offset must"),
        (lambda r: r["potentiometers"]["tolerances"].pop(), "6 potentiometers.tolerances for 7"),
        (
            lambda r: r["actuators"][1]["encoder"].update(
                position_limits_soft={"lower": 1.0, "upper": 1.0}
            ),
            "1 is not below 1",
        ),
    ],
)  # fmt: skip
def test_what_cannot_be_driven_is_refused(tmp_path: Path, change: Change, words: str) -> None:
    with pytest.raises(ConfigError, match=words.replace(".", r"\.")):
        read_motors(changed(tmp_path, change))

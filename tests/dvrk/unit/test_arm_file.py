"""dVRK's files: what is read of them, and what is refused, with the place."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from crtk_driver_dvrk.arm_file import read_arm
from crtk_driver_dvrk.plugin import TYPICAL
from crtk_drivers.errors import ConfigError
from rigs.dvrk_bench import PSM

Change = Callable[[dict[str, Any]], object]


def written(path: Path, found: object) -> str:
    """Write a file and return its path."""
    path.write_text(found if isinstance(found, str) else json.dumps(found))
    return str(path)


def changed(path: Path, change: Change) -> str:
    """Write the simulated arm's file with a change and return its path."""
    found = copy.deepcopy(PSM)
    change(found)
    return written(path / "io.json", found)


def actuator(found: dict[str, Any], at: int = 2) -> dict[str, Any]:
    """One actuator of a file."""
    each: dict[str, Any] = found["robots"][0]["actuators"][at]
    return each


def test_the_simulated_arm_is_a_psm_with_an_instrument() -> None:
    arm = read_arm(TYPICAL["io"], coupling=TYPICAL["coupling"])
    assert (arm.name, arm.serial_number, arm.boards) == ("PSM1", "simulated", (6, 7))
    assert [each.axis_id for each in arm.actuators] == [0, 1, 2, 3, 0, 1, 2]
    assert arm.has_potentiometers
    assert arm.has_efforts
    assert list(arm.inputs) == ["psm1_suj_clutch", "psm1_manip_clutch"]
    assert np.array_equal(arm.coupling[:3], np.eye(7)[:3])
    assert arm.coupling[5].tolist() == [0.0, 0.0, 0.0, 0.0, -0.8306, 0.6089, 0.6089]
    assert np.array_equal(arm.sensed, np.eye(7))


def test_without_a_coupling_joints_are_actuators() -> None:
    assert np.array_equal(read_arm(TYPICAL["io"]).coupling, np.eye(7))


def test_what_reading_does_not_need_may_be_missing(tmp_path: Path) -> None:
    def bare(found: dict[str, Any]) -> None:
        found.pop("digital_inputs")
        robot = found["robots"][0]
        for name in ("potentiometers", "hardware_version", "serial_number"):
            robot.pop(name)
        for each in robot["actuators"]:
            for name in ("drive", "potentiometer", "joint_type", "actuator_id"):
                each.pop(name)

    arm = read_arm(changed(tmp_path, bare))
    assert (arm.has_potentiometers, arm.has_efforts, arm.inputs) == (False, False, {})


def test_what_it_does_not_know_is_left_alone(tmp_path: Path) -> None:
    arm = read_arm(changed(tmp_path, lambda found: found.update(brakes=[{"axis_id": "?"}])))
    assert arm.name == "PSM1"


def test_potentiometers_at_joints_have_their_own_coupling(tmp_path: Path) -> None:
    matrix = np.eye(7)
    matrix[2, 1] = 1.0
    told = {"coupling": {"JointToActuatorPosition": matrix.tolist()}}
    arm = read_arm(changed(tmp_path, lambda f: f["robots"][0].update(potentiometers=told)))
    assert np.array_equal(arm.sensed, matrix)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda f: actuator(f).pop("encoder"), r"robots\.0\.actuators\.2\.encoder"),
        (
            lambda f: actuator(f)["encoder"]["bits_to_position"].pop("scale"),
            "bits_to_position.scale",
        ),
        (lambda f: actuator(f)["encoder"]["bits_to_position"].update(scale=0.0), "scale is 0"),
        (lambda f: actuator(f)["encoder"]["bits_to_position"].update(scale=float("nan")), "finite"),
        (lambda f: actuator(f)["drive"]["effort_to_current"].update(scale=0), "scale is 0"),
        (lambda f: actuator(f).update(board_id=16), "board_id"),
        (lambda f: actuator(f).update(axis_id=4), "axes 0 to 3"),
        (lambda f: actuator(f).update(axis_id=1), "actuators 1 and 2 are both axis 1 of board 6"),
        (lambda f: actuator(f).update(joint_type="SCREW"), "joint_type"),
        (lambda f: f["robots"][0].update(number_of_actuators=8), "has it been cut"),
        (lambda f: f["robots"][0].update(actuators=[]), "actuators"),
        (lambda f: f["robots"][0].update(hardware_version="dRA1"), "dRA1"),
        (lambda f: f.update(robots=[]), "robots"),
        (lambda f: f.pop("robots"), "sawRobotIO1394"),
        (lambda f: f["robots"].append(f["robots"][0]), "has 2 arms"),
        (lambda f: f.update(Robots=[]), "older release"),
    ],
)
def test_what_cannot_be_is_refused_with_its_place(
    tmp_path: Path, change: Change, words: str
) -> None:
    path = changed(tmp_path, change)
    with pytest.raises(ConfigError, match=f"(?i){words}") as caught:
        read_arm(path)
    assert caught.value.where == path


@pytest.mark.parametrize(
    "text", ["<Config/>", "[1, 2]", "3", "{", "[" * 100_000, '{"robots": null}']
)
def test_what_is_no_such_file_is_refused(tmp_path: Path, text: str) -> None:
    path = written(tmp_path / "io.json", text)
    with pytest.raises(ConfigError) as caught:
        read_arm(path)
    assert caught.value.remedy


def test_a_file_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read"):
        read_arm(str(tmp_path / "none.json"))


def test_one_of_several_arms_is_chosen_by_name(tmp_path: Path) -> None:
    other = {**copy.deepcopy(PSM["robots"][0]), "name": "PSM2"}
    path = changed(tmp_path, lambda f: f["robots"].append(other))
    assert read_arm(path, "PSM2").name == "PSM2"
    with pytest.raises(ConfigError, match=r"no arm 'ECM'.*PSM1, PSM2"):
        read_arm(path, "ECM")


@pytest.mark.parametrize(
    ("matrix", "words"),
    [
        ([[1.0, 0.0]], "square"),
        (np.eye(8).tolist(), "7 actuators"),
        ([[0.0]], "inverted"),
        ([], "ActuatorToJointPosition"),
        ([["a"]], "ActuatorToJointPosition"),
    ],
)
def test_a_coupling_that_cannot_be_is_refused(tmp_path: Path, matrix: object, words: str) -> None:
    path = written(tmp_path / "tool.json", {"coupling": {"ActuatorToJointPosition": matrix}})
    with pytest.raises(ConfigError, match=words) as caught:
        read_arm(TYPICAL["io"], coupling=path)
    assert caught.value.where == path

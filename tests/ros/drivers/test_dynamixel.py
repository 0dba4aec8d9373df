"""An arm and its gripper as a user has them: the command with --sim as a process, and the client."""

from __future__ import annotations

import signal
import subprocess
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from crtk_drivers.client import RemoteDevice, connect
from rigs.dynamixel_bench import PATIENT
from rigs.programs import COMMAND, Program, Start
from rigs.waiting import LONG, eventually


@pytest.fixture(scope="module")
def driver(start: Start) -> Iterator[Program]:
    values = {**PATIENT, "silent_timeout": 2.0, "watchdog": 2.5}
    patient = [part for name, value in values.items() for part in ("--set", f"{name}={value}")]
    arguments = ["dynamixel", "--ns", "/dynamixel_arm", "--sim", *patient]
    with start(COMMAND, *arguments, stderr=subprocess.PIPE) as process:
        yield process
        process.kill()


@pytest.fixture(scope="module")
def arm(driver: Program) -> Iterator[RemoteDevice]:
    with connect("/dynamixel_arm", timeout=LONG) as arm:
        eventually(lambda: arm.operating_state().state == "DISABLED", "connected")
        yield arm


def test_enable_move_and_disable_arm_and_gripper(arm: RemoteDevice) -> None:
    before = arm.measured_js(wait=LONG).position
    assert before.size == 6
    arm.enable(LONG)
    arm.gripper.enable(LONG)
    opening = arm.gripper.measured_js(wait=LONG).position
    assert arm.gripper.measured_js(wait=LONG).name == ("gripper",)
    goal = before + np.array([0.2, 0.0, 0.1, 0.0, 0.1, 0.2])
    move = arm.move_jp(goal)
    arm.gripper.move_jp(opening + 0.01).wait(LONG)
    move.wait(LONG)
    eventually(lambda: np.abs(arm.measured_js(wait=LONG).position - goal).max() < 6e-3, "there")
    eventually(
        lambda: abs(arm.gripper.measured_js().position - opening - 0.01).max() < 3e-4, "open"
    )
    assert arm.measured_cp(wait=LONG).position.size == 3
    arm.gripper.disable(LONG)
    assert arm.is_enabled()
    arm.disable(LONG)
    assert not arm.is_enabled()


def test_who_takes_the_gripper_for_a_joint_is_told_where_it_is(
    arm: RemoteDevice, run_far: Callable[..., tuple[int, str, str]]
) -> None:
    arm.enable(LONG)
    code, _, told = run_far("move", "/dynamixel_arm", "gripper=0.03", "--timeout", str(LONG))
    assert code == 2
    assert "a part of the device, not one of its joints" in told
    assert "crtk-driver move /dynamixel_arm --child gripper gripper=..." in told
    arm.disable(LONG)


def test_it_ends_on_a_signal(arm: RemoteDevice, driver: Program) -> None:
    driver.send_signal(signal.SIGINT)
    _, err = driver.communicate(timeout=LONG)
    assert driver.returncode == 0, err
    assert "Traceback" not in err

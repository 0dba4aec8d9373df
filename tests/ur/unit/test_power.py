"""The power of an arm, as the dashboard is asked for it."""

from __future__ import annotations

from collections.abc import Generator
from types import SimpleNamespace
from typing import Any, cast

import pytest

from crtk_driver_ur.control_link import ControlLink
from crtk_driver_ur.robot import Robot
from crtk_driver_ur.rtde.state_sample import StateSample
from crtk_driver_ur.safety import RobotMode, SafetyMode
from crtk_drivers.errors import TransitionFailed


class Dashboard:
    """Takes what it is asked for, and says yes; or no where it `refuses`."""

    def __init__(self, *, refuses: bool = False) -> None:
        self.asked: list[str] = []
        self._refuses = refuses

    def ask(self, name: str) -> Generator[None, None, None]:
        self.asked.append(name)
        yield
        if self._refuses:
            raise TransitionFailed(f"{name}: no")


def arm_at(dashboard: Dashboard, mode: RobotMode) -> Robot:
    robot = Robot(cast(ControlLink, dashboard), "an arm", needs_remote=False)
    robot.take(told(mode))
    return robot


def told(mode: RobotMode) -> StateSample:
    state: Any = SimpleNamespace(robot_mode=mode, safety_mode=SafetyMode.NORMAL, timestamp=0.0)
    return cast(StateSample, state)


def test_power_that_was_asked_for_and_does_not_show_yet_is_switched_off() -> None:
    dashboard = Dashboard()
    robot = arm_at(dashboard, RobotMode.POWER_OFF)
    steps = robot.power_on()
    next(steps)
    steps.close()
    robot.take(told(RobotMode.POWER_OFF))
    assert robot.has_power
    list(robot.power_off())
    assert dashboard.asked == ["power_on", "power_off"]
    assert not robot.has_power


def test_an_arm_whose_power_was_refused_is_not_switched_off() -> None:
    dashboard = Dashboard(refuses=True)
    robot = arm_at(dashboard, RobotMode.POWER_OFF)
    with pytest.raises(TransitionFailed):
        list(robot.power_on())
    assert not robot.has_power
    list(robot.power_off())
    assert dashboard.asked == ["power_on"]


def test_power_that_came_and_went_is_gone() -> None:
    dashboard = Dashboard()
    robot = arm_at(dashboard, RobotMode.POWER_OFF)
    next(robot.power_on())
    robot.take(told(RobotMode.IDLE))
    assert robot.has_power
    robot.take(told(RobotMode.POWER_OFF))
    assert not robot.has_power

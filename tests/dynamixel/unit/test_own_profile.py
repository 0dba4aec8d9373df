"""When a servo that takes its time has come to its goal, or stands where something holds it."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from crtk_driver_dynamixel.config import ServoConfig
from crtk_driver_dynamixel.own_profile import Approach

PERIOD = 0.01
GOAL = np.array([3000])
COUNT = 2.0 * np.pi / 4096.0


def ended_after(position: Callable[[float], float], seconds: float) -> float | None:
    """When it counts as ended, in s; None if not within so many."""
    config: Any = SimpleNamespace(profile_velocity=1.0, profile_acceleration=0.0, yields=True)
    configs: list[ServoConfig] = [config]
    approach = Approach(configs, [0])
    for time in np.arange(0.0, seconds, PERIOD).tolist():
        frame: Any = SimpleNamespace(
            position=np.array([round(position(time))]), seen=np.array([time])
        )
        approach.look(frame, GOAL)
        if approach.has_ended(GOAL):
            return time
    return None


def test_a_quiet_servo_stands_soon() -> None:
    assert ended_after(lambda time: 2000, 2.0) == pytest.approx(0.25, abs=PERIOD)


@pytest.mark.parametrize("rate", [2.0, 7.0, 50.0])
def test_a_servo_that_trembles_stands(rate: float) -> None:
    def trembles(time: float) -> float:
        return 2000 + 3.0 * np.cos(2.0 * np.pi * rate * time)

    ended = ended_after(trembles, 2.0)
    assert ended is not None
    assert ended <= 1.0 + 2.0 * PERIOD


@pytest.mark.parametrize(
    "position",
    [
        lambda time: 2000 + 0.0240 / COUNT * time,
        lambda time: 2000 + 0.187 / COUNT * (time - 2) ** 2,
    ],
    ids=["slowest", "turning round"],
)
def test_a_slow_servo_does_not_stand(position: Callable[[float], float]) -> None:
    assert ended_after(position, 4.0) is None

"""How the control program follows joint positions, on a simulated controller in virtual time."""

from __future__ import annotations

import pytest

from crtk_driver_ur.models import MODELS
from crtk_driver_ur.native.program import Kind, ProgramOptions, program_text
from crtk_sim_backends.ur.safety.modes import SafetyMode
from rigs.ur_controller import Bench

MODEL = MODELS["ur5"]  # CB3: 8 ms
PERIOD = 1.0 / MODEL.frequency
PROGRAM = 7
OPTIONS = ProgramOptions(
    version=(3, 15),
    first=0,
    watchdog_frequency=10.0,
    period=PERIOD,
    joint_deceleration=5.0,
    linear_deceleration=1.2,
    lookahead=0.1,
    joint_acceleration=5.0,
    joint_speeds=MODEL.velocity_limits,
    joint_ranges=MODEL.position_limits,
)


class Followed:
    """The first joint follows a position that goes at a speed, from where it stands."""

    def __init__(self, *, gain: float, slider: float) -> None:
        self.bench = Bench("ur5")
        self._gain, self._slider = gain, slider
        self._sequence = 0
        self.bench.write(input_int_register_0=PROGRAM)
        self.bench.controller.run_script(program_text(OPTIONS, PROGRAM))
        self.bench.write(speed_slider_mask=1, speed_slider_fraction=slider)
        self.begin = list(self.bench["target_q"])
        self.goal = 0.0
        self.fastest = 0.0

    def follow(self, speed: float, seconds: float) -> None:
        for _ in range(round(seconds / PERIOD)):
            self.goal += speed * PERIOD
            self._sequence += 1
            values = [self.begin[0] + self.goal, *self.begin[1:], self._gain, 0.0, self._slider]
            self.bench.write(
                input_int_register_0=PROGRAM,
                input_int_register_1=self._sequence,
                input_int_register_2=int(Kind.SERVO_JOINT),
                **{f"input_double_register_{at}": value for at, value in enumerate(values)},
            )
            self.bench.ticks(1)
            self.fastest = max(self.fastest, abs(self.bench["target_qd"][0]))

    @property
    def behind(self) -> float:
        return self.begin[0] + self.goal - self.bench["target_q"][0]


def test_a_gain_that_is_low_lets_a_joint_be_as_fast_as_it_is() -> None:
    joint = Followed(gain=100.0, slider=1.0)
    joint.follow(0.9 * MODEL.velocity_limits[0], 1.0)
    assert joint.fastest > 0.85 * MODEL.velocity_limits[0]
    joint.follow(0.0, 1.0)
    assert joint.behind == pytest.approx(0.0, abs=5e-3)


@pytest.mark.parametrize("gain", [300.0, 100.0])
def test_a_slider_below_the_least_pace_ends_in_no_protective_stop(gain: float) -> None:
    """The program goes on faster than the arm, and leads it no faster than it may be for that."""
    joint = Followed(gain=gain, slider=0.05)
    joint.follow(0.5 * MODEL.velocity_limits[0], 0.4)
    joint.follow(0.0, 10.0)
    assert joint.bench.controller.safety_mode is SafetyMode.NORMAL
    assert joint.behind == pytest.approx(0.0, abs=5e-3)

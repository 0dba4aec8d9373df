"""The speed slider of the simulated UR: the time of speedj and speedl stretches with it.

Source: tests of Universal_Robots_Client_Library (spline interpolation with speed scaling: each step of a
spline takes four periods at a quarter of the speed), and its external control program, which counts
the time of a spline by the `t` of its speeds.
"""

from __future__ import annotations

import pytest

from crtk_sim_backends.ur.messages import RuntimeExceptionMessage
from crtk_sim_backends.ur.safety.modes import RuntimeState, SafetyMode
from rigs.ur_controller import Bench

SLIDERS = [1.0, 0.5, 0.3, 0.1, pytest.param(0.01, marks=pytest.mark.slow)]
SPLINE = """
  qd = [0, 0, 0, 0, 0, 0]
  time = 0
  while time < 0.999999:
    time = time + get_steptime()
    before = qd[0]
    qd[0] = 3.0 * time * (1.0 - time)
    speedj(qd, norm(qd[0] - before) / get_steptime(), get_steptime())
    write_output_float_register(0, time)
  end
  stopj(10)
"""
"""Speeds of a cubic that turns joint 0 by 0.5 rad in a second, and ends at rest."""


def at(slider: float, **options: object) -> Bench:
    bench = Bench(**options)  # type: ignore[arg-type]
    bench.write(speed_slider_mask=1, speed_slider_fraction=slider)
    bench.seconds(0.4)
    return bench


@pytest.mark.sweep(4)
@pytest.mark.parametrize("model", ["ur5e", "ur5"])
@pytest.mark.parametrize("slider", SLIDERS)
def test_a_spline_of_speeds_arrives_and_takes_as_much_longer(slider: float, model: str) -> None:
    bench = at(slider, model=model)
    ticks = bench.run(SPLINE, seconds=200.0)
    assert bench["target_q"][0] == pytest.approx(0.5, abs=1e-3)
    assert ticks * bench.controller.dt == pytest.approx(1.0 / slider, rel=0.03)


@pytest.mark.sweep(3)
@pytest.mark.parametrize("slider", SLIDERS)
def test_target_speeds_are_those_of_full_speed_scaled(slider: float) -> None:
    bench = at(slider)
    bench.start(SPLINE)
    bench.until(lambda: bench["output_double_register_0"] >= 0.5, 100.0)
    assert bench["target_qd"][0] == pytest.approx(slider * 0.75, rel=0.01)
    bench.until(lambda: bench["output_double_register_0"] >= 0.75, 100.0)
    assert bench["target_qd"][0] == pytest.approx(slider * 0.5625, rel=0.01)


@pytest.mark.sweep(3)
@pytest.mark.parametrize("slider", SLIDERS)
def test_a_tool_speed_lasts_as_much_longer(slider: float) -> None:
    bench = at(slider)
    start = bench["target_TCP_pose"][2]
    bench.start("speedl([0, 0, 0.1, 0, 0, 0], a=0.5, t=0.6)\nwrite_output_integer_register(0, 1)")
    ticks = bench.until(lambda: bench["output_int_register_0"] == 1, 100.0)
    assert ticks * 0.002 == pytest.approx(0.6 / slider, rel=0.01)
    assert bench["target_TCP_pose"][2] - start == pytest.approx(0.05, abs=1.1e-3)


def test_a_spline_faster_than_a_joint_arrives_all_the_same() -> None:
    bench = Bench()
    bench.run(SPLINE.replace("3.0 * time", "18.0 * time"), seconds=10.0)  # up to 4.5 rad/s
    assert bench["target_q"][0] == pytest.approx(3.0, abs=5e-3)
    assert bench.controller.safety_mode == SafetyMode.NORMAL


def test_at_no_speed_a_speed_does_not_end_and_nothing_moves() -> None:
    bench = at(0.0)
    before = bench["target_q"]
    bench.start("speedj([0.5, 0, 0, 0, 0, 0], 5, 0.002)\nwrite_output_integer_register(0, 1)")
    bench.seconds(1.0)
    assert bench.controller.runtime_state == RuntimeState.PLAYING
    assert bench["output_int_register_0"] == 0
    assert bench["target_q"] == before
    bench.write(speed_slider_mask=1, speed_slider_fraction=1.0)
    bench.until(lambda: bench["output_int_register_0"] == 1, 1.0)


def test_a_speed_that_ends_within_a_period_leaves_the_rest_to_the_next() -> None:
    bench = Bench()
    bench.start(
        "i = 0\nwhile i < 100:\n speedj([0.4, 0, 0, 0, 0, 0], 40, 0.003)\n i = i + 1\nend\n"
        "write_output_integer_register(0, 1)"
    )
    ticks = bench.until(lambda: bench["output_int_register_0"] == 1)
    assert ticks * 0.002 == pytest.approx(0.3, abs=0.0041)


@pytest.mark.parametrize(
    "call", ["speedj([0.2, 0, 0, 0, 0, 0], 0, 0.1)", "speedl([0,0,0,0,0,0], 0, 0.1)"]
)
def test_no_acceleration_keeps_the_speed(call: str) -> None:
    """Between equal points of a spline, where UR's program asks for the acceleration 0."""
    bench = Bench()
    bench.run(call)
    assert not bench.of_type(RuntimeExceptionMessage)
    assert bench["target_qd"] == (0.0,) * 6
    assert bench.controller.safety_mode == SafetyMode.NORMAL


@pytest.mark.parametrize("slider", [0.1, 0.7])
def test_a_slider_that_goes_to_nothing_leaves_no_rest_of_a_speed(slider: float) -> None:
    """A move that began at a scale of 1e-17 would be planned with speeds that no joint has."""
    bench = at(slider)
    bench.run("movej([0.0, -1.569, 1.576, -1.571, -1.569, 0.0], a=5, v=3)", seconds=100.0)
    bench.write(speed_slider_mask=1, speed_slider_fraction=0.0)
    scales = []
    for _ in range(round(0.3 / bench.controller.dt)):
        bench.ticks(1)
        scales.append(bench.arm.scale)
    assert min(scale for scale in scales if scale > 0.0) > 1e-9
    assert scales[-1] == 0.0

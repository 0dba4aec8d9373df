"""Encoders, conveyors that moves track, and offsets of the path, of the simulated UR.

Source: URScript manual, chapter "motion": `encoder_...`, `track_conveyor_...`, `path_offset_...`.
"""

from __future__ import annotations

from itertools import pairwise
from math import cos, pi, sin

import pytest

from crtk_sim_backends.ur import SIM
from crtk_sim_backends.ur.messages import ErrorMessage, RuntimeExceptionMessage, TextMessage
from crtk_sim_backends.ur.safety.modes import RuntimeState, SafetyMode
from crtk_sim_backends.ur.signals.encoders import RANGES
from rigs.ur_clients import TcpClient
from rigs.ur_controller import Bench, apart
from rigs.waiting import eventually

ENABLED = "encoder_enable_pulse_decode(0, 1, 8, 9)\nsleep(0.5)\n"
LINEAR = "track_conveyor_linear(p[0, 2, 0, 0, 0, 0], 1000)\n"
FOREVER = "while True:\n sync()\nend"
SPEED = 0.1  # m/s


def belt(speed: float = SPEED, **options: object) -> Bench:
    bench = Bench(**options)  # type: ignore[arg-type]
    bench.controller.encoders.move(0, 1000.0 * speed)
    return bench


def position(bench: Bench) -> tuple[float, ...]:
    return tuple(bench["target_TCP_pose"][:3])


def failed(bench: Bench) -> str:
    return "; ".join(message.text for message in bench.of_type(RuntimeExceptionMessage))


# Encoders.


def test_pulses_are_counted_and_filtered() -> None:
    bench = belt()
    bench.start(
        f"{ENABLED}while True:\n write_output_float_register(0, encoder_get_tick_count(0))\n"
        ' write_output_integer_register(0, encoder_get_tick_count(0, opt="raw"))\n sync()\nend'
    )
    bench.seconds(2.0)
    assert bench["output_int_register_0"] == bench["encoder0_raw"] == pytest.approx(200, abs=2)
    assert bench["output_double_register_0"] == pytest.approx(200.0, abs=0.5)
    bench.controller.encoders.move(0, -1000.0 * SPEED)
    bench.seconds(3.0)
    assert bench["encoder0_raw"] == pytest.approx(-100, abs=2)
    assert bench["output_double_register_0"] == pytest.approx(65536 - 100, abs=0.5)


def test_one_input_tells_no_direction() -> None:
    bench = belt(-SPEED)
    bench.run("conveyor_pulse_decode(2, 3)\nsleep(1)")
    assert bench["encoder0_raw"] == pytest.approx(100, abs=2)
    bench.run("conveyor_pulse_decode(0)\nwrite_output_float_register(0, get_conveyor_tick_count())")
    assert bench["output_double_register_0"] == 0.0


@pytest.mark.parametrize("range_id", RANGES)
def test_counts_that_are_set_go_past_the_end_of_their_range(range_id: int) -> None:
    first, behind = RANGES[range_id]
    bench = Bench()
    bench.start(
        f"encoder_enable_set_tick_count(1, {range_id})\nencoder_set_tick_count(1, {behind - 10})\n"
        f"sleep(0.2)\nencoder_set_tick_count(1, {first + 10})\nsleep(2)\n"
        "write_output_float_register(0, encoder_get_tick_count(1))\n"
        f"write_output_float_register(1, encoder_unwind_delta_tick_count(1, {20 - (behind - first)}))"
    )
    bench.seconds(3.0)
    assert failed(bench) == ""
    assert bench["output_double_register_0"] == first + 10
    assert bench["output_double_register_1"] == 20.0


@pytest.mark.parametrize(
    ("call", "complaint"),
    [
        ("encoder_enable_pulse_decode(2, 1, 8, 9)", "encoder_index lies in 0 to 1"),
        ("encoder_enable_pulse_decode(0, 5, 8, 9)", "decoder lies in 0 to 4"),
        ("encoder_enable_pulse_decode(0, 1, 8, 0)", "digital input lies in 8 to 11"),
        ("conveyor_pulse_decode(1, 8, 9)", "digital input lies in 0 to 3"),
        ("encoder_set_tick_count(0, 1)", "not enabled"),
        ("encoder_enable_set_tick_count(0, 5)", "range_id lies in 0 to 4"),
        ("encoder_enable_set_tick_count(0, 1)\nencoder_set_tick_count(0, 256)", "range of the"),
        ('encoder_get_tick_count(0, "fast")', "no option fast"),
        ("track_conveyor_linear(p[0, 0, 0, 1, 0, 0], 1000)", "the direction"),
        ("track_conveyor_linear(p[1, 0, 0, 0, 0, 0], 0)", "number of ticks"),
        ("track_conveyor_circular([0, 0], 500)", "expected six numbers"),
        ("stop_conveyor_tracking(0)", "above zero"),
        ("path_offset_enable()\ntrack_conveyor_linear(p[1, 0, 0, 0, 0, 0], 9)", "is enabled"),
        (f"{LINEAR}path_offset_enable()", "a conveyor is tracked"),
        ("path_offset_set([0, 0, 0, 0, 0, 0], 5)", "type lies in 1 to 4"),
        ("path_offset_set_alpha_filter(1.1)", "not within 0 to 1"),
        ("path_offset_set_max_offset(0, 1)", "above zero"),
    ],
)
def test_what_cannot_be_ends_the_program_and_moves_nothing(call: str, complaint: str) -> None:
    bench = belt()
    before = bench["target_q"]
    bench.start(f"{call}\n{FOREVER}")
    bench.seconds(0.2)
    assert complaint in failed(bench)
    assert bench["target_q"] == before


def test_a_count_of_an_encoder_that_is_off_cannot_be_unwound() -> None:
    bench = Bench()
    bench.run("textmsg(encoder_unwind_delta_tick_count(0, 5))")
    assert bench.messages[-2].text == "None"


def test_software_before_5_2_has_one_encoder_and_the_old_functions() -> None:
    known = Bench(version=(5, 1, 0, 0)).controller.player._builtins
    assert "encoder_get_tick_count" not in known
    assert "get_conveyor_tick_count" in known


# Conveyors.


def test_the_tool_goes_with_the_belt_and_stays_on_it() -> None:
    bench = belt()
    start = position(bench)
    bench.start(f"{ENABLED}{LINEAR}{FOREVER}")
    bench.seconds(1.0)
    for _ in range(10):
        bench.seconds(0.1)
        belongs = SPEED * (bench.controller.time - 0.502)
        assert apart(position(bench), (start[0], start[1] + belongs, start[2])) < 2e-4
        assert apart(bench["target_TCP_speed"][:3], (0.0, SPEED, 0.0)) < 1e-3


def test_moves_are_made_on_the_belt_and_end_on_it() -> None:
    """A line down to a thing on the belt, and up again, is a line relative to the belt."""
    bench = belt()
    start = position(bench)
    down = (
        "movel(pose_add(get_target_tcp_pose_along_path(), p[0, 0, -0.05, 0, 0, 0]), v=0.1, a=1)\n"
    )
    bench.start(
        f"{ENABLED}{LINEAR}sleep(0.3)\n{down}write_output_integer_register(0, 1)\nsleep(0.5)\n"
        "movej([0, -1.57, 1.57, -1.57, -1.57, 0])\nwrite_output_integer_register(0, 2)\n" + FOREVER
    )
    for phase, height in ((1, -0.05), (2, 0.0)):
        bench.until(lambda phase=phase: bench["output_int_register_0"] == phase)
        belongs = SPEED * (bench.controller.time - 0.502)
        expected = (start[0], start[1] + belongs, start[2] + height)
        assert apart(position(bench), expected) < 1e-3


@pytest.mark.parametrize("slider", [1.0, 0.1, 0.0])
def test_the_speed_slider_does_not_slow_the_belt_down(slider: float) -> None:
    bench = belt()
    bench.write(speed_slider_mask=1, speed_slider_fraction=slider)
    bench.seconds(0.4)
    bench.start(f"{ENABLED}{LINEAR}{FOREVER}")
    bench.seconds(1.5)
    assert apart(bench["target_TCP_speed"][:3], (0.0, SPEED, 0.0)) < 1e-3


@pytest.mark.parametrize("turns", [True, False])
def test_a_turntable_is_followed_with_the_tool_or_without(turns: bool) -> None:
    bench = Bench()
    bench.controller.encoders.move(0, 50.0)
    before = bench["target_TCP_pose"]
    bench.start(
        f"{ENABLED}track_conveyor_circular(p[-0.3, 0, 0, 0, 0, 0], 500, {turns})\n{FOREVER}"
    )
    bench.seconds(1.504)
    angle = 2.0 * pi * 0.1
    x, y = before[0] + 0.3, before[1]
    there = (cos(angle) * x - sin(angle) * y - 0.3, sin(angle) * x + cos(angle) * y, before[2])
    assert apart(position(bench), there) < 1e-3
    assert bench["target_TCP_speed"][5] == pytest.approx(0.2 * pi if turns else 0.0, abs=5e-3)
    assert (apart(bench["target_TCP_pose"][3:], before[3:]) < 1e-6) is not turns


def test_stopping_brings_the_arm_to_rest_where_it_is() -> None:
    bench = belt()
    bench.start(
        f"{ENABLED}{LINEAR}sleep(0.5)\nstop_conveyor_tracking(a=2)\n"
        "write_output_integer_register(0, 1)\nsleep(0.5)\nwrite_output_integer_register(0, 2)\n"
        "movel(pose_add(get_target_tcp_pose(), p[0, 0, -0.05, 0, 0, 0]), v=0.5, a=5)"
    )
    bench.until(lambda: bench["output_int_register_0"] == 1)
    bench.ticks(2)
    assert bench["target_qd"] == (0.0,) * 6
    there = position(bench)
    bench.until(lambda: bench["output_int_register_0"] == 2)
    assert apart(position(bench), there) < 2e-5  # the first step of the move
    bench.until(lambda: bench.controller.runtime_state == RuntimeState.STOPPED)
    assert apart(position(bench), (there[0], there[1], there[2] - 0.05)) < 1e-6


@pytest.mark.parametrize("last", ["sleep(0.1)", "movej([0, -1.57, 1.57, -1.57, -1.57, 0])"])
def test_a_belt_at_rest_is_left_where_it_brought_the_tool(last: str) -> None:
    bench = belt()
    bench.start(
        f"{ENABLED}{LINEAR}sleep(2)\n{last}\nstop_conveyor_tracking()\n"
        "movej([0, -1.57, 1.57, -1.57, -1.57, 0])"
    )
    bench.seconds(1.0)
    bench.controller.encoders.move(0, 0.0)
    bench.seconds(1.0)
    assert bench["target_qd"] == (0.0,) * 6
    bench.until(lambda: bench.controller.runtime_state == RuntimeState.STOPPED)
    assert apart(bench["target_q"], (0, -1.57, 1.57, -1.57, -1.57, 0)) < 1e-9


@pytest.mark.parametrize("end", ["stop", "protective_stop", "power_off"])
def test_the_end_of_the_program_ends_it(end: str) -> None:
    bench = belt()
    bench.start(f"{ENABLED}{LINEAR}{FOREVER}")
    bench.seconds(1.0)
    before = bench["target_q"]
    getattr(bench.controller, end)()
    bench.seconds(0.5)
    assert bench["target_qd"] == (0.0,) * 6
    assert apart(bench["target_q"], before) < 0.02
    assert bench.controller.plant.superposition.source is None


def test_a_pause_holds_the_arm_and_what_the_belt_moves_meanwhile_is_lost() -> None:
    bench = belt()
    bench.start(f"{ENABLED}{LINEAR}{FOREVER}")
    bench.seconds(1.0)
    bench.controller.pause()
    bench.until(lambda: bench.controller.runtime_state == RuntimeState.PAUSED)
    bench.seconds(0.1)
    there = position(bench)
    bench.seconds(1.0)
    assert apart(position(bench), there) < 1e-6
    bench.controller.play()
    bench.seconds(1.2)
    assert position(bench)[1] - there[1] == pytest.approx(SPEED * 1.1, abs=2e-3)
    assert bench.controller.safety_mode == SafetyMode.NORMAL


def test_counts_that_come_seldom_move_the_arm_evenly() -> None:
    """An absolute encoder that is read ten times a second."""
    bench = Bench()
    bench.start(
        "set_conveyor_tick_count(0, 2)\ntrack_conveyor_linear(p[0, 1, 0, 0, 0, 0], 1000)\n"
        "i = 0\nwhile True:\n i = i + 10\n set_conveyor_tick_count(i)\n sleep(0.1)\nend"
    )
    bench.seconds(2.0)
    speeds = []
    for _ in range(200):
        bench.ticks(1)
        speeds.append(bench["target_TCP_speed"][1])
    assert 0.0 < min(speeds) < max(speeds) < 3.0 * SPEED
    assert sum(speeds) / 200 == pytest.approx(SPEED, rel=0.1)


@pytest.mark.parametrize(
    ("speed", "codes"),
    [(3.0, {(204, 1), (191, 3), (191, 32)}), (0.25, {(154, 0), (204, 1), (191, 34)})],
)
def test_a_belt_too_fast_or_out_of_reach_stops_the_arm(
    speed: float, codes: set[tuple[int, int]]
) -> None:
    bench = belt(speed)
    bench.start(f"{ENABLED}{LINEAR}{FOREVER}")
    bench.until(lambda: bench.controller.safety_mode == SafetyMode.PROTECTIVE_STOP)
    (error,) = bench.of_type(ErrorMessage)
    assert (error.code, error.argument) in codes
    bench.seconds(1.0)
    assert bench["target_qd"] == (0.0,) * 6


def test_a_belt_can_be_moved_at_run_time() -> None:
    with SIM.spawn() as sim, TcpClient(sim.host, "primary") as script:
        script.send(f"def track():\n{ENABLED}{LINEAR}{FOREVER}\nend\n".encode())
        sim.control.inject("conveyor", ticks=100.0)
        eventually(
            lambda: sim.control.outputs("actual_TCP_speed")["actual_TCP_speed"][1] > 0.09,
            timeout=10.0,
        )
        sim.control.clear("conveyor")
        eventually(lambda: sim.control.outputs("target_qd")["target_qd"] == [0.0] * 6)


# Offsets of the path.

WEAVING = """
path_offset_enable()
thread weave():
  t = 0
  while True:
    path_offset_set([{}], {})
    sync()
    t = t + get_steptime()
  end
end
h = run weave()
"""
SWING = "0.005 * (1 - cos(12.566 * t))"


@pytest.mark.parametrize(
    ("offset", "frame", "axis"),
    [
        (f"0, 0, {SWING}, 0, 0, 0", 1, (0.0, 0.0, 1.0)),
        (f"0, 0, {SWING}, 0, 0, 0", 2, (0.0, 0.0, -1.0)),  # the tool points down
        (f"0, {SWING}, 0, 0, 0, 0", 3, (1.0, 0.0, 0.0)),
        (f"0, 0, {SWING}, 0, 0, 0", 4, (0.0, 0.0, -1.0)),
    ],
)
def test_a_line_is_woven(offset: str, frame: int, axis: tuple[float, ...]) -> None:
    """The example of the manual: a wave of 2 Hz beside a line along y."""
    bench = Bench()
    start = position(bench)
    bench.start(
        WEAVING.format(offset, frame)
        + "movel(pose_add(get_target_tcp_pose_along_path(), p[0, -0.1, 0, 0, 0, 0]), v=0.1)\n"
        "kill h\npath_offset_disable()"
    )
    aside = []
    while bench.controller.runtime_state == RuntimeState.PLAYING:
        bench.ticks(1)
        x, y, z = (a - b for a, b in zip(position(bench), start, strict=True))
        off = x * axis[0] + z * axis[2]
        aside.append(off)
        across = abs(x) if axis[0] == 0.0 else abs(z)
        assert across < 1e-3
        assert -0.101 < y < 0.001
    assert failed(bench) == ""
    assert max(aside) == pytest.approx(0.01, abs=5e-4)
    assert sum(b >= 0.009 > a for a, b in pairwise(aside)) == 2


def test_a_path_offset_is_told_in_each_frame() -> None:
    bench = Bench()
    bench.start(
        "path_offset_enable()\npath_offset_set_alpha_filter(0.02)\n"
        "path_offset_set([0, 0, 0.02, 0, 0, 0.1], 2)\nsleep(2)\n"
        "textmsg(path_offset_get(2))\ntextmsg(path_offset_get(1)[2])\n"
        "textmsg(path_offset_get(4)[2])\npath_offset_disable()\ntextmsg(path_offset_get(1))"
    )
    bench.until(lambda: bench.controller.runtime_state == RuntimeState.STOPPED)
    own, base, world, none = (message.text for message in bench.of_type(TextMessage))
    numbers = [float(x) for x in own.removeprefix("p[").rstrip("]").split(",")]
    assert numbers == pytest.approx([0, 0, 0.02, 0, 0, 0.1], abs=1e-6)
    assert float(base) == pytest.approx(-0.02, abs=1e-3)
    assert float(world) == pytest.approx(0.02, abs=1e-3)
    assert none == "p[0,0,0,0,0,0]"


def test_a_path_offset_has_limits() -> None:
    bench = Bench()
    start = position(bench)
    bench.start(
        "path_offset_enable()\npath_offset_set_max_offset(0.01, 0.1)\n"
        "path_offset_set_alpha_filter(0.02)\npath_offset_set([0, 0, 0.5, 0, 0, 0], 1)\nsleep(3)"
    )
    bench.seconds(2.0)
    assert position(bench)[2] - start[2] == pytest.approx(0.01, abs=1e-4)


def test_an_offset_that_jumps_stops_the_arm() -> None:
    bench = Bench()
    bench.start(f"path_offset_enable()\npath_offset_set([0, 0, 0.05, 0, 0, 0], 1)\n{FOREVER}")
    bench.until(lambda: bench.controller.safety_mode == SafetyMode.PROTECTIVE_STOP, 1.0)
    (error,) = bench.of_type(ErrorMessage)
    assert (error.code, error.argument) == (204, 1)

"""The motion built-ins of the simulated UR, as programs see them."""

from __future__ import annotations

from itertools import pairwise
from math import sqrt

import pytest

from crtk_sim_backends.ur.messages import ErrorMessage, RuntimeExceptionMessage, TextMessage
from crtk_sim_backends.ur.motion.kinematics import cross, norm, to_transform
from crtk_sim_backends.ur.safety.modes import RuntimeState, SafetyMode
from rigs.ur_controller import Bench, apart

GOAL = [0.3, -1.2, 1.4, -1.6, -1.5, 0.2]


@pytest.fixture
def bench() -> Bench:
    return Bench()


def pose_above(bench: Bench, height: float) -> list[float]:
    pose = list(bench["target_TCP_pose"])
    pose[2] += height
    return pose


def failure(bench: Bench) -> str:
    return str(bench.of_type(RuntimeExceptionMessage)[-1].text)


@pytest.mark.parametrize("model", ["ur5e", "ur5"])
def test_movej_follows_its_trapezoid_and_arrives_exactly(model: str) -> None:
    bench = Bench(model)
    bench.ticks(1)
    distance = apart(bench["target_q"], GOAL)
    ticks = bench.run(f"movej({GOAL}, a=1.4, v=0.5)")
    expected = distance / 0.5 + 0.5 / 1.4
    assert ticks * bench.controller.dt == pytest.approx(expected, abs=2.5 * bench.controller.dt)
    bench.seconds(0.2)
    assert list(bench["target_q"]) == GOAL
    assert list(bench["actual_q"]) == GOAL


def test_movej_keeps_speed_and_acceleration(bench: Bench) -> None:
    bench.start(f"movej({GOAL}, a=1.4, v=0.5)")
    speeds: list[float] = [0.0]
    while bench.controller.runtime_state == RuntimeState.PLAYING:
        bench.ticks(1)
        speeds.append(max(map(abs, bench["target_qd"])))
    steps = [abs(b - a) for a, b in pairwise(speeds)]
    assert max(speeds) == pytest.approx(0.5, abs=1e-9)
    assert max(steps) <= 1.4 * bench.controller.dt + 1e-9


@pytest.mark.parametrize("seconds", [0.8, 2.0])
def test_duration_overrides_speed_and_is_exact(bench: Bench, seconds: float) -> None:
    bench.start(f"movej({GOAL}, a=0.1, v=0.1, t={seconds})")
    bench.seconds(seconds - 0.004)
    assert list(bench["target_q"]) != GOAL
    bench.seconds(0.006)
    assert list(bench["target_q"]) == GOAL


def test_movej_is_never_faster_than_a_joint_can_turn() -> None:
    bench = Bench("ur10e")
    bench.start("movej([2.0, -1.57, 1.57, -1.57, -1.57, 0.0], a=10, v=3.1)")
    bench.seconds(1.0)
    assert bench.controller.safety_mode == SafetyMode.NORMAL
    assert max(bench["target_qd"]) <= bench.controller.model.velocity[0] + 1e-9


def test_speed_slider_stretches_a_move(bench: Bench) -> None:
    full = Bench().run(f"movej({GOAL}, t=1.0)")
    bench.write(speed_slider_mask=1, speed_slider_fraction=0.5)
    bench.seconds(0.5)
    half = bench.run(f"movej({GOAL}, t=1.0)")
    assert half == pytest.approx(2 * full, abs=2)
    assert bench["speed_scaling"] == 1.0  # beside the slider
    assert bench["target_speed_fraction"] == 0.5


START = "movej([-1.57, -1.6, 1.6, -0.7, 0.7, 0.2], a=3, v=3)\n"
FIRST, SECOND = (f"p[-0.203, {y}, 0.559, 0.68, -1.083, -2.076]" for y in (0.263, 0.463))


def fastest_of(bench: Bench, body: str) -> list[float]:
    """Run a program; the largest speed of each joint as a share of what the joint can do."""
    bench.start(body)
    shares = [0.0] * 6
    while bench.controller.runtime_state == RuntimeState.PLAYING:
        bench.ticks(1)
        for i, speed in enumerate(bench["target_qd"]):
            shares[i] = max(shares[i], abs(speed) / bench.controller.model.velocity[i])
    assert bench.controller.safety_mode == SafetyMode.NORMAL, bench.describe()
    assert not bench.of_type(ErrorMessage)
    return shares


@pytest.mark.parametrize("model", ["ur3e", "ur5", "ur5e", "ur10e", "ur20"])
def test_a_time_that_cannot_be_kept_is_a_slower_move(model: str) -> None:
    """UR's client library, "unfeasible times": pi rad in 0.1 s succeeds, slower."""
    bench = Bench(model)
    bench.run(START)
    shares = fastest_of(bench, "movej([1.57, -1.6, 1.6, -0.7, 0.7, 0.2], t=0.1)")
    assert max(shares) == pytest.approx(1.0, abs=1e-6)
    assert bench["target_q"] == pytest.approx((1.57, -1.6, 1.6, -0.7, 0.7, 0.2))


@pytest.mark.sweep(5)
@pytest.mark.parametrize("how", ["a=1.4, v=1.04", "a=2.5, v=2.5", "a=1.4, v=1.04, t=0.1"])
@pytest.mark.parametrize("model", ["ur5", "ur5e", "ur10e", "ur16e", "ur20", "ur30"])
def test_a_line_is_as_fast_as_the_joints_can(model: str, how: str) -> None:
    """UR's client library: lines from that posture, of which a UR20's joints are too slow for some."""
    bench = Bench(model)
    bench.run(START)
    for target in (FIRST, SECOND, FIRST, SECOND):
        assert max(fastest_of(bench, f"movel({target}, {how})")) <= 1.0 + 1e-6
    bench.seconds(0.1)
    assert bench["target_TCP_pose"][:3] == pytest.approx((-0.203, 0.463, 0.559), abs=1e-6)


@pytest.mark.parametrize("move", ["movep({}, a=3, v=3, r=0.02)", "servoc({}, a=3, v=3)"])
def test_so_are_lines_at_constant_speed(move: str) -> None:
    bench = Bench("ur20")
    bench.run(START)
    body = "\n".join(move.format(target) for target in (FIRST, SECOND, FIRST))
    assert max(fastest_of(bench, f"{body}\nmovel({SECOND})")) <= 1.0 + 1e-6


@pytest.mark.parametrize("mode", [0, 1])
def test_so_is_a_circle(mode: int) -> None:
    bench = Bench("ur20")
    bench.run(f"{START}movel({FIRST})")
    via = SECOND.replace("-0.203, 0.463", "-0.3, 0.363")
    assert max(fastest_of(bench, f"movec({via}, {SECOND}, a=6, v=6, mode={mode})")) <= 1.0 + 1e-6
    assert bench["target_TCP_pose"][:3] == pytest.approx((-0.203, 0.463, 0.559), abs=1e-6)


def test_at_half_the_speed_a_move_is_planned_alike() -> None:
    full = Bench("ur20").run(f"{START}movel({FIRST}, a=2.5, v=2.5)\nmovel({SECOND}, a=2.5, v=2.5)")
    slow = Bench("ur20")
    slow.write(speed_slider_mask=1, speed_slider_fraction=0.5)
    slow.seconds(0.5)
    half = slow.run(f"{START}movel({FIRST}, a=2.5, v=2.5)\nmovel({SECOND}, a=2.5, v=2.5)")
    assert half == pytest.approx(2 * full, rel=0.01)


def test_movel_is_a_straight_line_with_the_tool_speed(bench: Bench) -> None:
    bench.ticks(1)
    start = list(bench["target_TCP_pose"])
    goal = [start[0] + 0.1, start[1] - 0.05, start[2] + 0.1, *start[3:]]
    bench.start(f"movel(p{goal}, a=1.2, v=0.25)")
    way = [b - a for a, b in zip(start[:3], goal[:3], strict=True)]
    length = sqrt(sum(x * x for x in way))
    fastest = 0.0
    while bench.controller.runtime_state == RuntimeState.PLAYING:
        bench.ticks(1)
        here = [b - a for a, b in zip(start[:3], bench["target_TCP_pose"][:3], strict=True)]
        along = sum(a * b for a, b in zip(here, way, strict=True)) / length
        off = sqrt(max(0.0, sum(x * x for x in here) - along * along))
        assert off < 1e-6
        fastest = max(fastest, sqrt(sum(x * x for x in bench["target_TCP_speed"][:3])))
    bench.seconds(0.2)
    assert apart(to_transform(bench["actual_TCP_pose"]), to_transform(goal)) < 1e-9
    assert fastest == pytest.approx(0.25, rel=0.01)


def test_movel_takes_joint_positions_too(bench: Bench) -> None:
    bench.run("movel([0.1, -1.57, 1.57, -1.57, -1.57, 0.0])")
    bench.seconds(0.2)
    assert bench["actual_q"] == (0.1, -1.57, 1.57, -1.57, -1.57, 0.0)


def test_movec_passes_its_via_point(bench: Bench) -> None:
    bench.ticks(1)
    x, y, z, *turn = bench["target_TCP_pose"]
    via = [x, y - 0.05, z + 0.05, *turn]
    goal = [x, y - 0.1, z, *turn]
    bench.start(f"movec(p{via}, p{goal}, a=1.2, v=0.1)")
    nearest = 1.0
    while bench.controller.runtime_state == RuntimeState.PLAYING:
        bench.ticks(1)
        pose = bench["target_TCP_pose"]
        radius = sqrt((pose[1] - (y - 0.05)) ** 2 + (pose[2] - z) ** 2)
        assert radius == pytest.approx(0.05, abs=1e-6)
        nearest = min(nearest, apart(pose[:3], via[:3]))
    assert nearest < 1e-3
    assert apart(bench["target_TCP_pose"][:3], goal[:3]) < 1e-6


def test_optimove_takes_fractions_only(bench: Bench) -> None:
    bench.run(f"optimovej({GOAL}, a=0.5, v=0.5)")
    assert list(bench["target_q"]) == GOAL
    bench.run(f"optimovej({GOAL}, a=1.5, v=0.5)")
    assert "fractions" in failure(bench)


def test_unreachable_pose_is_a_runtime_error(bench: Bench) -> None:
    bench.start("textmsg(1)\nmovej(p[3, 0, 0, 0, 0, 0])")
    bench.ticks(3)
    assert bench.controller.runtime_state == RuntimeState.STOPPED
    error = bench.of_type(RuntimeExceptionMessage)[-1]
    assert "inverse kinematics" in error.text
    assert error.line == 3


def test_a_line_through_the_singularity_stops_protectively(bench: Bench) -> None:
    bench.run("movej([0, -1.57, 1.57, -1.57, -1.57, 0], v=2)")
    bench.ticks(1)
    x, y, z, *turn = bench["target_TCP_pose"]
    bench.run(f"movel(p{[-x, y + 0.06, z, *turn]}, v=0.5)")  # past the axis of the base
    assert bench.controller.safety_mode == SafetyMode.PROTECTIVE_STOP
    assert [m.code for m in bench.of_type(ErrorMessage)] == [154]


@pytest.mark.parametrize(
    "call",
    [
        "movej([0, 1])",
        "movej([0, 0, 0, 0, 0, 0], a=0)",
        "speedj(1)",
        "servoj([0, 0])",
        "movel(p[0, 0, 0, 0, 0, 0], v=-1)",
        "stopj(0)",
    ],
)
def test_bad_arguments_stop_the_program(bench: Bench, call: str) -> None:
    bench.start(call)
    bench.ticks(2)
    assert bench.controller.runtime_state == RuntimeState.STOPPED
    assert failure(bench)
    assert not any(bench["target_qd"])


def test_two_threads_that_move_stop_the_program(bench: Bench) -> None:
    bench.start(
        "thread other():\n while True:\n speedj([0, 0.1, 0, 0, 0, 0], 1, 0.002)\n end\nend\n"
        f"h = run other()\nsleep(0.1)\nmovej({GOAL})"
    )
    bench.seconds(0.2)
    assert bench.controller.runtime_state in (RuntimeState.STOPPING, RuntimeState.STOPPED)
    assert failure(bench) == "Another thread is already controlling the robot"


def test_a_killed_thread_lets_go_in_the_same_period(bench: Bench) -> None:
    bench.start(
        "thread other():\n while True:\n speedj([0, 0.1, 0, 0, 0, 0], 1, 0.002)\n end\nend\n"
        'thread killer():\n sleep(0.1)\n kill h\n stopj(2)\n textmsg("stopped")\nend\n'
        "global h = run other()\nrun killer()\nsleep(0.5)"
    )
    bench.seconds(0.4)
    assert bench.controller.runtime_state == RuntimeState.PLAYING
    assert [m.text for m in bench.of_type(TextMessage)] == ["stopped"]
    assert not any(bench["target_qd"])


def test_speedj_reaches_its_speed_with_its_acceleration_and_returns_after_t(bench: Bench) -> None:
    bench.start('speedj([0.5, 0, 0, 0, 0, 0], a=1.0, t=0.25)\ntextmsg("back")\nstopj(1.0)')
    bench.seconds(0.25)
    assert bench["target_qd"][0] == pytest.approx(0.25, abs=1e-9)
    assert not bench.of_type(TextMessage)
    bench.ticks(1)
    assert bench.of_type(TextMessage)
    assert bench["target_qd"][0] == pytest.approx(0.248, abs=1e-9)


def test_speedj_without_t_returns_when_the_speed_is_reached(bench: Bench) -> None:
    bench.start('speedj([0.5, 0, 0, 0, 0, 0], a=1.0)\ntextmsg("back")\nsleep(1)')
    bench.until(lambda: bool(bench.of_type(TextMessage)))
    assert bench.controller.time == pytest.approx(0.5, abs=0.005)


def test_speedl_moves_the_tool_along_one_axis(bench: Bench) -> None:
    bench.ticks(1)
    start = bench["target_TCP_pose"]
    bench.start("speedl([0, 0, 0.1, 0, 0, 0], a=0.5, t=0.6)")
    bench.seconds(0.6)
    assert apart(bench["target_TCP_speed"], (0, 0, 0.1, 0, 0, 0)) < 1e-3
    travelled = [b - a for a, b in zip(start[:3], bench["target_TCP_pose"][:3], strict=True)]
    assert travelled[2] == pytest.approx(0.1 * 0.6 - 0.1 * 0.2 / 2, abs=1e-3)
    assert max(map(abs, travelled[:2])) < 1e-4


def test_joint_limit_stops_protectively(bench: Bench) -> None:
    bench.start("while True:\n speedj([2, 0, 0, 0, 0, 0], 5)\nend")
    bench.until(lambda: bench.controller.safety_mode == SafetyMode.PROTECTIVE_STOP)
    bench.seconds(1.0)
    assert bench.controller.runtime_state == RuntimeState.STOPPED
    assert abs(bench["actual_q"][0]) <= bench.controller.model.position[0]
    assert [(m.code, m.argument) for m in bench.of_type(ErrorMessage)] == [(150, 0)]


def test_servoj_brings_a_lookahead_that_is_no_number_into_its_range(bench: Bench) -> None:
    bench.write(input_double_register_0=float("nan"))
    bench.run("servoj([0.1,-1.57,1.57,-1.57,-1.57,0], 0, 0, 2, read_input_float_register(0))")
    assert bench["actual_q"][0] == pytest.approx(0.1, abs=1e-4)


def test_a_plan_without_a_number_stops_protectively(bench: Bench) -> None:
    bench.arm.command([float("nan")] * 6, [0.0] * 6)
    bench.ticks(2)
    assert bench.controller.safety_mode == SafetyMode.PROTECTIVE_STOP
    assert bench["actual_q"] == (0.0, -1.57, 1.57, -1.57, -1.57, 0.0)


def test_stopj_takes_the_time_its_deceleration_asks_for(bench: Bench) -> None:
    ticks = bench.run("speedj([0.5, 0, 0, 0, 0, 0], a=5.0)\nstopj(2.0)")
    assert ticks * 0.002 == pytest.approx(0.1 + 0.25, abs=0.008)
    assert not any(bench["target_qd"])


def test_stopl_stops_the_tool_within_its_deceleration(bench: Bench) -> None:
    ticks = bench.run("speedl([0, 0, 0.2, 0, 0, 0], a=1.0, t=0.4)\nstopl(1.0)")
    assert ticks * 0.002 == pytest.approx(0.4 + 0.2, abs=0.01)


def test_stopl_stays_on_the_line(bench: Bench) -> None:
    bench.start(
        "speedl([0.1, 0.25, -0.1, 0, 0, 0.2], 2, 0.5)\nstopl(0.5)\nwhile True:\nsync()\nend"
    )
    bench.seconds(0.5)
    start = bench["target_TCP_pose"][:3]
    speed = (0.1, 0.25, -0.1)
    line = [v / norm(speed) for v in speed]
    bench.until(lambda: not bench.arm.moving)
    moved = [b - a for a, b in zip(start, bench["target_TCP_pose"][:3], strict=True)]
    assert norm(moved) == pytest.approx(norm(speed) ** 2 / (2 * 0.5), rel=0.02)
    assert norm(cross(moved, line)) < 3e-4


def test_stopl_in_a_singularity_stops_all_the_same(bench: Bench) -> None:
    bench.start("movej([0, -1.57, 1.57, -1.57, 0, 0], v=3, a=30)\nspeedj([0.5,0,0,0,0,0],40,0.1)")
    bench.seconds(1.0)
    bench.run("speedj([0.5,0,0,0,0,0],40,0.1)\nstopl(2)")
    assert bench["target_qd"] == (0.0,) * 6
    assert bench["safety_mode"] == 1


def test_a_program_that_ends_in_motion_leaves_a_ramp(bench: Bench) -> None:
    bench.start("speedj([1.0, 0, 0, 0, 0, 0], a=10, t=0.2)")
    bench.seconds(0.202)
    assert bench.controller.runtime_state == RuntimeState.STOPPING
    bench.seconds(0.05)
    assert 0.0 < bench["target_qd"][0] < 1.0
    bench.seconds(0.1)
    assert bench["target_qd"] == (0.0,) * 6
    assert bench.controller.runtime_state == RuntimeState.STOPPED


def test_servoj_arrives(bench: Bench) -> None:
    q = [0.02, -1.55, 1.6, -1.57, -1.57, 0.03]
    bench.start(f"while True:\n servoj({q}, t=0.002, lookahead_time=0.1, gain=300)\nend")
    bench.seconds(3)
    assert list(bench["actual_q"]) == q


def test_pause_holds_a_move_and_resume_finishes_it(bench: Bench) -> None:
    bench.start(f"movej({GOAL}, t=1.0)")
    bench.seconds(0.4)
    assert bench.controller.pause()
    bench.until(lambda: bench.controller.runtime_state == RuntimeState.PAUSED, 1.0)
    bench.seconds(0.3)
    held = bench["actual_q"]
    assert bench["target_qd"] == (0.0,) * 6
    bench.seconds(1.0)
    assert bench["actual_q"] == held
    assert bench.controller.play()
    fastest = 0.0
    while bench.controller.runtime_state != RuntimeState.STOPPED:
        before = bench["target_qd"]
        bench.ticks(1)
        fastest = max(fastest, apart(before, bench["target_qd"]))
    assert list(bench["target_q"]) == GOAL
    assert fastest < 0.1  # no jump of speed, rad/s, in any period


def test_freedrive_gives_way_and_its_end_holds(bench: Bench) -> None:
    bench.start("freedrive_mode()\nsleep(1)\nend_freedrive_mode()\nsleep(5)")
    bench.seconds(0.1)
    still = bench["actual_q"]
    bench.controller.external_force([0, 20, 0, 0, 0, 0])
    bench.seconds(0.4)
    assert apart(bench["actual_q"], still) > 0.02
    bench.controller.external_force([0] * 6)
    bench.seconds(1.0)
    pushed = bench["actual_q"]
    bench.controller.external_force([0, 20, 0, 0, 0, 0])
    bench.seconds(1.0)
    assert bench["actual_q"] == pushed


def test_a_move_after_freedrive_starts_where_the_arm_was_left(bench: Bench) -> None:
    bench.start(f"freedrive_mode()\nsleep(1)\nend_freedrive_mode()\nsleep(1)\nmovej({GOAL})")
    bench.controller.external_force([0, 20, 0, 0, 0, 0])
    bench.seconds(0.9)
    bench.controller.external_force([0] * 6)
    bench.until(lambda: bench.controller.runtime_state == RuntimeState.STOPPED)
    assert list(bench["target_q"]) == GOAL


def test_freedrive_along_one_axis_moves_along_it_only(bench: Bench) -> None:
    bench.start("freedrive_mode(freeAxes=[0, 0, 1, 0, 0, 0])\nsleep(5)")
    bench.ticks(2)
    start = bench["actual_TCP_pose"]
    bench.controller.external_force([30, 30, 30, 0, 0, 0])
    bench.seconds(0.5)
    moved = [b - a for a, b in zip(start[:3], bench["actual_TCP_pose"][:3], strict=True)]
    assert moved[2] > 0.02
    assert max(map(abs, moved[:2])) < 2e-3


def test_force_mode_presses_until_the_reaction_balances(bench: Bench) -> None:
    bench.start(
        "force_mode(p[0,0,0,0,0,0], [0,0,1,0,0,0], [0,0,-10,0,0,0], 2, [0.1,0.1,0.05,0.3,0.3,0.3])"
        "\nsleep(5)\nend_force_mode()"
    )
    bench.seconds(0.5)
    assert -0.051 < bench["actual_TCP_speed"][2] < -0.03
    bench.controller.external_force([0, 0, 10, 0, 0, 0])
    bench.seconds(1.0)
    assert abs(bench["actual_TCP_speed"][2]) < 1e-4


PRESS = (
    "force_mode(p[0,0,0,0,0,0], [1,0,0,0,0,0], [20,0,0,0,0,0], 2, [0.1,0.1,0.1,0.3,0.3,0.3])"
    "\nsleep(0.5)\nend_force_mode()\n"
)


@pytest.mark.parametrize("stop", ["stopj(10)", "stopl(10)"])
def test_a_stop_after_force_mode_returns_when_the_arm_rests(bench: Bench, stop: str) -> None:
    bench.start(PRESS + stop + "\nwrite_output_integer_register(0, 7)\nsleep(1)")
    bench.seconds(0.4)
    assert abs(bench["actual_TCP_speed"][0]) > 0.02
    bench.until(lambda: bench["output_int_register_0"] == 7)
    assert not any(bench["target_qd"])


@pytest.mark.parametrize("between", ["", "stopj(10)\n"])
def test_servoj_straight_out_of_force_mode_arrives_exactly(bench: Bench, between: str) -> None:
    goal = list(bench["target_q"])
    servo = f"i = 0\nwhile i < 500:\n servoj({goal}, t=0.002)\n i = i + 1\nend"
    bench.start(PRESS + between + servo)
    bench.seconds(0.4)
    assert apart(bench["target_q"], goal) > 0.02
    bench.until(lambda: bench.controller.runtime_state == RuntimeState.STOPPED)
    assert apart(bench["target_q"], goal) < 1e-6


def test_direct_torque_accelerates_a_joint(bench: Bench) -> None:
    bench.start("while True:\n direct_torque([5, 0, 0, 0, 0, 0])\nend")
    bench.seconds(0.1)
    assert bench["target_qd"][0] > 0.05

"""Moves that clients of interpreter mode start, and abort."""

import pytest

from rigs.ur_controller import apart
from rigs.ur_interpreter import Interpreted

HOME = [0.0, -1.57, 1.57, -1.57, -1.57, 0.0]


@pytest.fixture
def bench():
    return Interpreted()


@pytest.fixture
def waiting(bench):
    """With a program in interpreter mode."""
    bench.start("interpreter_mode()")
    bench.ticks(2)
    return bench


def moving(bench, line):
    """Start a move and let it come to its full speed."""
    bench.send(line)
    bench.seconds(1.0)
    assert max(map(abs, bench["target_qd"])) > 0.05


def test_abort_stops_a_movej_within_its_deceleration_and_the_next_statement_follows(waiting):
    moving(waiting, "movej([1.5, -1.57, 1.57, -1.57, -1.57, 0], a=1, v=0.5)")
    at = waiting["target_q"][0]
    waiting.send("textmsg(get_target_joint_positions()[0])")
    assert waiting.send("abort") == ["ack: 0: abort"]
    waiting.until(lambda: bool(waiting.texts))
    assert float(waiting.texts[0]) - at == pytest.approx(0.5**2 / 2, abs=2e-3)
    waiting.ticks(1)
    assert apart(waiting["target_qd"], [0.0] * 6) == 0.0
    assert waiting.errors == []


def test_abort_keeps_a_movel_on_its_line(waiting):
    waiting.send("movel(pose_add(get_target_tcp_pose(), p[0, -0.2, 0, 0, 0, 0]), a=0.5, v=0.1)")
    start = waiting["target_TCP_pose"]
    waiting.seconds(1.0)
    waiting.send("abort")
    waiting.seconds(1.0)
    end = waiting["target_TCP_pose"]
    assert apart(waiting["target_qd"], [0.0] * 6) == 0.0
    assert 0.05 < start[1] - end[1] < 0.15
    assert (end[0], end[2]) == pytest.approx((start[0], start[2]), abs=1e-6)


def test_abort_stops_a_move_of_the_program_itself(bench):
    bench.start("movej([1.5, -1.57, 1.57, -1.57, -1.57, 0], a=1, v=0.5)\ntextmsg(1)")
    bench.seconds(1.0)
    bench.send("abort")
    bench.until(lambda: bool(bench.texts), seconds=1.0)
    assert bench["target_q"][0] < 1.0


@pytest.mark.parametrize("line", ["speedj([0.3, 0, 0, 0, 0, 0], 1, 3)", "optimovej({}, 0.1, 0.1)"])
def test_abort_leaves_other_motions_alone(waiting, line):
    moving(waiting, line.format([1.5, *HOME[1:]]))
    speed = waiting["target_qd"][0]
    waiting.send("abort")
    waiting.seconds(0.1)
    assert waiting["target_qd"][0] >= speed


def test_abort_of_a_paused_move_counts_when_it_goes_on(waiting):
    moving(waiting, "movej([1.5, -1.57, 1.57, -1.57, -1.57, 0], a=1, v=0.5)")
    waiting.controller.pause()
    waiting.seconds(1)
    waiting.send("abort")
    waiting.controller.play()
    waiting.seconds(2)
    assert apart(waiting["target_qd"], [0.0] * 6) == 0.0
    assert waiting["target_q"][0] < 1.2


def test_abort_without_a_move_does_not_reach_the_next(waiting):
    goal = [0.2, *HOME[1:]]
    waiting.send(f"movej({goal}, t=0.5)")
    waiting.seconds(1)
    waiting.send("abort", f"movej({HOME}, t=0.5)")
    waiting.seconds(1)
    assert apart(waiting["target_q"], HOME) < 1e-9


def test_abort_of_a_move_with_a_radius_begins_its_blend_at_once(waiting):
    to = "movel(pose_add(get_target_tcp_pose(), p[0, -0.4, 0, 0, 0, 0]), a=1, v=0.1, r=0.02)"
    start = waiting["target_TCP_pose"]
    waiting.send(to)
    waiting.seconds(1.0)
    waiting.send(f"movej({HOME}, a=1, v=0.5)")
    waiting.send("abort")
    slowest = 1.0
    for _ in range(50):
        waiting.ticks(1)
        slowest = min(slowest, max(map(abs, waiting["target_qd"])))
    assert waiting.state("statelastexecuted") == 2
    assert slowest > 0.01  # it never stopped
    assert start[1] - waiting["target_TCP_pose"][1] < 0.2
    waiting.seconds(5)
    assert apart(waiting["target_q"], HOME) < 1e-9
    assert waiting.errors == []


def test_statements_blend_into_each_other(waiting):
    waiting.send("movej([0.3, -1.57, 1.57, -1.57, -1.57, 0], a=2, v=0.5, r=0.05)")
    waiting.send("movej([0.6, -1.57, 1.57, -1.57, -1.57, 0], a=2, v=0.5)")
    waiting.until(lambda: waiting.state("statelastexecuted") == 2)
    assert waiting["target_qd"][0] > 0.2

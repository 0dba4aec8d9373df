"""Limits of the simulated UR: each one stops the arm protectively, with its error code."""

from __future__ import annotations

from math import pi

import pytest

from crtk_sim_backends.options import ConfigError
from crtk_sim_backends.ur.config import SimConfig
from crtk_sim_backends.ur.messages import ErrorMessage, ReportLevel, RuntimeExceptionMessage
from crtk_sim_backends.ur.motion.kinematics import norm
from crtk_sim_backends.ur.motion.limits import SafetyLimits
from crtk_sim_backends.ur.safety.modes import RuntimeState, SafetyMode
from rigs.ur_controller import Bench

FAST = "movej([0.8, -1.2, 1.2, -1.57, -1.57, 0.5], v=2.5, a=10)"
FAR = "while True:\n servoj([2, -1.57, 1.57, -1.57, -1.57, 0], lookahead_time=0.03)\nend"
FROZEN = "movej([1, -1.57, 1.57, -1.57, -1.57, 0])"
SWING = "while True:\n speedj([{}], 10, 0.01)\nend"


def stopped(bench: Bench, body: str) -> tuple[int, int]:
    bench.start(body)
    bench.until(lambda: bench.controller.safety_mode == SafetyMode.PROTECTIVE_STOP)
    bench.seconds(1.0)
    assert bench.controller.runtime_state == RuntimeState.STOPPED
    assert bench["target_qd"] == (0.0,) * 6
    (error,) = bench.of_type(ErrorMessage)
    assert error.text
    assert error.text != "Protective Stop"
    return error.code, error.argument


@pytest.mark.parametrize(
    ("limits", "argument"),
    [
        (SafetyLimits(power=100.0), 6),
        (SafetyLimits(momentum=1.0), 12),
    ],
)
def test_a_violated_safety_limit_stops_the_arm(limits: SafetyLimits, argument: int) -> None:
    assert stopped(Bench(limits=limits), FAST) == (191, argument)
    assert Bench().run(FAST)  # which the default limits permit


def test_a_tool_speed_beyond_the_limit_stops_what_is_not_planned() -> None:
    body = "while True:\n servoj([0.2, -1.57, 1.57, -1.57, -1.57, 0], lookahead_time=0.1)\nend"
    assert stopped(Bench(limits=SafetyLimits(tool_speed=0.3)), body) == (191, 3)


def test_a_speed_keeps_to_the_tool_speed() -> None:
    bench = Bench(limits=SafetyLimits(tool_speed=0.5))
    bench.start("speedj([2.5, 0, 0, 0, 0, 0], 10, 0.5)\nstopj(10)")
    fastest = 0.0
    while bench.controller.runtime_state == RuntimeState.PLAYING:
        bench.ticks(1)
        fastest = max(fastest, norm(bench["target_TCP_speed"][:3]))
    assert fastest == pytest.approx(0.5, rel=0.01)
    assert not bench.of_type(ErrorMessage)
    assert bench.controller.safety_mode == SafetyMode.NORMAL


@pytest.mark.parametrize("move", ["movej({}, v=2.5, a=10)", "movel({}, v=2.5, a=10)"])
def test_a_move_keeps_to_the_tool_speed(move: str) -> None:
    bench = Bench(limits=SafetyLimits(tool_speed=0.5))
    goal = "[0.8, -1.2, 1.2, -1.57, -1.57, 0.5]"
    bench.start(move.format(goal))
    fastest = 0.0
    while bench.controller.runtime_state == RuntimeState.PLAYING:
        bench.ticks(1)
        fastest = max(fastest, norm(bench["target_TCP_speed"][:3]))
    assert fastest == pytest.approx(0.5, rel=0.01)
    assert bench["target_q"] == pytest.approx((0.8, -1.2, 1.2, -1.57, -1.57, 0.5))
    assert bench.controller.safety_mode == SafetyMode.NORMAL


def test_a_tool_slower_than_its_limit_is_left_alone() -> None:
    bench = Bench(limits=SafetyLimits(tool_speed=0.3))
    bench.run("speedl([0, 0, 0.29, 0, 0, 0], 1, 0.5)\nstopl(2)")
    assert bench.controller.safety_mode == SafetyMode.NORMAL


@pytest.mark.parametrize("joint", range(6))
def test_a_joint_pushed_faster_than_it_can_turn(joint: int) -> None:
    torques = ", ".join("25" if i == joint else "0" for i in range(6))
    code = stopped(
        Bench(), f"while True:\n direct_torque([{torques}], viscous_scale=[1,1,1,1,1,1])\nend"
    )
    assert code[0] in (191, 150)
    assert joint not in (0, 5) or code == (191, 32 + joint)


@pytest.mark.parametrize("joint", range(6))
def test_a_joint_speed_that_is_asked_too_much_of_it_is_slowed_down(joint: int) -> None:
    """As UR's splines go on though they are beyond a joint (its test of a first point of no time)."""
    bench = Bench()
    speeds = ", ".join("6.6" if i == joint else "0.66" for i in range(6))
    bench.start(f"speedj([{speeds}], 40, 0.4)\nwrite_output_integer_register(0, 1)\nstopj(40)")
    bench.seconds(0.4)
    limits = bench.controller.model.velocity
    assert max(map(abs, bench["target_qd"])) == pytest.approx(limits[joint], rel=1e-6)
    assert bench["target_qd"][joint] / bench["target_qd"][(joint + 1) % 6] == pytest.approx(10.0)
    ticks = 200 + bench.until(lambda: bench["output_int_register_0"] == 1)
    way = 6.6 * 0.4 - 6.6**2 / 80.0  # that is planned
    slowed = limits[joint] / 40.0 + (way - limits[joint] ** 2 / 80.0) / limits[joint]
    assert ticks * 0.002 == pytest.approx(slowed, abs=0.005)
    bench.until(lambda: bench.controller.runtime_state == RuntimeState.STOPPED)
    assert bench.controller.safety_mode == SafetyMode.NORMAL


@pytest.mark.parametrize("joint", range(6))
def test_a_joint_at_the_end_of_its_way(joint: int) -> None:
    speeds = ", ".join("-3.0" if i == joint else "0" for i in range(6))
    bench = Bench()
    assert stopped(bench, SWING.format(speeds)) == (150, 0)
    assert bench["actual_q"][joint] >= -2 * pi


def test_a_servo_target_that_is_too_far_away() -> None:
    assert stopped(Bench(), FAR) == (204, 1)


def test_a_speed_through_a_singularity() -> None:
    bench = Bench()
    bench.run("movej([0, -1.2, 1.2, -1.57, -0.05, 0], v=3, a=20)")
    bench.messages.clear()
    code, _ = stopped(bench, "while True:\n speedl([0, 0, 0, 0.0, 0.5, 0.5], 1, 0.01)\nend")
    assert code in (154, 191)


@pytest.mark.parametrize("call", ["movej", "optimovej"])
def test_a_pose_out_of_reach_is_a_runtime_exception(call: str) -> None:
    bench = Bench()
    bench.start(f"sync()\n{call}(p[2, 0, 0, 0, 0, 0])")
    bench.seconds(0.1)
    error = bench.of_type(RuntimeExceptionMessage)[-1]
    assert "inverse kinematics" in error.text
    assert error.line == 3
    assert bench.controller.safety_mode == SafetyMode.NORMAL


OUT_OF_REACH = (
    "p[10, 0, 0, 0, 0, 0]",
    "p[0, 0, 0, 0, 0, 0]",
    "p[-10.2, 0.26, 0.56, 0.7, -1.1, -2.1]",
)


@pytest.mark.sweep(4)
@pytest.mark.parametrize("target", OUT_OF_REACH)
@pytest.mark.parametrize(
    "move",
    [
        "movel({}, v=1, a=2)",
        "movep({}, v=1, a=2)",
        "servoc({}, v=1, a=2)",
        "optimovel({}, v=0.5)",
        "movec(pose_add(get_target_tcp_pose(), p[0, 0.02, 0.02, 0, 0, 0]), {}, v=1, a=2)",
    ],
)
def test_a_line_out_of_reach_is_a_warning_and_a_protective_stop(move: str, target: str) -> None:
    """UR's client library: an error code and a stop, after whose unlocking the arm moves again."""
    bench = Bench()
    assert stopped(bench, move.format(target)) == (154, 0)
    assert [m.level for m in bench.of_type(ErrorMessage)] == [ReportLevel.WARNING]
    assert not bench.of_type(RuntimeExceptionMessage)
    bench.controller.run_script("set unlock protective stop")
    bench.run("movej([0.1, -1.57, 1.57, -1.57, -1.57, 0])")
    assert bench["target_q"][0] == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("body", "code", "level"),
    [
        ("protective_stop()", 209, ReportLevel.WARNING),
        ("movel(p[10, 0, 0, 0, 0, 0])", 154, ReportLevel.WARNING),
        ("set_payload(1)\nmovel(p[0.4, 0, 0, 0, 3.1, 0], v=5, a=9)", 157, ReportLevel.WARNING),
        ("movel(p[0.4, 0, 0, 0, 3.1, 0], v=5, a=9)", 158, ReportLevel.WARNING),
        (FROZEN, 153, ReportLevel.WARNING),
        (FAR, 204, ReportLevel.WARNING),
        (SWING.format("-3, 0, 0, 0, 0, 0"), 150, ReportLevel.WARNING),
        ("while True:\n direct_torque([20, 0, 0, 0, 0, 0])\nend", 191, ReportLevel.VIOLATION),
    ],
)
def test_only_limits_of_the_safety_configuration_are_violations(
    body: str, code: int, level: ReportLevel
) -> None:
    bench = Bench(limits=SafetyLimits(tool_force=20.0))
    if code in (157, 158):
        bench.controller.external_force([30.0, 0, 0, 0, 0, 0])
    if body is FROZEN:
        bench.controller.freeze_joint(0)
    stopped(bench, body)
    assert [(m.code, m.level) for m in bench.of_type(ErrorMessage)] == [(code, level)]


def test_the_arm_goes_on_after_a_violated_limit_is_unlocked() -> None:
    bench = Bench(limits=SafetyLimits(power=100.0))
    stopped(bench, FAST)
    bench.seconds(5.0)
    assert bench.controller.unlock_protective_stop()
    bench.run("movej([0.8, -1.2, 1.2, -1.57, -1.57, 0.5], v=0.1, a=0.2)")
    assert bench["target_q"] == (0.8, -1.2, 1.2, -1.57, -1.57, 0.5)


def test_limits_of_the_configuration() -> None:
    config = SimConfig(tool_speed_limit=0.25, contact="0,0,0/0,0,1")
    assert config.limits.tool_speed == 0.25
    assert len(config.surfaces) == 1
    with pytest.raises(ConfigError, match="power_limit"):
        SimConfig(power_limit=0)
    with pytest.raises(ConfigError, match=r"contact: .*normal"):
        SimConfig(contact="0,0,0/0,0,0")

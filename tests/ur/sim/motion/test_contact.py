"""The simulated UR touches surfaces: force mode, freedrive, contact detection, force limit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest

from crtk_sim_backends.ur.messages import ErrorMessage, TextMessage
from crtk_sim_backends.ur.motion.contact import Surface, parse
from crtk_sim_backends.ur.motion.kinematics import norm
from crtk_sim_backends.ur.safety.modes import RuntimeState, SafetyMode
from rigs.ur_controller import Bench, apart

START = "p[-0.45, -0.2, 0.3, 0, 3.14159, 0]"
TABLE = 0.25  # m, height
LIMITS = "[0.05, 0.05, 0.05, 0.3, 0.3, 0.3]"


def over_a_table(model: str = "ur5e", **changes: float) -> Bench:
    table = Surface.make((0.0, 0.0, TABLE), (0.0, 0.0, 1.0), **changes)
    bench = Bench(model, surfaces=[table])
    bench.run(f"movej({START}, v=3, a=20)")
    bench.seconds(0.2)
    return bench


def over_nothing() -> Bench:
    bench = Bench()
    bench.run(f"movej({START}, v=3, a=20)")
    bench.seconds(0.2)
    return bench


def force(bench: Bench) -> Sequence[float]:
    return list(bench["actual_TCP_force"])


def moved(bench: Bench, start: Sequence[float]) -> list[float]:
    return [b - a for a, b in zip(start[:3], bench["actual_TCP_pose"][:3], strict=True)]


@pytest.mark.parametrize(
    ("model", "stiffness"), [("ur5e", 2000.0), ("ur5e", 30000.0), ("ur5", 2000.0), ("ur5", 10000.0)]
)
def test_force_mode_presses_on_a_surface_with_its_force(model: str, stiffness: float) -> None:
    bench = over_a_table(model, stiffness=stiffness)
    start = bench["actual_TCP_pose"]
    bench.start(
        f"force_mode(p[0,0,0,0,0,0], [0,0,1,0,0,0], [0,0,-20,0,0,0], 2, {LIMITS})\nsleep(20)"
    )
    bench.seconds(4.0)
    largest = 0.0
    for _ in range(100):
        bench.ticks(1)
        largest = max(largest, abs(force(bench)[2] - 20.0))
    assert largest < 0.5
    assert bench["actual_TCP_pose"][2] == pytest.approx(TABLE - 20.0 / stiffness, abs=1e-4)
    assert max(map(abs, moved(bench, start)[:2])) < 1e-6  # the other axes hold
    assert bench["actual_TCP_force"][:2] == pytest.approx((0.0, 0.0), abs=1e-6)


def test_force_mode_follows_a_move_along_the_surface() -> None:
    bench = over_a_table()
    press = f"force_mode(p[0,0,0,0,0,0], [0,0,1,0,0,0], [0,0,-20,0,0,0], 2, {LIMITS})"
    bench.start(
        f"{press}\nsleep(3)\np = get_target_tcp_pose()\n"
        "movel(p[-0.45, -0.35, 0.3, 0, 3.14159, 0], v=0.1)\nsleep(10)"
    )
    bench.seconds(3.0)
    while bench["target_TCP_pose"][1] > -0.3499:
        bench.ticks(1)
        assert bench["actual_TCP_force"][2] == pytest.approx(20.0, abs=2.0)
        assert bench["target_TCP_pose"][0] == pytest.approx(-0.45, abs=2e-4)
        assert bench.controller.time < 10.0
    assert bench["target_TCP_pose"][3:] == pytest.approx((0, 3.14159, 0), abs=2e-3)


def test_force_mode_towards_a_point_turns_its_frame() -> None:
    """Type 1: the y axis points from the tool to the origin of the frame, here a post."""
    bench = over_nothing()
    start = bench["actual_TCP_pose"]
    bench.start(
        f"force_mode(p[-0.6, -0.4, 0.3, 0, 0, 0], [0,1,0,0,0,0], [0,20,0,0,0,0], 1, {LIMITS})"
        "\nsleep(20)"
    )
    bench.seconds(1.0)
    x, y, z = moved(bench, start)
    assert (x, y) == pytest.approx((-0.6 * norm((x, y)), -0.8 * norm((x, y))), abs=1e-3)
    assert norm((x, y)) > 0.03
    assert abs(z) < 1e-5


def test_force_mode_along_the_motion_turns_its_frame() -> None:
    """Type 3: x is the direction of motion in the plane, so y gives way across it."""
    bench = over_nothing()
    start = bench["actual_TCP_pose"]
    bench.start(
        f"force_mode(p[0, 0, 0, 0, 0, 0], [0,1,0,0,0,0], [0,10,0,0,0,0], 3, {LIMITS})\n"
        "movel(p[-0.45, -0.3, 0.3, 0, 3.14159, 0], v=0.1)\nsleep(20)"
    )
    bench.seconds(0.6)
    x, y, _ = moved(bench, start)
    # It moves towards -y, so that its y axis is +x of the base.
    assert y == pytest.approx(-0.056, abs=0.002)
    assert x > 0.02


def test_force_mode_takes_the_zero_of_the_sensor() -> None:
    bench = over_a_table()
    bench.controller.external_force([0, 0, 30, 0, 0, 0])
    bench.ticks(2)
    bench.start(
        f"zero_ftsensor()\nsync()\nforce_mode(p[0,0,0,0,0,0], [0,0,1,0,0,0], [0,0,0,0,0,0], 2, {LIMITS})\n"
        "sleep(20)"
    )
    bench.ticks(2)
    still = bench["actual_q"]
    bench.seconds(1.0)
    assert apart(bench["actual_q"], still) < 1e-6


def test_force_mode_begins_where_freedrive_left_the_arm() -> None:
    bench = Bench()
    bench.start(
        "freedrive_mode()\nsleep(0.5)\nend_freedrive_mode()\nsleep(0.5)\n"
        f"force_mode(p[0,0,0,0,0,0], [0,0,1,0,0,0], [0,0,0,0,0,0], 2, {LIMITS})\nsleep(20)"
    )
    bench.controller.external_force([0, 30, 0, 0, 0, 0])
    bench.seconds(0.5)
    bench.controller.external_force([0] * 6)
    bench.seconds(0.45)
    left = bench["actual_q"]
    bench.seconds(1.0)
    assert apart(bench["actual_q"], left) < 1e-6


@pytest.mark.parametrize("axis", range(3))
def test_freedrive_gives_way_along_its_axes_only(axis: int) -> None:
    bench = over_nothing()
    start = bench["actual_TCP_pose"]
    axes = [int(i == axis) for i in range(6)]
    bench.start(f"freedrive_mode({axes}, p[0, 0, 0, 0, 0, 0])\nsleep(20)")
    bench.controller.external_force([20, -20, 20, 1, 1, 1])
    bench.seconds(0.5)
    for i, way in enumerate(moved(bench, start)):
        assert (abs(way) > 0.02) == (i == axis)
        assert abs(way) > 0.02 or abs(way) < 1e-4
    assert apart(start[3:], bench["actual_TCP_pose"][3:]) < 1e-4


def test_teach_mode_is_freedrive_and_stops_at_a_surface() -> None:
    bench = over_a_table()
    bench.start("teach_mode()\nsleep(20)")
    bench.controller.external_force([0, 0, -30, 0, 0, 0])
    bench.seconds(5.0)
    # The hand presses the tool into the table by its own force.
    assert bench["actual_TCP_pose"][2] == pytest.approx(TABLE - 30.0 / 10000.0, abs=1e-3)


def test_a_move_into_a_surface_is_felt_and_stops_at_the_force_limit() -> None:
    bench = over_a_table()
    bench.start("movel(p[-0.45, -0.2, 0.2, 0, 3.14159, 0], v=0.05)")
    felt = []
    while bench.controller.safety_mode == SafetyMode.NORMAL:
        bench.ticks(1)
        depth = TABLE - bench["actual_TCP_pose"][2]
        felt.append((depth, force(bench)[2]))
        assert bench.controller.time < 10.0
    assert all(f == 0.0 for depth, f in felt if depth < -1e-3)
    assert max(f for _, f in felt) == pytest.approx(250.0, rel=0.02)
    errors = [(m.code, m.text) for m in bench.of_type(ErrorMessage)]
    assert errors[0][0] == 158  # no payload was given
    assert "Collision detected by joint" in errors[0][1]
    bench.seconds(1.0)
    assert bench.controller.runtime_state == RuntimeState.STOPPED
    assert bench["collision_detection_ratio"] > 0.5


def test_the_joint_that_feels_the_collision_is_named_and_torques_show_it() -> None:
    bench = over_a_table()
    before = bench["actual_current_as_torque"]
    bench.start("set_payload(1.0)\nspeedl([0, 0, -0.05, 0, 0, 0], 1, 5)")
    bench.until(lambda: force(bench)[2] > 100.0)
    assert apart(before, bench["actual_current_as_torque"]) > 10.0
    bench.until(lambda: bench.controller.safety_mode == SafetyMode.PROTECTIVE_STOP)
    error = bench.of_type(ErrorMessage)[0]
    assert error.code == 157
    assert ("Base", "Shoulder", "Elbow", "Wrist 1", "Wrist 2", "Wrist 3")[
        error.argument
    ] in error.text


def test_friction_holds_back_what_slides() -> None:
    bench = over_a_table(friction=0.3)
    bench.start(
        f"force_mode(p[0,0,0,0,0,0], [0,0,1,0,0,0], [0,0,-20,0,0,0], 2, {LIMITS})\nsleep(3)\n"
        "movel(p[-0.45, -0.35, 0.3, 0, 3.14159, 0], v=0.05)\nsleep(20)"
    )
    bench.seconds(4.5)
    assert bench["actual_TCP_speed"][1] == pytest.approx(-0.05, abs=5e-3)
    assert force(bench)[1] == pytest.approx(0.3 * 20.0, abs=0.5)


def test_tool_contact_counts_back_to_the_first_touch() -> None:
    bench = over_a_table()
    bench.start(
        "step_back = 0\nwhile step_back == 0:\n speedl([0, 0, -0.05, 0, 0, 0], 1, get_steptime())\n"
        " step_back = tool_contact(direction=[0, 0, -1, 0, 0, 0])\nend\n"
        "q = get_actual_joint_positions_history(step_back)\nstopl(3)\nmovel(q)\n"
        "textmsg(step_back)\nsleep(5)"
    )
    bench.until(lambda: bool(bench.of_type(TextMessage)))
    bench.seconds(0.3)
    assert int(bench.of_type(TextMessage)[0].text) > 0
    assert bench["actual_TCP_pose"][2] == pytest.approx(TABLE, abs=1e-3)


@pytest.mark.parametrize(
    ("direction", "contact"),
    [("[0,0,0,0,0,0]", True), ("[0,0,-1,0,0,0]", True), ("[0,0,1,0,0,0]", False)],
)
def test_tool_contact_looks_in_its_direction(direction: str, contact: bool) -> None:
    bench = over_a_table()
    bench.controller.external_force([0, 0, 20, 0, 0, 0])
    bench.seconds(0.1)
    bench.start(f"textmsg(tool_contact({direction}) > 0)")
    bench.seconds(0.1)
    assert bench.of_type(TextMessage)[0].text == str(contact)


def test_surfaces_can_be_placed_and_taken_away() -> None:
    bench = over_nothing()
    bench.controller.surroundings.place(3, Surface.make((0, 0, 0.31), (0, 0, 1), stiffness=1000))
    bench.seconds(0.1)
    assert force(bench)[2] == pytest.approx(10.0, abs=0.1)
    bench.controller.surroundings.place(3, None)
    bench.seconds(0.1)
    assert force(bench) == [0.0] * 6


def test_surfaces_of_an_option() -> None:
    floor, wall = parse("0,0,0.1/0,0,2/20000/50/0.3; 0.6,0,0/-1,0,0")
    assert floor == Surface((0.0, 0.0, 0.1), (0.0, 0.0, 1.0), 20000.0, 50.0, 0.3)
    assert wall.normal == (-1.0, 0.0, 0.0)
    assert parse("") == []


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("0,0,0.1", "point/normal"),
        ("0,0/0,0,1", "point of a surface"),
        ("0,0,0/0,0,0", "normal of a surface must not be zero"),
        ("0,0,0/0,0,up", "no number"),
        ("0,0,0/0,0,1/-5", "stiffness"),
        ("0,0,0/0,0,1/5/-1", "damping"),
        ("0,0,0/0,0,1/5/1/9", "friction"),
        ("0,0,nan/0,0,1", "point"),
    ],
)
def test_what_is_no_surface_is_refused(text: str, problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        parse(text)


def test_a_surface_pushes_and_never_pulls() -> None:
    surface = Surface.make((0, 0, 0), (0, 0, 1), 1000, 100)
    still: Any = (0.0, 0.0, 0.0)
    assert surface.force((0, 0, 0.001), still) is None
    assert surface.force((0, 0, -0.01), still) == pytest.approx((0, 0, 10))
    assert surface.force((0, 0, -0.01), (0, 0, -0.1)) == pytest.approx((0, 0, 20))
    assert surface.force((0, 0, -0.01), (0, 0, 5.0)) == (0, 0, 0)

"""Moves to a point of the simulated UR, and the blends between them."""

from __future__ import annotations

from itertools import pairwise
from math import pi

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crtk_sim_backends.ur.messages import ErrorMessage, RuntimeExceptionMessage, TextMessage
from crtk_sim_backends.ur.motion.kinematics import norm, to_transform
from crtk_sim_backends.ur.motion.paths import Arc, Line, rounded
from crtk_sim_backends.ur.motion.profiles import Profile, ramps, timed
from crtk_sim_backends.ur.safety.modes import RuntimeState, SafetyMode
from rigs.examples import examples
from rigs.ur_controller import Bench, apart

GOAL = [0.3, -1.2, 1.4, -1.6, -1.5, 0.2]
POSES = [
    [-0.45, -0.15, 0.45],
    [-0.45, -0.35, 0.45],
    [-0.45, -0.35, 0.60],
    [-0.60, -0.30, 0.55],
]
DOWN = [0.0, pi, 0.0]


@pytest.fixture
def bench() -> Bench:
    return Bench()


def pose(index: int) -> str:
    return f"p{[*POSES[index], *DOWN]}"


def place(index: int) -> list[float]:
    return POSES[index]


def ready(bench: Bench) -> None:
    """Bring the arm to the first pose."""
    bench.run(f"movej({pose(0)}, v=3, a=20)")
    bench.seconds(0.2)
    bench.messages.clear()


def record(bench: Bench, body: str, seconds: float = 30.0) -> list[dict[str, tuple[float, ...]]]:
    """Run a program; target position and speed of joints and tool in every period."""
    bench.start(body)
    periods = []

    def ended() -> bool:
        names = ("target_q", "target_qd", "target_TCP_pose", "target_TCP_speed")
        periods.append({name: bench[name] for name in names})
        return bool(bench.controller.runtime_state == RuntimeState.STOPPED)

    bench.until(ended, seconds)
    return periods


def speeds(periods: list[dict[str, tuple[float, ...]]]) -> list[float]:
    return [norm(period["target_TCP_speed"][:3]) for period in periods]


def nearest(periods: list[dict[str, tuple[float, ...]]], point: list[float]) -> float:
    return min(apart_in_space(period["target_TCP_pose"], point) for period in periods)


def apart_in_space(a: tuple[float, ...] | list[float], b: list[float]) -> float:
    return norm([x - y for x, y in zip(a[:3], b, strict=True)])


def jolt(periods: list[dict[str, tuple[float, ...]]], dt: float = 0.002) -> float:
    """Largest acceleration of a joint, rad/s^2."""
    return max(apart(a["target_qd"], b["target_qd"]) for a, b in pairwise(periods)) / dt


def blend_issues(bench: Bench) -> list[tuple[int, int]]:
    return [(m.code, m.argument) for m in bench.of_type(ErrorMessage)]


# Blends.


def test_a_blend_stays_within_its_radius_and_does_not_stop(bench: Bench) -> None:
    ready(bench)
    radius = 0.04
    body = f"movel({pose(1)}, a=1, v=0.3, r={radius})\nmovel({pose(2)}, a=1, v=0.3)"
    periods = record(bench, body)
    corner, end = place(1), place(2)
    assert 0.005 < nearest(periods, corner) < radius
    for period in periods:
        x, y, z = period["target_TCP_pose"][:3]
        assert abs(x - corner[0]) < 1e-6
        if y > corner[1] + radius:
            assert abs(z - corner[2]) < 1e-6  # on the first line
        if z > corner[2] + radius:
            assert abs(y - corner[1]) < 1e-6  # on the second one
    moving = [v for v in speeds(periods) if v > 0.0]
    inside = [
        norm(p["target_TCP_speed"][:3])
        for p in periods
        if apart_in_space(p["target_TCP_pose"], corner) < radius
    ]
    assert min(inside) > 0.1
    assert max(moving) == pytest.approx(0.3, rel=0.01)
    assert apart_in_space(periods[-1]["target_TCP_pose"], end) < 1e-9
    changes = [
        apart_in_space(a["target_TCP_speed"], list(b["target_TCP_speed"][:3]))
        for a, b in pairwise(periods)
    ]
    assert max(changes) / bench.controller.dt < 1.3  # no corner takes more than `a`, 1.0


MOVES = {
    "movej": "movej({}, a=3, v=1.5, r={})",
    "movel": "movel({}, a=1, v=0.3, r={})",
    "movep": "movep({}, a=1, v=0.2, r={})",
}


@pytest.mark.sweep(5)
@pytest.mark.parametrize("first", MOVES)
@pytest.mark.parametrize("second", MOVES)
@pytest.mark.parametrize("model", ["ur5e", "ur5"])
def test_every_kind_of_move_blends_with_every_other(first: str, second: str, model: str) -> None:
    bench = Bench(model)
    ready(bench)
    radius = 0.05
    body = f"{MOVES[first].format(pose(1), radius)}\n{MOVES[second].format(pose(2), 0)}"
    periods = record(bench, body)
    assert bench.messages[-1].title == "PROGRAM_XXX_STOPPED"
    assert not blend_issues(bench)
    assert 0.001 < nearest(periods, place(1)) < radius
    assert apart_in_space(periods[-1]["target_TCP_pose"], place(2)) < 1e-6
    assert jolt(periods, bench.controller.dt) < 40.0
    rests = [not any(p["target_qd"]) for p in periods]
    assert rests.index(False) + rests[rests.index(False) :].index(True) >= len(periods) - 110


def test_a_circle_blends_with_lines(bench: Bench) -> None:
    ready(bench)
    via, end = f"p{[-0.45, -0.25, 0.55, *DOWN]}", place(1)
    body = (
        f"movel(p{[-0.45, -0.15, 0.5, *DOWN]}, v=0.2, r=0.02)\n"
        f"movec({via}, {pose(1)}, v=0.2, r=0.03)\nmovel({pose(3)}, v=0.2)"
    )
    periods = record(bench, body)
    assert not blend_issues(bench)
    assert 0.001 < nearest(periods, end) < 0.03
    assert apart_in_space(periods[-1]["target_TCP_pose"], place(3)) < 1e-9
    assert jolt(periods) < 40.0


def test_the_program_goes_on_where_the_blend_begins(bench: Bench) -> None:
    ready(bench)
    bench.start(
        f'movel({pose(1)}, v=0.1, r=0.05)\ntextmsg("blend")\nmovel({pose(2)}, v=0.1)\n'
        'textmsg("end")'
    )
    bench.until(lambda: bool(bench.of_type(TextMessage)))
    here = apart_in_space(bench["target_TCP_pose"], place(1))
    assert here == pytest.approx(0.05, abs=0.002)
    bench.until(lambda: len(bench.of_type(TextMessage)) == 2)
    assert apart_in_space(bench["target_TCP_pose"], place(2)) < 1e-9


def test_the_target_waypoint_is_that_of_the_running_move(bench: Bench) -> None:
    ready(bench)
    bench.start(
        "thread watch():\n while True:\n  textmsg(get_target_waypoint())\n  sync()\n end\nend\n"
        f"movel({pose(1)}, v=0.3, r=0.05)\nglobal between = get_target_waypoint()\n"
        f"run watch()\nmovej({pose(2)})\nsync()\nsync()\n"
        'textmsg("p[0,", between[1])\nstopl(1)\nspeedl([0,0,-0.1,0,0,0], 1, 0.2)'
    )
    bench.until(lambda: bench.controller.runtime_state == RuntimeState.STOPPED)
    texts = [m.text for m in bench.of_type(TextMessage)]
    between = next(text for text in texts if text.startswith("p[0,"))
    assert float(between.removeprefix("p[0,")) == pytest.approx(place(1)[1])
    heights = [float(t.split(",")[2]) for t in texts if not t.startswith("p[0,")]
    assert heights[0] == pytest.approx(place(2)[2], abs=1e-6)
    assert heights[-1] < place(2)[2] - 0.01  # when no move runs: the target


def test_timed_moves_take_their_times_through_blends(bench: Bench) -> None:
    ready(bench)
    plain = Bench()
    ready(plain)
    times = (1.0, 0.6, 0.8)
    blended = "\n".join(
        f"movel({pose(i)}, t={t}, r={r})"
        for i, t, r in zip((1, 2, 3), times, (0.03, 0.03, 0), strict=True)
    )
    stopping = "\n".join(f"movel({pose(i)}, t={t})" for i, t in zip((1, 2, 3), times, strict=True))
    assert bench.run(blended) * 0.002 == pytest.approx(sum(times), abs=0.006)
    assert plain.run(stopping) * 0.002 == pytest.approx(sum(times), abs=0.008)


def test_the_speed_slider_stretches_blends_and_leaves_the_path(bench: Bench) -> None:
    ready(bench)
    slow = Bench()
    ready(slow)
    slow.write(speed_slider_mask=1, speed_slider_fraction=0.5)
    slow.seconds(0.5)
    body = f"movel({pose(1)}, v=0.2, r=0.04)\nmovel({pose(2)}, v=0.2)"
    full, half = record(bench, body), record(slow, body)
    assert len(half) == pytest.approx(2 * len(full), abs=15)
    assert nearest(half, place(1)) == pytest.approx(nearest(full, place(1)), abs=2e-4)


def test_a_pause_within_a_blend_holds_and_goes_on(bench: Bench) -> None:
    ready(bench)
    bench.start(f"movel({pose(1)}, v=0.2, r=0.05)\nmovel({pose(2)}, v=0.2)")
    bench.until(lambda: apart_in_space(bench["target_TCP_pose"], place(1)) < 0.045)
    bench.controller.pause()
    bench.seconds(0.5)
    assert not any(bench["target_qd"])
    assert apart_in_space(bench["target_TCP_pose"], place(1)) < 0.05
    bench.controller.play()
    bench.until(lambda: bench.controller.runtime_state == RuntimeState.STOPPED)
    assert apart_in_space(bench["target_TCP_pose"], place(2)) < 1e-9


@pytest.mark.parametrize(
    ("name", "argument"), [("movej", 4), ("movel", 11), ("movep", 9), ("movec", 0)]
)
def test_overlapping_blends_skip_the_waypoint_with_a_warning(
    bench: Bench, name: str, argument: int
) -> None:
    ready(bench)
    near = f"p{[-0.45, -0.32, 0.47, *DOWN]}"
    via = f"p{[-0.45, -0.335, 0.455, *DOWN]}, " if name == "movec" else ""
    body = f"movel({pose(1)}, v=0.2, r=0.04)\n{name}({via}{near}, r=0.04)\nmovel({pose(2)}, v=0.2)"
    periods = record(bench, body)
    assert blend_issues(bench) == [(171, argument)]
    assert apart_in_space(periods[-1]["target_TCP_pose"], place(2)) < 1e-9
    assert all(abs(p["target_TCP_pose"][0] - place(1)[0]) < 1e-6 for p in periods)


def test_a_waypoint_without_blend_is_never_skipped(bench: Bench) -> None:
    ready(bench)
    near = [-0.45, -0.34, 0.46]
    periods = record(
        bench, f"movel({pose(1)}, v=0.2, r=0.05)\nmovel(p{[*near, *DOWN]}, v=0.2)\nsync()"
    )
    assert not blend_issues(bench)
    assert apart_in_space(periods[-1]["target_TCP_pose"], near) < 1e-9


def test_a_blend_that_no_move_follows_leaves_the_arm_short_of_its_waypoint(bench: Bench) -> None:
    ready(bench)
    bench.run(f"movel({pose(1)}, v=0.2, a=2, r=0.05)")
    assert 0.03 < apart_in_space(bench["target_TCP_pose"], place(1)) < 0.05
    assert bench.controller.safety_mode == SafetyMode.NORMAL


def test_a_blend_to_a_move_of_another_thread(bench: Bench) -> None:
    ready(bench)
    body = (
        f"thread first():\n movel({pose(1)}, v=0.2, r=0.05)\nend\n"
        f"thread second():\n movel({pose(2)}, v=0.2)\nend\n"
        "h = run first()\njoin h\nh = run second()\njoin h"
    )
    periods = record(bench, body)
    assert 0.001 < nearest(periods, place(1)) < 0.05
    assert apart_in_space(periods[-1]["target_TCP_pose"], place(2)) < 1e-9
    assert not bench.of_type(RuntimeExceptionMessage)


def test_movep_rounds_corners_at_constant_speed(bench: Bench) -> None:
    ready(bench)
    body = "\n".join(
        f"movep({pose(i)}, a=2, v=0.1, r={r})" for i, r in ((1, 0.04), (2, 0.04), (3, 0))
    )
    periods = record(bench, body)
    fast = [i for i, v in enumerate(speeds(periods)) if v > 0.0999]
    for v in speeds(periods)[fast[0] : fast[-1]]:
        assert v == pytest.approx(0.1, rel=5e-3)
    # Around a right angle on a circle of the blend radius.
    assert nearest(periods, place(1)) == pytest.approx(0.04 * (2**0.5 - 1), abs=2e-4)


def test_a_stream_of_servoc_reaches_its_last_pose(bench: Bench) -> None:
    ready(bench)
    bench.start(
        f"global goal = {pose(1)}\n"
        "thread stream():\n while True:\n  servoc(goal, 1.2, 0.2, 0.03)\n end\nend\n"
        f"run stream()\nsleep(0.9)\ngoal = {pose(2)}\nsleep(3)"
    )
    bench.seconds(3.5)
    assert bench.controller.runtime_state == RuntimeState.PLAYING
    assert apart_in_space(bench["target_TCP_pose"], place(2)) < 1e-9


def test_a_stop_within_a_blend_forgets_it(bench: Bench) -> None:
    ready(bench)
    bench.run(f"movel({pose(1)}, v=0.2, r=0.05)\nstopl(2)\nmovel({pose(2)}, v=0.2)")
    bench.seconds(0.2)
    assert apart_in_space(bench["actual_TCP_pose"], place(2)) < 1e-9


@settings(max_examples=examples(15), deadline=None)
@given(
    st.lists(
        st.tuples(
            st.sampled_from(sorted(MOVES)),
            st.tuples(st.floats(-0.55, -0.4), st.floats(-0.3, -0.1), st.floats(0.3, 0.45)),
            st.one_of(st.just(0.0), st.floats(0.01, 0.1)),
        ),
        min_size=2,
        max_size=5,
    )
)
def test_any_sequence_of_blends_is_smooth_and_ends_at_its_last_waypoint(
    moves: list[tuple[str, tuple[float, float, float], float]],
) -> None:
    bench = Bench("ur5")
    ready(bench)
    last = len(moves) - 1
    body = "\n".join(
        MOVES[name].format(f"p{[*position, *DOWN]}", 0 if i == last else round(radius, 4))
        for i, (name, position, radius) in enumerate(moves)
    )
    periods = record(bench, body, 60.0)
    assert not bench.of_type(RuntimeExceptionMessage)
    assert {code for code, _ in blend_issues(bench)} <= {171}
    assert apart_in_space(periods[-1]["target_TCP_pose"], list(moves[-1][1])) < 1e-6
    assert jolt(periods, bench.controller.dt) < 60.0


# Circles.


@pytest.mark.parametrize("mode", [0, 1])
def test_movec_orients_the_tool_by_its_mode(bench: Bench, mode: int) -> None:
    ready(bench)
    x, y, z = place(0)
    # Half a circle in the horizontal plane.
    body = (
        f"movec(p{[x + 0.05, y - 0.05, z, 0, 0, 0]}, p{[x, y - 0.1, z, *DOWN]}, v=0.1, mode={mode})"
    )
    start = bench["target_TCP_pose"]
    periods = record(bench, f"{body}\ntextmsg(get_target_waypoint())")
    waypoint = bench.of_type(TextMessage)[0].text.removeprefix("p[").removesuffix("]")
    reached = to_transform([float(x) for x in waypoint.split(",")])
    assert apart(reached, to_transform(periods[-1]["target_TCP_pose"])) < 1e-5
    middle = min(periods, key=lambda p: abs(p["target_TCP_pose"][1] - (y - 0.05)))
    before, after = (to_transform(p) for p in (start, periods[-1]["target_TCP_pose"]))
    if mode == 0:
        assert apart(before[:9], after[:9]) < 1e-9
        assert apart(before[:9], to_transform(middle["target_TCP_pose"])[:9]) < 1e-6
    else:  # turned by half a turn about the vertical
        assert apart([-v for v in before[:6]], after[:6]) < 1e-6
        assert apart(before[6:9], after[6:9]) < 1e-6
    assert apart_in_space(periods[-1]["target_TCP_pose"], [x, y - 0.1, z]) < 1e-9


def test_movec_refuses_another_mode_and_points_on_a_line(bench: Bench) -> None:
    ready(bench)
    x, y, z = place(0)
    bench.run(f"movec({pose(1)}, {pose(2)}, mode=2)")
    assert "mode" in bench.of_type(RuntimeExceptionMessage)[-1].text
    bench.run(f"movec(p{[x, y - 0.1, z, *DOWN]}, p{[x, y - 0.2, z, *DOWN]})")
    assert "circle" in bench.of_type(RuntimeExceptionMessage)[-1].text


# Profiles and paths.


@pytest.mark.parametrize(("distance", "speed"), [(1.0, 0.5), (0.01, 0.5)])
def test_ramps_cover_their_distance(distance: float, speed: float) -> None:
    profile = Profile(ramps(distance, speed, 1.4))
    assert profile.at(profile.duration) == pytest.approx((distance, 0.0), abs=1e-12)
    assert profile.at(0.0) == (0.0, 0.0)
    middle, fastest = profile.at(profile.duration / 2)
    assert middle == pytest.approx(distance / 2)
    assert fastest <= speed + 1e-12


@given(st.floats(0.01, 2.0), st.floats(0.01, 2.0), st.floats(0.1, 10.0), st.floats(0.0, 1.0))
def test_ramps_between_any_two_speeds(
    distance: float, speed: float, acceleration: float, share: float
) -> None:
    start = share * min(2.0 * speed, (2.0 * acceleration * distance) ** 0.5)
    end = share * speed
    profile = Profile(ramps(distance, speed, acceleration, start, end), start)
    assert profile.distance == pytest.approx(distance)
    assert profile.speed <= speed + 1e-9


@given(
    st.floats(0.1, 2.0),
    st.floats(0.1, 5.0),
    st.one_of(st.just(0.0), st.floats(0.01, 1.0)),
    st.floats(0.0, 0.9),
)
def test_a_timed_profile_covers_its_distance(
    length: float, seconds: float, blend: float, share: float
) -> None:
    entry = share * length
    profile = Profile(timed(length, seconds, blend * seconds, entry))
    assert profile.distance == pytest.approx(length - entry)
    if not blend and not share:
        assert profile.duration == pytest.approx(seconds)


def test_arc_keeps_its_radius_and_line_its_direction() -> None:
    start = to_transform((0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    via = to_transform((0.1, 0.1, 0.0, 0.0, 0.0, 0.0))
    end = to_transform((0.2, 0.0, 0.0, 0.0, 0.0, 1.0))
    arc = Arc(start, via, end, fixed=False)
    assert apart(arc.at(1.0), end) < 1e-9
    assert apart(arc.at(0.5)[9:], via[9:]) < 1e-9
    assert apart(Line(start, end).at(1.0), end) < 1e-9
    assert Line(start, end).at(0.5)[9] == pytest.approx(0.1)


def test_a_rounded_corner_touches_both_lines() -> None:
    a, b, c = (to_transform((x, y, 0.0, 0.0, 0.0, 0.0)) for x, y in ((0, 0), (1, 0), (1.5, 1)))
    first, second = Line(a, b), Line(b, c)
    corner = rounded(first, second, 0.2)
    assert corner is not None
    assert apart(corner.at(0.0)[9:], (0.8, 0.0, 0.0)) < 1e-9
    assert apart(corner.at(1.0), c) < 1e-9
    step = 1e-6
    start = [(y - x) / step for x, y in zip(corner.at(0)[9:], corner.at(step)[9:], strict=True)]
    assert apart([x / corner.length for x in start], (1.0, 0.0, 0.0)) < 1e-4
    assert rounded(first, Line(b, a), 0.2) is None  # a reversal

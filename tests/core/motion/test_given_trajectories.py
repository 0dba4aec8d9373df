"""Trajectories that a client gives: what is refused, how they are gone along, and how they end.

The cases are those of joint_trajectory_controller, on an engine whose clock is the test's.
"""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import numpy as np
import pytest

from crtk_drivers.device import Condition, Following, Mode
from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.motion import orders
from crtk_drivers.motion.move import Move, Outcome, Violated
from crtk_drivers.samples import JointState, JointTrajectory, Vector, vector
from crtk_drivers.state import OperatingState
from rigs.joint_trajectories import tolerance, trajectory
from rigs.scripted_arm import BENT, JOINTS, PERIOD, RATE, ArmDevice, ArmRig

FOLLOW = "follow_joint_trajectory"
STILL = [0.0] * 6
SECOND = 10**9


def way(*offsets: float, every: float = 0.2, **changes: Any) -> JointTrajectory:
    """Points of all joints at `offsets` from where the arm is, one each `every` s from 0 on."""
    values: dict[str, Any] = {
        "names": JOINTS,
        "times": [every * index for index in range(len(offsets))],
        "positions": [BENT + offset for offset in offsets],
        "velocities": [STILL] * len(offsets),
    }
    return trajectory(**(values | changes))


def follow(rig: ArmRig, what: JointTrajectory) -> Move:
    move = rig.engine.submit(FOLLOW, what)
    assert move is not None
    return move


def run(rig: ArmRig, move: Move, limit: float = 5.0) -> float:
    """Cycle until a move has ended; return the seconds that took."""
    for cycle in range(int(limit * RATE)):
        if not move.is_busy():
            return cycle * PERIOD
        rig.cycle()
    raise AssertionError(f"it goes on after {limit} s")


NAN = float("nan")
OTHERS = [*JOINTS[:5], "elbow"]
REFUSALS: list[tuple[str, dict[str, Any], Reason]] = [
    ("unknown joint", {"names": OTHERS}, Reason.WRONG_NAMES),
    ("joint twice", {"names": [*JOINTS[:5], "a"]}, Reason.WRONG_NAMES),
    ("joints missing", {"names": JOINTS[:5], "positions": [BENT[:5]] * 3, "velocities": None},
     Reason.WRONG_NAMES),
    ("no names", {"names": ()}, Reason.EMPTY),
    ("no points", {"times": [], "positions": np.empty((0, 6)), "velocities": None}, Reason.EMPTY),
    ("too few positions", {"positions": [BENT[:5]] * 3, "velocities": None}, Reason.WRONG_SIZE),
    ("times go back", {"times": [0.0, 0.2, 0.1]}, Reason.OUT_OF_RANGE),
    ("a time twice", {"times": [0.0, 0.2, 0.2]}, Reason.OUT_OF_RANGE),
    ("a time before the start", {"times": [-0.1, 0.2, 0.3]}, Reason.OUT_OF_RANGE),
    ("a time that is none", {"times": [0.0, NAN, 0.2]}, Reason.NOT_FINITE),
    ("no end", {"times": [0.0, 0.2, np.inf]}, Reason.NOT_FINITE),
    ("no time between points", {"positions": [BENT, BENT + 0.1, BENT], "times": [0.0, 1e-310, 0.2]},
     Reason.OUT_OF_RANGE),
    ("ends moving", {"velocities": [STILL, STILL, [0.1, *STILL[1:]]]}, Reason.OUT_OF_RANGE),
    ("NaN", {"positions": [BENT, BENT + NAN, BENT]}, Reason.NOT_FINITE),
    ("infinite velocity", {"velocities": [STILL, [np.inf] * 6, STILL]}, Reason.NOT_FINITE),
    ("half a velocity", {"velocities": [STILL, [0.0] * 5 + [NAN], STILL]}, Reason.NOT_FINITE),
    ("out of range", {"positions": [BENT, BENT, BENT + 9.0], "times": [0.0, 5.0, 20.0]}, Reason.OUT_OF_RANGE),
    ("too fast", {"positions": [BENT, BENT + 1.0, BENT]}, Reason.OUT_OF_RANGE),
    ("starts elsewhere", {"positions": [BENT + 0.5, BENT + 0.5, BENT + 0.5]}, Reason.STEP_TOO_LARGE),
    ("ended in the past", {"start_ns": -SECOND}, Reason.TOO_OLD),
    ("begins next year", {"start_ns": 10**7 * SECOND}, Reason.FROM_FUTURE),
    ("a tolerance of another robot", {"path": (tolerance("elbow", 0.1),)}, Reason.WRONG_NAMES),
    ("a tolerance that is no number", {"goal": (tolerance("a", NAN),)}, Reason.NOT_FINITE),
    ("negative goal time", {"goal_time": -1.0}, Reason.NOT_FINITE),
]  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "reason"), [row[1:] for row in REFUSALS], ids=[row[0] for row in REFUSALS]
)
def test_what_joint_trajectory_controller_rejects_is_refused(
    changes: dict[str, Any], reason: Reason, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = ArmRig().enabled()
    rig.tells_time_to(orders, monkeypatch)
    if "start_ns" in changes:
        changes = {**changes, "start_ns": rig.wall_ns() + changes["start_ns"]}
    refusal = rig.refused(FOLLOW, way(0.0, 0.05, 0.1, **changes))
    assert refusal.reason is reason
    assert refusal.remedy
    assert not rig.engine.status.is_busy


def test_a_hundred_thousand_points_are_refused() -> None:
    rig = ArmRig().enabled()
    count = 100_000
    many = way(0.0, times=np.arange(count) * 0.01, positions=np.tile(BENT, (count, 1)))
    assert rig.refused(FOLLOW, many).reason is Reason.WRONG_SIZE


def test_it_is_refused_where_no_positions_are_taken_and_while_not_enabled() -> None:
    by_speed = ArmRig(Mode.JOINT_VELOCITY).enabled()
    assert by_speed.refused(FOLLOW, way(0.0, 0.1)).reason is Reason.UNSUPPORTED
    disabled = ArmRig()
    disabled.connect()
    assert disabled.refused(FOLLOW, way(0.0, 0.1)).reason is Reason.NOT_ENABLED


def test_it_goes_through_its_points_each_at_its_time_and_is_busy_meanwhile() -> None:
    rig = ArmRig().enabled()
    move = follow(rig, way(0.0, 0.05, -0.05, 0.1))
    assert rig.engine.status.is_busy
    taken = run(rig, move)
    assert move.outcome is Outcome.REACHED
    assert not rig.engine.status.is_busy
    assert taken == pytest.approx(0.6, abs=3 * PERIOD)
    for at, offset in ((0.2, 0.05), (0.4, -0.05), (0.6, 0.1)):
        there = rig.path[round(at * RATE) - 1]
        assert there == pytest.approx(BENT + offset, abs=2e-3)
    goal = rig.engine.latched("goal_js")
    assert goal is not None
    assert isinstance(goal[0], JointState)
    assert goal[0].position == pytest.approx(BENT + 0.1)


def test_names_may_be_in_another_order() -> None:
    rig = ArmRig().enabled()
    order = [3, 0, 5, 1, 4, 2]
    goal = BENT + 0.01 * np.arange(6)
    move = follow(
        rig,
        way(
            0.0,
            times=[0.0, 0.5],
            names=[JOINTS[index] for index in order],
            positions=[BENT[order], goal[order]],
            velocities=None,
        ),
    )
    run(rig, move)
    assert rig.path[-1] == pytest.approx(goal)


def test_a_goal_without_its_first_point_goes_there_from_where_the_arm_is() -> None:
    rig = ArmRig().enabled()
    move = follow(rig, way(0.1, times=[0.5], velocities=[STILL]))
    assert run(rig, move) == pytest.approx(0.5, abs=3 * PERIOD)
    steps = np.abs(np.diff(rig.path, axis=0)).max()
    assert steps < 0.35 * PERIOD
    assert rig.path[-1] == pytest.approx(BENT + 0.1)


@pytest.mark.parametrize("speed", [0.0, 1.0, -1.0])
@pytest.mark.parametrize("velocities", [None, [STILL] * 2])
@pytest.mark.parametrize("offset", [0.02, 0.05, 0.1, 0.2])
@pytest.mark.parametrize("time", [0.06, 0.1, 0.2, 0.4])
def test_the_way_to_the_first_point_keeps_the_limits(
    time: float, offset: float, velocities: list[list[float]] | None, speed: float
) -> None:
    rig = ArmRig().enabled()
    if speed:
        rig.engine.submit("move_jp", JointState(position=vector(BENT + speed)))
        rig.cycle(round(0.1 * RATE))
    here = rig.path[-1] if len(rig.path) else BENT
    limit = rig.engine.capabilities.limits[0].acceleration
    asked = trajectory(
        names=JOINTS,
        times=[time, time + 1.0],
        positions=[here + offset] * 2,
        velocities=velocities,
    )
    with suppress(CommandRefused):  # where the time is too short
        rig.engine.submit(FOLLOW, asked)
    begin = max(0, len(rig.path) - 2)
    rig.cycle(round((time + 0.1) * RATE))
    pulls = np.abs(np.diff(rig.path[begin:], n=2, axis=0)) / PERIOD**2
    assert pulls.max(initial=0.0) <= 1.03 * limit


def test_too_little_time_to_the_first_point_names_the_joint() -> None:
    rig = ArmRig().enabled()
    refusal = rig.refused(FOLLOW, way(0.05, 0.1, times=[0.06, 1.0]))
    assert refusal.reason is Reason.OUT_OF_RANGE
    assert "would accelerate at" in refusal.detail
    assert "Give the first point more time" in refusal.remedy


def test_a_start_that_is_a_little_off_is_joined_without_a_jump() -> None:
    rig = ArmRig().enabled()
    move = follow(rig, way(0.01, 0.05, 0.1))  # as far off as MoveIt allows
    run(rig, move)
    assert move.outcome is Outcome.REACHED
    assert np.abs(np.diff(rig.path, axis=0)).max() < 0.6 * PERIOD
    assert rig.path[0] == pytest.approx(BENT, abs=1e-3)


def test_a_stamp_partly_in_the_past_starts_where_it_is_by_now(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rig = ArmRig().enabled()
    rig.tells_time_to(orders, monkeypatch)
    what = way(0.0, 0.0, 0.1, every=1.0, start_ns=rig.wall_ns() - SECOND)
    assert run(rig, follow(rig, what)) == pytest.approx(1.0, abs=3 * PERIOD)
    assert rig.path[-1] == pytest.approx(BENT + 0.1)


def test_a_stamp_in_the_future_waits_busy(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = ArmRig().enabled()
    rig.tells_time_to(orders, monkeypatch)
    move = follow(rig, way(0.0, 0.1, start_ns=rig.wall_ns() + SECOND))
    rig.cycle(round(0.9 * RATE))
    assert rig.path[-1] == pytest.approx(BENT, abs=1e-6)
    assert rig.engine.status.is_busy
    assert 0.9 + run(rig, move) == pytest.approx(1.2, abs=3 * PERIOD)


def test_a_new_goal_replaces_the_old_one_and_goes_on_from_its_motion() -> None:
    rig = ArmRig().enabled()
    first = follow(rig, way(0.0, 0.1, 0.2, velocities=None))  # at 0.5 rad/s
    rig.cycle(round(0.3 * RATE))
    here = rig.path[-1]
    second = follow(rig, way(0.0, times=[0.5], positions=[BENT], velocities=[STILL]))
    rig.cycle()
    assert first.outcome is Outcome.PREEMPTED
    assert first.violated is None
    run(rig, second)
    assert second.outcome is Outcome.REACHED
    after = rig.path[round(0.3 * RATE) - 1 :]
    assert after[0].tolist() == here.tolist()
    assert np.abs(np.diff(after, n=2, axis=0)).max() < 25.0 * PERIOD**2, "its speed jumps"
    assert rig.path[-1] == pytest.approx(BENT)


def test_another_client_may_replace_it_and_a_stream_too() -> None:
    rig = ArmRig().enabled()
    for name, value in (
        ("move_jp", JointState(position=BENT)),
        ("servo_jp", JointState(position=BENT)),
    ):
        move = follow(rig, way(0.0, 0.001, 0.0))
        rig.cycle(2)
        rig.engine.submit(name, value)
        rig.cycle(2)
        assert move.outcome is Outcome.PREEMPTED
        assert name in move.reason
        rig.engine.submit("hold")
        rig.cycle(round(0.2 * RATE))


def test_a_goal_while_another_client_streams_is_refused() -> None:
    from crtk_drivers.motion.arbiter import Client

    rig = ArmRig().enabled()
    rig.engine.submit("servo_jp", JointState(position=BENT), client=Client("the pendant"))
    rig.cycle()
    with pytest.raises(CommandRefused) as refused:
        rig.engine.submit(FOLLOW, way(0.0, 0.1), client=Client("MoveIt"))
    assert refused.value.reason is Reason.STREAM_OWNED


class Lagging(ArmDevice):
    """Is `off` (6,) from what it is sent."""

    off: Vector | float = 0.0

    def write(self, setpoint: Any) -> None:
        super().write(setpoint)
        self.position = setpoint.values + self.off


def lagging(**changes: Any) -> tuple[ArmRig, Lagging]:
    rig = ArmRig(**changes)
    rig.device.__class__ = Lagging
    rig.enabled()
    assert isinstance(rig.device, Lagging)
    return rig, rig.device


PATHS = [
    ("no tolerance", (), 0.1, None),
    ("within it", (tolerance("b", 0.2),), 0.1, None),
    ("violated", (tolerance("b", 0.05),), 0.1, Violated.PATH),
    ("of another joint", (tolerance("a", 0.05),), 0.1, None),
    ("erased", (tolerance("b", -1.0),), 0.1, None),
    ("zero is the default, which is none", (tolerance("b", 0.0),), 0.1, None),
    ("illegal is the default, which is none", (tolerance("b", -3.0),), 0.1, None),
]


@pytest.mark.parametrize(
    ("path", "off", "violated"), [row[1:] for row in PATHS], ids=[row[0] for row in PATHS]
)
def test_the_path_tolerance(path: Any, off: float, violated: Violated | None) -> None:
    rig, device = lagging()
    device.off = vector([0.0, off, 0.0, 0.0, 0.0, 0.0])
    move = follow(rig, way(0.0, 0.02, 0.04, path=path))
    run(rig, move)
    assert move.violated is violated
    if violated:
        assert move.outcome is Outcome.ABORTED
        assert (
            "the path tolerance of follow_joint_trajectory is violated: the position of b"
            in move.reason
        )
        assert device.calls.count("stop") >= 1
        assert rig.state is OperatingState.ENABLED
    else:
        assert move.outcome is Outcome.REACHED


FOLLOWS = Following(error=(1.0,) * 6, arrival=(0.02,) * 6, lag=0.1)
GOALS = [
    # name, tolerances, goal time, off at the end, seconds until it is there, outcome, seconds it takes
    ("within the default", (), 0.0, 0.01, None, Outcome.REACHED, 0.4),
    ("later than planned", (), 0.0, 0.1, 1.0, Outcome.REACHED, 1.0),
    ("later than the goal time", (), 0.3, 0.1, 1.0, Outcome.ABORTED, 0.7),
    ("within the goal time", (), 0.8, 0.1, 1.0, Outcome.REACHED, 1.0),
    ("wider than the default", (tolerance("b", 0.2),), 0.3, 0.1, None, Outcome.REACHED, 0.4),
    ("narrower than it", (tolerance("b", 0.005),), 0.3, 0.01, None, Outcome.ABORTED, 0.7),
    ("erased", (tolerance("b", -1.0),), 0.3, 0.1, None, Outcome.REACHED, 0.4),
    ("illegal is the default", (tolerance("b", -3.0),), 0.3, 0.1, None, Outcome.ABORTED, 0.7),
    ("never, without a goal time", (), 0.0, 0.1, None, Outcome.ABORTED, 10.4),
]  # fmt: skip


@pytest.mark.parametrize(
    ("goal", "goal_time", "off", "there", "outcome", "takes"),
    [row[1:] for row in GOALS],
    ids=[row[0] for row in GOALS],
)
def test_the_goal_tolerance_and_the_time_that_is_left_for_it(
    goal: Any, goal_time: float, off: float, there: float | None, outcome: Outcome, takes: float
) -> None:
    rig, device = lagging(following=FOLLOWS)
    device.off = vector([0.0, off, 0.0, 0.0, 0.0, 0.0])
    begun = rig.clock()
    move = follow(rig, way(0.0, 0.02, 0.04, goal=goal, goal_time=goal_time))
    while move.is_busy():
        if there is not None and rig.clock() - begun > there:
            device.off = 0.0
        rig.cycle()
        assert rig.clock() - begun < 11.0
    assert move.outcome is outcome
    assert rig.clock() - begun == pytest.approx(takes, abs=0.03)
    if outcome is Outcome.ABORTED:
        assert move.violated is Violated.GOAL
        assert "the goal tolerance" in move.reason


def test_it_has_not_arrived_while_a_joint_still_moves() -> None:
    rig = ArmRig().enabled()
    moving = JointState(position=BENT + 0.04, velocity=vector([0.5] * 6))
    move = follow(rig, way(0.0, 0.02, 0.04))
    rig.cycle(round(0.3 * RATE))
    rig.device.extra["measured_js"] = moving
    rig.cycle(round(0.5 * RATE))
    assert move.is_busy()
    del rig.device.extra["measured_js"]
    run(rig, move)
    assert move.outcome is Outcome.REACHED


def test_the_speed_slider_slows_time_and_stops_it() -> None:
    rig = ArmRig().enabled()
    move = follow(rig, way(0.0, 0.1, 0.2))
    rig.cycle(10)
    rig.device.slider = 0.0
    rig.cycle(round(3.0 * RATE))
    assert move.is_busy(), "the goal is kept"
    assert np.abs(np.diff(rig.path[-200:], axis=0)).max() == 0.0
    rig.device.slider = 0.5
    assert run(rig, move) == pytest.approx(2.0 * 0.36, abs=0.25)
    assert move.outcome is Outcome.REACHED
    assert rig.path[-1] == pytest.approx(BENT + 0.2)


PHASES = ("before it begins", "on the way", "while it settles")
ENDS = ("cancel", "hold", "pause", "disable", "fault", "lost")


@pytest.mark.parametrize("phase", PHASES)
@pytest.mark.parametrize("end", ENDS)
def test_whatever_stops_it_ends_it_in_each_phase(phase: str, end: str) -> None:
    rig, device = lagging(following=FOLLOWS)
    move = follow(rig, way(0.0, 0.05, 0.1))
    if phase != PHASES[0]:
        rig.cycle(round(0.2 * RATE))
    if phase == PHASES[2]:
        device.off = 0.1
        rig.cycle(round(0.4 * RATE))
    device.off = 0.0
    assert move.is_busy()
    if end == "cancel":
        rig.engine.end_move(move, "it was cancelled")
    elif end == "hold":
        rig.engine.submit("hold")
    elif end == "fault":
        device.reported = Condition(OperatingState.FAULT, "overheated")
        rig.cycle()
        assert "overheated" in move.reason
    elif end == "lost":
        rig.disconnect("the cable was pulled")
    else:
        rig.command(end)
    if end != "lost":
        rig.cycle(2)
    assert not move.is_busy()
    assert move.outcome is (Outcome.PREEMPTED if end in ("cancel", "hold") else Outcome.ABORTED)
    assert move.violated is None
    assert move.reason
    assert not rig.engine.status.is_busy
    held = len(rig.path)
    if end != "lost":
        rig.cycle(20)
    assert len(rig.path) == held or np.abs(np.diff(rig.path[held - 1 :], axis=0)).max() == 0.0


def test_to_end_one_that_has_ended_stops_nothing() -> None:
    rig = ArmRig().enabled()
    first = follow(rig, way(0.0, 0.0, 0.0))
    run(rig, first)
    second = follow(rig, way(0.0, 0.05, 0.1))
    rig.cycle(5)
    rig.engine.end_move(first, "too late")
    rig.cycle(2)
    assert second.is_busy()


def test_to_end_one_whose_place_is_being_taken_leaves_the_next_one_alone() -> None:
    rig = ArmRig().enabled()
    first = follow(rig, way(0.0, 0.05, 0.1))
    rig.cycle(5)
    second = follow(rig, way(0.0, 0.0, 0.0))
    rig.engine.end_move(first, "it was cancelled")
    run(rig, second)
    assert (first.outcome, second.outcome) == (Outcome.PREEMPTED, Outcome.REACHED)


def test_it_tells_where_it_should_be_and_where_it_is() -> None:
    rig, device = lagging()
    device.off = 0.01
    move = follow(rig, way(0.0, 0.1, 0.2))
    assert move.progress is None
    rig.cycle(round(0.2 * RATE))
    assert move.progress is not None
    assert move.progress.time == pytest.approx(0.2, abs=0.01)
    assert move.progress.desired.position == pytest.approx(BENT + 0.1, abs=0.01)
    assert move.progress.desired.velocity.size == 6
    off = move.progress.actual.position - move.progress.desired.position
    assert off == pytest.approx([0.01] * 6, abs=0.01)


def test_who_asks_to_be_told_of_the_end_is_told_once() -> None:
    rig = ArmRig().enabled()
    move = follow(rig, way(0.0, 0.0))
    told: list[str] = []
    move.when_ended(lambda: told.append("first"))
    run(rig, move)
    move.when_ended(lambda: told.append("late"))
    move.finish(Outcome.ABORTED, "twice")
    assert told == ["first", "late"]
    assert move.outcome is Outcome.REACHED

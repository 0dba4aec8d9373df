"""Stops: how long, and how far, until it stands, whoever asks for that or falls silent."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from crtk_drivers.labs.bench.acquisition import (
    BUSY,
    Acquisition,
    BenchTest,
    Safety,
    Subject,
    Suite,
)
from crtk_drivers.labs.bench.bed import SMALL_SPEED, Bed, Broken
from crtk_drivers.labs.bench.signals import resolution, rest_time, slope
from crtk_drivers.labs.bench.trace import JointTrack, Trace
from crtk_drivers.labs.verdicts.estimates import exact, within
from crtk_drivers.labs.verdicts.judging import (
    Bound,
    Findings,
    Quantity,
)
from crtk_drivers.samples import Array, JointState, Vector, vector

RUN: Final = 0.5
"""Seconds of motion before the stop."""

AFTER: Final = 1.0

LONGEST: Final = 5.0
"""Seconds in which a move has got a third of its way."""

CLIENT_STARTS: Final = 20.0
"""Seconds in which a client's process has brought the device into motion."""

SPEED_OF: Final = 0.05
"""Seconds before a stop from which the speed is taken."""

BEGIN: Final = 0.2
"""Seconds in which a ramp gets to its speed."""

BEHIND: Final = 1.2
"""Times the way of the ramp that fits into the reach: what follows the stop is on top of it."""

HARDLY: Final = 5.0
"""Times the tolerance of rest: a joint that moved by less tells nothing of how it stops."""

ENDINGS: Final = ("hold", "silence", "disable", "client_killed")

TOLD: Final = {"client_killed": "kill -9 of the client"}
"""What people call an ending, if not by its name."""

TIME = {
    kind: Quantity.at_most(
        f"stop.{kind}.time", f"time to stand after {TOLD.get(kind, kind)}", "s", 0.01
    )
    for kind in ENDINGS
}
WAY = {
    kind: Quantity.at_most(
        f"stop.{kind}.distance", f"way after {TOLD.get(kind, kind)}", "mrad or mm", 1.0
    )
    for kind in ENDINGS
}
RETURN = {
    kind: Quantity.at_most(
        f"stop.{kind}.back", f"way back after {TOLD.get(kind, kind)}", "mrad or mm", 1.0
    )
    for kind in ENDINGS
}


def _speeds(bed: Bed, reach: Vector) -> Vector:
    """Return the speed of each joint (n,): a small share of its limit, and within its reach."""
    limits = np.array([limit.velocity for limit in bed.about.capabilities.limits])
    return vector(np.minimum(SMALL_SPEED * limits, reach / (BEHIND * RUN)))


def motion(
    command: str, home: Vector, speed: Vector, ramp: float = BEGIN
) -> Callable[[float], JointState]:
    """Return what a stream says at a time that gets from `home` (n,) to a speed (n,) in `ramp` s."""

    def velocity(t: float) -> JointState:
        return JointState(velocity=speed * min(1.0, t / ramp))

    def position(t: float) -> JointState:
        done = t - 0.5 * ramp if t > ramp else 0.5 * t * t / ramp
        return JointState(position=home + speed * done)

    return velocity if command == "servo_jv" else position


def _way(bed: Bed, home: Vector) -> Array:
    """Return how far each joint (n,) may go, upwards where there is room for that."""
    reach = bed.reach(0.8)
    upper = np.array([limit.upper for limit in bed.about.capabilities.limits])
    found: Array = np.where(upper - home > 1.5 * reach, reach, -reach)
    return found


def begin_motion(bed: Bed, home: Vector, *, velocity: bool = True) -> tuple[Vector, str]:
    """Bring all joints into motion by a stream, upwards where there is room for that.

    Args:
        bed: whose device is ENABLED.
        home: where it is set (n,).
        velocity: by ``servo_jv`` where it is offered.

    Returns:
        the speeds (n,), and the command.
    """
    speed, command = _intended(bed, home, velocity)
    bed.stream(command, motion(command, home, speed), RUN)
    return speed, command


def _intended(bed: Bed, home: Vector, velocity: bool) -> tuple[Vector, str]:
    way = _way(bed, home)
    speed = vector(np.sign(way) * _speeds(bed, np.abs(way)))
    return speed, "servo_jv" if velocity and bed.offers("servo_jv") else "servo_jp"


def _begin_elsewhere(bed: Bed, home: Vector) -> tuple[Vector, str]:
    """Let a process of its own bring all joints into motion, and kill it; return speeds and command."""
    speed, command = _intended(bed, home, velocity=True)
    far = vector(home + RUN * speed)
    with bed.client(command, home, speed):
        begun = bed.wait_until(
            lambda _: _share_of_way(bed.position, home, far) > 0.3, CLIENT_STARTS
        )
    if not begun:
        raise Broken(f"a client has not moved it within {CLIENT_STARTS:g} s")
    return speed, command


def _begin_move(bed: Bed, home: Vector) -> tuple[Vector, str]:
    """Bring all joints into motion by a move; return at a third of its way: no speeds (n,), command."""
    goal = vector(home + _way(bed, home))
    bed.submit("move_jp", JointState(position=goal))
    begun = bed.wait_until(lambda _: _share_of_way(bed.position, home, goal) > 1.0 / 3.0, LONGEST)
    if not begun:
        raise Broken(f"a move has not got a third of its way within {LONGEST:g} s")
    return vector(np.zeros(home.size)), "move_jp"


def _share_of_way(here: Vector, home: Vector, goal: Vector) -> float:
    way = np.abs(goal - home)
    column = int(np.argmax(way))
    return float(abs(here[column] - home[column]) / max(way[column], 1e-9))


def _stopping(kind: str) -> Acquisition:
    def run(bed: Bed) -> None:
        bed.enable()
        home = bed.setpoint
        # Of a stream of positions the last is where it stands, whoever stops it. What is stopped here goes
        # on by itself: a velocity in silence, a move at hold.
        if kind == "hold":
            speed, stream = _begin_move(bed, home)
            bed.submit("hold")
        elif kind == "client_killed":
            speed, stream = _begin_elsewhere(bed, home)
        else:
            speed, stream = begin_motion(bed, home, velocity=kind == "silence")
        if kind == "disable":
            bed.disable()
        bed.mark("asked")
        bed.rest(bed.about.silence + AFTER)
        bed.mark("end")
        bed.note(speed=speed.tolist(), stream=stream)
        if kind == "disable":
            bed.enable()
        bed.move_to(home)
        bed.disable()

    says = {
        "hold": "Sends hold in the midst of a move of all joints.",
        "silence": "Ends a stream of all joints without a word.",
        "disable": "Sends disable in a stream of all joints.",
        "client_killed": "Kills the process that streams to all joints, in motion.",
    }
    needs = ("servo_jp", "move_jp", "hold", "measured_js")
    if kind == "client_killed":
        return Acquisition(kind, says[kind], Safety.FAULT_IN_MOTION, run, needs, Suite.FULL)
    return Acquisition(kind, says[kind], Safety.SMALL, run, needs)


def _asked(trace: Trace, kind: str) -> float:
    """Return when the device was asked to stop, on the axis of the recording."""
    if kind == "hold":
        return trace.commands("hold")[-1][0]
    # To disable it is asked right after the last command; the state tells only that it was done.
    return trace.commands(trace.notes["stream"])[-1][0]


def speed_before(joints: JointTrack, asked: float) -> Vector:
    """Return how fast each joint was (n,), by its stamps: on a busy machine samples arrive in heaps."""
    before = joints.between(asked - RUN, asked)
    valid = np.isfinite(before.stamp)
    late = valid & (before.stamp > asked - SPEED_OF)
    chosen = late if np.count_nonzero(late) > 1 else valid
    if not chosen.any():
        return vector(np.zeros(joints.position.shape[1]))
    stamp, position = before.stamp[chosen], before.position[chosen]
    return vector(np.nan_to_num([abs(slope(stamp, each)) for each in position.T]))


def _analysis(kind: str) -> Callable[[Trace, Subject], Findings]:
    def analyse(trace: Trace, subject: Subject) -> Findings:
        joints = trace.joints
        asked, end = _asked(trace, kind), trace.mark("end")
        part = joints.between(asked - RUN, end)
        speed = np.abs(np.asarray(trace.notes["speed"]))
        if kind == "hold":
            speed = speed_before(joints, asked)
        if part.at.size < 20:
            return Findings(doubts=(f"{part.at.size} samples",))
        steps = resolution(joints.position)
        tolerance = np.maximum.reduce([2.0 * steps, 0.01 * speed, np.full(speed.size, 1e-4)])
        column = int(np.argmax(speed / tolerance))
        moved = float(np.ptp(part.position[:, column]))
        if moved < HARDLY * tolerance[column]:
            name, at = subject.joints[column], speed[column]
            return Findings(doubts=(f"{name} hardly moved: by {moved:.2g}, at {at:.2g} a second",))
        at_asked = _at(part.at, part.position, asked)
        time_to_rest = rest_time(part.at, part.position, asked, tolerance)
        way = np.abs(part.position[-1] - at_asked)
        back = _way_back(part.at, part.position, asked)
        limits = subject.limits
        deceleration = np.array([limit.acceleration for limit in limits])
        silent = subject.silence if kind in ("silence", "client_killed") else 0.0
        declared = subject.stop_time
        reaction = silent + 2.0 * subject.period + subject.lag
        seconds = reaction + float((speed / deceleration).max())
        source = "two periods, the declared lag and the time that its acceleration takes"
        if kind == "disable":
            seconds, source = max(seconds, declared), "the time in which it declares to stand"
        ways = (
            speed * (reaction + 2.0 * subject.period) + speed**2 / (2.0 * deceleration) + tolerance
        )
        gone = subject.furthest(WAY[kind], way, ways, "the way in that time at that speed")
        worst = int(np.argmax(way / ways))
        return Findings(
            doubts=(*subject.too_busy(max(0.25 * seconds, BUSY)), *subject.gaps(part.stamp)),
            measurements=(
                subject.measured(
                    TIME[kind],
                    within(time_to_rest, subject.period, part.at.size),
                    Bound(seconds + subject.period, f"{'the silence, ' if silent else ''}{source}"),
                ),
                gone,
                subject.measured(
                    RETURN[kind],
                    exact(1e3 * float((back / np.maximum(ways, 1e-9)).max() * ways[worst])),
                    Bound(
                        1e3 * float(max(0.3 * ways[worst], tolerance[worst])),
                        "three tenths of that way",
                    ),
                    part=gone.part,
                ),
            ),
            plots=(
                subject.ways_told(
                    f"The stop after {kind}",
                    part.at - asked,
                    part.position - part.position[0],
                    x_label="time since then, s",
                ),
            ),
        )

    return analyse


def _at(at: Vector, position: Array, when: float) -> Array:
    """Return the position (n,) at a time, between two samples."""
    return np.array([np.interp(when, at, column) for column in position.T])


def _way_back(at: Vector, position: Array, since: float) -> Array:
    """Return how far each joint (n,) came back after its furthest point."""
    after = position[at >= since]
    found: Array = np.maximum(
        np.abs(np.max(after, axis=0) - after[-1]) * (after[-1] > position[0]),
        np.abs(np.min(after, axis=0) - after[-1]) * (after[-1] < position[0]),
    )
    return found


_NAMES: Final = {
    "hold": ("S1", "hold"),
    "silence": ("S2", "silence"),
    "disable": ("S1b", "disable in motion"),
    "client_killed": ("S3", "client killed"),
}


TESTS: Final = tuple(
    BenchTest(
        _NAMES[kind][0],
        _NAMES[kind][1],
        "stop",
        _stopping(kind),
        _analysis(kind),
        (TIME[kind], WAY[kind], RETURN[kind]),
        guards=kind == "hold",
    )
    for kind in ENDINGS
)

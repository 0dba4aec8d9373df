"""What the motion layer costs each cycle, and how late interpolation makes a stream.

    python bench/motion.py [--cycles 3000]

Columns: axes, microseconds at the median and the 99th percentile. `naive` does the same with numpy arrays
made anew in each cycle and without limits. Times are of this thread's processor, not of the wall: a busy
machine does not change them much. Latency is found by comparing the output with the delayed input.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable

import numpy as np

from crtk_drivers.device import CartesianLimits, JointLimits
from crtk_drivers.gates.resolved_rate import ResolvedRate
from crtk_drivers.geometry.quaternions import quaternion_from_rotvec
from crtk_drivers.samples import Pose, Vector, vector
from crtk_drivers.trajectory.interpolators import JointInterpolator, PoseInterpolator
from crtk_drivers.trajectory.profiles import JointProfile, LineProfile

CYCLE = 0.002
TIMEOUT = 0.3
LIMIT = JointLimits(-6.3, 6.3, velocity=3.0, acceleration=40.0, jerk=1000.0, effort=150.0)
TOOL = CartesianLimits(0.5, 1.5, 3.0, 10.0)
INPUT_RATE = 50.0


def measured(step: Callable[[int], object], cycles: int) -> tuple[float, float]:
    """Return the microseconds of processor time, median and 99th percentile, of `step`."""
    for index in range(100):
        step(index)
    spent = np.empty(cycles)
    for index in range(cycles):
        began = time.thread_time_ns()
        step(index + 100)
        spent[index] = time.thread_time_ns() - began
    return float(np.percentile(spent, 50)) / 1e3, float(np.percentile(spent, 99)) / 1e3


def wave(now: float, axes: int) -> Vector:
    """Return what is streamed."""
    return np.asarray(0.3 * np.sin(math.pi * now + np.arange(axes) * 0.5))


def interpolate_joints(axes: int) -> Callable[[int], object]:
    """Goals at 50 Hz, steps at 500 Hz."""
    motion = JointInterpolator([LIMIT] * axes, CYCLE, TIMEOUT)
    motion.start(wave(0.0, axes), 0.0)
    every = round(1.0 / INPUT_RATE / CYCLE)

    def step(index: int) -> object:
        now = index * CYCLE
        if index % every == 0:
            motion.command(wave(now, axes), now)
        return motion.point(now)

    return step


def interpolate_joints_every_cycle(axes: int) -> Callable[[int], object]:
    """A goal, and so a plan, in each cycle: the worst case."""
    motion = JointInterpolator([LIMIT] * axes, CYCLE, TIMEOUT)
    motion.start(wave(0.0, axes), 0.0)

    def step(index: int) -> object:
        now = index * CYCLE
        motion.command(wave(now, axes), now)
        return motion.point(now)

    return step


def interpolate_naively(axes: int) -> Callable[[int], object]:
    """Straight between the last two goals."""
    every = round(1.0 / INPUT_RATE / CYCLE)
    goals = [wave(0.0, axes), wave(0.0, axes)]

    def step(index: int) -> object:
        if index % every == 0:
            goals[:] = goals[1], wave(index * CYCLE, axes)
        share = index % every / every
        before, after = np.array(goals[0]), np.array(goals[1])
        return before + share * (after - before), (after - before) * INPUT_RATE

    return step


def interpolate_pose(axes: int) -> Callable[[int], object]:
    """Poses at 50 Hz, steps at 500 Hz."""
    motion = PoseInterpolator(TOOL, CYCLE, TIMEOUT)
    every = round(1.0 / INPUT_RATE / CYCLE)

    def pose(now: float) -> Pose:
        place = wave(now, 6) * 0.2
        return Pose(vector(place[:3]), quaternion_from_rotvec(vector(place[3:])))

    motion.start(pose(0.0), 0.0)

    def step(index: int) -> object:
        now = index * CYCLE
        if index % every == 0:
            motion.command(pose(now), now)
        return motion.point(now)

    return step


def move_joints(axes: int) -> Callable[[int], object]:
    """A step along a profile."""
    rest = vector(np.zeros(axes))
    profile = JointProfile(rest, rest, rest, vector(np.full(axes, 1.0)), [LIMIT] * axes)
    return lambda index: profile.state(index * CYCLE % profile.duration)


def plan_joints(axes: int) -> Callable[[int], object]:
    """A new goal while moving."""
    rest = vector(np.zeros(axes))
    limits = [LIMIT] * axes
    profile = JointProfile(rest, rest, rest, vector(np.full(axes, 1.0)), limits)
    state = profile.state(profile.duration / 3.0)
    return lambda index: JointProfile(*state, vector(wave(index * CYCLE, axes)), limits)


def move_naively(axes: int) -> Callable[[int], object]:
    """A quintic from rest to rest, by polynomial arrays."""
    start, goal = np.zeros(axes), np.ones(axes)

    def step(index: int) -> object:
        share = index * CYCLE % 1.0
        weights = np.array((10.0, -15.0, 6.0)) @ np.array((share**3, share**4, share**5))
        slopes = np.array((30.0, -60.0, 30.0)) @ np.array((share**2, share**3, share**4))
        return start + (goal - start) * weights, (goal - start) * slopes

    return step


def move_line(axes: int) -> Callable[[int], object]:
    """A step along a straight line with a turn, in its blend."""
    begin = Pose(vector((0.0, 0.0, 0.0)), vector((0.0, 0.0, 0.0, 1.0)))
    end = Pose(vector((0.5, 0.2, 0.1)), quaternion_from_rotvec(vector((0.5, 0.2, 0.1))))
    first = LineProfile(begin, end, TOOL)
    pose, twist, change = first.state(first.duration / 3.0)
    line = LineProfile(pose, begin, TOOL, twist=twist, acceleration=change)
    return lambda index: line.state(index * CYCLE % line.duration)


def servo_twist(axes: int) -> Callable[[int], object]:
    """A twist through the Jacobian, with every limit."""
    resolver = ResolvedRate([LIMIT] * axes, TOOL, CYCLE)
    jacobian = np.random.default_rng(1).normal(size=(6, axes))
    joints = vector(np.zeros(axes))
    state = {"before": vector(np.zeros(axes))}

    def step(index: int) -> object:
        rate = resolver.follow_twist(
            joints, jacobian, vector(wave(index * CYCLE, 6)), state["before"]
        )
        state["before"] = rate.velocity
        return rate

    return step


def servo_pose(axes: int) -> Callable[[int], object]:
    """A pose through the Jacobian, with every limit."""
    resolver = ResolvedRate([LIMIT] * axes, TOOL, CYCLE)
    jacobian = np.random.default_rng(1).normal(size=(6, axes))
    joints, before = vector(np.zeros(axes)), vector(np.zeros(axes))
    here = Pose(vector((0.0, 0.0, 0.0)), vector((0.0, 0.0, 0.0, 1.0)))
    goal = Pose(vector((0.01, 0.0, 0.0)), quaternion_from_rotvec(vector((0.0, 0.01, 0.0))))
    return lambda index: resolver.follow_pose(joints, here, jacobian, goal, 4 * CYCLE, before)


def servo_naively(axes: int) -> Callable[[int], object]:
    """The pseudo-inverse."""
    jacobian = np.random.default_rng(1).normal(size=(6, axes))
    return lambda index: np.linalg.pinv(jacobian) @ wave(index * CYCLE, 6)


ROWS: tuple[tuple[str, Callable[[int], Callable[[int], object]]], ...] = (
    ("interpolate_jp, 50 Hz", interpolate_joints),
    ("interpolate_jp, a goal each cycle", interpolate_joints_every_cycle),
    ("  naive", interpolate_naively),
    ("interpolate_cp, 50 Hz", interpolate_pose),
    ("move_jp, a cycle", move_joints),
    ("move_jp, a plan", plan_joints),
    ("  naive, a cycle", move_naively),
    ("move_cp, a cycle in a blend", move_line),
    ("servo_cv", servo_twist),
    ("servo_cp by Jacobian", servo_pose),
    ("  naive", servo_naively),
)


def latency(rate: float, jitter: float, limit: JointLimits) -> tuple[float, float, float]:
    """Return seconds of delay found, those that the interpolator says, and the rms error in rad."""
    rng = np.random.default_rng(1)
    stream = sorted(
        ((k + rng.uniform(0.0, jitter)) / rate, k / rate) for k in range(round(6 * rate))
    )
    motion = JointInterpolator([limit] * 6, CYCLE, TIMEOUT)
    motion.start(wave(0.0, 6), 0.0)
    times, values, said = [], [], []
    for index in range(round(5.5 / CYCLE)):
        now = index * CYCLE
        while stream[0][0] <= now:
            arrival, sampled = stream.pop(0)
            motion.command(wave(sampled, 6), arrival)
        values.append(motion.step(now)[0])
        times.append(now)
        said.append(motion.latency)
    settled = slice(round(2.0 / CYCLE), None)
    time_, value = np.array(times)[settled], np.array(values)[settled]
    axes = np.arange(6) * 0.5

    def error(delay: float) -> float:
        should = 0.3 * np.sin(math.pi * (time_[:, None] - delay) + axes)
        return float(np.sqrt(np.mean((value - should) ** 2)))

    found = min((step * 0.0005 for step in range(600)), key=error)
    return found, float(np.mean(said[settled])), error(found)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cycles", type=int, default=3000)
    cycles: int = parser.parse_args().cycles
    print(f"{'':36}{'6 axes p50':>12}{'p99':>8}{'7 axes p50':>12}{'p99':>8}   us a cycle")
    for name, make in ROWS:
        six, seven = (measured(make(axes), cycles) for axes in (6, 7))
        print(f"{name:36}{six[0]:12.1f}{six[1]:8.1f}{seven[0]:12.1f}{seven[1]:8.1f}")
    soft = JointLimits(-6.3, 6.3, velocity=2.0, acceleration=10.0, jerk=100.0, effort=1.0)
    print(f"\n{'input':12}{'jitter':>8}{'latency':>10}{'said':>8}{'rms':>8}   ms, mrad")
    for limits, label in ((LIMIT, "UR limits"), (soft, "10 rad/s², 100 rad/s³")):
        print(label)
        for rate in (10, 20, 50, 100):
            for jitter in (0.0, 0.3):
                found, said, error = (1e3 * part for part in latency(rate, jitter, limits))
                print(f"{rate:9} Hz{jitter:8.1f}{found:10.1f}{said:8.1f}{error:8.2f}")


if __name__ == "__main__":
    main()

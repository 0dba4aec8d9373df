"""What each CRTK command costs, in the client's thread (submit) and in the I/O thread (a cycle).

The whole engine with a device that answers at once: joints that take positions and efforts, kinematics
by pinocchio. Servo commands come in each cycle, interpolated ones in every tenth (50 Hz), moves twice a
second. The cycle of an engine that just holds is shown first, and is in all others too. Times are of this
thread's processor.
"""

from __future__ import annotations

import gc
import math
import time
from collections.abc import Callable

import numpy as np
from ruckig import InputParameter, Ruckig, Trajectory
from typing_extensions import override

from bench.report import options, show
from crtk_drivers.commands import Command, Kind, Level, Payload
from crtk_drivers.device import Capabilities, CartesianLimits, Device, JointLimits, Mode, Setpoint
from crtk_drivers.engine import Engine, EngineOptions
from crtk_drivers.kinematics.chain import Chain, DHJoint, chain_from_dh
from crtk_drivers.kinematics.serial import SerialChain
from crtk_drivers.samples import (
    AxisMode,
    CartesianServo,
    JointServo,
    JointState,
    Pose,
    Sample,
    Stamp,
    Twist,
    Value,
    Vector,
    Wrench,
    joint_state,
    vector,
)

CYCLE = 0.002
INTERPOLATE_EVERY = 10
MOVE_EVERY = 250
LIMIT = JointLimits(-6.3, 6.3, velocity=3.0, acceleration=40.0, jerk=1000.0, effort=150.0)
TOOL = CartesianLimits(1.0, 3.0, 5.0, 20.0, 100.0, 20.0)
HALF = math.pi / 2

UR5E = (
    (0.0, HALF, 0.163),
    (-0.425, 0.0, 0.0),
    (-0.392, 0.0, 0.0),
    (0.0, HALF, 0.133),
    (0.0, -HALF, 0.1),
    (0.0, 0.0, 0.1),
)
IIWA = (
    (0.0, -HALF, 0.34),
    (0.0, HALF, 0.0),
    (0.0, HALF, 0.4),
    (0.0, -HALF, 0.0),
    (0.0, -HALF, 0.4),
    (0.0, HALF, 0.0),
    (0.0, 0.0, 0.126),
)
ARMS = {
    6: (UR5E, [0.0, -1.6, 1.4, -1.2, -1.6, 0.3]),
    7: (IIWA, [0.3, 0.6, 0.2, -1.3, 0.2, 1.1, 0.1]),
}
"""By number of axes: rows of a, alpha and d (m, rad), and where the arm begins."""


def chain_of(axes: int) -> Chain:
    """Return the arm of so many axes."""
    rows, _ = ARMS[axes]
    joints = [
        DHJoint(f"joint_{i}", a=a, alpha=alpha, d=d, lower=LIMIT.lower, upper=LIMIT.upper)
        for i, (a, alpha, d) in enumerate(rows)
    ]
    return chain_from_dh(joints)


class Clock:
    """Time that passes when the bench says so."""

    now = 1000.0

    def __call__(self) -> float:
        """Return the time."""
        return self.now


class Arm(Device):
    """Follows every setpoint at once."""

    def __init__(self, axes: int, clock: Clock) -> None:
        self._kinematics = SerialChain(chain_of(axes))
        self._clock = clock
        self._position = vector(ARMS[axes][1])
        self._capabilities = Capabilities(
            joints=tuple(f"joint_{i}" for i in range(axes)),
            limits=(LIMIT,) * axes,
            cartesian_limits=TOOL,
            modes=frozenset({Mode.JOINT_POSITION, Mode.JOINT_EFFORT}),
            rate=1.0 / CYCLE,
        )

    @property
    @override
    def capabilities(self) -> Capabilities:
        return self._capabilities

    @property
    @override
    def kinematics(self) -> SerialChain:
        return self._kinematics

    @property
    @override
    def address(self) -> str:
        return "bench"

    @override
    def open(self, deadline: float) -> None:
        """There is nothing to do."""

    @override
    def close(self) -> None:
        """There is nothing to do."""

    @override
    def read(self, deadline: float) -> Sample:
        stamp = Stamp(round(self._clock.now * 1e9), self._clock.now)
        return Sample(stamp, {"measured_js": JointState(position=self._position)})

    @override
    def write(self, setpoint: Setpoint) -> None:
        if setpoint.mode is Mode.JOINT_POSITION:
            self._position = setpoint.values

    @override
    def stop(self) -> None:
        """There is nothing to do."""


class Source:
    """Values for each command: a smooth motion of some centimetres around where the arm begins."""

    def __init__(self, arm: Arm, axes: int) -> None:
        self._arm = arm
        self._start = vector(ARMS[axes][1])
        self._axes = np.arange(axes) * 0.5

    def joints(self, time: float) -> Vector:
        """Return the joint position (n,)."""
        return vector(self._start + 0.05 * (np.sin(2.0 * time + self._axes) - np.sin(self._axes)))

    def value(self, command: Command, time: float) -> Value:
        """Return the value of a command at a time."""
        wave = vector(0.05 * np.sin(2.0 * time + np.arange(6)))
        if command.payload is Payload.JOINT_SERVO:
            modes = [AxisMode.POSITION] * (self._axes.size - 1) + [AxisMode.VELOCITY]
            velocity = np.full(self._axes.size, 0.01 * math.sin(2.0 * time))
            return JointServo(tuple(modes), self.joints(time), vector(velocity))
        if command.payload is Payload.CARTESIAN_SERVO:
            modes = [AxisMode.POSITION, AxisMode.VELOCITY, *[AxisMode.NONE] * 4]
            here = self._arm.kinematics.forward(self.joints(time))
            task = Pose(vector((0.0, 0.0, 0.0)), vector((0.0, 0.0, 0.0, 1.0)))
            twist = Twist(vector(wave[:3] * 0.1), vector(wave[3:] * 0.1))
            return CartesianServo(tuple(modes), here, twist, Wrench(wave[:3], wave[3:]), task)
        if command.payload is Payload.TWIST:
            return Twist(vector(wave[:3]), vector(wave[3:]))
        if command.payload is Payload.WRENCH:
            return Wrench(vector(wave[:3]), vector(wave[3:]))
        if command.payload is Payload.POSE:
            if command.kind is Kind.RELATIVE:
                return Pose(vector(wave[:3] * 0.002), vector((0.0, 0.0, 0.0, 1.0)))
            return self._arm.kinematics.forward(self.joints(time))
        if command.kind in (Kind.VELOCITY, Kind.EFFORT):
            return joint_state(command.kind, vector(0.05 * np.sin(2.0 * time + self._axes)))
        if command.kind is Kind.RELATIVE:
            return JointState(position=vector(0.0001 * np.sin(2.0 * time + self._axes)))
        return JointState(position=self.joints(time))


def cost(name: str, axes: int, cycles: int) -> tuple[Vector, Vector]:
    """Return the microseconds of processor time of each submit and of each cycle while `name` runs."""
    clock = Clock()
    arm = Arm(axes, clock)
    engine = Engine(arm, "bench", EngineOptions(), clock)
    engine.connect(math.inf)
    engine.cycle(math.inf)
    engine.state_command("enable")
    for _ in range(3):
        clock.now += CYCLE
        engine.cycle(math.inf)
    command = engine.commands.get(name)
    source = Source(arm, axes)
    every = {Level.SERVO: 1, Level.INTERPOLATE: INTERPOLATE_EVERY, Level.MOVE: MOVE_EVERY}
    submits, spent = [], []
    gc.collect()
    for index in range(cycles):
        if command is not None and index % every[command.level] == 0:
            value = source.value(command, index * CYCLE)
            began = time.thread_time_ns()
            engine.submit(name, value)
            submits.append(time.thread_time_ns() - began)
        clock.now += CYCLE
        began = time.thread_time_ns()
        engine.cycle(math.inf)
        spent.append(time.thread_time_ns() - began)
    return np.array(submits) / 1e3, np.array(spent) / 1e3


def shares(axes: int, calls: int) -> dict[str, Vector]:
    """Return the microseconds of the libraries' own calls."""
    chain, (_, start) = SerialChain(chain_of(axes)), ARMS[axes]
    joints = vector(start)
    pose, near = chain.forward(joints), vector(np.array(start) + 0.001)
    ruckig, problem = Ruckig(axes), InputParameter(axes)
    problem.current_position, problem.target_position = start, (np.array(start) + 0.5).tolist()
    problem.max_velocity = [LIMIT.velocity] * axes
    problem.max_acceleration = [LIMIT.acceleration] * axes
    problem.max_jerk = [LIMIT.jerk] * axes
    trajectory = Trajectory(axes)
    ruckig.calculate(problem, trajectory)
    work: dict[str, Callable[[], object]] = {
        "ruckig: a plan": lambda: ruckig.calculate(problem, trajectory),
        "ruckig: a point": lambda: trajectory.at_time(0.1),
        "pinocchio: forward kinematics": lambda: chain.forward(joints),
        "pinocchio: Jacobian": lambda: chain.jacobian(joints),
        "pinocchio: inverse kinematics, 1 mrad away": lambda: chain.inverse(pose, near),
    }
    found = {}
    for what, call in work.items():
        times = np.empty(calls)
        for index in range(calls):
            began = time.thread_time_ns()
            call()
            times[index] = time.thread_time_ns() - began
        found[what] = times / 1e3
    return found


def main() -> None:
    """Print the tables."""
    given = options(__doc__ or "", cycles=(2000, "of each command"))
    clock = Clock()
    engine = Engine(Arm(6, clock), "bench", EngineOptions(), clock)
    names = [name for name, command in engine.commands.items() if command.is_motion]
    rows = []
    for name in ("(holding)", *names):
        row = [name]
        for axes in (6, 7):
            for times in cost(name, axes, given.cycles):
                found = (np.median(times), np.percentile(times, 99)) if times.size else ()
                row += [f"{value:.0f}" for value in found] or ["-", "-"]
        rows.append(row)
    header = ["command"] + [what for _ in (6, 7) for what in _COLUMNS]
    notes = ["us of processor time; the first four columns are of 6 axes, the others of 7."]
    show("Commands", header, rows, notes)
    rows = []
    for what in (both := {axes: shares(axes, given.cycles) for axes in (6, 7)})[6]:
        row = [what]
        for axes in (6, 7):
            times = both[axes][what]
            row += [f"{np.median(times):.1f}", f"{np.percentile(times, 99):.1f}"]
        rows.append(row)
    show("Libraries' share, us", ["call", "6 axes p50", "p99", "7 axes p50", "p99"], rows)


_COLUMNS = ("submit", "p99", "cycle", "p99")

if __name__ == "__main__":
    main()

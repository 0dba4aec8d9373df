"""A six-axis arm that takes what it declares, behind a real engine with a clock that the test turns.

What is written is judged as it arrives (`Judge`): against the limits always, and against the motion before
where the core has promised to go on from that (see `docs/motion.md`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from crtk_drivers.commands import Command, Kind, Level, Payload, Space, find
from crtk_drivers.device import (
    Capabilities,
    CartesianLimits,
    Device,
    JointLimits,
    Mode,
    Setpoint,
    Steps,
)
from crtk_drivers.engine import Engine, EngineOptions
from crtk_drivers.errors import CommandRefused
from crtk_drivers.geometry.quaternions import quaternion_from_rotvec
from crtk_drivers.geometry.rates import turn
from crtk_drivers.kinematics.chain import DHJoint, chain_from_dh
from crtk_drivers.kinematics.serial import SerialChain
from crtk_drivers.options import LimitPolicy
from crtk_drivers.samples import (
    AxisMode,
    CartesianServo,
    JointServo,
    JointState,
    Pose,
    Sample,
    Twist,
    Value,
    Vector,
    Wrench,
    joint_state,
    vector,
)
from crtk_drivers.state import OperatingState
from crtk_drivers.testing.clock import FakeClock

RATE = 100.0
CYCLE = 1.0 / RATE
HALF = math.pi / 2
LIMIT = JointLimits(-3.0, 3.0, velocity=2.0, acceleration=20.0, jerk=400.0, effort=50.0)
TOOL = CartesianLimits(2.0, 6.0, 10.0, 30.0, force=50.0, torque=20.0)
HOME = np.array([0.3, -1.2, 1.4, -1.0, -1.5, 0.2])
EFFORT_RISE = 0.1
ROWS = (
    (0.0, HALF, 0.163),
    (-0.425, 0.0, 0.0),
    (-0.392, 0.0, 0.0),
    (0.0, HALF, 0.133),
    (0.0, -HALF, 0.1),
    (0.0, 0.0, 0.1),
)
CHAIN = SerialChain(
    chain_from_dh(
        DHJoint(f"j{i}", a=a, alpha=alpha, d=d, lower=LIMIT.lower, upper=LIMIT.upper)
        for i, (a, alpha, d) in enumerate(ROWS)
    )
)

VARIANTS: dict[str, frozenset[Mode]] = {
    "positions": frozenset({Mode.JOINT_POSITION}),
    "velocities": frozenset({Mode.JOINT_VELOCITY}),
    "positions, velocities and efforts": frozenset(
        {Mode.JOINT_POSITION, Mode.JOINT_VELOCITY, Mode.JOINT_EFFORT}
    ),
    "positions, twists and wrenches": frozenset(
        {Mode.JOINT_POSITION, Mode.CARTESIAN_VELOCITY, Mode.CARTESIAN_EFFORT}
    ),
    "poses and twists": frozenset({Mode.CARTESIAN_POSITION, Mode.CARTESIAN_VELOCITY}),
}

SMOOTH_LEVELS = (Level.INTERPOLATE, Level.MOVE)


class Arm(Device):
    """Follows positions at once, velocities exactly, efforts like a damped mass."""

    def __init__(self, clock: FakeClock, modes: frozenset[Mode], every_cycle: bool) -> None:
        self.clock = clock
        self.position = HOME.copy()
        self.velocity = np.zeros(6)
        self.target: Setpoint | None = None
        self.judge: Judge | None = None
        self._read = clock()
        self._capabilities = Capabilities(
            joints=CHAIN.joints,
            limits=(LIMIT,) * 6,
            cartesian_limits=TOOL,
            modes=modes,
            measured=("measured_js", "measured_cp"),
            has_free=True,
            rate=RATE,
            writes_every_cycle=every_cycle,
        )

    @property
    def capabilities(self) -> Capabilities:
        return self._capabilities

    @property
    def address(self) -> str:
        return "motion"

    @property
    def kinematics(self) -> SerialChain:
        return CHAIN

    def open(self, deadline: float) -> None:
        pass

    def close(self) -> None:
        pass

    def read(self, deadline: float) -> Sample:
        dt, self._read = self.clock() - self._read, self.clock()
        mode = None if self.target is None else self.target.mode
        if self.target is not None and mode is not None and mode.space is Space.CARTESIAN:
            self._follow_tool(mode, self.target.values, dt)
        elif mode is Mode.JOINT_VELOCITY:
            self.velocity = self.target.values if self.target else np.zeros(6)
        elif mode is Mode.JOINT_EFFORT and self.target is not None:
            self._push(self.target.values, dt)
        if mode not in (Mode.JOINT_POSITION, Mode.CARTESIAN_POSITION):
            self.position = self.position + dt * self.velocity
        joints = JointState(vector(self.position), vector(self.velocity), name=CHAIN.joints)
        pose = CHAIN.forward(joints.position)
        return Sample(self.clock.stamp(), {"measured_js": joints, "measured_cp": pose})

    def _follow_tool(self, mode: Mode, values: Vector, dt: float) -> None:
        jacobian = CHAIN.jacobian(vector(self.position))
        if mode is Mode.CARTESIAN_VELOCITY:
            self.velocity = np.linalg.pinv(jacobian) @ values
        elif mode is Mode.CARTESIAN_EFFORT:
            self._push(jacobian.T @ values, dt)

    def _push(self, effort: Vector, dt: float) -> None:
        velocity = self.velocity + dt * (effort - 5.0 * self.velocity)
        self.velocity = np.clip(velocity, -0.9 * LIMIT.velocity, 0.9 * LIMIT.velocity)

    def write(self, setpoint: Setpoint) -> None:
        if self.judge is not None:
            self.judge.written(setpoint)
        if setpoint.mode is Mode.JOINT_POSITION:
            before = self.position
            self.position = setpoint.values.copy()
            self.velocity = (self.position - before) / CYCLE
        elif setpoint.mode is Mode.CARTESIAN_POSITION:
            pose = Pose(setpoint.values[:3], setpoint.values[3:])
            self.position = CHAIN.inverse(pose, vector(self.position)).copy()
        self.target = setpoint

    def stop(self) -> None:
        self.target, self.velocity = None, np.zeros(6)

    def free(self) -> Steps:
        while True:
            yield


@dataclass
class _Motion:
    """What the hardware was doing: joints and tool, as far as the setpoints tell."""

    time: float
    mode: Mode
    position: Vector
    velocity: Vector
    values: Vector
    pose: Pose
    twist: Vector = field(default_factory=lambda: vector(np.zeros(6)))


class Judge:
    """Holds what is written against the promises. `name` is the command in force."""

    def __init__(self, arm: Arm, engine: Engine) -> None:
        self.arm = arm
        self.engine = engine
        self.name = ""
        self.count = 0
        self.steady = True
        """No cycle has been late: speeds can be told from steps."""
        self.last: _Motion | None = None
        self.judged = ""
        self.accelerations: dict[str, float] = {}

    def written(self, setpoint: Setpoint) -> None:
        assert self.engine.status.state is OperatingState.ENABLED
        now, values = self.arm.clock(), setpoint.values
        self._within_limits(setpoint)
        last = self.last
        moving = last is not None and now - last.time < 1.5 * CYCLE
        position = values if setpoint.mode is Mode.JOINT_POSITION else vector(self.arm.position)
        pose = self._pose(setpoint)
        if last is not None and moving and self._goes_on(last, setpoint.mode):
            # Where the hardware is sent from one cycle to the next.
            velocity = vector((position - last.position) / CYCLE)
            twist = _twist(last.pose, pose)
        elif setpoint.mode.kind is Kind.POSITION and not self._is_own(setpoint.mode):
            # A first position that a client sends is a step, and no motion.
            velocity = twist = vector(np.zeros(6))
        else:
            velocity = self._told(setpoint, position)
            twist = vector(CHAIN.jacobian(vector(self.arm.position)) @ velocity)
            if setpoint.mode is Mode.CARTESIAN_POSITION:
                twist = _twist(CHAIN.forward(vector(self.arm.position)), pose)
        if setpoint.mode is Mode.JOINT_VELOCITY:
            velocity = values
            twist = vector(CHAIN.jacobian(vector(self.arm.position)) @ velocity)
        if setpoint.mode is Mode.CARTESIAN_VELOCITY:
            twist = values
        motion = _Motion(now, setpoint.mode, position, velocity, values, pose, twist)
        self._smooth(motion, last if moving else None)
        self.last, self.count = motion, self.count + 1

    def _is_own(self, mode: Mode) -> bool:
        """Whether the core makes the motion itself, of what a client asks for."""
        command = find(self.name)
        return command.level in SMOOTH_LEVELS or (
            command.payload is Payload.TWIST and mode is not Mode.CARTESIAN_VELOCITY
        )

    @staticmethod
    def _goes_on(last: _Motion, mode: Mode) -> bool:
        return last.mode is mode and mode.kind is Kind.POSITION

    def _told(self, setpoint: Setpoint, position: Vector) -> Vector:
        """Return the joint velocity that a first setpoint of its kind leads to."""
        if setpoint.mode.kind is Kind.POSITION:
            return vector((position - self.arm.position) / CYCLE)
        return vector(self.arm.velocity)

    def _pose(self, setpoint: Setpoint) -> Pose:
        if setpoint.mode is Mode.CARTESIAN_POSITION:
            return Pose(setpoint.values[:3], setpoint.values[3:])
        if setpoint.mode is Mode.JOINT_POSITION:
            return CHAIN.forward(setpoint.values)
        return CHAIN.forward(vector(self.arm.position))

    def _within_limits(self, setpoint: Setpoint) -> None:
        values = setpoint.values
        assert np.isfinite(values).all()
        if setpoint.mode is Mode.JOINT_POSITION:
            assert np.abs(values).max() <= LIMIT.upper + 1e-9
            step = np.abs(values - self.arm.position).max()
            assert step <= LIMIT.velocity * 0.1 + 1e-9, f"{self.name}: a step of {step:.4f}"
        elif setpoint.mode is Mode.JOINT_VELOCITY:
            assert np.abs(values).max() <= LIMIT.velocity + 1e-9
        elif setpoint.mode is Mode.JOINT_EFFORT:
            assert np.abs(values).max() <= LIMIT.effort + 1e-9
        elif setpoint.mode is Mode.CARTESIAN_VELOCITY:
            assert np.linalg.norm(values[:3]) <= TOOL.linear_velocity + 1e-9
            assert np.linalg.norm(values[3:]) <= TOOL.angular_velocity + 1e-9

    def _smooth(self, motion: _Motion, last: _Motion | None) -> None:
        """Hold a motion that the core makes itself against the one before."""
        if not self.steady:
            self.accelerations.clear()
            return
        is_own = self._is_own(motion.mode)
        if motion.mode.kind is Kind.EFFORT:
            if is_own:
                self._rises(motion, last)
            return
        velocity, twist, what = self._before(last)
        told = f"{self.name} after {what}"
        # Speeds are told from steps; that of the last moment is half a cycle's acceleration ahead.
        slack = 1.02 if self.name == self.judged else 1.55
        self.judged = self.name
        change = motion.twist - twist
        by_pose = find(self.name).payload is Payload.POSE or motion.mode.space is Space.CARTESIAN
        for part, size, limit, counts in (
            ("joints", np.abs(motion.velocity - velocity).max(), LIMIT.acceleration, not by_pose),
            ("tool", np.linalg.norm(change[:3]), TOOL.linear_acceleration, by_pose),
            ("turn", np.linalg.norm(change[3:]), TOOL.angular_acceleration, by_pose),
        ):
            # A motion may come with more acceleration than is allowed; it then loses it.
            acceleration = float(size) / CYCLE
            before, self.accelerations[part] = self.accelerations.get(part, 0.0), acceleration
            # What a turn of the axes adds within a cycle.
            allowed = max(limit * (slack + 0.1 * by_pose), 1.2 * before) + 0.5
            assert acceleration <= allowed or not (counts and is_own), (
                f"{told}: {part} with {acceleration:.1f}, allowed {limit:.1f}"
            )

    def _before(self, last: _Motion | None) -> tuple[Vector, Vector, str]:
        """Return joint velocity and twist that the hardware had, and under what."""
        if last is None:
            velocity = self.arm.velocity if self.arm.target is None else np.zeros(6)
            if self.arm.target is not None and self.arm.target.mode.kind is not Kind.POSITION:
                velocity = self.arm.velocity
            jacobian = CHAIN.jacobian(vector(self.arm.position))
            return vector(velocity), vector(jacobian @ velocity), "rest"
        velocity, twist = last.velocity, last.twist
        if last.mode.kind is Kind.POSITION and self._stepped(last):
            velocity, twist = vector(np.zeros(6)), vector(np.zeros(6))
        if last.mode.kind is Kind.EFFORT:
            velocity = vector(self.arm.velocity)
            twist = vector(CHAIN.jacobian(vector(self.arm.position)) @ velocity)
        elif last.mode is Mode.CARTESIAN_VELOCITY:
            velocity = vector(self.arm.velocity)
        elif last.mode.space is Space.JOINT and last.mode is not Mode.JOINT_POSITION:
            twist = vector(CHAIN.jacobian(vector(self.arm.position)) @ velocity)
        return velocity, twist, str(last.mode)

    @staticmethod
    def _stepped(last: _Motion) -> bool:
        """Whether the last positions were a step, and no motion: faster than anything may move."""
        if last.mode is Mode.JOINT_POSITION:
            return bool(np.abs(last.velocity).max() > LIMIT.velocity * 1.05)
        linear, angular = np.linalg.norm(last.twist[:3]), np.linalg.norm(last.twist[3:])
        return bool(linear > TOOL.linear_velocity * 1.05 or angular > TOOL.angular_velocity * 1.05)

    def _rises(self, motion: _Motion, last: _Motion | None) -> None:
        before = np.zeros(6)
        if last is not None and last.mode is motion.mode:
            before = last.values
        change = np.abs(motion.values - before).max()
        most = {
            Mode.JOINT_EFFORT: LIMIT.effort / EFFORT_RISE,
            Mode.CARTESIAN_EFFORT: TOOL.force / EFFORT_RISE,
        }[motion.mode]
        if motion.mode is Mode.JOINT_EFFORT and find(self.name).space is Space.CARTESIAN:
            return  # through a Jacobian that changes with the arm
        assert change <= most * CYCLE * 2.05 + 1e-6, f"{self.name}: {change / CYCLE:.1f} N·m/s"


def _twist(before: Pose, after: Pose) -> Vector:
    linear = (after.position - before.position) / CYCLE
    return vector((*linear, *(turn(after.orientation, before.orientation) / CYCLE)))


class MotionRig:
    """The arm, its engine, and values for every command."""

    def __init__(self, variant: str, every_cycle: bool = False) -> None:
        self.clock = FakeClock()
        self.arm = Arm(self.clock, VARIANTS[variant], every_cycle)
        options = EngineOptions(
            interpolate_timeout=0.06, mode_switch_dwell=0.0, limits=LimitPolicy(max_step=0.1)
        )
        self.engine = Engine(self.arm, "arm", options, self.clock, self.clock.advance)
        self.judge = self.arm.judge = Judge(self.arm, self.engine)
        self.engine.connect(math.inf)
        self.cycle()
        self.reach("enable")

    def cycle(self, late: float = 0.0) -> None:
        self.judge.steady = late == 0.0
        self.clock.advance(CYCLE + late)
        self.engine.cycle(math.inf)

    def reach(self, command: str) -> None:
        self.engine.state_command(command)
        for _ in range(4):
            self.cycle()

    @property
    def names(self) -> list[str]:
        """Everything that moves the arm or ends its motion."""
        plain = [n for n, c in self.engine.commands.items() if c.is_motion and "/" not in n]
        return [*plain, "hold", "free"]

    def send(self, name: str, time: float, size: float = 1.0) -> bool:
        """Send a command; return whether it was accepted."""
        command = find(name)
        value = self.value(command, time, size) if command.is_motion else None
        before, self.judge.name = self.judge.name, name
        try:
            self.engine.submit(name, value)
        except CommandRefused:
            self.judge.name = before
            return False
        return True

    def value(self, command: Command, time: float, size: float = 1.0) -> Value:
        """Return what a command says at a time: a motion about where the arm began."""
        wave = size * np.sin(4.0 * time + np.arange(6))
        if command.payload is Payload.JOINT_SERVO:
            return self._mixed_joints(time, wave)
        if command.payload is Payload.CARTESIAN_SERVO:
            modes = [AxisMode.POSITION, AxisMode.VELOCITY, *[AxisMode.NONE] * 4]
            here = CHAIN.forward(self.joints(time, size))
            task = Pose(vector((0.0, 0.0, 0.0)), vector((0.0, 0.0, 0.0, 1.0)))
            twist = Twist(vector(wave[:3] * 0.1), vector(wave[3:] * 0.1))
            zero = Wrench(vector(np.zeros(3)), vector(np.zeros(3)))
            return CartesianServo(tuple(modes), here, twist, zero, task)
        if command.payload is Payload.TWIST:
            return Twist(vector(wave[:3] * 0.1), vector(wave[3:] * 0.2))
        if command.payload is Payload.WRENCH:
            return Wrench(vector(wave[:3] * 10.0), vector(wave[3:] * 5.0))
        if command.payload is Payload.POSE:
            if command.is_relative:
                step = 0.1 if command.level is Level.MOVE else 0.001
                turned = quaternion_from_rotvec(vector(wave[3:] * step))
                return Pose(vector(wave[:3] * step), turned)
            return CHAIN.forward(self.joints(time, size))
        if command.is_relative:
            step = 0.1 if command.level is Level.MOVE else 0.002
            return JointState(position=vector(wave * step))
        if command.kind is Kind.VELOCITY:
            return joint_state(command.kind, vector(wave * 0.3))
        if command.kind is Kind.EFFORT:
            return joint_state(command.kind, vector(wave * 5.0))
        return JointState(position=self.joints(time, size))

    def joints(self, time: float, size: float = 1.0) -> Vector:
        """Return a joint position on a way about home."""
        way = 0.05 * size * (np.sin(4.0 * time + np.arange(6)) - np.sin(np.arange(6)))
        return vector(HOME + way)

    def _mixed_joints(self, time: float, wave: Vector) -> JointServo:
        modes = self.arm.capabilities.modes
        if Mode.JOINT_POSITION in modes:
            kinds = [AxisMode.POSITION] * 3 + [AxisMode.VELOCITY] * 3
            return JointServo(tuple(kinds), self.joints(time), vector(wave * 0.1))
        return JointServo((AxisMode.VELOCITY,) * 6, velocity=vector(wave * 0.1))

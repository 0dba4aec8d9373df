"""An engine on a six-axis arm with the geometry of a UR5e; modes, limits and moves are a test's choice."""

from typing import Any

import numpy as np

from crtk_drivers.device import (
    Capabilities,
    CartesianLimits,
    Goal,
    JointLimits,
    Kinematics,
    Mode,
    Setpoint,
)
from crtk_drivers.engine import Engine, EngineOptions
from crtk_drivers.geometry.frames import moved
from crtk_drivers.geometry.quaternions import quaternion_from_rotvec
from crtk_drivers.geometry.rates import turn
from crtk_drivers.kinematics.chain import DHJoint, chain_from_dh
from crtk_drivers.kinematics.serial import SerialChain
from crtk_drivers.samples import (
    AxisMode,
    CartesianServo,
    JointServo,
    Pose,
    Sample,
    Twist,
    Value,
    Vector,
    Wrench,
    vector,
)
from crtk_drivers.testing.clock import FakeClock
from rigs.scripted_engine import LONG_STEPS, Recorder, Rig, ScriptedDevice

JOINTS = tuple("abcdef")
HALF = np.pi / 2.0
LENGTHS = (
    (0.0, HALF, 0.1625),
    (-0.425, 0.0, 0.0),
    (-0.3922, 0.0, 0.0),
    (0.0, HALF, 0.1333),
    (0.0, -HALF, 0.0997),
    (0.0, 0.0, 0.0996),
)
ARM = SerialChain(
    chain_from_dh(
        DHJoint(name, a, alpha, d, lower=-2.0 * np.pi, upper=2.0 * np.pi)
        for name, (a, alpha, d) in zip(JOINTS, LENGTHS, strict=True)
    )
)

LIMIT = JointLimits(-6.0, 6.0, velocity=2.0, acceleration=20.0, jerk=400.0, effort=50.0)
TOOL = CartesianLimits(0.5, 1.5, 5.0, 10.0, force=40.0, torque=10.0)
RATE = 250.0
PERIOD = 1.0 / RATE
BENT = vector((0.4, -1.2, 1.5, -1.1, -1.3, 0.3))
"""Far from every singularity."""
STRETCHED = vector((0.4, -1.2, 1.5, -1.1, 0.02, 0.3))
"""Near the wrist's singularity."""

P, V, F, N = AxisMode.POSITION, AxisMode.VELOCITY, AxisMode.EFFORT, AxisMode.NONE


def six_joints(*modes: Mode, **changes: Any) -> Capabilities:
    values: dict[str, Any] = {
        "joints": JOINTS,
        "limits": (LIMIT,) * 6,
        "cartesian_limits": TOOL,
        "modes": frozenset(modes or (Mode.JOINT_POSITION,)),
        "measured": ("measured_js", "measured_cp"),
        "rate": RATE,
    }
    return Capabilities(**(values | changes))


class ArmKinematics(Kinematics):
    """Those of `ARM`, with one attempt at an inverse."""

    def forward(self, joints: Vector) -> Pose:
        return ARM.forward(joints)

    def inverse(self, pose: Pose, reference: Vector) -> Vector:
        return ARM.inverse(pose, reference, restarts=0)

    def jacobian(self, joints: Vector) -> Any:
        return ARM.jacobian(joints)


class ArmDevice(ScriptedDevice):
    """Obeys at once and exactly, whatever the mode; efforts move nothing.

    Attributes:
        velocity: (6,) of the joints, while it follows velocities.
        twist: (6,) of the tool, the same.
        extra: further values of each sample.
        ready: what `takes_setpoints` says after `stop`.
        slider: what `pace` says.
        arrived: what `has_arrived` says.
        gravity: what `use_gravity_compensation` was told.
    """

    def __init__(
        self, clock: FakeClock, capabilities: Capabilities, at: Vector, has_kinematics: bool
    ) -> None:
        super().__init__(clock, capabilities, has_kinematics)
        self.solver = ArmKinematics()
        self.position = np.array(at)
        self.velocity = np.zeros(6)
        self.twist = np.zeros(6)
        self.extra: dict[str, Value] = {}
        self.ready = True
        self.slider = 1.0
        self.arrived = True
        self.gravity: list[bool] = []
        self._read_at = clock()

    def read(self, deadline: float) -> Sample | None:
        elapsed, self._read_at = self.clock() - self._read_at, self.clock()
        self.position = self.position + self.velocity * elapsed
        if self.twist.any():
            step = self.twist * elapsed
            way = Pose(vector(step[:3]), quaternion_from_rotvec(vector(step[3:])))
            self.position = np.array(
                ARM.inverse(moved(self.pose, way), vector(self.position), restarts=0)
            )
        sample = super().read(deadline)
        assert sample is not None
        return Sample(sample.stamp, {**sample.values, **self.extra})

    @property
    def pose(self) -> Pose:
        return self.solver.forward(vector(self.position))

    def write(self, setpoint: Setpoint) -> None:
        assert setpoint.mode in self.declared.modes, "no such mode"
        assert self.takes_setpoints, "written while it comes to rest"
        super().write(setpoint)
        self._stand()
        if setpoint.mode is Mode.JOINT_VELOCITY:
            self.velocity = setpoint.values.copy()
        elif setpoint.mode is Mode.CARTESIAN_VELOCITY:
            self.twist = setpoint.values.copy()
        elif setpoint.mode is Mode.CARTESIAN_POSITION:
            goal = Pose(vector(setpoint.values[:3]), vector(setpoint.values[3:]))
            self.position = np.array(ARM.inverse(goal, vector(self.position), restarts=0))

    def stop(self) -> None:
        super().stop()
        self._stand()

    def _stand(self) -> None:
        self.velocity, self.twist = np.zeros(6), np.zeros(6)

    @property
    def takes_setpoints(self) -> bool:
        return self.ready

    @property
    def pace(self) -> float:
        return self.slider

    @property
    def has_arrived(self) -> bool:
        return self.arrived

    def move(self, goal: Goal) -> None:
        self._stand()
        super().move(goal)

    def use_gravity_compensation(self, on: bool) -> None:
        self._called("use_gravity_compensation")
        self.gravity.append(on)


class ArmRig(Rig):
    """The rig, on the arm."""

    device: ArmDevice

    def __init__(
        self,
        *modes: Mode,
        options: EngineOptions | None = None,
        at: Vector = BENT,
        has_kinematics: bool = True,
        **changes: Any,
    ) -> None:
        self.clock = FakeClock()
        self.device = ArmDevice(self.clock, six_joints(*modes, **changes), at, has_kinematics)
        self.engine = Engine(
            self.device, "rig", options or LONG_STEPS, self.clock, self.clock.advance
        )
        self.told = Recorder()
        self.engine.add_observer(self.told)

    def cycle(self, count: int = 1, period: float = PERIOD) -> None:
        super().cycle(count, period)

    def enabled(self) -> "ArmRig":
        super().enabled()
        return self

    def stream(self, name: str, value: Value, count: int, every: int = 1) -> None:
        for _ in range(count):
            self.engine.submit(name, value)
            self.cycle(every)

    @property
    def path(self) -> np.ndarray:
        """What was written in each cycle."""
        return np.array([setpoint.values for setpoint in self.written])

    @property
    def tool_path(self) -> list[Pose]:
        """Where the tool was sent in each cycle, of joint positions."""
        return [ARM.forward(setpoint.values) for setpoint in self.written]


def twist(*values: float, frame: str = "") -> Twist:
    return Twist(vector(values[:3]), vector(values[3:]), frame)


def wrench(*values: float, frame: str = "") -> Wrench:
    return Wrench(vector(values[:3]), vector(values[3:]), frame)


def step(*values: float, frame: str = "") -> Pose:
    """An increment: translation and rotation vector."""
    return Pose(vector(values[:3]), quaternion_from_rotvec(vector(values[3:])), frame)


def js(modes: str, position: Any = (), velocity: Any = (), effort: Any = ()) -> JointServo:
    """A mixed joint setpoint, its modes as letters: ``"PPVNNN"``."""
    return JointServo(letters(modes), vector(position), vector(velocity), vector(effort))


def letters(modes: str) -> tuple[int, ...]:
    return tuple({"P": P, "V": V, "F": F, "N": N}[letter] for letter in modes)


def cs(
    modes: str,
    pose: Pose | None = None,
    rate: Twist | None = None,
    push: Wrench | None = None,
    task: Pose | None = None,
    frame: str = "",
) -> CartesianServo:
    """A mixed setpoint of the tool, its modes as letters; what is not given is zero."""
    return CartesianServo(
        letters(modes),
        pose or step(0, 0, 0, 0, 0, 0),
        rate or twist(0, 0, 0, 0, 0, 0),
        push or wrench(0, 0, 0, 0, 0, 0),
        task or step(0, 0, 0, 0, 0, 0),
        frame,
    )


def apart(first: Pose, second: Pose) -> float:
    """The larger of the distances of two poses in m and in rad."""
    return max(
        float(np.linalg.norm(first.position - second.position)),
        float(np.linalg.norm(turn(first.orientation, second.orientation))),
    )

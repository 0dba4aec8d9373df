"""A device without hardware: a gantry whose setpoints come back as measurements.

It is a complete `Device`, small enough to read in one go: use it as the pattern of a plugin, and in tests
and examples that need a device but no simulator process. Three linear axes x, y, z carry a rotation about
z, so that its kinematics are exact and need no solver. Behind it is a first-order plant that moves with
the real clock.

A test may change the public attributes at any time; they take effect in the next cycle.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping

import numpy as np
from pydantic import Field
from typing_extensions import override

from crtk_drivers.config import DeviceConfig
from crtk_drivers.device import (
    Capabilities,
    CartesianLimits,
    Condition,
    Device,
    DeviceKind,
    Following,
    JointLimits,
    Kinematics,
    Mode,
    Setpoint,
    Steps,
    StopPolicy,
)
from crtk_drivers.errors import ConnectionFailed, ConnectionLost, KinematicsError
from crtk_drivers.geometry.quaternions import quaternion_from_rotvec, rotvec_from_quaternion
from crtk_drivers.plugins import DevicePlugin
from crtk_drivers.samples import (
    Array,
    JointState,
    Pose,
    Sample,
    Stamp,
    Twist,
    Vector,
    Wrench,
    vector,
)

JOINTS = ("x", "y", "z", "yaw")
LINEAR = JointLimits(
    lower=-1.0, upper=1.0, velocity=1.0, acceleration=20.0, jerk=200.0, effort=100.0
)
ROTARY = JointLimits(
    lower=-3.1, upper=3.1, velocity=2.0, acceleration=40.0, jerk=400.0, effort=20.0
)
TIME_CONSTANT = 0.02
"""Seconds in which the plant makes up 63 % of a difference."""
DAMPING = 20.0
"""N·s/m (N·m·s/rad): an effort leads to a velocity of effort / DAMPING, and a velocity takes that effort."""
TILT_TOLERANCE = 1e-6
"""Radians about x or y beyond which a pose is out of the gantry's reach."""


class LoopbackConfig(DeviceConfig):
    """Configuration of the gantry."""

    address: str = Field(
        default="loopback",
        min_length=1,
        description="A name; devices with the same address share one I/O thread.",
    )
    rate: float = Field(default=100.0, ge=1.0, le=1000.0, description="Of the I/O cycle, in Hz.")
    needs_homing: bool = Field(default=False, description="Positions count only after home.")
    transition_time: float = Field(
        default=0.0, ge=0.0, le=4.0, description="What enable, disable and home take, in s."
    )


class GantryKinematics(Kinematics):
    """Exact, and without a solver.

    Args:
        where: the device, for messages.
    """

    def __init__(self, where: str) -> None:
        self._where = where

    @override
    def forward(self, joints: Vector) -> Pose:
        x, y, z, yaw = joints.tolist()
        return Pose(vector((x, y, z)), quaternion_from_rotvec(vector((0.0, 0.0, yaw))), "base")

    @override
    def inverse(self, pose: Pose, reference: Vector) -> Vector:
        tilt_x, tilt_y, yaw = rotvec_from_quaternion(pose.orientation).tolist()
        if math.hypot(tilt_x, tilt_y) > TILT_TOLERANCE:
            raise KinematicsError(
                "the tool of the gantry turns about z only",
                where=self._where,
                remedy="Ask for an orientation with x = y = 0.",
            )
        return vector((*pose.position.tolist(), yaw))

    @override
    def jacobian(self, joints: Vector) -> Array:
        jacobian = np.zeros((6, 4))
        jacobian[:3, :3] = np.eye(3)
        jacobian[5, 3] = 1.0
        return jacobian


class LoopbackDevice(Device):
    """The gantry.

    Attributes:
        reachable: `open` fails while this is False, and `read` reports the link as lost.
        silent: `read` returns no sample, as a device that stopped talking.
        reported: what the hardware says of itself, see `Condition`.
        writes: how many setpoints have arrived.
        last_setpoint: the newest of them.
        transition_time: seconds that enable, disable and home take.
    """

    def __init__(self, config: LoopbackConfig | None = None) -> None:
        config = config or LoopbackConfig()
        self.reachable = True
        self.silent = False
        self.reported = Condition()
        self.writes = 0
        self.last_setpoint: Setpoint | None = None
        self._address = config.address
        self._kinematics = GantryKinematics(config.address)
        self.transition_time = config.transition_time
        self._homed = False
        self._position = np.zeros(len(JOINTS))
        self._velocity = np.zeros(len(JOINTS))
        self._effort = np.zeros(len(JOINTS))
        self._target: Setpoint | None = None
        self._updated = 0.0
        self._capabilities = Capabilities(
            joints=JOINTS,
            limits=(LINEAR, LINEAR, LINEAR, ROTARY),
            cartesian_limits=CartesianLimits(1.0, 2.0, 5.0, 10.0, 100.0, 20.0),
            modes=frozenset(
                {
                    Mode.JOINT_POSITION,
                    Mode.JOINT_VELOCITY,
                    Mode.JOINT_EFFORT,
                    Mode.CARTESIAN_VELOCITY,
                }
            ),
            measured=("measured_js", "measured_cp", "measured_cv", "measured_cf"),
            has_free=True,
            needs_homing=config.needs_homing,
            rate=config.rate,
            transition_timeout=5.0,
            stop=StopPolicy(0.0, "stops at once: it is only a model"),
            following=Following((0.05, 0.05, 0.05, 0.1), (0.002,) * 4, lag=5.0 * TIME_CONSTANT),
        )

    def go_to_zero(self) -> None:
        """Put the plant at rest at zero, between two tests."""
        self._target = None
        self._position = np.zeros(len(JOINTS))
        self._velocity = np.zeros(len(JOINTS))

    @property
    @override
    def capabilities(self) -> Capabilities:
        return self._capabilities

    @property
    @override
    def address(self) -> str:
        return self._address

    @property
    @override
    def condition(self) -> Condition:
        return self.reported

    @property
    @override
    def is_homed(self) -> bool:
        return self._homed

    @property
    @override
    def kinematics(self) -> Kinematics:
        return self._kinematics

    @property
    @override
    def counters(self) -> Mapping[str, float]:
        return {"writes": float(self.writes)}

    @override
    def open(self, deadline: float) -> None:
        if not self.reachable:
            raise ConnectionFailed(
                "no answer", where=self._address, remedy="Set `reachable` of the device again."
            )
        self._updated = time.monotonic()
        self._target = None

    @override
    def close(self) -> None:
        self._target = None

    @override
    def read(self, deadline: float) -> Sample | None:
        if not self.reachable:
            raise ConnectionLost("the link is gone", where=self._address)
        stamp = Stamp.now()
        self._integrate(stamp.monotonic - self._updated)
        self._updated = stamp.monotonic
        if self.silent:
            return None
        position, velocity, effort = (
            vector(values) for values in (self._position, self._velocity, self._effort)
        )
        pose = self._kinematics.forward(position)
        return Sample(
            stamp,
            {
                "measured_js": JointState(position, velocity, effort, JOINTS),
                "measured_cp": pose,
                "measured_cv": Twist(velocity[:3], vector((0.0, 0.0, velocity[3])), "base"),
                "measured_cf": Wrench(effort[:3], vector((0.0, 0.0, effort[3])), "base"),
            },
        )

    @override
    def write(self, setpoint: Setpoint) -> None:
        self.writes += 1
        self.last_setpoint = self._target = setpoint

    @override
    def stop(self) -> None:
        self._target = None

    @override
    def enable(self) -> Steps:
        yield from self._transition()

    @override
    def disable(self) -> Steps:
        self.stop()
        yield from self._transition()

    @override
    def home(self) -> Steps:
        yield from self._transition()
        self._homed = True

    @override
    def unhome(self) -> Steps:
        self._homed = False
        yield from ()

    @override
    def free(self) -> Steps:
        self.stop()
        yield from ()

    def _transition(self) -> Steps:
        begun = time.monotonic()
        while time.monotonic() < begun + self.transition_time:
            yield

    def _integrate(self, elapsed: float) -> None:
        share = 1.0 - math.exp(-elapsed / TIME_CONSTANT)
        before = self._position.copy()
        target = self._target
        if target is not None and target.mode is Mode.JOINT_POSITION:
            self._position += share * (target.values - self._position)
            self._velocity = (self._position - before) / max(elapsed, 1e-6)
            self._effort = DAMPING * self._velocity
            return
        self._velocity += share * (self._wanted_velocity(target) - self._velocity)
        self._effort = DAMPING * self._velocity
        if target is not None and target.mode is Mode.JOINT_EFFORT:
            self._effort = target.values.copy()
        lower = [limit.lower for limit in self._capabilities.limits]
        upper = [limit.upper for limit in self._capabilities.limits]
        self._position = np.clip(self._position + self._velocity * elapsed, lower, upper)

    def _wanted_velocity(self, target: Setpoint | None) -> Array:
        if target is None:
            return np.zeros(len(JOINTS))
        if target.mode is Mode.JOINT_EFFORT:
            return target.values / DAMPING
        if target.mode is Mode.CARTESIAN_VELOCITY:
            return target.values[[0, 1, 2, 5]]
        return target.values


PLUGIN = DevicePlugin(
    name="loopback",
    summary="a gantry that exists in memory only, for tests and as a pattern for plugins",
    config=LoopbackConfig,
    kind=DeviceKind.ARM,
    create=LoopbackDevice,
    is_model=True,
)

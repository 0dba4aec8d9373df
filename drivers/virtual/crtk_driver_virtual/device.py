"""The virtual arm as a CRTK device: the plant, its clock, its states."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from typing_extensions import override

from crtk_driver_virtual.config import VirtualConfig, WallConfig
from crtk_driver_virtual.models import Arm, load_arm
from crtk_driver_virtual.plant import FREE, HOLD, LONGEST_RAMP, Command, Drive, Plant, Wall
from crtk_drivers.commands import Payload
from crtk_drivers.device import (
    Capabilities,
    Device,
    Following,
    Input,
    Kinematics,
    Mode,
    Setpoint,
    Steps,
    StopPolicy,
)
from crtk_drivers.errors import CommandRefused, ConnectionFailed, ConnectionLost, Reason
from crtk_drivers.kinematics.serial import SerialChain
from crtk_drivers.samples import JointState, Sample, Stamp, Twist, Vector, Wrench, empty, vector

BASE_FRAME: Final = "base"
TOOL_FRAME: Final = "tool"
LONGEST_STEP: Final = 0.05
"""Seconds that the plant makes up for at once; of a longer pause the rest never happens in it."""
STOP_TIMEOUT: Final = 2.0
"""Seconds that disable waits for the arm to stand before the brakes close."""
FURTHEST: Final = 0.25
"""rad (m) that a joint may be pushed away from where it was sent; a servo gives way to walls and hands."""
ARRIVAL: Final = 0.01
"""rad (m) within which a joint is where a move ends."""
TIME_CONSTANTS: Final = 5.0
"""Of a servo, after which it has carried a setpoint out."""
IK_TIME_LIMIT: Final = 0.1
"""Seconds for one pose."""

_DRIVES: Mapping[Mode, Drive] = MappingProxyType(
    {
        Mode.JOINT_POSITION: Drive.POSITION,
        Mode.JOINT_VELOCITY: Drive.VELOCITY,
        Mode.JOINT_EFFORT: Drive.EFFORT,
        Mode.CARTESIAN_EFFORT: Drive.WRENCH,
    }
)


class VirtualDevice(Device):
    """One arm in memory. Its time is the monotonic clock; it moves while it is read.

    Args:
        config: of the arm.
        now: the present on both clocks.

    Attributes:
        reachable: `open` fails while this is False, and `read` reports the link as lost: for tests.
        plant: what moves.
    """

    def __init__(
        self,
        config: VirtualConfig,
        now: Callable[[], Stamp] = Stamp.now,
    ) -> None:
        self.reachable = True
        self._config = config
        self._now = now
        arm = load_arm(config)
        tool = None if config.tool is None else config.tool.pose
        self._chain = SerialChain(
            arm.chain,
            tool=tool,
            frame_id=BASE_FRAME,
            name=f"virtual {config.address}",
            time_limit=IK_TIME_LIMIT,
        )
        self._joints = arm.chain.names
        self._has_masses = arm.has_masses
        self.plant = self._plant_of(
            arm,
            gravity=config.gravity,
            tool=tool,
            walls=[_wall(wall) for wall in config.walls],
            cycle=1.0 / config.rate,
            bandwidth=config.servo_bandwidth,
        )
        self.plant.gravity_compensation = config.gravity_compensation
        self._homed = False
        self._updated = 0.0
        self._skipped = 0.0
        modes = {Mode.JOINT_POSITION, Mode.JOINT_VELOCITY}
        if arm.has_masses:
            modes.add(Mode.JOINT_EFFORT)
            if arm.tool.force > 0.0 and arm.tool.torque > 0.0:
                modes.add(Mode.CARTESIAN_EFFORT)
        count = len(self._joints)
        lag = LONGEST_RAMP + TIME_CONSTANTS / (2.0 * math.pi * config.servo_bandwidth)
        self._capabilities = Capabilities(
            joints=self._joints,
            limits=arm.limits,
            cartesian_limits=arm.tool,
            modes=frozenset(modes),
            measured=("measured_js", "measured_cp", "measured_cv", "measured_cf"),
            has_free=arm.has_masses,
            has_gravity_compensation=arm.has_masses,
            needs_homing=config.needs_homing,
            rate=config.rate,
            base_frame=BASE_FRAME,
            tool_frame=TOOL_FRAME,
            transition_timeout=STOP_TIMEOUT + config.transition_time + 1.0,
            stop=StopPolicy(0.0, "slows down and holds; it ends with this process", STOP_TIMEOUT),
            following=Following((FURTHEST,) * count, (ARRIVAL,) * count, lag),
        )

    # ------------------------------------------------------------------------------------ description

    @property
    @override
    def capabilities(self) -> Capabilities:
        return self._capabilities

    @property
    @override
    def address(self) -> str:
        return self._config.address

    @property
    @override
    def takes_setpoints(self) -> bool:
        return self.plant.command is not HOLD or self.plant.is_held

    @property
    @override
    def is_homed(self) -> bool:
        return self._homed

    @property
    @override
    def kinematics(self) -> Kinematics:
        return self._chain

    @property
    @override
    def counters(self) -> Mapping[str, float]:
        """How long the plant has run, and what it left out because the process came too late."""
        return {"plant time (s)": self.plant.time, "time left out (s)": self._skipped}

    @property
    @override
    def inputs(self) -> Mapping[str, Input]:
        """``apply_wrench``: a hand that pushes."""
        summary = "a hand that pushes: the wrench that acts on the tool from now on, in base axes"
        return {"apply_wrench": Input(summary, Payload.WRENCH, self.apply_wrench)}

    # ------------------------------------------------------------------------------------- connection

    @override
    def open(self, deadline: float) -> None:
        if not self.reachable:
            raise ConnectionFailed(
                "no answer", where=self.address, remedy="Set `reachable` of the device again."
            )
        self._updated = self._now().monotonic

    @override
    def close(self) -> None:
        """Nothing is open."""

    @override
    def read(self, deadline: float) -> Sample | None:
        """Let the plant catch up with the clock, and say where it is."""
        if not self.reachable:
            raise ConnectionLost("the link is gone", where=self.address)
        stamp = self._now()
        self._catch_up(stamp, LONGEST_STEP)
        plant = self.plant
        return self._sample(stamp, vector(plant.position), vector(plant.velocity))

    def _catch_up(self, stamp: Stamp, longest: float) -> None:
        """Let the plant go on to a stamp, but by no more than `longest` seconds."""
        elapsed = stamp.monotonic - self._updated
        self._updated = stamp.monotonic
        self._skipped += max(0.0, elapsed - longest)
        self.plant.advance(min(elapsed, longest))

    def _sample(self, stamp: Stamp, position: Vector, velocity: Vector) -> Sample:
        """Return what is told of joints (n,) as they were measured."""
        plant = self.plant
        effort = vector(plant.effort) if self._has_masses else empty()
        twist, wrench = plant.jacobian @ velocity, plant.wrench
        return Sample(
            stamp,
            {
                "measured_js": JointState(position, velocity, effort, self._joints),
                "measured_cp": self._chain.forward(position),
                "measured_cv": Twist(vector(twist[:3]), vector(twist[3:]), BASE_FRAME),
                "measured_cf": Wrench(vector(wrench[:3]), vector(wrench[3:]), BASE_FRAME),
            },
        )

    # ----------------------------------------------------------------------------------------- motion

    @override
    def write(self, setpoint: Setpoint) -> None:
        self.plant.command = Command(_DRIVES[setpoint.mode], setpoint.values)

    @override
    def stop(self) -> None:
        self.plant.command = HOLD

    @override
    def free(self) -> Steps:
        """The weight is carried, whatever `use_gravity_compensation` said."""
        self.plant.command = FREE
        yield from ()

    @override
    def use_gravity_compensation(self, on: bool) -> None:
        """It counts for efforts and wrenches."""
        self.plant.gravity_compensation = on

    def apply_wrench(self, wrench: Wrench) -> None:
        """Push the tool as a hand does, from now on, until the next call. From any thread.

        Args:
            wrench: that acts on the tool point, in N and N·m, in base axes.

        Raises:
            CommandRefused: not finite, or in another frame.
        """
        values = wrench.vector
        if values.size != 6 or not np.isfinite(values).all():
            raise CommandRefused(
                "apply_wrench",
                Reason.NOT_FINITE,
                f"{values.tolist()} is no wrench",
                where=self.address,
                remedy="Give a force and a torque of three finite numbers each.",
            )
        if wrench.frame_id not in ("", BASE_FRAME):
            raise CommandRefused(
                "apply_wrench",
                Reason.WRONG_FRAME,
                f"it is in {wrench.frame_id!r}",
                where=self.address,
                remedy=f"Give it in {BASE_FRAME!r}, the arm's own base.",
            )
        self.plant.hand = values

    # ------------------------------------------------------------------------------------- transitions

    @override
    def enable(self) -> Steps:
        """Release the brakes and hold."""
        if self.plant.braked:
            self.plant.command = HOLD
            yield from self._transition()
            self.plant.braked = False

    @override
    def disable(self) -> Steps:
        """Wait for the arm to stand, and close the brakes."""
        self.stop()
        deadline = self._time + STOP_TIMEOUT
        while not self.plant.is_held and self._time < deadline:
            yield
        yield from self._transition()
        self.plant.braked = True

    @override
    def home(self) -> Steps:
        """Take a moment; the positions were right before."""
        yield from self._transition()
        self._homed = True

    @override
    def unhome(self) -> Steps:
        self._homed = False
        yield from ()

    def _transition(self) -> Steps:
        end = self._time + self._config.transition_time
        while self._time < end:
            yield

    @property
    def _time(self) -> float:
        return self._now().monotonic

    def _plant_of(self, arm: Arm, **given: Any) -> Plant:
        return Plant(arm, **given)


def _wall(config: WallConfig) -> Wall:
    normal = np.array(config.normal)
    return Wall(
        vector(config.point),
        vector(normal / np.linalg.norm(normal)),
        config.stiffness,
        config.damping,
    )

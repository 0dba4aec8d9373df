"""One arm of Raven: where it was led, as far as anybody knows, and what the next packet adds to that."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from crtk_driver_raven.config import RavenConfig
from crtk_driver_raven.packets import Increment
from crtk_drivers.commands import Payload
from crtk_drivers.device import (
    Capabilities,
    CartesianLimits,
    Input,
    Note,
    Setpoint,
    Severity,
    Steps,
    StopPolicy,
)
from crtk_drivers.device.capabilities import Mode
from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.geometry.quaternions import quaternion_from_rotvec, quaternion_product, unit
from crtk_drivers.geometry.rates import turn
from crtk_drivers.kit.device_behind import DeviceBehind
from crtk_drivers.samples import Number, Pose, Sample, Stamp, Vector, vector

__all__ = ["STOP", "Arm", "Robot"]

UM: Final = 1e6
"""µm of a metre."""
MRAD: Final = 1e3
AHEAD: Final = 0.1
"""Seconds at full speed that an arm may be told to go beyond where it was led."""
MOST_JAW: Final = 0.2
"""rad that one command may open or close a jaw."""
MOST_WAITING: Final = 0.8
"""Seconds of what is to be done with a jaw; while more waits nothing is added."""
ROUNDING: Final = 2.0
"""µm and mrad of a packet that may be made up later: no packet has less than a whole one."""
FRAME: Final = "itp"
HOME: Final = vector((0.0, 0.0, 0.0)), vector((0.0, 0.0, 0.0, 1.0))
STOP: Final = StopPolicy(
    5.0,
    "stands where the last packet led it, which nobody reads back; its pedal goes up 5 s after that packet",
)


class Robot(Protocol):
    """What an arm needs of the robot that it belongs to."""

    is_lost: bool
    engaged: bool

    @property
    def address(self) -> str:
        """Where it is."""


class Arm(DeviceBehind):
    """One arm, led by increments. Its pose is what it was led by since it was connected: nothing comes back.

    Args:
        robot: that it belongs to.
        name: gold or green.
        config: of the robot.
    """

    def __init__(self, robot: Robot, name: str, config: RavenConfig) -> None:
        tool = config.tool
        self._robot = robot
        self._speed, self._turning = tool.linear_velocity, tool.angular_velocity
        self._jaw_speed = config.jaw_velocity
        self._led, self._led_turn = np.zeros(3, dtype=np.int64), HOME[1]
        """Where the packets so far have led it: µm, and a quaternion."""
        self._follows = False
        self._goal: tuple[Vector, Vector] | None = None
        """Where it is to be led: m, and a quaternion; None: nowhere."""
        self._closings: deque[int] = deque()
        """What is to be done with the jaw, in mrad, command by command."""
        self._may_go = self._may_close = 0.0
        """µm and mrad that the packets before could have led by, and did not, since they go in whole ones."""
        capabilities = Capabilities(
            modes=frozenset({Mode.CARTESIAN_POSITION}),
            measured=(),
            cartesian_limits=CartesianLimits(
                tool.linear_velocity,
                tool.angular_velocity,
                tool.linear_acceleration,
                tool.angular_acceleration,
            ),
            rate=float(config.rate),
            base_frame=FRAME,
            tool_frame=f"{name}_tool",
            stop=STOP,
        )
        super().__init__(robot, name, capabilities, "the robot")

    @property
    @override
    def is_linked(self) -> bool:
        return not self._robot.is_lost

    @override
    def read(self, deadline: float) -> Sample | None:
        """Return where it was led, which is no measurement."""
        self.check_link()
        led = Pose(vector(self._led / UM), self._led_turn, FRAME)
        return Sample(Stamp.now(), {"setpoint_cp": led})

    @override
    def write(self, setpoint: Setpoint) -> None:
        """Take where it is to be led.

        Raises:
            CommandRefused: the pedal was moved; or it is further than it gets at full speed in `AHEAD`, since
                it must stand when commands stop.
        """
        self._check_pedal("setpoint")
        position, orientation = vector(setpoint.values[:3]), vector(setpoint.values[3:])
        way = math.dist(position, self._led / UM)
        angle = math.hypot(*turn(orientation, self._led_turn))
        if not (way <= AHEAD * self._speed and angle <= AHEAD * self._turning):
            raise CommandRefused(
                "setpoint",
                Reason.STEP_TOO_LARGE,
                f"it would be {way:.4f} m and {angle:.4f} rad ahead of where it was led; it goes "
                f"{self._speed:g} m/s and {self._turning:g} rad/s",
                where=self.address,
                remedy="Start from setpoint_cp and stream more slowly, or use interpolate_cp.",
            )
        self._goal = position, orientation

    @override
    def stop(self) -> None:
        """Let no further packet lead it anywhere: what it was not led by yet is forgotten."""
        self._goal = None
        self._closings.clear()

    @override
    def enable(self) -> Steps:
        """Be led from now on, until the pedal is moved."""
        self._follows = True
        yield from ()

    def pedal_moved(self) -> None:
        """Be led no further by what was asked for before: this arm hears of that a moment later."""
        self._follows = False
        self.stop()

    def begin_anew(self) -> None:
        """Count from where it is now."""
        self._led, self._led_turn = np.zeros(3, dtype=np.int64), HOME[1]
        self.pedal_moved()

    def step(self, seconds: float) -> Increment:
        """Return what the next packet leads it by: towards its goal, no faster than it may go.

        Args:
            seconds: since the packet before.
        """
        closing = self._close_by(seconds)
        goal = self._goal
        if goal is None:
            return Increment(closing=closing)
        position, orientation = goal
        moved = self._go_by(UM * position - self._led, UM * self._speed * seconds)
        about = turn(orientation, self._led_turn)
        angle = math.hypot(*about)
        share = min(1.0, self._turning * seconds / angle) if angle > 0.0 else 0.0
        turned = quaternion_from_rotvec(vector(about * share))
        self._led = self._led + moved
        self._led_turn = unit(quaternion_product(turned, self._led_turn))
        x, y, z = moved.tolist()
        a, b, c, w = turned.tolist()
        return Increment((x, y, z), (a, b, c, w), closing)

    def _go_by(self, way: Vector, most: float) -> NDArray[np.int64]:
        """Return what part of a way (3,) in µm is gone now: whole µm, no more than the speed allows."""
        length, most = math.hypot(*way), self._may_go + most
        if length <= most:
            self._may_go = 0.0
            return np.rint(way).astype(np.int64)
        moved = np.trunc(way * most / length).astype(np.int64)
        self._may_go = min(most - math.hypot(*moved), ROUNDING)
        return moved

    def _close_by(self, seconds: float) -> int:
        """Return by how many whole mrad the jaw is closed now."""
        closings = self._closings
        most = self._may_close + MRAD * self._jaw_speed * seconds
        part = 0
        with suppress(IndexError):  # none is left, or they were forgotten just now
            whole = int(min(most, MOST_JAW * MRAD))
            part = max(-whole, min(whole, closings[0]))
            if part == closings[0]:
                closings.popleft()
            else:
                closings[0] -= part
        self._may_close = min(most - abs(part), ROUNDING) if closings else 0.0
        return part

    def _check_pedal(self, command: str) -> None:
        if not (self._follows and self._robot.engaged):
            raise CommandRefused(
                command,
                Reason.NOT_ENABLED,
                "the pedal is up, or was",
                where=self.address,
                remedy="Send enable, and wait for this arm to be ENABLED.",
            )

    @property
    @override
    def inputs(self) -> Mapping[str, Input]:
        summary = f"open the jaw by so many rad, or close it (below 0); up to {MOST_JAW} at a time"
        return {"jaw_increment": Input(summary, Payload.NUMBER, self._take_jaw)}

    def _take_jaw(self, value: Any) -> None:
        assert isinstance(value, Number)
        opening = float(value.value)
        self._check_pedal("jaw_increment")
        if not abs(opening) <= MOST_JAW:
            raise CommandRefused(
                "jaw_increment",
                Reason.OUT_OF_RANGE if math.isfinite(opening) else Reason.NOT_FINITE,
                f"{opening} rad at once",
                where=self.address,
                remedy=f"Send up to {MOST_JAW} rad at a time.",
            )
        if sum(map(abs, tuple(self._closings))) > MRAD * self._jaw_speed * MOST_WAITING:
            raise CommandRefused(
                "jaw_increment",
                Reason.STEP_TOO_LARGE,
                "the jaw has not done what it was told before",
                where=self.address,
                remedy="Send less at a time: jaw_velocity says how fast it is.",
            )
        if closing := round(-MRAD * opening):
            self._closings.append(closing)

    @property
    @override
    def notes(self) -> tuple[Note, ...]:
        text = "nothing comes back: setpoint_cp is where it was led, not where it is"
        return (Note(Severity.WARNING, "one way", text),)

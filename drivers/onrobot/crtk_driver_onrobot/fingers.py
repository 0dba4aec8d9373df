"""An OnRobot gripper with fingers by its registers: one joint, the opening between the fingertips."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Final, NamedTuple

from typing_extensions import override

from crtk_driver_onrobot.config import OnRobotConfig
from crtk_driver_onrobot.device import Talk
from crtk_driver_onrobot.grip import Grip
from crtk_driver_onrobot.models import Fingers
from crtk_driver_onrobot.registers import Command, Status, order, stop_order
from crtk_drivers.commands import Payload
from crtk_drivers.device import Capabilities, JointLimits, Mode, Reading, StopPolicy
from crtk_drivers.errors import CommandRefused, ConnectionFailed, DeviceError, Reason
from crtk_drivers.kit.gripping import Adjustable, Doing, Fault, Hand, HandService, Measured
from crtk_drivers.samples import Numbers, Value

__all__ = ["FingerHand"]

SETTLING: Final = 0.1
"""Time constant of the velocity in s: the opening has steps of 0.1 mm."""
STEP: Final = 1e-4
BUSY: Final = 0x01
GRIPS: Final = 0x02
STANDS: Final = 3.0
"""Seconds in which fingers stand that were told to stop."""
_OBEYS: Final = frozenset({Doing.MOVING, Doing.THERE, Doing.HOLDS})
"""In which it does what it was asked for last."""


class Goal(NamedTuple):
    """Where the fingers are sent: steps of the opening, force in N, share of the speed."""

    steps: int
    force: float
    speed: float


class FingerHand(Hand):
    """One gripper."""

    def __init__(self, config: OnRobotConfig) -> None:
        assert isinstance(config.tool, Fingers)
        self._config = config
        self._tool = config.tool
        self._talk = Talk(config)
        self._grip = Grip(lambda: stop_order(self._tool), inside=config.grip == "inside")
        least, most = config.data.force
        text = f"force of the next motions in N, {least:g} to {most:g}"
        self._force = Adjustable(
            "force", text, config.force or least, lambda: config.data.force, "N"
        )
        model = config.data
        limits = JointLimits(
            lower=0.0,
            upper=model.upper,
            velocity=model.speed * config.speed,
            acceleration=20.0 * model.speed,
            jerk=1000.0 * model.speed,
            effort=0.0,
        )
        self.capabilities = Capabilities(
            model=model.title,
            joints=(config.joint,),
            joint_units=("m",),
            limits=(limits,),
            modes=frozenset({Mode.JOINT_POSITION}),
            native_moves=frozenset({"move_jp"}),
            rate=config.rate,
            transition_timeout=2.0 * STANDS,
            stop=StopPolicy(STANDS, "goes on to where it was sent last; keeps its grip"),
            velocity_resolution=(STEP / SETTLING,),
        )

    @property
    @override
    def where(self) -> str:
        return self._talk.where

    @property
    @override
    def counters(self) -> Mapping[str, float]:
        return {**self._talk.counters, "ignored": self._grip.ignored}

    # ------------------------------------------------------------------------------------- the link

    @property
    @override
    def is_open(self) -> bool:
        return self._talk.status is not None

    @override
    def open(self, deadline: float, given_up: Callable[[], bool]) -> None:
        self._grip.begin()
        status = self._talk.open(deadline, given_up)
        try:
            self._see(status, time.monotonic())
        except DeviceError:
            self._talk.close()
            raise

    @override
    def close(self, *, moves: bool) -> None:
        self._talk.close()

    @override
    def exchange(self, deadline: float) -> Measured | None:
        command = self._grip.next
        answer = self._talk.exchange(command, deadline)
        delivered = None if answer is None else answer.delivered
        if command is not None and delivered is not command:
            self._grip.tried(command)
        if delivered is not None:
            self._grip.delivered(delivered, time.monotonic())
        if answer is None:
            return None
        self._see(answer.status, answer.stamp.monotonic)
        opening, effort = answer.status.value(self._tool.opening), self._tool.effort
        told = None if effort is None else answer.status.value(effort)
        return Measured(answer.stamp, opening, effort=told)

    def _see(self, status: Status, now: float) -> None:
        """Take a status that was asked for at `now`: it may be read late.

        Raises:
            ConnectionFailed: fingertips are set in the gripper with which its fingers have no way to go.
        """
        self._check_range()
        flags = status.words[self._tool.flags]
        opening = status.value(self._tool.opening)
        busy, grips = bool(flags & BUSY), bool(flags & GRIPS)
        self._grip.see(opening, now, busy=busy, grips=grips)

    # ---------------------------------------------------------------------------------- what moves it

    @property
    def _range(self) -> tuple[float, float]:
        """Between which openings the fingers go that are mounted now, in m, as the gripper tells it."""
        status, tool = self._talk.status, self._tool
        upper = self._config.data.upper
        if status is None:
            return 0.0, upper
        if tool.range is not None:
            return status.value(tool.range[0]), status.value(tool.range[1])
        assert tool.offset is not None
        return 0.0, upper - 2.0 * status.value(tool.offset)

    def _check_range(self) -> None:
        lower, upper = self._range
        if lower < upper and upper > 0.0:
            return
        status, offset = self._talk.status, self._tool.offset
        if status is not None and offset is not None:
            what = (
                f"its fingertips are set to be {1e3 * status.value(offset):.1f} mm thick each, and its "
                f"fingers go {1e3 * self._config.data.upper:.0f} mm: nothing is left"
            )
        else:
            what = f"it tells that its fingers go from {1e3 * lower:.1f} to {1e3 * upper:.1f} mm"
        raise ConnectionFailed(
            what,
            where=self._talk.where,
            remedy="Set its fingers anew (web client of the Compute Box, or OnRobot's URCap).",
        )

    @override
    def check(self, command: str, value: float) -> None:
        lower, upper = self._range
        if not lower - STEP <= value <= upper + STEP:
            raise CommandRefused(
                command,
                Reason.OUT_OF_RANGE,
                f"an opening of {value:.4f} m, where its fingers go from {lower:.4f} to {upper:.4f} m",
                where=self._talk.where,
                remedy="Stay within that; other fingers or mountings have another range.",
            )

    @override
    def order(self, mode: Mode, value: float, ratio: float) -> Goal:
        lower, upper = self._range
        opening = min(max(value, lower), upper)
        return Goal(round(opening / STEP), self._force.value, ratio * self._config.speed)

    @override
    def go(self, order: Goal, *, at_once: bool) -> None:
        self._grip.go(self._command(order), time.monotonic(), at_once=at_once)

    def _command(self, goal: Goal) -> Command:
        return order(self._tool, goal.steps * STEP, goal.force, goal.speed)

    @override
    def halt(self, *, aside: bool) -> None:
        halt = self._grip.stop(time.monotonic())
        if halt is not None and aside:
            self._talk.shout(halt)

    @override
    def let_go(self) -> None:
        closed, opened = self._range
        opening = closed if self._config.grip == "inside" else opened
        self.go(self.order(Mode.JOINT_POSITION, opening, 1.0), at_once=True)

    @property
    @override
    def is_told(self) -> bool:
        return self._grip.is_told

    @property
    @override
    def rests(self) -> bool:
        return self._grip.rests

    @property
    @override
    def doing(self) -> Doing:
        return self._grip.doing

    @property
    @override
    def disobeys(self) -> bool:
        return bool(self._grip.refused) or self.doing not in _OBEYS

    @property
    @override
    def refusal(self) -> str:
        return self._grip.refused

    # --------------------------------------------------------------------------------------- its state

    @property
    @override
    def fault(self) -> Fault | None:
        status = self._talk.status
        if status is None:
            return None
        flags = status.words[self._tool.flags]
        found = (bit.fault for bit in self._tool.faults if bool(flags & bit.mask) is bit.when)
        return next(found, None)

    @property
    @override
    def taken_over(self) -> bool:
        return self._grip.taken_over

    @override
    def adopt(self) -> None:
        self._grip.adopt()

    # ------------------------------------------------------------------------------------ beyond CRTK

    @property
    @override
    def services(self) -> Mapping[str, HandService]:
        return self._talk.services(empty=False)

    @property
    @override
    def adjustables(self) -> tuple[Adjustable, ...]:
        return (self._force,)

    @property
    @override
    def readings(self) -> Mapping[str, Reading]:
        text = "least and greatest opening, in m"
        return {
            "range": Reading(text, Payload.NUMBERS, self._tell_range),
            "tool": Reading("which one is there", Payload.TEXT, self._talk.tell_tool),
        }

    def _tell_range(self) -> Value | None:
        return None if self._talk.status is None else Numbers(self._range)

"""What is sent to the drives step by step: faults cleared, states set and read back, axes homed."""

from __future__ import annotations

import time
from collections.abc import Generator, Iterable, Sequence
from typing import Final

from crtk_driver_copley.axis import Axis
from crtk_driver_copley.codec import Reply, get, home, put
from crtk_driver_copley.config import HomingConfig
from crtk_driver_copley.line import Exchange, Line
from crtk_driver_copley.tables import (
    ACCELERATION_UNIT,
    HOMING,
    LIMITS,
    VELOCITY_UNIT,
    Parameter,
    Trajectory,
    fault_texts,
)
from crtk_driver_copley.tracking import refusal
from crtk_drivers.device import Steps
from crtk_drivers.errors import DeviceError, DeviceFault, TransitionFailed
from crtk_drivers.kit.axes import Complaint

__all__ = ["Procedures"]

BEGINS: Final = 0.5
"""Seconds in which a drive tells that it homes."""


class Procedures:
    """Procedures of all axes.

    Args:
        line, axes: of the arm.
    """

    def __init__(self, line: Line, axes: Sequence[Axis]) -> None:
        self._line = line
        self._axes = axes
        self._begin: list[Exchange] = []  # commands by which something moves

    def take_back(self) -> None:
        """Let nothing move by what was not sent yet."""
        self._line.withdraw(self._begin)

    def do(
        self, commands: Iterable[str], *, once: bool = False
    ) -> Generator[None, None, list[Reply]]:
        """Send commands, wait for all answers, and raise what was refused.

        Args:
            commands: of them.
            once: something moves by them, and none must be carried out twice.
        """
        asked = list(commands)
        answers: list[Reply | None] = []
        sent = [self._line.ask(command, answers.append, once=once) for command in asked]
        if once:
            self._begin = sent
        try:
            while len(answers) < len(asked):
                yield
        finally:
            self._line.withdraw(sent)  # a procedure that is cancelled does not go on
        for command, reply in zip(asked, answers, strict=True):
            if reply is None:
                raise DeviceError(
                    f"no answer to {command!r}, which may have been taken", where=self._line.where
                )
            if reply.error:
                raise DeviceError(refusal(command, reply.error), where=self._line.where)
        return [reply for reply in answers if reply is not None]

    def clear_faults(self) -> Steps:
        """Clear what is latched; `enable` is the only one that may."""
        told = yield from self.do([get(axis.to, Parameter.FAULTS) for axis in self._axes])
        latched = [(axis, reply.values[0]) for axis, reply in zip(self._axes, told, strict=True)]
        found = [(axis, bits) for axis, bits in latched if bits]
        yield from self.do([put(axis.to, Parameter.FAULTS, bits) for axis, bits in found])
        left = yield from self.do([get(axis.to, Parameter.FAULTS) for axis, _ in found])
        words = [
            f"{axis.name}: {meaning.text}. {meaning.remedy}"
            for (axis, _), reply in zip(found, left, strict=True)
            for meaning in fault_texts(reply.values[0])
        ]
        if words:
            raise DeviceFault(
                f"a fault could not be cleared: {' '.join(words)}", where=self._line.where
            )
        for axis in self._axes:
            axis.latched = 0

    def set_state(self, state: int) -> Steps:
        """Set the desired state of all axes, and believe it when it is read back."""
        yield from self.do([put(axis.to, Parameter.DESIRED_STATE, state) for axis in self._axes])
        told = yield from self.do([get(axis.to, Parameter.DESIRED_STATE) for axis in self._axes])
        wrong = [
            f"{axis.name} tells {reply.text!r}"
            for axis, reply in zip(self._axes, told, strict=True)
            if reply.values != (state,)
        ]
        if wrong:
            raise TransitionFailed(
                f"the desired state (0x24) was set to {state}: {', '.join(wrong)}",
                where=self._line.where,
                remedy="Does another program talk to the drive?",
            )

    def home(self, axis: Axis) -> Generator[None, None, Complaint | None]:
        """Home an axis, and return why it was not."""
        homing = axis.joint.homing
        assert homing is not None
        if homing.method != "drive":
            yield from self._set_homing(axis, homing)
        # Homed before, it tells so until it begins anew; only a method without a motion is over at once.
        method = (yield from self.do([get(axis.to, Parameter.HOME_METHOD)]))[0].values[0]
        proven = method == HOMING["here"] or not axis.trajectory & Trajectory.REFERENCED
        begun = False
        axis.homing = True
        try:
            yield from self.do([home(axis.to)], once=True)
            told = yield from self._told(axis)
            sent = time.monotonic()
            while (going := told & (Trajectory.HOMING | Trajectory.RUNNING)) or not (
                begun or proven
            ):
                begun = begun or bool(going)
                if time.monotonic() > sent + (homing.timeout if begun else BEGINS):
                    break
                yield
                told = yield from self._told(axis)
        finally:
            axis.judged()  # a switch at which it stands is not news
            axis.homing = False
        is_homed = told & Trajectory.REFERENCED and (begun or proven)
        if is_homed and not told & (Trajectory.HOME_ERROR | Trajectory.HOMING):
            return None
        why = "it tells a homing error" if told & Trajectory.HOME_ERROR else "it found nothing"
        if told & Trajectory.HOMING:
            why = f"it is not done after {homing.timeout:g} s"
        elif not begun:
            why = "it did not begin"
        at = [meaning.text for bit, meaning in LIMITS.items() if axis.status & bit]
        return Complaint(
            f"{why}{''.join(f', at its {text}' for text in at)}",
            "Check its switches, the method and its direction.",
        )

    def _set_homing(self, axis: Axis, homing: HomingConfig) -> Steps:
        counts = axis.joint.counts
        values = {
            Parameter.HOME_METHOD: HOMING[homing.method],
            Parameter.HOME_FAST: round(homing.speed * counts / VELOCITY_UNIT),
            Parameter.HOME_SLOW: round(homing.slow * counts / VELOCITY_UNIT),
            Parameter.HOME_ACCELERATION: round(
                axis.joint.acceleration * counts / ACCELERATION_UNIT
            ),
            Parameter.HOME_OFFSET: 0,
        }
        yield from self.do([put(axis.to, key, max(0, value)) for key, value in values.items()])

    def _told(self, axis: Axis) -> Generator[None, None, Trajectory]:
        reply = (yield from self.do([get(axis.to, Parameter.TRAJECTORY)]))[0]
        return axis.take_trajectory(reply.values[0])

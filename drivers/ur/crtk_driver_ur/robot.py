"""The robot's power and safety: what the controller says last, and the procedures that change it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from crtk_driver_ur.control_link import ControlLink
from crtk_driver_ur.rtde.state_sample import StateSample
from crtk_driver_ur.safety import (
    PAUSED_PROGRAM,
    STILL,
    RobotMode,
    RuntimeState,
    SafetyMode,
    condition_of,
)
from crtk_drivers.device import Condition, Steps
from crtk_drivers.errors import CommandRefused, CrtkError, DeviceFault, Reason, raise_first
from crtk_drivers.state import OperatingState

__all__ = ["Robot"]

UNLOCK_AFTER = 5.1
"""Seconds on the controller's clock that a protective stop lasts before it is unlocked: the controller
refuses before 5 s (Dashboard Server manual)."""

WAITING = frozenset({RobotMode.CONFIRM_SAFETY, RobotMode.UPDATING_FIRMWARE})
"""Robot modes in which the arm takes no power before somebody has done something."""

POWER_BEGINS = 10.0
"""Seconds in which an arm that was told to come up shows another robot mode."""


class Robot:
    """Everything belongs to the I/O thread, but `state` may be read from any.

    Args:
        link: for the dashboard.
        where: the device, for messages.
        needs_remote: whether the controller must be in remote control.

    Attributes:
        state: the newest; None before the first.
        is_claimed: control is being taken, and nobody else may change the power.
    """

    def __init__(self, link: ControlLink, where: str, *, needs_remote: bool) -> None:
        self.state: StateSample | None = None
        self.is_claimed = False
        self._link = link
        self._where = where
        self._needs_remote = needs_remote
        self._stopped_at = -math.inf
        self._is_powered_on = False  # it was asked to be, and does not show it yet

    def take(self, state: StateSample) -> None:
        """Take note of a new state."""
        before, self.state = self.state, state
        if state.safety_mode == SafetyMode.PROTECTIVE_STOP and (
            before is None or before.safety_mode != SafetyMode.PROTECTIVE_STOP
        ):
            self._stopped_at = state.timestamp
        self._is_powered_on = self._is_powered_on and state.robot_mode <= RobotMode.POWER_OFF

    @property
    def condition(self) -> Condition:
        """The best operating state that the controller allows."""
        state = self.state
        if state is None:
            return Condition()
        return condition_of(
            state.robot_mode,
            state.safety_mode,
            state.runtime_state,
            state.robot_status_bits,
            self._link.remote if self._needs_remote else None,
        )

    @property
    def mode(self) -> int:
        """One of `RobotMode`, if this driver knows it."""
        return RobotMode.NO_CONTROLLER if self.state is None else self.state.robot_mode

    @property
    def has_power(self) -> bool:
        """Whether the arm has power, or is about to have it."""
        return self._is_powered_on or self.mode > RobotMode.POWER_OFF

    @property
    def safety(self) -> int:
        """One of `SafetyMode`, if this driver knows it."""
        return SafetyMode.UNDEFINED if self.state is None else self.state.safety_mode

    @property
    def playing(self) -> bool:
        """Whether a program runs."""
        return self.state is not None and self.state.runtime_state == RuntimeState.PLAYING

    @property
    def paused(self) -> bool:
        """Whether a program is paused, or about to be."""
        return self.state is not None and self.state.runtime_state in PAUSED_PROGRAM

    @property
    def standing(self) -> bool:
        """Whether the controller wants the arm to stand."""
        return self.state is None or max(map(abs, self.state.target_qd)) < STILL

    # Procedures

    @contextmanager
    def claimed(self) -> Iterator[None]:
        """Keep the services from changing the power meanwhile."""
        self.is_claimed = True
        try:
            yield
        finally:
            self.is_claimed = False

    def until(
        self, test: Callable[[], bool], timeout: float = math.inf, *, safe: bool = False
    ) -> Steps:
        """Wait for `test`, at most `timeout` seconds; with `safe`, fail when a stop comes in between."""
        deadline = time.monotonic() + timeout
        while not test() and time.monotonic() < deadline:
            if safe:
                self.require_safe()
            yield

    def require_safe(self) -> None:
        """Raise DeviceFault while something must be attended to."""
        raise_first(self._unsafe())

    def _unsafe(self) -> Iterator[DeviceFault]:
        found = self.condition
        if found.allows is OperatingState.FAULT:
            yield DeviceFault(found.reason, where=self._where)

    def obstacles(self, command: str, *, unlocks: bool = False) -> Iterator[CrtkError]:
        """Yield why `command` cannot have control: a stop, a question at the pendant, somebody who has it.

        Args:
            command: for the messages.
            unlocks: it unlocks a protective stop.
        """
        if not (unlocks and self.safety == SafetyMode.PROTECTIVE_STOP):
            yield from self._unsafe()
        if self._needs_remote and self._link.remote is False:
            yield self._local_control("state_command", f"{command}: ")
            return
        found = self.condition
        if self.mode in WAITING:
            yield DeviceFault(found.reason, where=self._where)
        if found.allows is OperatingState.PAUSED:
            yield CommandRefused(
                "state_command",
                Reason.LOCAL_CONTROL,
                f"{command}: {found.reason}",
                where=self._where,
            )

    def require_hands_off(self, command: str) -> None:
        """Refuse `command` while our control program runs or is about to. From any thread."""
        if self.is_claimed or self._link.program_runs:
            raise CommandRefused(
                command,
                Reason.INVALID_TRANSITION,
                "the driver has control of the arm, or is taking it",
                where=self._where,
                remedy="Send disable first (with power_off_on_disable: false the arm keeps its power).",
            )

    def require_remote(self, command: str, detail: str = "") -> Steps:
        """Refuse `command` while the teach pendant has control; `detail` comes before the reason."""
        if not (self._needs_remote and self._link.has_local_control):
            return
        remote = yield from self._link.ask("is_in_remote_control")
        self._link.control_is(bool(remote))
        if not remote:
            raise self._local_control(command, detail)

    def _local_control(self, command: str, detail: str) -> CommandRefused:
        return CommandRefused(
            command,
            Reason.LOCAL_CONTROL,
            f"{detail}the teach pendant has control",
            where=self._where,
            remedy="Switch it to remote control (top right corner), then send it again; a controller "
            "that obeys without (UR's simulator) needs require_remote_control: false.",
        )

    def unlock(self) -> Steps:
        """Leave a protective stop, not before the controller allows it; nothing if there is none."""
        if self.safety != SafetyMode.PROTECTIVE_STOP:
            return
        yield from self.until(
            lambda: (
                self.state is not None and self.state.timestamp > self._stopped_at + UNLOCK_AFTER
            )
        )
        yield from self._link.ask("close_safety_popup")
        yield from self._link.ask("unlock_protective_stop")
        yield from self.until(lambda: self.safety != SafetyMode.PROTECTIVE_STOP)

    def power_on(self) -> Steps:
        """Power the arm; its brakes stay engaged. Nothing if it has power."""
        if self.mode < RobotMode.IDLE:
            self._is_powered_on = True  # also where nobody waits any more for the answer
            try:
                yield from self._link.ask("power_on")
            except CrtkError:
                self._is_powered_on = False
                raise
            yield from self._come_up(RobotMode.IDLE)

    def release_brakes(self) -> Steps:
        """Power the arm and release its brakes. Nothing if that is so."""
        yield from self.power_on()
        if self.mode != RobotMode.RUNNING:
            yield from self._link.ask("brake_release")
            yield from self._come_up(RobotMode.RUNNING)

    def _come_up(self, goal: RobotMode) -> Steps:
        """Wait for `goal`; fail when a stop comes in between, the power goes, or never begins to come."""
        begins, has_begun = self.mode, False
        deadline = time.monotonic() + POWER_BEGINS
        while self.mode < goal:
            self.require_safe()
            has_begun = has_begun or self.mode != begins
            if has_begun and self.mode == RobotMode.POWER_OFF:
                raise self._powerless("lost its power while it came up")
            if not has_begun and time.monotonic() > deadline:
                raise self._powerless(f"did not begin to come up within {POWER_BEGINS:g} s")
            yield

    def _powerless(self, what: str) -> DeviceFault:
        return DeviceFault(
            f"the arm {what}",
            where=self._where,
            remedy="Look at the message on the teach pendant, then enable again.",
        )

    def power_off(self) -> Steps:
        """Switch the arm's power off. Nothing if it has none."""
        if self.has_power:
            self._is_powered_on = False
            yield from self._link.ask("power_off")
            yield from self.until(lambda: self.mode <= RobotMode.POWER_OFF)

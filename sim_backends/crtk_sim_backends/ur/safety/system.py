"""The safety system: what stops the robot, who may end it, and the safety mode that shows."""

from __future__ import annotations

from typing import Final

from crtk_sim_backends.ur.safety.modes import (
    POWER_OFF_SECONDS,
    PROTECTIVE_STOP_LOCK_SECONDS,
    SAFETY_RULES,
    SafetyMode,
    SafetyRule,
    gravest,
)

OPERATIONAL_MODES: Final = ("NONE", "MANUAL", "AUTOMATIC")

_NEEDS_RESTART: Final = (SafetyMode.VIOLATION, SafetyMode.FAULT, SafetyMode.PROTECTIVE_STOP)


class SafetySystem:
    """All causes of a stop that hold now. The safety mode is that of the gravest.

    Args:
        lock_seconds: time for which a protective stop cannot be unlocked.

    Attributes:
        operational_mode: what remote clients control: "NONE" (nothing), "MANUAL" or "AUTOMATIC".
        manual: whether the robot is in manual mode, in which it stays when they give control back.
    """

    def __init__(self, lock_seconds: float = PROTECTIVE_STOP_LOCK_SECONDS) -> None:
        self.operational_mode = "NONE"
        self.manual = False
        self._lock_seconds = lock_seconds
        self._causes: set[SafetyMode] = set()
        self._protective_stop_time = 0.0
        self._pressed: set[SafetyMode] = set()  # emergency stop buttons
        self._emergency_end = 0.0
        self._automatic = False
        self._device_held = True  # the three-position enabling device, or none is connected
        self._automatic_safeguard_open = False

    @property
    def mode(self) -> SafetyMode:
        """Safety mode that shows."""
        return gravest(self._causes)

    @property
    def rule(self) -> SafetyRule:
        """What it means for program, power and speed."""
        return SAFETY_RULES[self.mode]

    @property
    def stopped_protectively(self) -> bool:
        """Whether a protective stop holds, whatever shows."""
        return SafetyMode.PROTECTIVE_STOP in self._causes

    def set(self, cause: SafetyMode, on: bool) -> None:
        """Let a cause begin or end."""
        if on:
            self._causes.add(cause)
        else:
            self._causes.discard(cause)

    def set_operational_mode(self, mode: str) -> None:
        """Change between manual and automatic mode, in each of which other devices count.

        "NONE" gives the choice back to the pendant, and leaves the robot in the mode that it is in.
        """
        self.operational_mode = mode
        self._automatic = mode == "AUTOMATIC" or (self._automatic and mode == "NONE")
        self.manual = mode == "MANUAL" or (self.manual and mode == "NONE")
        self._check_devices()

    def hold_enabling_device(self, held: bool) -> None:
        """Hold the three-position enabling device in its middle, or let go of it."""
        self._device_held = held
        self._check_devices()

    def open_automatic_safeguard(self, is_open: bool) -> None:
        """Open or close the safeguard that counts in automatic mode alone."""
        self._automatic_safeguard_open = is_open
        self._check_devices()

    def _check_devices(self) -> None:
        self.set(
            SafetyMode.SYSTEM_THREE_POSITION_ENABLING_STOP, self.manual and not self._device_held
        )
        self.set(
            SafetyMode.AUTOMATIC_MODE_SAFEGUARD_STOP,
            self._automatic and self._automatic_safeguard_open,
        )

    def stop_protectively(self, time: float) -> None:
        """Begin a protective stop; its lock counts from now."""
        self._protective_stop_time = time
        self._causes.add(SafetyMode.PROTECTIVE_STOP)

    def unlock_protective_stop(self, time: float, *, at_once: bool = False) -> bool:
        """End it; False while it is locked, but for `at_once`."""
        locked = time - self._protective_stop_time < self._lock_seconds
        if locked and not at_once:
            return False
        self._causes.discard(SafetyMode.PROTECTIVE_STOP)
        return True

    def press_emergency_stop(self, button: SafetyMode, time: float) -> None:
        """Press the button of the robot or of the system: a stop of category 1."""
        self._pressed.add(button)
        self._emergency_end = time + POWER_OFF_SECONDS
        self._causes.add(button)

    def release_emergency_stop(self, button: SafetyMode) -> None:
        """Pull it out again. A stop that has begun is completed before the mode changes."""
        self._pressed.discard(button)

    def settle(self, time: float, *, powered: bool) -> bool:
        """End the emergency stops that are complete and released; whether there was one."""
        released = (
            {SafetyMode.ROBOT_EMERGENCY_STOP, SafetyMode.SYSTEM_EMERGENCY_STOP} - self._pressed
        ) & self._causes
        if not released or powered or time < self._emergency_end:
            return False
        self._causes -= released
        return True

    def restart(self) -> None:
        """Forget violations, faults and protective stops."""
        self._causes.difference_update(_NEEDS_RESTART)

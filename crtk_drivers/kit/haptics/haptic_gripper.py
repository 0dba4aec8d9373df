"""The gripper of a haptic device: an angle, and a force where it has a motor."""

from __future__ import annotations

from typing import Final, Protocol

from typing_extensions import override

from crtk_drivers.device import Capabilities, JointLimits, Mode, Setpoint
from crtk_drivers.kit.device_behind import DeviceBehind, Unit
from crtk_drivers.kit.haptics.traits import Traits
from crtk_drivers.samples import Sample

__all__ = ["GRIPPER", "HapticGripper"]

GRIPPER: Final = "gripper"


class Front(Unit, Protocol):
    """What a gripper needs of the device that it is part of."""

    is_open: bool

    @property
    def gripper_sample(self) -> Sample | None:
        """See `HapticDevice`."""

    def hear(self, deadline: float) -> bool:
        """See `HapticDevice`."""

    def grip(self, force: float) -> int:
        """See `HapticDevice`."""

    def has_taken(self, number: int) -> bool:
        """See `HapticDevice`."""

    def end_process(self) -> None:
        """See `HapticDevice`."""


class HapticGripper(DeviceBehind):
    """One gripper.

    Args:
        front: the device.
        traits: of that.
    """

    def __init__(self, front: Front, traits: Traits) -> None:
        self._front = front
        self._told = 0.0
        self._stopped = 0
        self.is_open = False
        lower, upper = traits.gripper_range
        limit = JointLimits(
            lower=lower,
            upper=upper,
            velocity=50.0,
            acceleration=1000.0,
            jerk=10_000.0,
            effort=traits.grip,
        )
        capabilities = Capabilities(
            joints=(GRIPPER,),
            joint_units=("rad",),
            limits=(limit,),
            modes=frozenset({Mode.JOINT_EFFORT}) if traits.grip else frozenset(),
            rate=traits.rate,
            stop=traits.stop,
        )
        super().__init__(front, GRIPPER, capabilities, "the device", "It follows its device.")

    @property
    @override
    def is_linked(self) -> bool:
        return self._front.is_open

    @override
    def open(self, deadline: float) -> None:
        super().open(deadline)
        self.is_open = True

    @override
    def close(self) -> None:
        self.is_open = False
        self._front.end_process()

    @override
    def read(self, deadline: float) -> Sample | None:
        if not self._front.is_open:  # that was closed before, or lost
            self._front.hear(deadline)
        found = self._front.gripper_sample
        if found is None or found.stamp.monotonic == self._told:
            return None
        self._told = found.stamp.monotonic
        return found

    @override
    def write(self, setpoint: Setpoint) -> None:
        self._front.grip(float(setpoint.values[0]))

    @override
    def stop(self) -> None:
        if self._capabilities.modes:
            self._stopped = self._front.grip(0.0)

    @property
    @override
    def has_stopped(self) -> bool:
        return self._front.has_taken(self._stopped)

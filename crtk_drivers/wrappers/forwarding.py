"""A device around another one, which passes everything on: the base of what adds to a device from outside."""

# ruff: noqa: D102 - what is passed on is documented in Device

from __future__ import annotations

from collections.abc import Mapping

from crtk_drivers.device import (
    Capabilities,
    Condition,
    Device,
    Goal,
    Input,
    MoveProgress,
    Note,
    Reading,
    Service,
    Setpoint,
    Steps,
)
from crtk_drivers.samples import Array, Pose, Sample, Vector


class WrappedDevice(Device):
    """Passes every call on to `inner`. A subclass overrides what it changes."""

    def __init__(self, inner: Device) -> None:
        self.inner = inner

    @property
    def capabilities(self) -> Capabilities:
        return self.inner.capabilities

    @property
    def address(self) -> str:
        return self.inner.address

    @property
    def bus(self) -> str:
        return self.inner.bus

    @property
    def takes_setpoints(self) -> bool:
        return self.inner.takes_setpoints

    @property
    def pace(self) -> float:
        """See the base class."""
        return self.inner.pace

    @property
    def has_arrived(self) -> bool:
        """See the base class."""
        return self.inner.has_arrived

    @property
    def has_stopped(self) -> bool:
        return self.inner.has_stopped

    @property
    def found(self) -> str:
        return self.inner.found

    @property
    def condition(self) -> Condition:
        return self.inner.condition

    @property
    def is_homed(self) -> bool:
        return self.inner.is_homed

    @property
    def counters(self) -> Mapping[str, float]:
        return self.inner.counters

    @property
    def notes(self) -> tuple[Note, ...]:
        return self.inner.notes

    @property
    def services(self) -> Mapping[str, Service]:
        return self.inner.services

    @property
    def inputs(self) -> Mapping[str, Input]:
        return self.inner.inputs

    @property
    def readings(self) -> Mapping[str, Reading]:
        return self.inner.readings

    @property
    def children(self) -> Mapping[str, Device]:
        return self.inner.children

    def open(self, deadline: float) -> None:
        self.inner.open(deadline)

    def abort_open(self) -> None:
        self.inner.abort_open()

    def close(self) -> None:
        self.inner.close()

    def read(self, deadline: float) -> Sample | None:
        return self.inner.read(deadline)

    def write(self, setpoint: Setpoint) -> None:
        self.inner.write(setpoint)

    def stop(self) -> None:
        self.inner.stop()

    def enable(self) -> Steps:
        return self.inner.enable()

    def disable(self) -> Steps:
        return self.inner.disable()

    def pause(self) -> Steps:
        return self.inner.pause()

    def resume(self) -> Steps:
        return self.inner.resume()

    def home(self) -> Steps:
        return self.inner.home()

    def unhome(self) -> Steps:
        return self.inner.unhome()

    def free(self) -> Steps:
        return self.inner.free()

    def use_gravity_compensation(self, on: bool) -> None:
        self.inner.use_gravity_compensation(on)

    def move(self, goal: Goal) -> None:
        self.inner.move(goal)

    def move_progress(self) -> MoveProgress:
        return self.inner.move_progress()

    def forward_kinematics(self, joints: Vector) -> Pose:
        return self.inner.forward_kinematics(joints)

    def inverse_kinematics(self, pose: Pose, reference: Vector) -> Vector:
        return self.inner.inverse_kinematics(pose, reference)

    def nearby_inverse_kinematics(self, pose: Pose, reference: Vector) -> Vector:
        return self.inner.nearby_inverse_kinematics(pose, reference)

    def jacobian(self, joints: Vector) -> Array:
        return self.inner.jacobian(joints)

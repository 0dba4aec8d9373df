"""A device around another one, which passes everything on: the base of what adds to a device from outside."""

from __future__ import annotations

from collections.abc import Mapping

from typing_extensions import override

from crtk_drivers.device import (
    Capabilities,
    Condition,
    Device,
    Goal,
    Input,
    Kinematics,
    MoveProgress,
    Note,
    Reading,
    Service,
    Setpoint,
    Steps,
)
from crtk_drivers.errors import CrtkError
from crtk_drivers.samples import Sample


class WrappedDevice(Device):
    """Passes every call on to `inner`. A subclass overrides what it changes."""

    def __init__(self, inner: Device) -> None:
        self.inner = inner

    @property
    @override
    def capabilities(self) -> Capabilities:
        return self.inner.capabilities

    @property
    @override
    def address(self) -> str:
        return self.inner.address

    @property
    @override
    def bus(self) -> str:
        return self.inner.bus

    @property
    @override
    def takes_setpoints(self) -> bool:
        return self.inner.takes_setpoints

    @property
    @override
    def pace(self) -> float:
        return self.inner.pace

    @property
    @override
    def has_arrived(self) -> bool:
        return self.inner.has_arrived

    @property
    @override
    def velocity_steps(self) -> tuple[float, ...]:
        return self.inner.velocity_steps

    @property
    @override
    def has_stopped(self) -> bool:
        return self.inner.has_stopped

    @property
    @override
    def is_taken_over(self) -> bool:
        return self.inner.is_taken_over

    @property
    @override
    def found(self) -> str:
        return self.inner.found

    @property
    @override
    def condition(self) -> Condition:
        return self.inner.condition

    @property
    @override
    def obstacles(self) -> tuple[CrtkError, ...]:
        return self.inner.obstacles

    @property
    @override
    def is_homed(self) -> bool:
        return self.inner.is_homed

    @property
    @override
    def kinematics(self) -> Kinematics | None:
        return self.inner.kinematics

    @property
    @override
    def counters(self) -> Mapping[str, float]:
        return self.inner.counters

    @property
    @override
    def counter_units(self) -> Mapping[str, str]:
        return self.inner.counter_units

    @property
    @override
    def notes(self) -> tuple[Note, ...]:
        return self.inner.notes

    @property
    @override
    def services(self) -> Mapping[str, Service]:
        return self.inner.services

    @property
    @override
    def inputs(self) -> Mapping[str, Input]:
        return self.inner.inputs

    @property
    @override
    def readings(self) -> Mapping[str, Reading]:
        return self.inner.readings

    @property
    @override
    def children(self) -> Mapping[str, Device]:
        return self.inner.children

    @property
    @override
    def followers(self) -> frozenset[str]:
        return self.inner.followers

    @override
    def open(self, deadline: float) -> None:
        self.inner.open(deadline)

    @override
    def abort_open(self) -> None:
        self.inner.abort_open()

    @override
    def will_close(self) -> None:
        self.inner.will_close()

    @override
    def wake(self) -> bool:
        return self.inner.wake()

    @override
    def close(self) -> None:
        self.inner.close()

    @override
    def read(self, deadline: float) -> Sample | None:
        return self.inner.read(deadline)

    @override
    def write(self, setpoint: Setpoint) -> None:
        self.inner.write(setpoint)

    @override
    def stop(self) -> None:
        self.inner.stop()

    @override
    def left(self) -> None:
        self.inner.left()

    @override
    def enable(self) -> Steps:
        return self.inner.enable()

    @override
    def disable(self) -> Steps:
        return self.inner.disable()

    @override
    def pause(self) -> Steps:
        return self.inner.pause()

    @override
    def resume(self) -> Steps:
        return self.inner.resume()

    @override
    def home(self) -> Steps:
        return self.inner.home()

    @override
    def unhome(self) -> Steps:
        return self.inner.unhome()

    @override
    def free(self) -> Steps:
        return self.inner.free()

    @override
    def use_gravity_compensation(self, on: bool) -> None:
        self.inner.use_gravity_compensation(on)

    @override
    def move(self, goal: Goal) -> None:
        self.inner.move(goal)

    @override
    def move_progress(self) -> MoveProgress:
        return self.inner.move_progress()

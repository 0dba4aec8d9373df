"""The virtual arm with defects: what stands under `defects` in its configuration, applied."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Final

from typing_extensions import override

from crtk_driver_virtual.config import VirtualConfig
from crtk_driver_virtual.defective_plant import DefectivePlant
from crtk_driver_virtual.defects import Delivery, Senses, mask_of
from crtk_driver_virtual.device import LONGEST_STEP, VirtualDevice
from crtk_driver_virtual.models import Arm
from crtk_driver_virtual.plant import Command, Drive, Plant
from crtk_drivers.device import Mode, Setpoint, Steps
from crtk_drivers.samples import JointState, Pose, Sample, Stamp, Twist, Vector, Wrench, vector

LONGEST_UNWATCHED: Final = 5.0
"""Seconds that an arm that ignores its watchdog makes up for at once."""


class DefectiveDevice(VirtualDevice):
    """A virtual arm that is not as it should be.

    Args:
        config: of the arm, with its defects.
        now: the present on both clocks.
        sleep: lets seconds pass on them.

    Raises:
        ConfigError: as of the arm without defects.
    """

    plant: DefectivePlant

    def __init__(
        self,
        config: VirtualConfig,
        now: Callable[[], Stamp] = Stamp.now,
        sleep: Callable[[float], object] = time.sleep,
    ) -> None:
        self._defects = config.defects
        super().__init__(config, now)
        count = len(self.capabilities.joints)
        self._mask = mask_of(self._defects, count)
        self._senses = Senses(self._defects, count)
        self._delivery = Delivery(self._defects)
        self._sleep = sleep
        self._was_open = False

    @property
    @override
    def counters(self) -> Mapping[str, float]:
        """Those of the arm, and how many samples were lost."""
        return {**super().counters, "samples lost": self._delivery.lost}

    @override
    def open(self, deadline: float) -> None:
        super().open(deadline)
        self._delivery.begin()
        if self._was_open:
            self.plant.move_aside(self._defects.jump_on_reconnect)
        self._was_open = True

    @override
    def read(self, deadline: float) -> Sample | None:
        if not self.reachable:
            told = self._delivery.without_link(self._now())
            return super().read(deadline) if told is None else told
        if self._defects.jitter:
            self._sleep(self._delivery.wait)
        stamp, plant = self._now(), self.plant
        unwatched = self._defects.ignores_watchdog
        self._catch_up(stamp, LONGEST_UNWATCHED if unwatched else LONGEST_STEP)
        position, velocity = self._senses.joints(plant.position, plant.velocity, stamp.monotonic)
        return self._delivery.take(self._sample(stamp, vector(position), vector(velocity)))

    @override
    def write(self, setpoint: Setpoint) -> None:
        if setpoint.mode is Mode.JOINT_POSITION:
            setpoint = replace(setpoint, values=vector(setpoint.values - self._senses.zero))
        super().write(setpoint)

    @override
    def stop(self) -> None:
        if not self._defects.ignores_stop:
            super().stop()

    @override
    def enable(self) -> Steps:
        was_braked = self.plant.braked
        yield from super().enable()
        way = self._defects.jump_on_enable
        if was_braked and way:
            self.plant.command = Command(Drive.POSITION, self.plant.position + way * self._mask)

    @override
    def disable(self) -> Steps:
        was_braked = self.plant.braked
        yield from super().disable()
        if not was_braked:
            self.plant.sag()

    @override
    def home(self) -> Steps:
        yield from super().home()
        self._senses.find_zero()

    # ------------------------------------------------------------------------------------------- inside

    @override
    def _sample(self, stamp: Stamp, position: Vector, velocity: Vector) -> Sample:
        told = super()._sample(stamp, position, velocity)
        values, senses = dict(told.values), self._senses
        joints, twist = values["measured_js"], values["measured_cv"]
        wrench = values["measured_cf"]
        if isinstance(joints, JointState) and joints.effort.size:
            values["measured_js"] = replace(joints, effort=vector(senses.effort(joints.effort)))
        pose = self.kinematics.forward(senses.for_pose(position))
        if isinstance(pose, Pose):
            values["measured_cp"] = senses.pose(pose)
        if isinstance(twist, Twist):
            moved = senses.twist(twist.vector)
            values["measured_cv"] = replace(
                twist, linear=vector(moved[:3]), angular=vector(moved[3:])
            )
        if isinstance(wrench, Wrench):
            felt = senses.wrench(wrench.vector, stamp.monotonic)
            values["measured_cf"] = replace(wrench, force=vector(felt[:3]), torque=vector(felt[3:]))
        return Sample(told.stamp, values)

    @override
    def _plant_of(self, arm: Arm, **given: Any) -> Plant:
        return DefectivePlant(self._defects, arm, **given)

"""The velocities and accelerations that drives in profile modes hold, written beside the cycle."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from crtk_driver_canopen.arm_link import ArmLink
from crtk_driver_canopen.config import CanopenConfig
from crtk_driver_canopen.jobs import NodeJobs, one_by_one
from crtk_driver_canopen.modes import OpMode
from crtk_driver_canopen.profiles import ProfileRates
from crtk_driver_canopen.sdo import Sdo
from crtk_drivers.errors import CrtkError

__all__ = ["GivenRates"]


class GivenRates:
    """Those of all n joints of an arm. It belongs to the I/O thread.

    Args:
        config, link: of the arm.
    """

    def __init__(self, config: CanopenConfig, link: ArmLink) -> None:
        self._link = link
        self._velocities = np.array([joint.velocity for joint in config.joints.values()])
        self._accelerations = np.array([joint.acceleration for joint in config.joints.values()])
        self._jobs = NodeJobs()
        self._wanted: list[ProfileRates] = []
        self._given: list[ProfileRates | None] = []
        self._giving: dict[int, ProfileRates] = {}

    def begin(self) -> None:
        """The drives have just been set up: they hold the limits of their joints."""
        self._jobs = NodeJobs()
        self._given = [*self._full()]
        self._giving = {}

    def note_set_up(self, nodes: set[int]) -> None:
        """Nodes have been set up again: they hold the limits."""
        for index, rates in enumerate(self._full()):
            if self._link.axes[index].config.node in nodes:
                self._given[index] = rates

    def want_full(self) -> None:
        """Want the limits."""
        self._wanted = self._full()

    def want(self, velocities: NDArray[np.float64], accelerations: NDArray[np.float64]) -> None:
        """Want velocities (n,) in rad/s (m/s) and accelerations (n,) in rad/s² (m/s²)."""
        self._wanted = self._rates(velocities, accelerations)

    def _full(self) -> list[ProfileRates]:
        return self._rates(self._velocities, self._accelerations)

    def _rates(
        self, velocities: NDArray[np.float64], accelerations: NDArray[np.float64]
    ) -> list[ProfileRates]:
        return [
            ProfileRates.in_units(velocity, acceleration, axis.facts.units)
            for velocity, acceleration, axis in zip(
                velocities.tolist(), accelerations.tolist(), self._link.axes, strict=True
            )
        ]

    def give(self) -> bool:
        """Return whether the drives in profile modes hold the rates that are wanted; else have them written.

        Raises:
            CrtkError: a drive does not take them.
        """
        if self._jobs.running:
            return False
        giving, self._giving = self._giving, {}
        errors: list[CrtkError]
        errors, self._jobs.errors = self._jobs.errors, []
        for index, rates in giving.items():
            self._given[index] = None if errors else rates
        if errors and all(self._wanted[index] == rates for index, rates in giving.items()):
            raise errors[0]
        nodes: dict[int, list[Callable[[], None]]] = {}
        for index, axis in enumerate(self._link.axes):
            rates, before = self._wanted[index], self._given[index]
            if axis.mode in (OpMode.PP, OpMode.PV) and rates != before:
                self._giving[index] = rates
                sdo = Sdo(self._link.master.sdo(axis.config.node), axis.config.axis)
                nodes.setdefault(axis.config.node, []).append(partial(rates.write, sdo, before))
        self._jobs.start({node: partial(one_by_one, writes) for node, writes in nodes.items()})
        return not nodes

"""The simulator of a sensor feels its tool as the arm turns that carries it on ROS."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

from crtk_drivers.labs.carried import Coupling
from crtk_drivers.labs.lab_file import CarriedEntry
from crtk_drivers.plugins import DevicePlugin, RunningSim
from crtk_drivers.samples import Pose

__all__ = ["felt_on_ros"]

CONNECT_TIMEOUT: Final = 3.0
"""Seconds of one attempt to find the arm, and for its first pose; the next one follows."""


@contextmanager
def felt_on_ros(
    plugin: DevicePlugin, sim: RunningSim | None, entry: CarriedEntry | None
) -> Iterator[None]:
    """Within, the simulator feels what hangs on it. Does nothing without a simulator or an entry."""
    if sim is None or entry is None or plugin.sim_load is None:
        yield
        return
    arm = _Arm(entry.on)
    try:
        with Coupling(sim, plugin.sim_load, entry.carried, arm.look, plugin.name):
            yield
    finally:
        arm.close()


class _Arm:
    """The arm in a namespace; found when it is there, and again after it was away. For one thread."""

    def __init__(self, namespace: str) -> None:
        self._namespace = namespace
        self._found: Any = None

    def look(self) -> Pose | None:
        """Return the pose that it tells; None while that is not valid.

        Raises:
            CrtkError: it is not there, or has told none.
        """
        from crtk_drivers.client import connect  # a device that feels nothing needs none of it

        wait = 0.0
        if self._found is None:
            wait = CONNECT_TIMEOUT
            self._found = connect(self._namespace, timeout=wait, features=["measured_cp"])
        pose, stamp = self._found.measured_cp(age=0.0, wait=wait, extra=True)
        return pose if stamp else None

    def close(self) -> None:
        """Leave it."""
        if self._found is not None:
            self._found.close()

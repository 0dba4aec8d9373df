"""A simulator follows the arms on ROS that carry its device, or the markers of that."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any, Final

from crtk_drivers.config import DeviceConfig
from crtk_drivers.kit.ages import Ages
from crtk_drivers.labs.lab_file import CarriedEntry
from crtk_drivers.labs.sim_coupling import Coupling, Told, followed
from crtk_drivers.plugins import DevicePlugin, RunningSim
from crtk_drivers.samples import CLOCKS_AGREE, Stamp

__all__ = ["coupled_on_ros"]

CONNECT_TIMEOUT: Final = 3.0
"""Seconds of one attempt to find the arm, and for its first pose; the next one follows."""


@contextmanager
def coupled_on_ros(
    plugin: DevicePlugin, config: DeviceConfig, sim: RunningSim | None, entry: CarriedEntry | None
) -> Iterator[None]:
    """Within, the simulator follows what carries it. Does nothing without a simulator or an entry."""
    with ExitStack() as stack:
        if sim is not None and entry is not None:
            for each in followed(plugin, config, sim, entry, plugin.name):
                arm = _Arm(each.on)
                stack.callback(arm.close)
                stack.enter_context(Coupling(sim, each, arm.look))
        yield


class _Arm:
    """The arm in a namespace; found when it is there, and again after it was away. For one thread."""

    def __init__(self, namespace: str) -> None:
        self._namespace = namespace
        self._found: Any = None
        self._ages = Ages()
        self._stamp_ns = self._ours_ns = 0

    def look(self) -> Told | None:
        """Return the pose that it tells, and when that was by our clock; None while it is not valid.

        Raises:
            CrtkError: it is not there, or has told none.
        """
        from crtk_drivers.client import connect  # a device that feels nothing needs none of it

        wait = 0.0
        if self._found is None:
            wait = CONNECT_TIMEOUT
            self._found = connect(self._namespace, timeout=wait, features=["measured_cp"])
        pose, stamp = self._found.measured_cp(age=0.0, wait=wait, extra=True)
        return (pose, self._ours(round(1e9 * stamp))) if stamp else None

    def _ours(self, stamp_ns: int) -> int:
        """Return a stamp on the clock of this machine, which the simulator has, too.

        The arm may be on another one: where its clock is ahead, the simulator would wait until then.
        """
        if stamp_ns != self._stamp_ns:
            now = Stamp.now()
            ours = now.wall_ns - round(
                1e9 * (now.monotonic - self._ages.acquired(stamp_ns, now.monotonic))
            )
            agrees = abs(ours - stamp_ns) <= CLOCKS_AGREE * 1e9
            self._stamp_ns, self._ours_ns = stamp_ns, stamp_ns if agrees else ours
        return self._ours_ns

    def close(self) -> None:
        """Leave it."""
        if self._found is not None:
            self._found.close()

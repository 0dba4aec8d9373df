"""The simulator of a device follows the arm that carries it, or its markers, by the poses that this tells."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np

from crtk_drivers.errors import CrtkError
from crtk_drivers.geometry.frames import product, relative
from crtk_drivers.labs.carried import Carried
from crtk_drivers.labs.lab_file import CarriedEntry
from crtk_drivers.plugins import DevicePlugin, RunningSim
from crtk_drivers.samples import Pose, Vector, Wrench

PERIOD: Final = 0.01
"""Seconds between two looks at the arm."""

RETRY: Final = 1.0
"""Seconds after a look at the arm, or a word to the simulator, that failed."""

PATIENCE: Final = 1.0
"""Seconds that the thread may take to end."""

logger = logging.getLogger(__name__)

Told = tuple[Pose, int]
"""A pose of the arm, and when it was there, in ns since the epoch."""


class Weight:
    """Lets the simulator of a sensor feel its tool, as often as the arm has turned.

    Args:
        sim: of the sensor.
        load: see `DevicePlugin.sim_load`.
        carried: the sensor and its tool.
    """

    def __init__(
        self, sim: RunningSim, load: Callable[[RunningSim, Wrench], None], carried: Carried
    ) -> None:
        self._sim = sim
        self._load = load
        self._carried = carried
        self._felt: Vector | None = None

    def __call__(self, arm: Pose, wall_ns: int) -> None:
        """Tell it of the arm.

        Raises:
            RuntimeError: the simulator does not answer.
        """
        if self._felt is not None and np.array_equal(arm.orientation, self._felt):
            return
        self._felt = None  # what fails may have come through all the same
        self._load(self._sim, self._carried.weight(arm.orientation))
        self._felt = arm.orientation


class Marker:
    """Lets the simulator of a tracker see a marker where the arm has it.

    Args:
        sim: of the tracker.
        put: see `DevicePlugin.sim_put`.
        known_by: what the simulator knows the marker by.
        stands: pose of the tracker in the frame in which the arm tells its poses.
        mounting: pose of the marker in the frame of the arm's tool.
    """

    def __init__(
        self,
        sim: RunningSim,
        put: Callable[[RunningSim, str, Pose, int], None],
        known_by: str,
        stands: Pose,
        mounting: Pose,
    ) -> None:
        self._sim = sim
        self._put = put
        self._known_by = known_by
        self._stands = stands
        self._mounting = mounting
        self._seen = 0

    def __call__(self, arm: Pose, wall_ns: int) -> None:
        """Tell it of the arm; also of one that stands: between two poses a simulator goes straight.

        Raises:
            RuntimeError: the simulator does not answer.
        """
        if wall_ns == self._seen:
            return
        seen = relative(self._stands, product(arm, self._mounting))
        self._put(self._sim, self._known_by, seen, wall_ns)
        self._seen = wall_ns


@dataclass(frozen=True)
class Followed:
    """What a simulator follows.

    Attributes:
        on: the device that carries it, as the entry has it.
        name: of the device, and of its marker, for messages.
        tell: tells the simulator of a pose of the carrier, and its time in ns since the epoch.
    """

    on: str
    name: str
    tell: Callable[[Pose, int], None]


def followed(
    plugin: DevicePlugin, config: Any, sim: RunningSim, entry: CarriedEntry, name: str
) -> Iterator[Followed]:
    """Yield what the simulator of a device follows.

    Args:
        plugin, config: of the device.
        sim: that runs.
        entry: what carries what; see `LabDevice.coupled`.
        name: of the device.
    """
    if entry.tool is not None and plugin.sim_load is not None:
        yield Followed(entry.on, name, Weight(sim, plugin.sim_load, entry.carried))
    if entry.stands is None or plugin.sim_put is None:
        return
    known = plugin.markers(config)
    for marker, its in entry.markers.items():
        tell = Marker(sim, plugin.sim_put, known[marker], entry.stands.pose, its.mounting.pose)
        yield Followed(its.on, f"{name} {marker}", tell)


class Coupling:
    """Lets a simulator follow an arm, from a thread of its own. A context manager.

    While the arm tells no pose nothing changes: an arm that is gone has not moved.

    Args:
        sim: that follows.
        follows: what of it.
        look: returns the pose that the arm tells, None while it tells none that is valid; may wait, and raise
            CrtkError.
    """

    def __init__(self, sim: RunningSim, follows: Followed, look: Callable[[], Told | None]) -> None:
        self._sim = sim
        self._tell = follows.tell
        self._name = follows.name
        self._look = look
        self._ended = threading.Event()
        self._thread = threading.Thread(
            target=self._run, name=f"coupling of {follows.name}", daemon=True
        )

    @property
    def runs(self) -> bool:
        """Whether it is at work: it ends by itself with the simulator."""
        return self._thread.is_alive()

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join(PATIENCE)

    def _run(self) -> None:
        told, follows = "", False
        period = PERIOD
        while not self._ended.wait(period) and self._sim.running:
            period = PERIOD
            try:
                found = self._look()
                if found is None:
                    continue
                self._tell(*found)
            except (CrtkError, RuntimeError, OSError) as error:
                if self._ended.is_set() or not self._sim.running:
                    return
                if told != str(error):
                    told = str(error)
                    logger.warning(
                        "%s: its simulator does not follow the arm: %s", self._name, told
                    )
                period = RETRY
            else:
                if told or not follows:
                    logger.info("%s: its simulator follows the arm", self._name)
                told, follows = "", True

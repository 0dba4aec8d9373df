"""What hangs on a sensor that an arm carries, and how its weight pulls as the arm turns.

The weight alone: what accelerates the tool, and what touches it, is in none of this.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from crtk_drivers.errors import CrtkError
from crtk_drivers.geometry.quaternions import matrix_from_quaternion
from crtk_drivers.plugins import RunningSim
from crtk_drivers.samples import Pose, Vector, Wrench, vector

GRAVITY: Final = 9.80665
"""m/s², against the z axis of the frame in which the arm tells its poses."""

PERIOD: Final = 0.01
"""Seconds between two looks at the arm."""

RETRY: Final = 1.0
"""Seconds after a look at the arm, or a word to the simulator, that failed."""

PATIENCE: Final = 1.0
"""Seconds that the thread may take to end."""

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Carried:
    """A sensor on an arm, and its tool.

    Attributes:
        mass: of the tool, in kg; 0 where it is not known.
        center_of_mass: of the tool, in the sensor's frame, in m.
        orientation: of the sensor in the frame of the arm's ``measured_cp``: quaternion x, y, z, w.
    """

    mass: float = 0.0
    center_of_mass: tuple[float, float, float] = (0.0, 0.0, 0.0)
    orientation: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)

    def down(self, arm: Vector) -> Vector:
        """Return the direction of gravity (3,) in the sensor's frame.

        Args:
            arm: orientation (4,) that the arm tells.
        """
        sensor = matrix_from_quaternion(arm) @ matrix_from_quaternion(vector(self.orientation))
        return vector(-sensor[2])

    def weight(self, arm: Vector) -> Wrench:
        """Return what the tool pulls with at an orientation (4,) of the arm, in the sensor's frame."""
        force = self.mass * GRAVITY * self.down(arm)
        return Wrench(vector(force), vector(np.cross(self.center_of_mass, force)))


UNKNOWN: Final = Carried()
"""As nothing is said of: the axes of the arm's tool, and no tool that is known."""


class Coupling:
    """Lets the simulator of a sensor feel its tool, from a thread of its own. A context manager.

    Until the arm has told a pose it feels nothing of it, and while the arm tells none it feels what it felt
    last: an arm that is gone has not moved.

    Args:
        sim: of the sensor.
        load: see `DevicePlugin.sim_load`.
        carried: the sensor and its tool.
        look: returns the pose that the arm tells, None while it tells none that is valid; may wait, and raise
            CrtkError.
        name: of the sensor, for messages.
    """

    def __init__(
        self,
        sim: RunningSim,
        load: Callable[[RunningSim, Wrench], None],
        carried: Carried,
        look: Callable[[], Pose | None],
        name: str,
    ) -> None:
        self._sim = sim
        self._load = load
        self._carried = carried
        self._look = look
        self._name = name
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"weight on {name}", daemon=True)

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
        felt: Vector | None = None
        told = ""
        period = PERIOD
        while not self._ended.wait(period) and self._sim.running:
            period = PERIOD
            try:
                pose = self._look()
                if pose is None or (felt is not None and np.array_equal(pose.orientation, felt)):
                    continue
                self._load(self._sim, self._carried.weight(pose.orientation))
            except (CrtkError, RuntimeError, OSError) as error:
                if self._ended.is_set() or not self._sim.running:
                    return
                if told != str(error):
                    told = str(error)
                    logger.warning("%s: its simulator does not feel its tool: %s", self._name, told)
                felt, period = None, RETRY  # it may have come through all the same
            else:
                if told or felt is None:
                    logger.info("%s: its simulator feels its tool", self._name)
                felt, told = pose.orientation, ""

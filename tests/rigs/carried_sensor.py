"""A force sensor without hardware on an arm: what hangs on it pulls as the arm turns."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np
from typing_extensions import override

from crtk_drivers.device import Capabilities, Device, Setpoint, StopPolicy
from crtk_drivers.labs.carried import Carried
from crtk_drivers.samples import Pose, Sample, Stamp, Wrench, vector
from crtk_sim_backends.netft.defects import TransducerDefects, Wrongs


class CarriedSensor(Device):
    """Tells at each read what its tool pulls with.

    Args:
        rate: of it, in Hz.
        carried: how it sits on the arm, and its tool.
        look: returns the pose of the arm, None as long as that tells none.
        defects: of its transducer: those of the simulated NetFT.
        behind: reads by which what it tells is older than its stamp.
    """

    def __init__(
        self,
        rate: float,
        carried: Carried,
        look: Callable[[], Pose | None],
        defects: TransducerDefects,
        behind: int = 0,
    ) -> None:
        self._carried = carried
        self._look = look
        self._wrongs = Wrongs(defects)
        self._felt: deque[Wrench] = deque(maxlen=behind + 1)
        self._opened = 0.0
        self._capabilities = Capabilities(
            measured=("measured_cf",), rate=rate, stop=StopPolicy(0.0, "has nothing that moves")
        )

    @property
    @override
    def capabilities(self) -> Capabilities:
        return self._capabilities

    @property
    @override
    def address(self) -> str:
        return "a sensor"

    @override
    def open(self, deadline: float) -> None:
        self._opened = Stamp.now().monotonic

    @override
    def close(self) -> None:
        """It holds nothing."""

    @override
    def read(self, deadline: float) -> Sample | None:
        pose, stamp = self._look(), Stamp.now()
        if pose is not None:
            self._felt.append(self._carried.weight(pose.orientation))
        if not self._felt:
            return None
        felt = np.concatenate([self._felt[0].force, self._felt[0].torque])[None, :]
        (told,) = self._wrongs.measured(felt, np.array([stamp.monotonic - self._opened]))
        return Sample(stamp, {"measured_cf": Wrench(vector(told[:3]), vector(told[3:]), "sensor")})

    @override
    def write(self, setpoint: Setpoint) -> None:
        raise NotImplementedError

    @override
    def stop(self) -> None:
        """It has nothing that moves."""

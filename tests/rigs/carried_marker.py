"""A tracker without a wire that sees a marker on an arm: the simulated tracker, asked in this thread."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from typing_extensions import override

from crtk_drivers.device import Capabilities, Device, Sensor, StopPolicy
from crtk_drivers.geometry.frames import product, relative
from crtk_drivers.geometry.quaternions import unit
from crtk_drivers.samples import Pose, Poses, Sample, Stamp, vector
from crtk_sim_backends.ndi import wire
from crtk_sim_backends.ndi.defects import TrackerDefects
from crtk_sim_backends.ndi.families import FAMILIES
from crtk_sim_backends.ndi.motion import MOTIONS
from crtk_sim_backends.ndi.plugs import sensors_of
from crtk_sim_backends.ndi.tracker import Tracker
from rigs.measured_poses import pose

STANDS = pose((-1.1, -0.1, 0.4), (0.0, -np.pi / 2.0, 0.0))
"""In the frame of the arm; its volume is at negative z."""
MOUNTING = pose((0.02, -0.05, 0.11), (0.5, 1.2, -0.7))
PART = "MARKER"
NOISE = 0.05
"""mm."""


class CarriedMarker(Sensor):
    """The one tool of a tracker, which an arm carries.

    Args:
        look: returns the pose of the arm, None as long as that tells none.
        defects: of the tracker.
    """

    def __init__(self, look: Callable[[], Pose | None], defects: TrackerDefects) -> None:
        self._look = look
        self._frame = ""
        self._tracker = Tracker(
            FAMILIES["vega"],
            sensors_of(PART),
            MOTIONS["still"],
            NOISE,
            0,
            defects,
            lambda: Stamp.now().monotonic,
            lambda: Stamp.now().wall_ns,
        )
        for text in ("INIT:", "PHSR:02", "PINIT:01", "PENA:01D", "TSTART:80"):
            assert not self._asked(text).startswith("ERROR"), text
        self._capabilities = Capabilities(
            measured=("measured_cp",),
            rate=60.0,
            stop=StopPolicy(0.0, "has nothing that moves"),
            base_frame="tracker",
            tool_frame="marker",
        )

    @property
    @override
    def capabilities(self) -> Capabilities:
        return self._capabilities

    @property
    @override
    def address(self) -> str:
        return "a marker"

    @override
    def open(self, deadline: float) -> None:
        """It is open."""

    @override
    def close(self) -> None:
        """It holds nothing."""

    @override
    def read(self, deadline: float) -> Sample | None:
        arm, stamp = self._look(), Stamp.now()
        if arm is not None:
            at = relative(STANDS, product(arm, MOUNTING))
            self._tracker.put(PART, stamp.wall_ns, at.position, at.orientation)
        told = self._asked("TX:0001")
        frame = told[-13:-5]
        if frame == self._frame:
            return None
        self._frame = frame
        if "MISSING" in told:
            return Sample(Stamp(0, stamp.monotonic), {})
        q0, qx, qy, qz = (1e-4 * int(told[at : at + 6]) for at in range(4, 28, 6))
        position = [1e-5 * int(told[at : at + 7]) for at in range(28, 49, 7)]
        seen = Pose(vector(position), unit(vector((qx, qy, qz, q0))), "tracker")
        return Sample(stamp, {"measured_cp": seen})

    def _asked(self, text: str) -> str:
        data = text.encode()
        return self._tracker.obey(data + b"%04X" % wire.check(data)).decode()[:-5]


class MarkerTracker(Sensor):
    """The tracker that the marker is behind."""

    def __init__(self, marker: CarriedMarker) -> None:
        self._marker = marker
        self._capabilities = Capabilities(
            type="tracker",
            measured=("measured_cp_array",),
            rate=60.0,
            stop=StopPolicy(0.0, "has nothing that moves"),
        )

    @property
    @override
    def capabilities(self) -> Capabilities:
        return self._capabilities

    @property
    @override
    def address(self) -> str:
        return "a tracker"

    @property
    @override
    def children(self) -> Mapping[str, Device]:
        return {"marker": self._marker}

    @override
    def open(self, deadline: float) -> None:
        """It is open."""

    @override
    def close(self) -> None:
        """It holds nothing."""

    @override
    def read(self, deadline: float) -> Sample | None:
        return Sample(Stamp.now(), {"measured_cp_array": Poses((), "tracker")})

"""A tool that a tracker sees, as a device behind it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Final

from typing_extensions import override

from crtk_driver_ndi.frames import ToolSeen
from crtk_driver_ndi.tracker import Tracker
from crtk_drivers.commands import Payload
from crtk_drivers.device import (
    Capabilities,
    Condition,
    Reading,
    Sensor,
    Steps,
    StopPolicy,
)
from crtk_drivers.errors import TransitionFailed
from crtk_drivers.geometry.frames import product, relative
from crtk_drivers.geometry.quaternions import unit
from crtk_drivers.kit.device_behind import DeviceBehind
from crtk_drivers.samples import Flag, Number, Numbers, Pose, Sample, Stamp, Text, Value, vector
from crtk_drivers.state import OperatingState

__all__ = ["MM", "OUTSIDE", "STOP", "ToolDevice", "place_of", "pose_of"]

MM: Final = 1e-3
OUTSIDE: Final = frozenset({"out of volume", "partly out of volume"})
NORM: Final = 0.01
"""By how much a quaternion of the tracker may differ from one of unit length."""

STOP: Final = StopPolicy(0.0, "has nothing that moves")


def pose_of(seen: ToolSeen | None, outside: str, frame_id: str) -> Pose | None:
    """Return where a tool is in the tracker's frame; None if it is missing.

    Args:
        seen: what a frame says of it.
        outside: "tell" or "missing": what to do with poses out of the volume.
        frame_id: of the tracker.
    """
    if seen is None or seen.values is None:
        return None
    if outside == "missing" and OUTSIDE.intersection(seen.told):
        return None
    q0, qx, qy, qz, x, y, z, _ = seen.values
    # A number that is none passes no comparison.
    if not (abs(math.hypot(q0, qx, qy, qz) - 1.0) < NORM and math.isfinite(x + y + z)):
        return None
    return Pose(vector((x * MM, y * MM, z * MM)), unit(vector((qx, qy, qz, q0))), frame_id)


def place_of(tracker: Tracker, place: int) -> Pose | None:
    """Return where the tip of a tool is in the tracker's frame; None if it is missing.

    Args:
        tracker: that sees it.
        place: of the tool in the configuration.
    """
    config = tracker.config
    pose = pose_of(tracker.seen(place), config.outside, config.frame_id)
    tip = config.tools[place].tip
    return pose if pose is None or tip is None else product(pose, tip.pose)


class ToolDevice(DeviceBehind, Sensor):
    """One tool: where it is, in the frame of the tracker or of the reference tool.

    Args:
        tracker: that sees it.
        name: of it.
        place: of it in the configuration.
        reference: place of the reference tool, None if there is none.
    """

    def __init__(self, tracker: Tracker, name: str, place: int, reference: int | None) -> None:
        config = tracker.config
        self._tracker = tracker
        self._place = place
        self._reference = reference
        self._base = config.frame_id if reference is None else config.reference
        capabilities = Capabilities(
            measured=("measured_cp",)
            if reference is None
            else ("measured_cp", "local/measured_cp"),
            rate=config.rate,
            base_frame=self._base,
            tool_frame=name,
            stop=STOP,
        )
        super().__init__(tracker, name, capabilities, "the tracker")
        self._told = 0.0, 0
        self._last: Mapping[str, Value] = {}

    @property
    @override
    def is_linked(self) -> bool:
        return self._tracker.prepared is not None

    @property
    @override
    def condition(self) -> Condition:
        if self._tracker.stream is not None:
            return Condition()
        return Condition(OperatingState.DISABLED, "the tracker does not track")

    @override
    def read(self, deadline: float) -> Sample | None:
        """Return what the tracker has just brought; missing, the last pose with stamp 0."""
        self.check_link()
        tracker, stream = self._tracker, self._tracker.stream
        before = self._told
        self._told = tracker.alive, stream.frames if stream is not None else 0
        if self._told == before:
            return None
        if stream is None or self._told[1] == before[1]:
            return Sample(Stamp.now())  # without values: it only shows that the link is alive
        values = self._values()
        if not values:
            return Sample(Stamp(0, stream.stamp.monotonic), self._last)
        self._last = values
        return Sample(stream.stamp, values)

    @override
    def enable(self) -> Steps:
        """Rely on it.

        Raises:
            TransitionFailed: the tracker does not track.
        """
        if self._tracker.stream is None:
            raise TransitionFailed(
                "the tracker does not track",
                where=self.address,
                remedy="Enable the tracker; its tools tell where they are from then on.",
            )
        yield from ()

    @property
    @override
    def readings(self) -> Mapping[str, Reading]:
        def row(
            summary: str, payload: Payload, tell: Callable[[ToolSeen], Value | None]
        ) -> Reading:
            return Reading(
                summary, payload, lambda: None if not (seen := self._seen()) else tell(seen)
            )

        return {
            "visible": row("whether it has a pose", Payload.FLAG, self._visible),
            "quality": row("what its pose suffers from, or nothing", Payload.TEXT, self._quality),
            "tracking_error": row("m RMS; without unit for an Aurora", Payload.NUMBER, self._error),
            "buttons": row("1 where one is pressed", Payload.NUMBERS, _buttons),
        }

    def _seen(self) -> ToolSeen | None:
        return self._tracker.seen(self._place)

    def _pose(self, place: int) -> Pose | None:
        return place_of(self._tracker, place)

    def _values(self) -> Mapping[str, Value]:
        """Return what is measured; empty if it or the reference is missing."""
        pose = self._pose(self._place)
        if pose is None or self._reference is None:
            return {} if pose is None else {"measured_cp": pose}
        reference = self._pose(self._reference)
        if reference is None:
            return {}
        seen_from = replace(relative(reference, pose), frame_id=self._base)
        return {"measured_cp": seen_from, "local/measured_cp": replace(pose, frame_id="local")}

    def _visible(self, seen: ToolSeen) -> Value:
        return Flag(self._pose(self._place) is not None)

    def _quality(self, seen: ToolSeen) -> Value:
        words = list(seen.told)
        if seen.values is not None and not words and self._pose(self._place) is None:
            words.append("numbers that are no pose")
        if self._reference is not None and self._pose(self._reference) is None:
            words.append(f"the reference {self._base} is missing")
        return Text(", ".join(words))

    def _error(self, seen: ToolSeen) -> Value | None:
        prepared = self._tracker.prepared
        if seen.values is None or prepared is None:
            return None
        return Number(seen.values[7] * (MM if prepared.identity.family.error_is_length else 1.0))


def _buttons(seen: ToolSeen) -> Value:
    return Numbers(tuple(float(pressed) for pressed in seen.buttons))

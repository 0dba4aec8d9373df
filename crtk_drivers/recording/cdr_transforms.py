"""Transforms between frames from ROS 2 messages: tf2_msgs/msg/TFMessage, of ``/tf`` and ``/tf_static``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from crtk_drivers.recording.cdr import Fields
from crtk_drivers.samples import Pose

TYPE: Final = "tf2_msgs/msg/TFMessage"

TOPICS: Final = ("/tf", "/tf_static")
"""Where they are published, by all of a graph."""

MOST_TRANSFORMS: Final = 100_000


@dataclass(frozen=True, slots=True)
class Transform:
    """Where a frame is.

    Attributes:
        stamp_ns: since the epoch.
        pose: of the frame `child`, in that which `pose` names.
        child: name of the frame.
    """

    stamp_ns: int
    pose: Pose
    child: str


def decode_transforms(data: bytes) -> tuple[Transform, ...]:
    """Return what a TFMessage holds.

    Raises:
        Malformed: bytes that are no such message, or too many transforms.
    """
    fields = Fields(data)
    count = fields.few("transforms", MOST_TRANSFORMS)
    found = tuple(_transform(fields) for _ in range(count))
    fields.end()
    return found


def _transform(fields: Fields) -> Transform:
    stamp_ns, frame_id, child = fields.stamp(), fields.text(), fields.text()
    return Transform(stamp_ns, Pose(fields.numbers(3), fields.numbers(4), frame_id), child)

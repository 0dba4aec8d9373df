"""The way that the joints of an arm went in a recording, and whether an arm may go it again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from crtk_drivers.errors import RecordingError
from crtk_drivers.recording import Recording
from crtk_drivers.recording.foreign import Foreign
from crtk_drivers.samples import Array, JointState, Vector

GAP: Final = 0.5
"""Seconds between two positions in which a joint may move: over a longer time it is not known how it went."""

RESTS: Final = 1e-3
"""rad (m) that a joint may have moved in a gap."""

SLACK: Final = 1.02
"""By how much a velocity between two positions may exceed a limit: stamps are not exact."""

STEP: Final = 0.01
"""Seconds over which a velocity is judged at least."""


@dataclass(frozen=True, slots=True)
class JointPath:
    """Positions (n, joints) in rad or m at times (n,) in s from 0 on.

    Attributes:
        names: of the joints.
        topic: that they are from.
    """

    names: tuple[str, ...]
    times: Vector
    positions: Array
    topic: str

    def at(self, time: float) -> list[float]:
        """Return where the joints are at a time: between two positions in a straight line."""
        columns = self.positions.T
        return [float(np.interp(time, self.times, column)) for column in columns]

    @property
    def seconds(self) -> float:
        """How long it takes."""
        return float(self.times[-1])


def joint_path(recording: Recording | Foreign, namespace: str = "") -> JointPath:
    """Return the way of a device: its setpoints, or what was measured where there are none.

    Args:
        recording: opened.
        namespace: of the device; empty if there is one alone.

    Raises:
        RecordingError: there is none, or several.
    """
    found = []
    for name in ("setpoint_js", "measured_js"):
        topics = [
            topic
            for topic, type_name in recording.topics.items()
            if topic == f"{namespace.rstrip('/')}/{name}"
            or (not namespace and topic.endswith(f"/{name}"))
            if type_name == "sensor_msgs/msg/JointState"
        ]
        if len(topics) > 1:
            raise RecordingError(
                f"has joints of several devices: {', '.join(topics)}",
                where=str(recording.path),
                remedy="Say by --from which one: its namespace.",
            )
        found += topics
    for topic in found:
        path = _read(recording, topic)
        if path is not None:
            return path
    raise RecordingError(
        f"holds no joint positions{f' of {namespace}' if namespace else ''}",
        where=str(recording.path),
        remedy="It takes setpoint_js or measured_js.",
    )


def _read(recording: Recording | Foreign, topic: str) -> JointPath | None:
    times: list[int] = []
    positions: list[list[float]] = []
    names: tuple[str, ...] = ()
    for message in recording.messages(topic):
        try:
            found = message.decoded()
        except RecordingError:
            continue
        value = found.value
        if not found.stamp_ns or not isinstance(value, JointState) or not value.position.size:
            continue
        if times and (value.name != names or value.position.size != len(positions[0])):
            raise RecordingError(f"{topic} has other joints later on", where=str(recording.path))
        names = value.name
        times.append(message.log_time)
        positions.append(value.position.tolist())
    if len(times) < 2:
        return None
    at, order = np.unique(np.array(times, dtype=np.uint64), return_index=True)
    whole = np.array(positions)[order]
    if not np.isfinite(whole).all():
        raise RecordingError(f"{topic} has numbers that are not finite", where=str(recording.path))
    return JointPath(names, (at - at[0]) * 1e-9, whole, topic)


def refused(path: JointPath, joints: Sequence[Mapping[str, Any]], rate: float) -> str:
    """Return why an arm may not go this way so fast; empty if it may.

    Args:
        path: of the recording.
        joints: of the arm, as its manifest tells them: name, lower, upper, velocity.
        rate: times as fast as it was recorded.
    """
    names = tuple(str(joint["name"]) for joint in joints)
    if path.names and path.names != names:
        return f"it is of another device: {', '.join(path.names)}, not {', '.join(names)}"
    if path.positions.shape[1] != len(names):
        return f"it is of {path.positions.shape[1]} joints, not {len(names)}"
    gaps = np.diff(path.times)
    moved = np.abs(np.diff(path.positions, axis=0))
    for index, joint in enumerate(joints):
        name, column = names[index], path.positions[:, index]
        low, high = joint.get("lower"), joint.get("upper")
        if low is not None and column.min() < low:
            return f"{name} goes to {column.min():.4g}, its range begins at {low:.4g}"
        if high is not None and column.max() > high:
            return f"{name} goes to {column.max():.4g}, its range ends at {high:.4g}"
        jumps = np.flatnonzero((gaps > GAP) & (moved[:, index] > RESTS))
        if jumps.size:
            at = float(path.times[jumps[0]])
            return f"{name} moves by {moved[jumps[0], index]:.4g} in a gap at {at:.2f} s"
        fastest, at = _fastest(path.times, column)
        limit = joint.get("velocity")
        if limit is not None and fastest * rate > SLACK * limit:
            advice = (
                f"; --rate {0.99 * limit / fastest:.2g} would do" if fastest < 1e3 * limit else ""
            )
            speed = f"{name} goes at {fastest * rate:.3g} a second at {at:.2f} s"
            return f"{speed}, its limit is {limit:.3g}{advice}"
    return ""


def _fastest(times: Vector, column: Vector) -> tuple[float, float]:
    """Return the greatest velocity over `STEP` or more, and when (s) that is."""
    later = np.searchsorted(times, times + STEP)
    sound = later < times.size
    if not sound.any():
        later, sound = np.full(times.size, times.size - 1), np.arange(times.size) < times.size - 1
    ends = later[sound]
    speeds = np.abs(column[ends] - column[sound]) / (times[ends] - times[sound])
    worst = int(np.argmax(speeds))
    return float(speeds[worst]), float(times[sound][worst])

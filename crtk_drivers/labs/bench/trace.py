"""A recording as arrays, for those who judge it. Pure."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Final

import numpy as np

from crtk_drivers.samples import Array, JointState, Pose, Twist, Value, Vector, Wrench

Row = tuple[str, int, int, Any]
"""Topic, arrival and stamp in ns since the epoch (stamp 0: not valid), value."""

NS: Final = 1e-9


@dataclass(frozen=True)
class Event:
    """What happened at `at`: a change of state, a refusal, a mark of the test."""

    at: float
    kind: str
    text: str


@dataclass(frozen=True, eq=False)
class JointTrack:
    """Joint states over time.

    Attributes:
        at: arrival (N,), in s from the begin of the recording.
        stamp: acquisition (N,), on the same axis; NaN where the data are not valid.
        position, velocity, effort: (N, n); NaN where it is not known.
    """

    at: Vector
    stamp: Vector
    position: Array
    velocity: Array
    effort: Array

    def between(self, begin: float, end: float) -> JointTrack:
        """Return what arrived from `begin` to `end`."""
        within = (self.at >= begin) & (self.at <= end)
        return JointTrack(
            self.at[within],
            self.stamp[within],
            self.position[within],
            self.velocity[within],
            self.effort[within],
        )

    @property
    def by_stamp(self) -> JointTrack:
        """What is valid, on the axis of acquisition."""
        sound = np.isfinite(self.stamp)
        made = self.stamp[sound]
        return JointTrack(
            made, made, self.position[sound], self.velocity[sound], self.effort[sound]
        )


@dataclass(frozen=True, eq=False)
class PoseTrack:
    """Poses over time: position (N, 3) and orientation (N, 4); the rest as in a `JointTrack`."""

    at: Vector
    stamp: Vector
    position: Array
    orientation: Array

    def acquired(self, begin: float, end: float) -> tuple[Vector, Array]:
        """Return when what is valid was acquired from `begin` to `end`, and the positions (N, 3)."""
        within = (self.stamp >= begin) & (self.stamp <= end)
        return self.stamp[within], self.position[within]


@dataclass(frozen=True, eq=False)
class VectorTrack:
    """Twists or wrenches over time: (N, 6); the rest as in a `JointTrack`."""

    at: Vector
    stamp: Vector
    values: Array

    def between(self, begin: float, end: float) -> VectorTrack:
        """Return what arrived from `begin` to `end`."""
        within = (self.at >= begin) & (self.at <= end)
        return VectorTrack(self.at[within], self.stamp[within], self.values[within])


@dataclass(frozen=True, eq=False)
class Trace:
    """A recording.

    Attributes:
        rows: by topic.
        events: in their order.
        notes: what the acquisition wrote down for its analysis.
        begin: arrival of the first row, in ns since the epoch.
    """

    rows: Mapping[str, tuple[Row, ...]]
    events: tuple[Event, ...]
    notes: Mapping[str, Any] = field(default_factory=dict)
    begin: int = 0

    @classmethod
    def of(cls, rows: Iterable[Row]) -> Trace:
        """Return the trace of rows in the order of arrival."""
        topics: dict[str, list[Row]] = {}
        events: list[Event] = []
        notes: dict[str, Any] = {}
        begin = 0
        for row in rows:
            topic, arrival, _, value = row
            begin = begin or arrival
            if topic != "events":
                topics.setdefault(topic, []).append(row)
                continue
            said = json.loads(value.value)
            if said["kind"] == "note":
                notes |= json.loads(said["text"])
            else:
                events.append(Event((arrival - begin) * NS, said["kind"], said["text"]))
        return cls(
            {name: tuple(found) for name, found in topics.items()}, tuple(events), notes, begin
        )

    @cached_property
    def joints(self) -> JointTrack:
        """What was measured of the joints."""
        return self.joint_states("measured_js")

    def joint_states(self, topic: str) -> JointTrack:
        """Return joint states, those that have positions, velocities or efforts of the usual size."""
        rows = self.rows.get(topic, ())
        states = [row[3] for row in rows if isinstance(row[3], JointState)]
        size = max(
            (max(s.position.size, s.velocity.size, s.effort.size) for s in states), default=0
        )
        at, stamp = self._times(rows)
        return JointTrack(
            at,
            stamp,
            *(
                _stacked([getattr(state, part) for state in states], size)
                for part in ("position", "velocity", "effort")
            ),
        )

    def poses(self, topic: str) -> PoseTrack:
        """Return poses."""
        rows = self.rows.get(topic, ())
        values = [row[3] for row in rows if isinstance(row[3], Pose)]
        return PoseTrack(
            *self._times(rows),
            _stacked([pose.position for pose in values], 3),
            _stacked([pose.orientation for pose in values], 4),
        )

    def vectors(self, topic: str) -> VectorTrack:
        """Return twists or wrenches."""
        rows = self.rows.get(topic, ())
        values = [row[3].vector for row in rows if isinstance(row[3], Twist | Wrench)]
        return VectorTrack(*self._times(rows), _stacked(values, 6))

    def commands(self, name: str) -> tuple[tuple[float, float, Value | None], ...]:
        """Return when each command of a name came, its stamp on the same axis, and what it said."""
        rows = self.rows.get(f"command/{name}", ())
        return tuple(
            ((arrival - self.begin) * NS, (stamp - self.begin) * NS, value)
            for _, arrival, stamp, value in rows
        )

    def positions_sent(self, name: str) -> tuple[Vector, Array]:
        """Return when the joint positions (N, n) of a command came."""
        sent = [
            (at, value.position)
            for at, _, value in self.commands(name)
            if isinstance(value, JointState)
        ]
        return np.array([at for at, _ in sent]), np.array([position for _, position in sent])

    def mark(self, text: str) -> float:
        """Return when a mark was made.

        Raises:
            LookupError: it was not.
        """
        for event in self.events:
            if event.kind == "mark" and event.text == text:
                return event.at
        raise LookupError(f"the recording has no mark {text!r}: the motion was not carried out")

    def marks(self, text: str) -> list[float]:
        """Return all times at which a mark was made."""
        return [event.at for event in self.events if (event.kind, event.text) == ("mark", text)]

    def _times(self, rows: tuple[Row, ...]) -> tuple[Vector, Vector]:
        at = np.array([(arrival - self.begin) * NS for _, arrival, _, _ in rows])
        stamp = np.array([(made - self.begin) * NS if made else np.nan for _, _, made, _ in rows])
        return at, stamp


def _stacked(values: list[Vector], size: int) -> Array:
    stacked = np.full((len(values), size), np.nan)
    for row, value in zip(stacked, values, strict=True):
        if value.size == size:
            row[:] = value
    return stacked

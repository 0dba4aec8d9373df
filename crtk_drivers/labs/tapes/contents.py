"""What a recording says of each device in it, as numbers over time: what pictures are made of."""

from __future__ import annotations

import json
from array import array
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from crtk_drivers.commands import Direction, Level, find
from crtk_drivers.labs.tapes.clocks import clocks_of
from crtk_drivers.labs.tapes.rows import row_of
from crtk_drivers.recording import Message, Recording
from crtk_drivers.recording.foreign import Foreign
from crtk_drivers.samples import Array, Vector

MOST: Final = 400_000
"""Messages of a topic that are read; of more of them, one in so many."""

SECOND: Final = 1e-9

_DRAWN: Final = frozenset(
    {"measured_js", "setpoint_js", "measured_cp", "setpoint_cp", "measured_cf"}
)


@dataclass(slots=True)
class Track:
    """The numbers of one topic.

    Attributes:
        times: (n,) of the messages, in s since the recording began: by stamp, or by arrival where stamps are
            not of one clock.
        columns: (n,) by name; NaN where a message says nothing, or is not valid.
    """

    times: Vector
    columns: dict[str, Array]

    def part(self, name: str) -> dict[str, Array]:
        """Return the columns of a part, ``position``, by what follows in their names."""
        begin = f"{name}/"
        found = self.columns.items()
        return {key.removeprefix(begin): value for key, value in found if key.startswith(begin)}


@dataclass(slots=True)
class DeviceTracks:
    """What is known of one device.

    Attributes:
        namespace: of its topics.
        tracks: by CRTK name.
        states: when (s) it was announced, state, reason.
        refusals: when (s), command, reason.
        commands: when (s) each came, by name.
    """

    namespace: str
    tracks: dict[str, Track] = field(default_factory=dict)
    states: list[tuple[float, str, str]] = field(default_factory=list)
    refusals: list[tuple[float, str, str]] = field(default_factory=list)
    commands: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))


@dataclass(slots=True)
class Contents:
    """What is in a recording.

    Attributes:
        began: ns since the epoch.
        seconds: that it lasts.
        devices: by namespace.
        others: type and number of messages of topics that are not drawn.
        left_out: of topics that are too long, one in how many was read.
        note: what is to be known of the clocks, see `Clocks`.
    """

    began: int
    seconds: float
    devices: dict[str, DeviceTracks]
    others: dict[str, tuple[str, int]]
    left_out: dict[str, int]
    note: str = ""


class _Gathered:
    """The rows of one topic, as they come: when (s) each arrived, and by how much that is after its stamp."""

    def __init__(self) -> None:
        self._arrived = array("d")
        self._late = array("d")
        self._at: dict[str, tuple[array[int], array[float]]] = {}

    def add(self, arrived: float, late: float, row: Mapping[str, object]) -> None:
        """Take a message; `late` is NaN of one that is not valid."""
        number, is_valid = len(self._arrived), late == late
        self._arrived.append(arrived)
        self._late.append(late)
        for name, value in row.items() if is_valid else ():
            if isinstance(value, float):
                if name not in self._at:
                    self._at[name] = array("q"), array("d")
                places, values = self._at[name]
                places.append(number)
                values.append(value)

    @property
    def late(self) -> Vector:
        """Arrival less stamp of what is valid."""
        late: Vector = np.array(self._late)
        return late[np.isfinite(late)]

    def track(self, farthest: float) -> Track:
        """Return the rows in order; those that arrived at most `farthest` s off their stamp by that."""
        times, late = np.array(self._arrived), np.array(self._late)
        times = np.where(np.abs(late) <= farthest, times - late, times)
        order = np.argsort(times, kind="stable")
        columns = {}
        for name, (places, values) in self._at.items():
            column = np.full(times.size, np.nan)
            column[np.array(places)] = values
            columns[name] = column[order]
        return Track(times[order], columns)


def contents_of(
    recording: Recording | Foreign, begin: float = 0.0, end: float = np.inf
) -> Contents:
    """Return what is in a recording, between two times in s since it began."""
    began, last = _span(recording)
    devices: dict[str, DeviceTracks] = {}
    gathered: dict[str, _Gathered] = {}
    others: dict[str, tuple[str, int]] = {}
    places: dict[str, tuple[str, str] | None] = {}
    every = {topic: -(-count // MOST) for topic, count in recording.counts.items()}
    seen: defaultdict[str, int] = defaultdict(int)
    for topic, type_name in recording.topics.items():
        place = places[topic] = _place(topic, type_name)
        if place is None:
            others[topic] = type_name, recording.counts[topic]
    for message in recording.messages():
        place = places.get(message.topic)
        at = (message.log_time - began) * SECOND
        if place is None or not begin <= at <= end:
            continue
        seen[message.topic] += 1
        if seen[message.topic] % max(1, every[message.topic]):
            continue
        namespace, name = place
        device = devices.setdefault(namespace, DeviceTracks(namespace))
        if name in _DRAWN:
            stamp_ns, _, row = row_of(message)
            late = (message.log_time - stamp_ns) * SECOND if stamp_ns else np.nan
            gathered.setdefault(message.topic, _Gathered()).add(at, late, row)
        else:
            _take_event(device, name, at, message)
    late_by = {topic: rows.late for topic, rows in gathered.items()}
    clocks = clocks_of(late_by, recording)
    for topic, rows in gathered.items():
        place = places[topic]
        assert place is not None
        devices[place[0]].tracks[place[1]] = rows.track(clocks.farthest(topic))
    left_out = {topic: number for topic, number in every.items() if number > 1}
    whole = (last - began) * SECOND
    seconds = min(whole, end) if end < np.inf else whole
    return Contents(began, seconds, devices, others, left_out, clocks.note)


def _span(recording: Recording | Foreign) -> tuple[int, int]:
    first, last = 0, 0
    for message in recording.messages():
        first = min(first or message.log_time, message.log_time)
        last = max(last, message.log_time)
    return first, last


_TEXTS: Final = ("refusals", "crtk_driver/status")


def _place(topic: str, type_name: str) -> tuple[str, str] | None:
    """Return namespace and CRTK name of a topic that is drawn; None if it is not."""
    for name in (*_DRAWN, "operating_state", *_TEXTS):
        if topic.endswith(f"/{name}"):
            return topic[: -len(name) - 1] or "/", name
    space, _, name = topic.rpartition("/")
    try:
        row = find(name)
    except KeyError:
        return None
    is_command = row.direction is Direction.COMMANDED and row.level is not Level.SETTING
    return (space or "/", name) if is_command else None


def _take_event(device: DeviceTracks, name: str, at: float, message: Message) -> None:
    _, _, row = row_of(message)
    if name == "operating_state":
        device.states.append((at, str(row.get("state", "?")), ""))
    elif name in _TEXTS:
        for content in _json(row.get("data")):
            if name == "refusals":
                words = str(content.get("command", "")), str(content.get("reason", ""))
                device.refusals.append((at, *words))
            else:
                words = str(content.get("state", "")), str(content.get("detail", ""))
                device.states.append((at, *words))
    else:
        device.commands[name].append(at)


def _json(text: object) -> Iterator[Mapping[str, object]]:
    try:
        content = json.loads(str(text))
    except (ValueError, RecursionError):
        return
    if isinstance(content, dict):
        yield content

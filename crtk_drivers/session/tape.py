"""What one device does, as messages for recordings: samples, setpoints, states, refusals, commands.

The topics are those of the node. What ROS has no topic for is below ``crtk_driver/``, JSON in a
std_msgs/String: ``status`` (the operating state with its reason), ``warnings``, ``health`` (counters, once
a second). The I/O thread only hands over references: a message is made where it is written.
"""

from __future__ import annotations

import json
import logging
import math
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, fields, is_dataclass
from typing import Any, Final, Protocol

import numpy as np
from typing_extensions import override

from crtk_drivers.commands import ROS_TYPES, Command, Direction, Level, Payload
from crtk_drivers.device import Reading
from crtk_drivers.engine import Engine, Observer
from crtk_drivers.errors import CommandRefused, WrongReading, unexpected
from crtk_drivers.motion.past import Moment
from crtk_drivers.recording import Raw, cdr
from crtk_drivers.recording.recorder import Entry
from crtk_drivers.samples import VALUE_TYPES, Stamp, Value
from crtk_drivers.state import OperatingState, Status

logger = logging.getLogger(__name__)

HEALTH_PERIOD: Final = 1.0

_NOT_RECORDED: Final = ("jacobian", "setpoint_cv", "setpoint_cf")
"""What follows from the rest, and is recorded only if it is asked for."""

_LATCHED: Final = (Level.GOAL, Level.SETTING)

LARGE: Final = 1 << 16
"""Bytes from which what a client sends is counted with what waits, or is kept: it may send any."""


class Sink(Protocol):
    """Takes an entry; must return at once."""

    def __call__(self, entry: Entry, messages: int, size: int = 0) -> object:
        """`messages` is how many it makes; `size` the bytes that it holds, 0: fewer than `LARGE`."""


def usual_topics(engine: Engine) -> tuple[str, ...]:
    """Return the CRTK names that are recorded of each sample unless others are asked for."""
    return tuple(
        name
        for name, command in engine.commands.items()
        if _is_sampled(command) and name not in _NOT_RECORDED and not command.frame
    )


def _is_sampled(command: Command) -> bool:
    return command.direction is Direction.PUBLISHED and command.level not in (
        Level.STATE,
        *_LATCHED,
    )


def refusal_text(refusal: CommandRefused, count: int) -> str:
    """Return a refusal as the topic ``refusals`` reports it; `count` is how many of its kind there were."""
    seconds, nanoseconds = divmod(refusal.stamp_ns, 1_000_000_000)
    content = {
        "command": refusal.command,
        "reason": refusal.reason.value,
        "message": refusal.detail,
        "remedy": refusal.remedy,
        "count": count,
        "stamp": {"sec": seconds, "nanosec": nanoseconds},
    }
    if refusal.state_command:
        content["state_command"] = refusal.state_command
    return json.dumps(content)


class Tape(Observer):
    """Hands over what one device does, to whoever writes or keeps it.

    Args:
        engine: of the device.
        namespace: that its topics are in.
        names: of the topics of each sample; empty: the usual ones.

    Attributes:
        namespace: as given.
    """

    def __init__(self, engine: Engine, namespace: str, names: Sequence[str] = ()) -> None:
        self.namespace = namespace
        self._engine = engine
        self._messages = engine.messages
        sampled = {name for name, command in engine.commands.items() if _is_sampled(command)}
        self.names = tuple(name for name in names if name in sampled) or usual_topics(engine)
        self._sinks: tuple[Sink, ...] = ()
        self._readings: dict[str, Value] = {}
        self._failed: set[str] = set()
        self._texts: dict[str, str] = {}
        self._refusals: Counter[tuple[str, str]] = Counter()
        self._health_due = 0.0

    def attach(self, keep: Callable[[Moment], object], sink: Sink) -> None:
        """Hand over to these from now on: moments, and all else."""
        engine = self._engine
        if not self._sinks:
            engine.add_observer(self)
            engine.hearers = (*engine.hearers, self._heard)
        self._sinks = (*self._sinks, sink)
        engine.keepers = (*engine.keepers, keep)

    def detach(self, keep: Callable[[Moment], object], sink: Sink) -> None:
        """Hand over to these no more."""
        engine = self._engine
        engine.keepers = tuple(each for each in engine.keepers if each != keep)
        self._sinks = tuple(each for each in self._sinks if each != sink)
        if not self._sinks:
            engine.hearers = tuple(each for each in engine.hearers if each != self._heard)
            engine.remove_observer(self)

    def teller(self) -> Callable[[str, int, Moment], Iterable[Raw]]:
        """Return the function of entries that makes the messages of moments; for one thread."""
        past, commands, names = self._engine.past(), self._engine.commands, self.names
        topics = {name: f"{self.prefix}{name}" for name in names}
        types = {name: ROS_TYPES[commands[name].payload] for name in names}

        def tell(_: str, log_time: int, moment: Moment) -> Iterator[Raw]:
            for name, value, stamp in past.values(moment, names):
                data = self._messages.of(name, commands[name], value, stamp)
                yield Raw(topics[name], types[name], data, log_time, stamp.wall_ns or log_time)

        return tell

    def standing(self) -> Iterator[Raw]:
        """Yield what holds now: state, goals, settings, readings."""
        now = time.time_ns()
        yield from self._of_status("operating_state", now, self._engine.status, now)
        for name, command in self._engine.commands.items():
            if command.level in _LATCHED and command.direction is Direction.PUBLISHED:
                yield from self._of_latched(name, now)
        for name, text in tuple(self._engine.standing.items()):
            self._texts[name] = text
            yield from self._of_standing(name, now, text)
        for name, reading in self._engine.readings.items():
            value = self._told(name, reading)
            if value is not None:
                self._readings[name] = value
                yield from self._of_reading(reading.told_as(name), now, reading.payload, value)

    def look(self) -> None:
        """Hand over readings and texts that have changed, and once a second the counters. In one thread."""
        now, sinks = time.time_ns(), self._sinks
        for name, text in tuple(self._engine.standing.items()):
            if self._texts.get(name) is not text:
                self._texts[name] = text
                for sink in sinks:
                    sink((self._of_standing, name, now, text), 1)
        for name, reading in self._engine.readings.items():
            value = self._told(name, reading)
            if value is None or value == self._readings.get(name):
                continue
            self._readings[name] = value
            for sink in sinks:
                sink((self._of_reading, reading.told_as(name), now, reading.payload, value), 1)
        if time.monotonic() >= self._health_due:
            self._health_due = time.monotonic() + HEALTH_PERIOD
            health = asdict(self._engine.health())
            if not math.isfinite(health["sample_age"]):
                health["sample_age"] = None
            for sink in sinks:
                sink((self._of_text, "crtk_driver/health", now, health, False), 1)

    def _told(self, name: str, reading: Reading) -> Value | None:
        """Return a reading; one that fails is not known, told once, and keeps no other from being told."""
        try:
            return reading.tell()
        except WrongReading:  # it has been logged
            return None
        except Exception as error:
            if name not in self._failed:
                logger.warning("recording: %s is left out: %s", name, unexpected(error))
            self._failed.add(name)
            return None

    @property
    def prefix(self) -> str:
        """What comes before the names of the device's topics."""
        return f"{self.namespace.rstrip('/')}/"

    # ---------------------------------------------------------------------------------- what is told

    @override
    def status_changed(self, status: Status, stamp: Stamp) -> None:
        entry = (self._of_status, "operating_state", time.time_ns(), status, stamp.wall_ns)
        for sink in self._sinks:
            sink(entry, 2)

    @override
    def command_refused(self, refusal: CommandRefused) -> None:
        kind = refusal.command, refusal.reason.value
        if len(self._refusals) < 4096:  # any text may be submitted
            self._refusals[kind] += 1
        entry = (self._of_refusal, "refusals", time.time_ns(), refusal, self._refusals[kind])
        for sink in self._sinks:
            sink(entry, 1)

    @override
    def latched(self, name: str) -> None:
        entry = (self._of_latched, name, time.time_ns())
        for sink in self._sinks:
            sink(entry, 1)

    @override
    def warned(self, text: str) -> None:
        entry = (self._of_text, "crtk_driver/warnings", time.time_ns(), {"text": text}, False)
        for sink in self._sinks:
            sink(entry, 1)

    def _heard(self, name: str, value: Value | None, stamp_ns: int) -> None:
        if self._payload(name) is None:  # any text may be submitted; the refusal is recorded
            return
        entry = (self._of_command, name, time.time_ns(), value, stamp_ns)
        size = _size(value)
        for sink in self._sinks:
            sink(entry, 1, size if size >= LARGE else 0)

    # ---------------------------------------------------------------------------------- the messages

    def _of_status(self, name: str, log_time: int, status: Status, stamp_ns: int) -> Iterator[Raw]:
        if not self._engine.has_state:  # it follows that of another one
            return
        data = cdr.encode(status, stamp_ns)
        yield self._raw(name, cdr.TYPE_NAMES[Status], data, log_time, stamp_ns, True)
        told = {"state": str(status.state), "detail": status.detail, "remedy": status.remedy}
        yield from self._of_text("crtk_driver/status", log_time, told, True)

    def _of_refusal(
        self, name: str, log_time: int, refusal: CommandRefused, count: int
    ) -> Iterator[Raw]:
        data = cdr.encode_text(refusal_text(refusal, count))
        yield self._raw(name, cdr.TEXT_TYPE, data, log_time)

    def _of_latched(self, name: str, log_time: int) -> Iterator[Raw]:
        found, command = self._engine.latched(name), self._engine.commands.get(name)
        if found is None or command is None:
            return
        value, stamp = found
        data = self._messages.encoded(name, command, value, stamp.wall_ns)
        yield self._raw(name, ROS_TYPES[command.payload], data, log_time, stamp.wall_ns, True)

    def _of_command(
        self, name: str, log_time: int, value: Value | None, stamp_ns: int
    ) -> Iterator[Raw]:
        payload = self._payload(name)
        assert payload is not None
        if value is not None and type(value) is not VALUE_TYPES.get(payload):
            return
        frame_id = self._messages.outgoing(getattr(value, "frame_id", ""))
        data = cdr.NOTHING if value is None else cdr.encode(value, stamp_ns, frame_id)
        yield self._raw(name, ROS_TYPES[payload], data, log_time, stamp_ns)

    def _payload(self, name: str) -> Payload | None:
        command, taken = self._engine.commands.get(name), self._engine.inputs.get(name)
        if command is not None:
            return command.payload
        if taken is not None:
            return taken.payload
        return Payload.TEXT if name == "state_command" else None

    def _of_reading(
        self, name: str, log_time: int, payload: Payload, value: Value
    ) -> Iterator[Raw]:
        data = cdr.encode(value, log_time, self._messages.outgoing(getattr(value, "frame_id", "")))
        yield self._raw(name, ROS_TYPES[payload], data, log_time, 0, True)

    def _of_standing(self, name: str, log_time: int, text: str) -> Iterator[Raw]:
        yield self._raw(name, cdr.TEXT_TYPE, cdr.encode_text(text), log_time, 0, True)

    def _of_text(
        self, name: str, log_time: int, content: Mapping[str, Any], is_latched: bool
    ) -> Iterator[Raw]:
        data = cdr.encode_text(json.dumps(content, default=str))
        yield self._raw(name, cdr.TEXT_TYPE, data, log_time, 0, is_latched)

    def _raw(
        self,
        name: str,
        type_name: str,
        data: bytes,
        log_time: int,
        stamp_ns: int = 0,
        is_latched: bool = False,
    ) -> Raw:
        topic = f"{self.prefix}{name}"
        return Raw(topic, type_name, data, log_time, stamp_ns or log_time, is_latched)


def _size(value: object) -> int:
    """Return the bytes of texts and numbers in a value, roughly."""
    match value:
        case str():
            return len(value)
        case np.ndarray():
            return value.nbytes
        case tuple():
            return 8 * len(value) + sum(map(_size, value))
    if is_dataclass(value):
        return sum(_size(getattr(value, each.name)) for each in fields(value))
    return 0


def is_new_fault(before: Status, status: Status) -> bool:
    """Whether a device has gone to FAULT, and was not on its way up."""
    fault = OperatingState.FAULT
    return status.state is fault and before.state is not fault and not status.connecting

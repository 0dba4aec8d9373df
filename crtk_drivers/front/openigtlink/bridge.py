"""CRTK devices for programs that speak OpenIGTLink, as 3D Slicer and Plus: they are told, and may command.

A command goes the way of any client's, through the checks and the arbiter of the device; what a connection
has begun ends with it.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Iterable, Mapping
from functools import partial
from typing import Any, Final

from crtk_drivers.commands import Command, Level, Payload
from crtk_drivers.errors import CommandRefused, ConfigError, CrtkError, Reason, unexpected
from crtk_drivers.front.base import DeviceFront
from crtk_drivers.front.openigtlink.bodies import (
    NAME,
    NAMES,
    STATUS,
    Capability,
    Empty,
    QuaternionTrackingData,
    Reply,
    Start,
    StatusBody,
    String,
    Tracked,
    TrackingData,
    Transform,
)
from crtk_drivers.front.openigtlink.bridged import ERROR, BridgedDevice, Feed
from crtk_drivers.front.openigtlink.codec import Damaged, Message, crc64
from crtk_drivers.front.openigtlink.connection import Connection
from crtk_drivers.front.openigtlink.message_values import MILLIMETRES, as_type, value_of
from crtk_drivers.motion.move import Move
from crtk_drivers.options import TOO_LATE
from crtk_drivers.status.throttle import Throttle

logger = logging.getLogger(__name__)

RATE: Final = 60.0
"""Hz at which values are looked at."""
FASTEST: Final = 1000.0
STATUS_PERIOD: Final = 1.0
"""Seconds after which a status is told again, changed or not."""
SEEN: Final = 0.5
"""Seconds after which a tool that tells no new pose is left out: tracking data has one stamp for all."""
LOG_INTERVAL: Final = 2.0

_TRACKING: Final = ("TDATA", "QTDATA")
_TYPES: Final = tuple(sorted({*NAMES.values()}))


class Bridge:
    """The devices behind one or more doors (`front.openigtlink.doors`). No thread before `start`.

    Args:
        devices: by the names that they have in OpenIGTLink.
        scale: of lengths of poses: `values.MILLIMETRES` or `values.METRES`.
        rate: Hz at which their values are looked at, and told where they are new.
        only: the CRTK names that are told; None: all that is measured, set, or a goal.
        takes: whether they can be commanded.
        version: of headers.

    Raises:
        ConfigError: a name that has no room in a message, or that no device tells.
        MissingExtra: a library is not installed.
    """

    def __init__(
        self,
        devices: Mapping[str, DeviceFront],
        *,
        scale: float = MILLIMETRES,
        rate: float = RATE,
        only: Iterable[str] | None = None,
        takes: bool = True,
        version: int = 1,
    ) -> None:
        crc64(b"")
        self.version = version
        names = None if only is None else tuple(only)
        self.devices = {
            name: BridgedDevice(name, front, scale, names, takes) for name, front in devices.items()
        }
        told = {each for device in self.devices.values() for each in device.tells}
        if lacking := [each for each in names or () if each not in told]:
            raise ConfigError(
                f"no device tells {', '.join(lacking)}",
                where=", ".join(self.devices),
                remedy=f"There is {', '.join(sorted(told)) or 'nothing that can be sent'}.",
            )
        self._scale = scale
        self._period = 1.0 / min(rate, FASTEST)
        self._commands = {
            name: (device, command)
            for device in self.devices.values()
            for name, command in device.commands.items()
        }
        self._feeds = [feed for device in self.devices.values() for feed in device.feeds]
        self._lock = threading.Lock()
        self._connections: list[Connection] = []
        self._latest: dict[str, Message] = {}
        self._came: dict[str, float] = {}
        self._statuses: dict[str, StatusBody] = {}
        self._statuses_due = 0.0
        self._failures = Throttle(LOG_INTERVAL)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="igtl values", daemon=True)

    def __enter__(self) -> Bridge:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def start(self) -> None:
        """Begin to tell values to whoever is connected."""
        self._thread.start()

    def close(self, timeout: float = 2.0) -> None:
        """Let all peers go, which ends what they have begun. The devices stay open. May be called twice."""
        self._stopping.set()
        connections = self.connections
        for connection in connections:
            connection.end()
        for connection in connections:
            connection.join(timeout)
        if self._thread.is_alive():
            self._thread.join(timeout)

    @property
    def connections(self) -> tuple[Connection, ...]:
        """Who is connected."""
        with self._lock:
            return tuple(self._connections)

    def join(self, connection: Connection) -> None:
        """Take a new peer; it is told the newest of everything at once."""
        statuses = self._status_messages()
        with self._lock:
            self._connections.append(connection)
            known = list(self._latest.values())
        logger.info("%s is connected", connection.where)
        connection.offer(known)
        connection.offer(statuses)
        connection.start()

    # ------------------------------------------------------------------------------------------- values

    def _run(self) -> None:
        due = time.monotonic()
        while not self._stopping.wait(max(0.0, due - time.monotonic())):
            now = time.monotonic()
            due = max(due + self._period, now)
            try:
                self._tell(now)
            except Exception as error:
                if self._failures.passes(type(error), now):
                    logger.exception("values are not told: %s", unexpected(error))

    def _tell(self, now: float) -> None:
        found = [
            message for feed in self._feeds if (message := self._newest(feed, now)) is not None
        ]
        with self._lock:
            self._latest.update({message.device: message for message in found})
            self._came.update({message.device: now for message in found})
        if now >= self._statuses_due:
            self._statuses_due = now + STATUS_PERIOD
            self._statuses = {}
        found += [each for each in self._status_messages() if self._is_news(each)]
        for connection in self.connections:
            connection.offer(found)
            connection.offer(self._bundles_due(connection, now))

    def _newest(self, feed: Feed, now: float) -> Message | None:
        """Return the newest value; one that cannot be read keeps no other from being told."""
        try:
            return feed.newest()
        except Exception as error:
            if self._failures.passes((feed.device, type(error)), now):
                logger.exception("%s is not told: %s", feed.device, unexpected(error))
            return None

    def _status_messages(self) -> list[Message]:
        now = time.time_ns()
        return [
            Message(name, device.status(), stamp_ns=now) for name, device in self.devices.items()
        ]

    def _is_news(self, message: Message) -> bool:
        body = message.body
        assert isinstance(body, StatusBody)
        is_new = self._statuses.get(message.device) != body
        self._statuses[message.device] = body
        return is_new

    def _bundles_due(self, connection: Connection, now: float) -> list[Message]:
        found = []
        for kind, period in list(connection.bundles.items()):
            if now >= connection.due.get(kind, 0.0):
                connection.due[kind] = now + period
                found.append(self._bundle(kind))
        return found

    def _bundle(self, kind: str, device: str = "") -> Message:
        """Return where the tools are that are seen now, as one message, with the stamp of the oldest."""
        tools, stamps = [], []
        for name, latest in self._poses():
            assert isinstance(latest.body, Transform)
            tools.append(Tracked(name, latest.body.matrix))
            stamps.append(latest.stamp_ns)
        make = TrackingData if kind == "TDATA" else QuaternionTrackingData
        return Message(device or "tools", make(tuple(tools)), kind, min(stamps, default=0))

    def _poses(self) -> list[tuple[str, Message]]:
        begun = time.monotonic() - SEEN
        with self._lock:
            latest = {key: each for key, each in self._latest.items() if self._came[key] > begun}
        return [
            (name, latest[f"{name}/measured_cp"])
            for name in self.devices
            if f"{name}/measured_cp" in latest
        ]

    # ----------------------------------------------------------------------------------- from the peers

    def command(self, device: str) -> Command | None:
        """See `connection.Served`."""
        found = self._commands.get(device)
        return None if found is None else found[1]

    def take(self, connection: Connection, message: Message) -> None:
        """See `connection.Served`."""
        verb, kind = message.type[:4], message.type[4:]
        if verb in ("GET_", "STT_", "STP_"):
            self._asked(connection, message, verb, kind)
            return
        found = self._commands.get(message.device)
        if found is None:
            if message.type not in ("STATUS", "CAPABILITY") and not message.type.startswith("RTS_"):
                self._complain(connection, message.device, "not found", self._unknown(message))
            return
        device, command = found
        try:
            self._carry_out(connection, device, command, message)
        except CrtkError as error:
            self._tell_refusal(connection, device, command, error)

    def _tell_refusal(
        self, connection: Connection, device: BridgedDevice, command: Command, error: CrtkError
    ) -> None:
        connection.answer(
            Message(f"{device.name}/{ERROR}", String(f"{error}"), stamp_ns=time.time_ns())
        )
        if self._failures.passes((device.name, type(error), command.name), time.monotonic()):
            logger.warning("%s: %s: %s", connection.where, device.name, error)

    def refuse(self, connection: Connection, damaged: Damaged) -> None:
        """See `connection.Served`."""
        how = "checksum error" if damaged.is_checksum else "unknown error"
        self._complain(connection, damaged.device, how, f"{damaged.type}: {damaged.why}")

    def left(self, connection: Connection) -> None:
        """See `connection.Served`. It is one of the connections until what it has begun has been held."""
        for device in self.devices.values():
            homes = device.stops_homing(connection)
            if not device.ownership.leave(connection) and not homes:
                continue
            try:
                device.hold()
                logger.warning("%s is gone while it moved %s: held", connection.where, device.name)
            except Exception as error:  # the other devices are held, whatever this one has
                logger.error(
                    "%s is gone while it moved %s, and that cannot be held: %s",
                    connection.where,
                    device.name,
                    error if isinstance(error, CrtkError) else unexpected(error),
                )
        with self._lock:
            if connection in self._connections:
                self._connections.remove(connection)
        logger.info("%s is gone", connection.where)

    def _carry_out(
        self, connection: Connection, device: BridgedDevice, command: Command, message: Message
    ) -> None:
        try:
            value = value_of(command, message.body, self._scale)
        except (TypeError, ValueError) as error:
            raise CommandRefused(
                command.name,
                Reason.WRONG_TYPE,
                f"{message.type} holds no {command.payload}: {error}",
                where=device.name,
                remedy="See the table of messages in the documentation.",
            ) from error
        if command.level is Level.SERVO:
            late = connection.late(message, time.monotonic())
            if late > TOO_LATE:
                raise CommandRefused(
                    command.name,
                    Reason.TOO_OLD,
                    f"the network kept it for {late:.1f} s, by its stamp and those before it",
                    where=device.name,
                    remedy="Send where to go now.",
                )
        if command.name == "hold":
            device.ownership.hold(connection)
            device.hold()
        elif command.name == "state_command":
            device.front.state_command(value, timeout=0.0)
        else:
            device.ownership.claim(connection, command)
            send = device.senders[command.name]
            try:
                begun = send() if command.payload is Payload.EMPTY else send(value)
            except CrtkError:
                device.ownership.refused(connection)
                raise
            move = begun if command.level is Level.MOVE else None
            device.ownership.began(connection, move)
            if move is not None:
                ended = partial(self._move_ended, connection, device, command, move)
                move.when_ended(ended)
        device.began(connection, command, value)

    def _move_ended(
        self, connection: Connection, device: BridgedDevice, command: Command, move: Move
    ) -> None:
        """Tell a refusal that comes after the call, as of a device on the far side of ROS. Never waits."""
        refusal = getattr(move, "refusal", None)
        if refusal is not None:
            device.ownership.refused(connection, move)
            self._tell_refusal(connection, device, command, refusal)

    def _unknown(self, message: Message) -> str:
        name = message.device.partition("/")[0]
        device = self.devices.get(name)
        if device is None:
            return f"no device {name}; there is {', '.join(self.devices)}"
        return f"{name} takes {', '.join(each.partition('/')[2] for each in device.commands) or 'nothing'}"

    def _complain(self, connection: Connection, device: str, how: str, text: str) -> None:
        if self._failures.passes((connection.where, device, how), time.monotonic()):
            logger.warning("%s: %s: %s", connection.where, device, text)
        body = StatusBody(STATUS[how], "", text)
        connection.answer(Message(device[:NAME], body, stamp_ns=time.time_ns()))

    # ------------------------------------------------------------------------------------------- queries

    def _asked(self, connection: Connection, message: Message, verb: str, kind: str) -> None:
        kind = next((each for each in _TYPES if each[:8] == kind), kind)
        if kind.startswith("CAPABIL"):
            connection.answer(Message(message.device, Capability(_TYPES)))
        elif kind not in _TYPES:
            self._complain(connection, message.device, "unknown instruction", message.type)
        elif verb == "GET_":
            for each in self._answers(kind, message.device):
                connection.answer(each)
        else:
            done = self._subscribed(connection, message, verb, kind)
            connection.answer(
                Message(message.device, Reply(done), f"RTS_{kind}", stamp_ns=time.time_ns())
            )

    def _answers(self, kind: str, device: str) -> list[Message]:
        """Return what is known of a name, or of any; a message without a body where nothing is."""
        nothing = [Message(device, Empty(), kind)]
        if kind == "STATUS":
            found = self._status_messages()
            return [each for each in found if device in ("", each.device)] or nothing
        if kind in _TRACKING and device.partition("/")[0] not in self.devices:
            return [self._bundle(kind, device)]
        with self._lock:
            latest = list(self._latest.values())
        return [
            each
            for known in latest
            if device in ("", known.device) or known.device == f"{device}/measured_cp"
            if (each := _as_asked(kind, known)) is not None
        ] or nothing

    def _subscribed(self, connection: Connection, message: Message, verb: str, kind: str) -> bool:
        is_start, device = verb == "STT_", message.device
        if kind in _TRACKING:
            if not is_start:
                connection.bundles.pop(kind, None)
                return True
            body = message.body
            resolution = body.resolution if isinstance(body, Start) else 0
            connection.due.pop(kind, None)
            connection.bundles[kind] = max(self._period, resolution * 1e-3)
            return True
        known = {feed.device for feed in self._feeds} | set(self.devices)
        if device and device not in known:
            return False
        if is_start:
            connection.stopped.discard((kind, device))
        else:
            connection.stopped.add((kind, device))
        return True


def _as_asked(kind: str, known: Message) -> Message | None:
    """Return what is known as a message of a type; None if it cannot be one."""
    body: Any = known.body if known.type == kind else None
    if body is None and isinstance(known.body, Transform):
        body = as_type(kind, known.body, known.device.partition("/")[0])
    if body is None:
        return None
    return Message(known.device, body, stamp_ns=known.stamp_ns, metadata=known.metadata)

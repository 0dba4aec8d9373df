"""One CAN bus through python-can: opened, sent to, received from, with typed errors.

It belongs to one thread, the one that opens it: that one sends and receives. Others hand over frames
with `post`; they are sent by that thread, some in each cycle, so that they never delay it.
"""

from __future__ import annotations

import logging
import math
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Final

from typing_extensions import override

from crtk_driver_canopen.bus_state import (
    FATAL,
    BusCounters,
    BusLost,
    Condition,
    bus_lost,
    condition_of_error,
    conditions_of_frame,
)
from crtk_driver_canopen.frames import ERROR, STANDARD, Frame
from crtk_drivers.errors import ConfigError, ConnectionFailed, MissingExtra

try:
    import can

    from crtk_driver_canopen.ports import Port, port_of
except ImportError as error:  # pragma: no cover - the extra is installed where tests run
    raise MissingExtra("python-can", "canopen") from error

Handler = Callable[[bytes, float], None]
"""Takes the data of a frame, and when it was received in monotonic seconds."""

Record = Callable[[Frame], None]
"""Takes a frame that was sent or received, with the time of day."""

FULL_LIMIT: Final = 2
"""Cycles in a row in which there may be no room to send."""

_OVERDUE: Final = 1024
"""Frames that are taken when the time is over: those that waited, but not all that a babbling node sends."""

_SLICE: Final = 0.005
"""Longest wait for a frame at once, in s: what other threads have handed over is sent after it."""

_SERVER_TIMEOUT: Final = 2.0
"""Seconds for a socketcand server to accept a connection."""

_POSTED_AT_ONCE: Final = 4
"""Frames of other threads that are sent at once."""

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class BusAddress:
    """Which bus: what python-can's `can.Bus` takes.

    Attributes:
        bitrate: in bit/s. Where the kernel sets it (socketcan) it is only reckoned with.
        options: further arguments of the interface, for example ``host`` and ``port`` of socketcand.
    """

    interface: str
    channel: str
    bitrate: int
    options: Mapping[str, Any] = field(default_factory=dict)

    @override
    def __str__(self) -> str:
        return f"{self.interface} {self.channel}".strip()


_KERNEL_SETS_BITRATE: Final = frozenset({"socketcan", "socketcand", "virtual", "udp_multicast"})

_DEFAULT_OPTIONS: Final[Mapping[str, Mapping[str, Any]]] = MappingProxyType(
    {"socketcand": {"tcp_tune": True}}
)
"""Where python-can's own defaults are too slow for a cycle: without it TCP collects small frames."""


_OWN_FRAMES_UNMARKED: Final = frozenset({"udp_multicast"})
"""Interfaces that give back what is sent, as if somebody else had sent it."""


class CanLink:
    """Frames of one bus.

    Args:
        address: which bus.
        record: given every frame that is sent or received; see `crtk_driver_canopen.candump`.

    Attributes:
        counters: see `BusCounters`.
        condition: what is known of the controller.
        give_up_at: monotonic seconds at which whoever waits in `poll` gives up, while drives are looked for.
    """

    def __init__(self, address: BusAddress, record: Record | None = None) -> None:
        self.address = address
        self.counters = BusCounters()
        self.condition = Condition.GOOD
        self._record = record
        self._bus: can.BusABC | None = None
        self._port: Port | None = None
        self._thread = 0
        self._sending = threading.Lock()
        self._aborted = threading.Event()
        self.give_up_at = math.inf
        self._handlers: dict[int, Handler] = {}
        self._arrived: deque[Frame] = deque()
        self._posted: deque[Frame] = deque(maxlen=1024)
        self._echoes = bool(address.options.get("receive_own_messages"))
        self._full = 0

    @property
    def where(self) -> str:
        """The bus, for errors."""
        return f"canopen {self.address}"

    @property
    def bus(self) -> can.BusABC:
        """python-can's bus.

        Raises:
            BusLost: it is not open.
        """
        if self._bus is None:
            raise self._not_open()
        return self._bus

    @property
    def is_open(self) -> bool:
        """Whether the bus is open."""
        return self._bus is not None

    @property
    def hears_itself(self) -> bool:
        """Whether frames that were sent come back, and cannot be told from those of others."""
        return self.address.interface in _OWN_FRAMES_UNMARKED

    @property
    def owned(self) -> bool:
        """Whether this is the thread that sends and receives."""
        return self._thread == threading.get_ident()

    # Opening and closing

    def open(self) -> None:
        """Open the bus; this thread then owns it.

        Raises:
            ConfigError: python-can knows no such interface, or it refuses the options.
            ConnectionFailed: the bus cannot be opened.
        """
        self.close()
        address = self.address
        options = {**_DEFAULT_OPTIONS.get(address.interface, {}), **address.options}
        if address.interface not in _KERNEL_SETS_BITRATE:
            options.setdefault("bitrate", address.bitrate)
        try:
            if address.interface == "socketcand":
                _check_server(options)
            self._bus = can.Bus(interface=address.interface, channel=address.channel, **options)
        except (can.CanInterfaceNotImplementedError, TypeError, ValueError) as error:
            raise ConfigError(
                f"python-can cannot use it: {_reason(error)}",
                where=self.where,
                remedy="Check `bus.interface` and `bus.options`; interfaces: "
                f"{', '.join(sorted(can.VALID_INTERFACES))}",
            ) from error
        except (can.CanError, OSError) as error:
            raise ConnectionFailed(
                f"cannot be opened: {_reason(error)}",
                where=self.where,
                remedy="Check that the adapter is plugged in and the interface is up "
                "(ip link show), or that the server of the bus is running.",
            ) from error
        self._port = port_of(self._bus)
        self._thread = threading.get_ident()
        self._full = 0
        self._arrived.clear()
        self._posted.clear()
        self.condition = Condition.GOOD

    def close(self) -> None:
        """Close the bus; does nothing if it is not open."""
        bus, self._bus, self._port = self._bus, None, None
        if bus is None:
            return
        try:
            bus.shutdown()
        except (can.CanError, OSError) as error:
            logger.warning("%s: closing: %s", self.where, error)

    # Sending

    def send(self, *frames: Frame) -> bool:
        """Send frames, one after the other; return whether there was room for all.

        Raises:
            BusLost: the bus cannot be used, or has had no room for more than `FULL_LIMIT` cycles.
        """
        if self._port is None:
            raise self._not_open()
        try:
            with self._sending:
                count = self._port.send(frames)
        except (can.CanError, OSError) as error:
            self._lose(condition_of_error(error), _reason(error), error)
        self.counters.sent += count
        if self._record is not None:
            now = time.time()
            for frame in frames[:count]:
                self._record(frame._replace(time=now))
        complete = count == len(frames)
        self.counters.full += not complete
        return complete

    def end_cycle(self, complete: bool) -> None:
        """Take note of whether all frames of a cycle could be sent.

        Raises:
            BusLost: there was no room for more than `FULL_LIMIT` cycles in a row.
        """
        self._full = 0 if complete else self._full + 1
        if self._full > FULL_LIMIT:
            # A controller that went off the bus often only shows that its queue stays full.
            condition = self.condition if self.condition in FATAL else Condition.FULL
            self._lose(condition, f"for {self._full} cycles in a row", None)

    def post(self, cob_id: int, data: bytes) -> None:
        """Have a frame sent, from any thread.

        Raises:
            BusLost: the bus is not open, or cannot be used.
        """
        frame = Frame(cob_id, data)
        if not self.owned:
            _ = self.bus
            self._posted.append(frame)
        elif not self.send(frame):
            self._retry(frame)

    def send_aside(self, frames: Sequence[Frame], timeout: float) -> bool:
        """Send frames at once, from another thread than the one that owns the bus, which may be stuck.

        Args:
            timeout: seconds for that one to end what it is sending.

        Returns:
            Whether there was room for all.
        """
        port = self._port
        if port is None or not self._sending.acquire(timeout=timeout):
            return False
        try:
            return port.send(frames) == len(frames)
        except (can.CanError, OSError) as error:
            logger.warning("%s: %s", self.where, _reason(error))
            return False
        finally:
            self._sending.release()

    def _retry(self, frame: Frame) -> None:
        """Wait a little for room, in the owning thread and outside of a cycle."""
        for _ in range(20):
            time.sleep(0.001)
            if self.send(frame):
                return
        self._lose(Condition.FULL, "for 20 ms", None)

    def send_posted(self) -> None:
        """Send some of what other threads have handed over.

        Raises:
            BusLost: the bus cannot be used.
        """
        posted = self._posted
        for _ in range(min(len(posted), _POSTED_AT_ONCE)):
            frame = posted.popleft()
            if not self.send(frame):
                posted.appendleft(frame)
                return

    # Receiving

    def subscribe(self, cob_id: int, handler: Handler) -> None:
        """Have `handler` called for the frames of a COB-ID, in the owning thread."""
        self._handlers[cob_id] = handler

    def unsubscribe(self, cob_id: int) -> None:
        """Forget the handler of a COB-ID."""
        self._handlers.pop(cob_id, None)

    def receive(self, timeout: float) -> Frame | None:
        """Return the next data frame, None when none came in time.

        Args:
            timeout: seconds; 0 or less: one that is there already.

        Raises:
            BusLost: the bus cannot be used.
        """
        arrived = self._arrived
        if not arrived:
            if self._port is None:
                raise self._not_open()
            try:
                arrived.extend(self._port.receive(timeout))
            except (can.CanError, OSError) as error:
                self._lose(condition_of_error(error), _reason(error), error)
            if not arrived:
                return None
        frame = arrived.popleft()
        if self._record is not None:
            self._record(frame if frame.time else frame._replace(time=time.time()))
        if frame.can_id > STANDARD:
            self._set_aside(frame)
            return None
        self.counters.received += 1
        return frame

    def _set_aside(self, frame: Frame) -> None:
        """Take what is no data frame of CANopen."""
        if frame.can_id & ERROR:
            self._take_error(frame)
        else:
            self.counters.unknown += 1

    def dispatch(self, frame: Frame, now: float) -> None:
        """Give a frame to the handler of its COB-ID; our own ones, where they come back, to none."""
        if self._echoes and frame.own:
            return
        handler = self._handlers.get(frame.can_id)
        if handler is None:
            self.counters.unknown += 1
        else:
            handler(frame.data, now)

    def poll(self, until: float, done: Callable[[], bool] | None = None) -> bool:
        """Receive and dispatch, and send what others posted, until a time or until `done`.

        Args:
            until: monotonic seconds.
            done: asked after each frame.

        Returns:
            Whether `done` was so.

        Raises:
            BusLost: the bus cannot be used.
            ConnectionFailed: opening was aborted.
        """
        until, overdue = min(until, self.give_up_at), 0
        while overdue < _OVERDUE:
            self.check_aborted()
            self.send_posted()
            if done is not None and done():
                return True
            now = time.monotonic()
            frame = self.receive(min(until - now, _SLICE))
            overdue += now >= until
            if frame is not None:
                self.dispatch(frame, time.monotonic())
            elif now >= until:
                return False
        return False

    def abort_open(self) -> None:
        """End an opening that waits, and let later ones fail. From any thread."""
        self._aborted.set()

    def check_aborted(self) -> None:
        """See that nobody has aborted the opening that is under way.

        Raises:
            ConnectionFailed: somebody has.
        """
        if self.give_up_at < math.inf and self._aborted.is_set():
            raise ConnectionFailed("opening was given up", where=self.where)

    def _take_error(self, frame: Frame) -> None:
        self.counters.error_frames += 1
        for condition in conditions_of_frame(frame.can_id, frame.data):
            if condition is Condition.OVERRUN:
                self.counters.overruns += 1
                continue
            self.counters.passive += condition is Condition.PASSIVE
            self.counters.bus_off += condition is Condition.BUS_OFF
            self.condition = condition
            if condition in FATAL:
                self._lose(condition, "told by the controller", None)

    def _not_open(self) -> BusLost:
        return bus_lost(Condition.GONE, "it is not open", self.where)

    def _lose(self, condition: Condition, text: str, error: Exception | None) -> None:
        self.condition = condition
        raise bus_lost(condition, text, self.where) from error


def _check_server(options: Mapping[str, Any]) -> None:
    """See that a socketcand server is there: python-can itself tries for 10 s without a pause.

    Raises:
        OSError: it is not.
        ValueError: there is no host or port.
    """
    missing = {"host", "port"} - set(options)
    if missing:
        raise ValueError(f"socketcand needs {' and '.join(sorted(missing))}")
    socket.create_connection((options["host"], options["port"]), _SERVER_TIMEOUT).close()


def _reason(error: Exception) -> str:
    return str(error).strip() or type(error).__name__

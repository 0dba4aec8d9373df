"""The state of the arm as it comes from the controller: one RTDE connection, no threads.

Freshness is judged by the controller's own time stamp, which advances with its control cycle, never
by the arrival of bytes: a repeated stamp is old data.
"""

from __future__ import annotations

import logging
import math
import os
import select
import socket
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar, cast

from crtk_driver_ur.rtde import codec
from crtk_driver_ur.rtde.codec import (
    ControllerVersion,
    DataPackage,
    Flat,
    Malformed,
    Message,
    Recipe,
    RtdeDecoder,
    RtdeFramingError,
    SetupReply,
    StateReply,
    TextMessage,
    VersionReply,
)
from crtk_driver_ur.rtde.echoes import Echoes
from crtk_driver_ur.rtde.state_sample import StateSample
from crtk_driver_ur.rtde.variables import IN_USE, NOT_FOUND, OPTIONAL_OUTPUTS, OUTPUTS
from crtk_drivers.errors import ConnectionFailed, ConnectionLost, ProtocolError
from crtk_drivers.kit.ready import await_connection

__all__ = ["RTDE_PORT", "RtdeStream", "StreamCounters"]

RTDE_PORT = 30004
MALFORMED_IN_A_ROW = 3
"""So many broken packages one after the other end the connection."""

ASK_AGAIN = 0.1
"""Seconds from one question, whose answer shows how old states are, to the next."""
UNANSWERED = 5.0
"""Seconds after which no answer comes any more; how old states are is not known then."""

_RECEIVE_SIZE = 16384
_RECEIVES_AT_ONCE = 64
_LOG_LEVELS = {0: logging.ERROR, 1: logging.ERROR, 2: logging.WARNING, 3: logging.INFO}
_RUNTIME_STATE = tuple(OUTPUTS).index("runtime_state")
_log = logging.getLogger(__name__)

ReplyT = TypeVar("ReplyT", VersionReply, ControllerVersion, SetupReply, StateReply)


@dataclass(slots=True)
class StreamCounters:
    """What happened on one connection so far, in packages."""

    received: int = 0
    skipped: int = 0
    lost: int = 0
    gaps: int = 0
    repeated: int = 0
    restarts: int = 0
    malformed: int = 0
    texts: int = 0


class RtdeStream:
    """One connection to the controller's real-time data exchange; it listens.

    While it does, it asks for the controller's version again and again. Packages and answers come in the
    order in which they were made: a package behind an answer was made after its question was sent.

    The object is used once: open, receive until it fails or is not wanted any more, close. `open` and
    `receive` belong to one thread; `close` may be called from any, also while they wait.

    Args:
        host: address or name of the controller.
        port: of the real-time data exchange.
        frequency: samples per second; None for the rate of the controller.
        sees_all: the controller sends all of its states; of those that are no samples: `StateSample.passed`.
        protocol_version: the highest to ask for, 1 or 2.
        clock: the monotonic clock.

    Attributes:
        nonsense: variable for which the last package was dropped; empty since one was good.
    """

    def __init__(
        self,
        host: str,
        *,
        port: int = RTDE_PORT,
        frequency: float | None = None,
        sees_all: bool = False,
        protocol_version: int = 2,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.host = host
        self.port = port
        self._wanted_frequency = frequency
        self._sees_all = sees_all
        self._wanted_protocol = protocol_version
        self._clock = clock
        self._where = f"RTDE {host}:{port}"
        self._busy = threading.Lock()
        self._waking = threading.Lock()
        self._closing = threading.Event()
        self._opened = False
        self._socket: socket.socket | None = None
        self._wake = -1
        self._poll = select.poll()
        self._decoder = RtdeDecoder()
        self._recipe: Recipe | None = None
        self._missing: tuple[str, ...] = ()
        self._group: Callable[[Flat], tuple[Any, ...]]
        self._controller_version = ControllerVersion(0, 0, 0, 0)
        self._frequency = 0.0
        self._every = 1  # package becomes a sample
        self._held = 0  # packages since the last sample
        self._passed: set[int] = set()
        self._early: list[DataPackage] = []
        self._echoes = Echoes()
        self._asked = 0  # number of the question that is not answered yet
        self._answered = 0  # of that whose answer no package has followed yet
        self._asked_at = -math.inf
        self._cycle = 0.0
        self._timestamp: float | None = None
        self._malformed_row = 0
        self._counters = StreamCounters()
        self.nonsense = ""

    @property
    def address(self) -> str:
        """Host and port, for messages."""
        return f"{self.host}:{self.port}"

    @property
    def controller_version(self) -> ControllerVersion:
        """Version of the controller's software; known when open."""
        return self._controller_version

    @property
    def protocol_version(self) -> int:
        """The protocol version in force."""
        return self._decoder.protocol_version

    @property
    def frequency(self) -> float:
        """Samples per second; known when open."""
        return self._frequency

    @property
    def missing(self) -> tuple[str, ...]:
        """Optional variables that this controller does not know."""
        return self._missing

    @property
    def counters(self) -> StreamCounters:
        """What happened so far."""
        return replace(self._counters)

    def age(self, state: StateSample) -> float:
        """Return how old a state may have been when it was received, s; 0 where that is not known."""
        return self._echoes.age(state.received, state.timestamp)

    def open(self, deadline: float) -> None:
        """Connect, agree on version and variables, and start the stream.

        Args:
            deadline: on the monotonic clock.

        Raises:
            ConnectionFailed: unreachable, or silent, or without a variable that is needed.
            ProtocolError: the peer's answers are not RTDE.
        """
        with self._busy:
            if self._opened:
                raise RuntimeError("an RtdeStream is opened once; make a new one")
            self._opened = True
            if self._closing.is_set():
                raise self._closed()
            started = False
            try:
                self._wake = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
                self._connect(deadline)
                self._negotiate(deadline)
                started = True
            except ConnectionLost as error:
                raise ConnectionFailed(
                    f"while connecting: {error.message}", where=error.where, remedy=error.remedy
                ) from error
            finally:
                if not started:
                    self._release()

    def receive(self, deadline: float) -> StateSample | None:
        """Return the newest sample, or None if none arrived by the monotonic `deadline`, or until `wake`.

        Older packages that have arrived as well are counted and dropped.

        Raises:
            ConnectionLost: the controller closed the connection, or `close` was called.
            ProtocolError: what arrives is not RTDE any more.
        """
        with self._busy:
            if self._socket is None:
                raise self._closed()
            while True:
                self._ask_for_age()
                if not self._early and not self._wait(select.POLLIN, deadline):
                    return None
                newest, count = self._read_packages()
                if newest is not None:
                    sample = self._sample(newest, count)
                    if sample is not None:
                        return sample
                if self._clock() >= deadline:
                    return None

    def wake(self) -> bool:
        """Let a `receive` that waits, or else the next one, return None; return whether it is open."""
        with self._waking:
            if self._wake < 0:
                return False
            os.eventfd_write(self._wake, 1)
            return True

    def close(self) -> None:
        """Close the connection; a waiting `receive` ends. May be called twice, from any thread."""
        self._closing.set()
        self.wake()
        with self._busy:
            self._release()

    def _release(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None
        with self._waking:
            if self._wake >= 0:
                os.close(self._wake)
                self._wake = -1

    def _closed(self) -> ConnectionLost:
        return ConnectionLost("the stream is closed", where=self._where, remedy="Open a new one.")

    def _connect(self, deadline: float) -> None:
        try:
            found = socket.getaddrinfo(self.host, self.port, type=socket.SOCK_STREAM)
        except OSError as error:
            raise ConnectionFailed(
                f"{self.host!r} cannot be resolved: {error}",
                where=self._where,
                remedy="Give the controller's IP address (teach pendant: Settings, System, Network).",
            ) from error
        family, kind, protocol, _, address = found[0]
        peer = socket.socket(family, kind, protocol)
        self._socket = peer
        peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._poll = select.poll()
        self._poll.register(self._wake, select.POLLIN)
        self._poll.register(peer, 0)
        try:
            await_connection(peer, address, lambda: self._wait(select.POLLOUT, deadline))
        except ConnectionLost:
            raise  # closed by another thread
        except TimeoutError as error:
            raise ConnectionFailed(
                "nothing answers at this address",
                where=self._where,
                remedy="Check that the controller is on, the cable and the address (ping it).",
            ) from error
        except OSError as error:
            raise ConnectionFailed(
                f"cannot connect: {error.strerror}",
                where=self._where,
                remedy="Check the address, and that the controller has finished starting; "
                "PolyScope 5 can switch RTDE off under Settings, Security, Services.",
            ) from error

    def _negotiate(self, deadline: float) -> None:
        if self._wanted_protocol > 1:
            request = codec.encode_protocol_version(2)
            reply = self._ask(request, VersionReply, "protocol version", deadline)
            if reply.accepted:
                self._decoder.protocol_version = 2
        self._controller_version = self._ask(
            codec.encode_controller_version(), ControllerVersion, "controller version", deadline
        )
        base = 500.0 if self._controller_version.major >= 5 else 125.0
        wanted = min(self._wanted_frequency or base, base)
        # The controller sends on every n-th of its cycles.
        self._frequency, self._cycle = base, 1.0 / base
        if self._decoder.protocol_version > 1:
            self._frequency = base / math.floor(base / wanted)
        if self._sees_all:
            self._every, wanted = round(base / self._frequency), base
        self._setup(wanted, deadline)
        self._answered = self._echoes.leaves(self._clock())
        reply_to_start = self._ask(codec.encode_start(), StateReply, "start", deadline)
        if not reply_to_start.accepted:
            raise ConnectionFailed(
                "the controller refuses to start the stream",
                where=self._where,
                remedy="Close other RTDE clients, or restart the controller.",
            )

    def _setup(self, frequency: float, deadline: float) -> None:
        names = tuple(OUTPUTS)
        reply = self._ask_for_outputs(names, frequency, deadline)
        unknown = {name for name, kind in zip(names, reply.types, strict=True) if kind == NOT_FOUND}
        needed = sorted(unknown - OPTIONAL_OUTPUTS.keys())
        if needed:
            raise ConnectionFailed(
                f"controller software {self._controller_version} lacks {', '.join(needed)}",
                where=self._where,
                remedy="Update the controller's software (CB3: 3.5 or later, e-Series: any).",
            )
        if unknown:
            self._missing = tuple(sorted(unknown))
            names = tuple(name for name in names if name not in unknown)
            reply = self._ask_for_outputs(names, frequency, deadline)
        refused = [
            f"{name} ({kind})"
            for name, kind in zip(names, reply.types, strict=True)
            if kind in (NOT_FOUND, IN_USE)
        ]
        if refused or reply.recipe_id == 0:
            raise ConnectionFailed(
                f"the controller refuses the output variables {', '.join(refused) or names}",
                where=self._where,
                remedy="Close the other RTDE client (a second driver, a fieldbus) that claims them.",
            )
        for name, kind in zip(names, reply.types, strict=True):
            if kind != OUTPUTS[name]:
                raise ProtocolError(
                    f"{name} is announced as {kind}, but it is {OUTPUTS[name]}",
                    where=self._where,
                    remedy="Report it with the version of the controller's software.",
                )
        self._recipe = Recipe(reply.recipe_id or 0, names, reply.types)
        self._group = self._recipe.grouping(tuple(OUTPUTS))
        self._decoder.add_recipe(self._recipe)

    def _ask_for_outputs(
        self, names: Sequence[str], frequency: float, deadline: float
    ) -> SetupReply:
        request = codec.encode_output_setup(names, frequency, self._decoder.protocol_version)
        reply = self._ask(request, SetupReply, "output setup", deadline)
        if len(reply.types) != len(names):
            raise ProtocolError(
                f"{len(names)} variables asked for, {len(reply.types)} types in the answer",
                where=self._where,
                remedy="Check that this is the real-time data exchange of a UR controller.",
            )
        return reply

    def _ask(self, request: bytes, kind: type[ReplyT], what: str, deadline: float) -> ReplyT:
        """Send a request and return its reply; texts in between are logged."""
        peer = cast(socket.socket, self._socket)
        try:
            peer.sendall(request)
        except OSError as error:
            raise self._lost(error) from error
        while True:
            if not self._wait(select.POLLIN, deadline):
                raise ConnectionFailed(
                    f"connected, but the request for the {what} is not answered",
                    where=self._where,
                    remedy="Check that this is a UR controller that has finished starting; "
                    "restart it if it stays silent.",
                )
            messages = iter(self._read())
            for message in messages:
                if isinstance(message, kind):
                    self._early = [data for data in messages if isinstance(data, DataPackage)]
                    return message
                if not isinstance(message, TextMessage | DataPackage):
                    raise ProtocolError(
                        f"answer to the request for the {what} is {message}",
                        where=self._where,
                        remedy="Check that this is the real-time data exchange of a UR controller.",
                    )

    def _ask_for_age(self) -> None:
        """Send the question that shows how old packages are, if it is time and the last one is answered."""
        now = self._clock()
        if now < self._asked_at + (UNANSWERED if self._asked else ASK_AGAIN):
            return
        if self._asked:
            self._echoes.begin()
        try:
            cast(socket.socket, self._socket).sendall(codec.encode_controller_version())
        except BlockingIOError:  # nothing goes out: the packages will tell
            self._asked_at = now
        except OSError as error:
            raise self._lost(error) from error
        else:
            self._asked, self._asked_at = self._echoes.leaves(now), now

    def _take_answers(self, messages: Sequence[Message]) -> None:
        """See in messages that came in this order which of them answer a question."""
        for message in messages:
            if isinstance(message, ControllerVersion):
                self._answered, self._asked = self._asked, 0
            elif isinstance(message, DataPackage) and self._answered:
                # Its time may be that at which the cycle began in which the question came.
                made = self._group(message.flat())[0] + self._cycle
                if math.isfinite(made):
                    self._echoes.take(self._answered, made)
                    self._answered = 0

    def _wait(self, events: int, deadline: float) -> bool:
        """Wait for the socket until the deadline, or for `wake` or `close`; return whether it is ready."""
        peer = cast(socket.socket, self._socket)
        self._poll.modify(peer, events)
        ready = [file for file, _ in self._poll.poll(max(0.0, deadline - self._clock()) * 1000.0)]
        if self._closing.is_set():
            raise self._closed()
        if self._wake in ready:
            os.eventfd_read(self._wake)
            ready.remove(self._wake)
        return bool(ready)

    def _read(self) -> list[Message]:
        """Read what has arrived, log the texts, give up on what is not RTDE."""
        peer = cast(socket.socket, self._socket)
        data = b""
        for _ in range(_RECEIVES_AT_ONCE):
            try:
                chunk = peer.recv(_RECEIVE_SIZE)
            except BlockingIOError:
                break
            except OSError as error:
                raise self._lost(error) from error
            if not chunk:
                raise self._lost(None)
            data += chunk
            if len(chunk) < _RECEIVE_SIZE:
                break
        try:
            messages = self._decoder.feed(data)
        except RtdeFramingError as error:
            raise ProtocolError(
                str(error), where=self._where, remedy="Check for a proxy or a second writer."
            ) from error
        for message in messages:
            if isinstance(message, Malformed):
                self._count_malformed(message)
            else:
                self._malformed_row = 0
                if isinstance(message, TextMessage):
                    self._counters.texts += 1
                    level = _LOG_LEVELS.get(message.level, logging.WARNING)
                    _log.log(level, "%s: %s: %s", self._where, message.source, message.message)
        return [message for message in messages if not isinstance(message, Malformed)]

    def _count_malformed(self, message: Malformed) -> None:
        self._counters.malformed += 1
        self._malformed_row += 1
        if self._malformed_row >= MALFORMED_IN_A_ROW:
            raise ProtocolError(
                f"{self._malformed_row} broken packages in a row, the last of type {message.type} "
                f"({message.reason.name.lower()}, {len(message.payload)} bytes)",
                where=self._where,
                remedy="Connect again; if it comes back, check for a proxy or a faulty network.",
            )

    def _count_nonsense(self, name: str) -> None:
        """Note a package that is no sample; whoever waits for samples sees that there are none."""
        self._counters.malformed += 1
        if name != self.nonsense:
            self.nonsense = name
            _log.warning("%s: %s is not a finite number; samples are dropped", self._where, name)

    def _lost(self, error: OSError | None) -> ConnectionLost:
        reason = "the controller closed the connection"
        if error is not None:
            reason = f"the connection broke: {os.strerror(error.errno or 0)}"
        return ConnectionLost(
            reason,
            where=self._where,
            remedy="Check the network and whether the controller was restarted or is overloaded.",
        )

    def _read_packages(self) -> tuple[DataPackage | None, int]:
        """Return the newest data package that has arrived, and how many there were."""
        packages, self._early = self._early, []
        messages = [*packages, *self._read()]
        self._take_answers(messages)
        packages = [message for message in messages if isinstance(message, DataPackage)]
        for package in packages[:-1]:
            flat = package.flat()
            if name := package.recipe.nonsense(flat):
                self._count_nonsense(name)
            else:
                self._passed.add(self._group(flat)[_RUNTIME_STATE])
        return (packages[-1] if packages else None), len(packages)

    def _sample(self, package: DataPackage, count: int) -> StateSample | None:
        received = self._clock()
        flat = package.flat()
        if name := package.recipe.nonsense(flat):
            self._count_nonsense(name)
            return None
        values = self._group(flat)
        timestamp: float = values[0]
        last, rate = self._timestamp, self._frequency * self._every
        steps = count if last is None else round((timestamp - last) * rate)
        counters = self._counters
        counters.received += count
        if steps == 0:
            counters.repeated += count
            return None
        self.nonsense = ""
        if last is not None and 0 < steps < self._every:
            self._held += count
            self._passed.add(values[_RUNTIME_STATE])
            return None
        self._timestamp = timestamp
        count, self._held = count + self._held, 0
        passed, self._passed = tuple(self._passed), set()
        restarted = steps < 0
        if restarted:
            self._echoes.begin()
        lost = 0 if restarted else max(0, steps - count)
        skipped = max(0, count // self._every - 1)
        counters.skipped += skipped
        counters.lost += lost
        counters.gaps += lost > 0
        counters.restarts += restarted
        return StateSample(received, lost, skipped, restarted, passed, *values)

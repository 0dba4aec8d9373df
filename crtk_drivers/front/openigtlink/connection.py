"""One peer: a thread that reads what it sends, and one that sends what waits for it, the newest of each name.

A peer that takes nothing blocks its own thread alone. One that takes nothing for `STALLED`, or whose stream
is lost, is disconnected.
"""

from __future__ import annotations

import logging
import select
import socket
import struct
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from typing import Final, Protocol

from crtk_drivers.commands import Command, Level
from crtk_drivers.errors import CrtkError
from crtk_drivers.front.openigtlink.bodies import TooLong
from crtk_drivers.front.openigtlink.codec import Damaged, Message, StreamDecoder, encode
from crtk_drivers.kit import BadData
from crtk_drivers.kit.lateness import Lateness

logger = logging.getLogger(__name__)

STALLED: Final = 5.0
"""Seconds in which a peer must take something of what is sent to it."""
MOST_ANSWERS: Final = 100
"""Answers that wait for a peer; who asks for more and takes none is disconnected."""
PIECE: Final = 65536
"""Bytes that are read at once, and sent at most while a peer takes some."""
_LOOK: Final = 0.2
"""Seconds after which a thread that waits looks whether it is to end."""


class Served(Protocol):
    """Who is behind a connection."""

    def take(self, connection: Connection, message: Message) -> None:
        """Carry out what a peer sends; called from the connection's reading thread."""

    def refuse(self, connection: Connection, damaged: Damaged) -> None:
        """A message of a peer was dropped."""

    def left(self, connection: Connection) -> None:
        """A peer is gone; called once, from its reading thread."""

    def command(self, device: str) -> Command | None:
        """Return the command that messages of a name are; None if they are none."""


class Connection:
    """A connected peer. No thread runs before `start`.

    Args:
        peer: the socket; closed with the connection.
        where: the peer, for messages.
        served: who is behind it.
        version: of headers, until the peer has sent one of a higher version.

    Attributes:
        where: as given.
        version: in force.
        sent, received, overwritten: messages; the last were not sent, since a newer one of their name came.
        stopped: types and names (empty: all) of what this peer does not want.
        bundles: types of tracking data that it wants in one message, with their periods in s.
        due: when each is due, in monotonic seconds.
    """

    def __init__(self, peer: socket.socket, where: str, served: Served, version: int = 1) -> None:
        self.where = where
        self.version = version
        self.sent = self.received = self.overwritten = 0
        self.stopped: set[tuple[str, str]] = set()
        self.bundles: dict[str, float] = {}
        self.due: dict[str, float] = {}
        self._peer = peer
        self._served = served
        self._decoder = StreamDecoder()
        self._streams: dict[str, tuple[int, Lateness]] = {}
        self._changed = threading.Condition()
        self._answers: deque[Message] = deque()
        self._newest: dict[tuple[str, str], Message] = {}
        self._ended = threading.Event()
        self._writer, self._reader = (
            threading.Thread(target=run, name=f"igtl {where}", daemon=True)
            for run in (self._write, self._read)
        )
        peer.setblocking(False)
        peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        # One whose machine has gone says nothing of it: what is sent is not acknowledged any more.
        peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, round(STALLED * 1000))

    @property
    def has_ended(self) -> bool:
        """Whether the peer is gone, or told to go."""
        return self._ended.is_set()

    @property
    def waiting(self) -> int:
        """How many values wait to be sent: of each name one at the most."""
        return len(self._newest)

    def start(self) -> None:
        """Begin to read and to send."""
        self._writer.start()
        self._reader.start()

    def end(self) -> None:
        """Let it go; from any thread, and more than once."""
        self._ended.set()
        with self._changed:
            self._changed.notify_all()

    def join(self, timeout: float) -> None:
        """Wait until its threads have ended: the reading one outlives the other."""
        if self._reader.is_alive() and self._reader is not threading.current_thread():
            self._reader.join(timeout)

    def wait(self, timeout: float) -> bool:
        """Wait until it has ended; return whether it has."""
        return self._ended.wait(timeout)

    # ------------------------------------------------------------------------------------- to the peer

    def offer(self, messages: Iterable[Message]) -> None:
        """Let values be sent; one that still waits gives way to a newer one of its name. Never waits."""
        with self._changed:
            for message in messages:
                if self._wants(message):
                    key = message.type, message.device
                    self.overwritten += key in self._newest
                    self._newest[key] = message
            self._changed.notify_all()

    def answer(self, message: Message) -> None:
        """Let an answer be sent, after those before it. Never waits."""
        with self._changed:
            self._answers.append(message)
            self._changed.notify_all()
        if len(self._answers) > MOST_ANSWERS:
            self._give_up(f"it asks, and takes none of {MOST_ANSWERS} answers")

    def _wants(self, message: Message) -> bool:
        stopped = self.stopped
        return not stopped or not (
            (message.type, message.device) in stopped or (message.type, "") in stopped
        )

    def _next(self) -> Message | None:
        with self._changed:
            while not self._ended.is_set():
                if self._answers:
                    return self._answers.popleft()
                while self._newest:
                    message = self._newest.pop(next(iter(self._newest)))
                    if self._wants(message):  # it may have been stopped since
                        return message
                self._changed.wait(_LOOK)
        return None

    def _write(self) -> None:
        try:
            while (message := self._next()) is not None:
                try:
                    data = encode(message, max(message.version, self.version), self.sent)
                except (TooLong, struct.error, OverflowError) as error:
                    logger.warning("%s: %s is not sent: %s", self.where, message.device, error)
                    continue
                self._send(data)
                self.sent += 1
        except (ConnectionResetError, BrokenPipeError):
            self.end()
        except OSError as error:
            self._give_up(f"{error.strerror or error}")
        except Exception:
            logger.exception("%s: it ends", self.where)
            self.end()

    def _send(self, data: bytes) -> None:
        left = memoryview(data)
        while left and not self._ended.is_set():
            deadline = time.monotonic() + STALLED
            while not self._ready(select.POLLOUT):
                if self._ended.is_set():
                    return
                if time.monotonic() > deadline:
                    raise TimeoutError(0, f"it took nothing for {STALLED:g} s")
            left = left[self._peer.send(left[:PIECE]) :]

    # ----------------------------------------------------------------------------------- from the peer

    def _read(self) -> None:
        try:
            while not self._ended.is_set():
                if not self._ready(select.POLLIN):
                    continue
                data = self._peer.recv(PIECE)
                if not data:
                    break
                self._take(self._decoder.feed(data))
        except BadData as error:
            self._give_up(f"its stream is lost: {error}")
        except (ConnectionResetError, BrokenPipeError):
            self.end()  # it has closed, and not read all
        except OSError as error:
            self._give_up(f"{error.strerror or error}")
        except Exception:
            logger.exception("%s: it ends", self.where)
        finally:
            self.end()
            self._served.left(self)
            self._writer.join(STALLED)
            self._peer.close()

    def _take(self, found: list[Message | Damaged]) -> None:
        """Carry out what arrived at once; of absolute setpoints of one name the newest only."""
        newest = {
            each.device: index
            for index, each in enumerate(found)
            if isinstance(each, Message) and self._is_overtaken_by_the_next(each)
        }
        for index, each in enumerate(found):
            if isinstance(each, Damaged):
                self._served.refuse(self, each)
                continue
            self.received += 1
            self.version = max(self.version, each.version)
            if newest.get(each.device, index) == index:
                self._carry_out(each)

    def late(self, message: Message, now: float) -> float:
        """Return by how many seconds a message came later than those of its name before, by its stamp.

        Of messages without a stamp, or all with the same, it is 0. From the reading thread.

        Args:
            message: of a stream, in its turn.
            now: monotonic seconds.
        """
        before, lateness = self._streams.get(message.device) or (message.stamp_ns, Lateness())
        self._streams[message.device] = message.stamp_ns, lateness
        return lateness.of(1e-9 * (message.stamp_ns - before), now)

    def _is_overtaken_by_the_next(self, message: Message) -> bool:
        command = self._served.command(message.device)
        return command is not None and command.level is Level.SERVO and not command.is_relative

    def _carry_out(self, message: Message) -> None:
        try:
            self._served.take(self, message)
        except CrtkError as error:
            logger.warning("%s: %s: %s", self.where, message.device, error)

    def _ready(self, events: int) -> bool:
        poll = select.poll()
        poll.register(self._peer, events)
        return bool(poll.poll(_LOOK * 1000.0))

    def _give_up(self, why: str) -> None:
        if not self._ended.is_set():
            logger.warning("%s: disconnected: %s", self.where, why)
            self.end()


Accept = Callable[[socket.socket, str], Connection]
"""Makes and starts the connection of a peer."""

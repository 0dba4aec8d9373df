"""A box: asked over TCP, and its stream over UDP; all that has arrived at a time.

One thread opens and receives. There is no thread here.
"""

from __future__ import annotations

import contextlib
import select
import socket
import struct
import time
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from crtk_driver_schunk.fts import frames
from crtk_driver_schunk.fts.config import FtsConfig
from crtk_driver_schunk.fts.frames import ERRORS, NO_SUCH, Op, Parameter, Reply
from crtk_drivers.errors import ConnectionFailed, ConnectionLost, DeviceError, TransitionFailed
from crtk_drivers.kit import FrameDecoder, MessageLink, TcpTransport
from crtk_drivers.kit.clock_fit import ClockFit
from crtk_drivers.kit.sensing.datagrams import Receiver, ask_for_buffer, receiver_for
from crtk_drivers.kit.sensing.sequence import Event, SequenceTracker

__all__ = ["Batch", "FtsStream"]

RATES: Final = (1000, 500, 250, 100)
"""Measurements a second by the value of `OUTPUT_RATE`; others send several in a datagram."""
SILENCE: Final = 0.3
"""Seconds without a datagram after which the stream is asked for again."""
AGAIN: Final = 0.3
"""Seconds for a new connection by which a sensor is told to stop."""
ANSWER: Final = 1.0
"""Seconds that the box has for an answer."""
PIECE: Final = 0.05
"""Seconds after which a wait looks whether it is given up."""
STRANGE: Final = 500
"""So many datagrams in a row that are no measurements end the connection."""
_OLD_PORT: Final = 54843
_CHECK: Final = "Check the address, the cable, and that the sensor is on."


@dataclass(frozen=True, slots=True)
class Batch:
    """Measurements that arrived together, oldest first.

    Attributes:
        status: status word of each (n,), READY turned round.
        values: force in N and torque in N·m (n, 6).
        times: of each measurement, monotonic seconds (n,).
        restarted: the box has counted anew since the last batch.
    """

    status: NDArray[np.uint32]
    values: NDArray[np.float64]
    times: NDArray[np.float64]
    restarted: bool

    def __len__(self) -> int:
        return len(self.times)


class FtsStream:
    """The way to one box; can be opened and closed again and again, and remembers its counters.

    Args:
        config: where it is.
        aborted: whether to give up what waits.
        clock: monotonic seconds.
    """

    def __init__(
        self,
        config: FtsConfig,
        aborted: Callable[[], bool],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._config = config
        self._aborted = aborted
        self._clock = clock
        transport = TcpTransport(
            config.host, config.tcp_port, "schunk-fts", _CHECK, aborted=aborted, clock=clock
        )
        self._tcp = MessageLink(
            transport,
            lambda: FrameDecoder(frames.reply_size, frames.parse_reply, strict=True),
            "Is it the command port (82) of an FTS box?",
        )
        self.tracker = SequenceTracker(RATES[0])
        self.clock_fit = ClockFit()
        self.name = ""
        self.rate = RATES[0]
        self.malformed = self.asked_again = self.receive_buffer = 0
        self._udp: socket.socket | None = None
        self._receiver: Receiver | None = None
        self._poll = select.poll()
        self._strange = 0
        self._counter: int | None = None
        self._number = 0
        self._heard = 0.0

    @property
    def where(self) -> str:
        """For messages."""
        return self._tcp.where

    @property
    def counters(self) -> Mapping[str, float]:
        """Measurements so far, and what became of them."""
        told = self.tracker.counters
        return {
            "received": told.received,
            "lost": told.lost,
            "gaps": told.gaps,
            "duplicates": told.duplicates,
            "late": told.late,
            "malformed": self.malformed,
            "asked_again": self.asked_again,
            "receive_buffer": self.receive_buffer,
        }

    # -------------------------------------------------------------------------------- open and close

    def open(self, deadline: float) -> None:
        """Connect, and wait for the first measurement.

        Raises:
            ConnectionFailed: not by the monotonic `deadline`, or it refuses.
        """
        self.close()
        try:
            self._tcp.open(deadline)
            self._tcp.write(frames.request(Op.STOP))
            self._ask(deadline, Op.STOP, passing=True)
            self._identify(deadline)
            self._bind()
            self._tell_port(deadline)
            self._start(deadline)
        except (DeviceError, OSError):
            self.close()
            raise

    def close(self) -> None:
        """Disconnect, and let it stop. May be called twice."""
        if self._udp is not None:
            self._stop()
            self._udp.close()
        self._udp = self._receiver = None
        self._tcp.close()

    def _stop(self) -> None:
        """Let it stop; by a new connection where the one for commands was lost meanwhile."""
        try:
            self._tcp.write(frames.request(Op.STOP))
        except ConnectionLost:
            config, clock = self._config, self._clock
            way = TcpTransport(config.host, config.tcp_port, "schunk-fts", _CHECK, clock=clock)
            with contextlib.suppress(DeviceError):  # it is gone, and its stream finds nobody
                way.open(clock() + AGAIN)
                way.write(frames.request(Op.STOP))
            way.close()

    def _identify(self, deadline: float) -> None:
        name = self._ask(deadline, Op.GET, frames.NAME, passing=True)
        self.name = name.value.split(b"\0")[0].decode("ascii", "replace") if not name.error else ""
        wanted = self._config.output_rate
        if wanted is not None:
            value = bytes((RATES.index(wanted),))
            self._ask(deadline, Op.SET, frames.OUTPUT_RATE, value)
        told = self._ask(deadline, Op.GET, frames.OUTPUT_RATE, passing=True)
        code = told.value[0] if told.value and not told.error else 0
        if code >= len(RATES):
            raise ConnectionFailed(
                f"it sends several measurements in a datagram (output rate {code})",
                where=self.where,
                remedy="Set output_rate: 1000, which is written to the box.",
            )
        self.rate = RATES[code]

    def _bind(self) -> None:
        self._udp = peer = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        peer.setblocking(False)
        try:
            peer.bind(("", self._config.udp_port))
        except OSError as error:
            raise ConnectionFailed(
                f"UDP port {self._config.udp_port} cannot be had: {error.strerror}",
                where=self.where,
                remedy="Another program listens there; give each sensor an udp_port of its own, or 0.",
            ) from error
        self.receive_buffer = ask_for_buffer(peer, self._config.receive_buffer)
        self._receiver = receiver_for(peer)
        self._poll = select.poll()
        self._poll.register(peer, select.POLLIN)

    def _tell_port(self, deadline: float) -> None:
        assert self._udp is not None
        port = self._udp.getsockname()[1]
        told = self._ask(deadline, Op.SET, frames.UDP_PORT, struct.pack("<H", port), passing=True)
        if told.error and not (told.error in NO_SUCH and port == _OLD_PORT):
            raise ConnectionFailed(
                f"it takes no UDP port {port}: {_text(told.error)}",
                where=self.where,
                remedy=f"Use udp_port: {_OLD_PORT}, the only one that old firmware knows.",
            )

    def _start(self, deadline: float) -> None:
        self.tracker.rate = self.rate
        self.tracker.expect_series()
        self.clock_fit.reset()
        self._counter, self._number, self._strange = None, 0, 0
        self._ask(deadline, Op.START)
        self._heard = self._clock()
        self._take_sender(deadline)

    def _take_sender(self, deadline: float) -> None:
        """Wait for the first datagram of the box, and hear nobody else from then on."""
        assert self._udp is not None
        addresses = {entry[4][0] for entry in socket.getaddrinfo(self._config.host, None)}
        while not self._aborted() and self._clock() < deadline:
            if not self._poll.poll(1e3 * PIECE):
                continue
            _, sender = self._udp.recvfrom(2048)
            if sender[0] in addresses:
                self._udp.connect(sender)
                return
        raise ConnectionFailed(
            "it answers, and sends no measurements",
            where=self.where,
            remedy=f"Does a firewall keep UDP from port {self._udp.getsockname()[1]}?",
        )

    # ------------------------------------------------------------------------------------- requests

    def _ask(
        self,
        deadline: float,
        op: Op,
        parameter: Parameter | None = None,
        value: bytes = b"",
        *,
        passing: bool = False,
    ) -> Reply:
        """Ask and wait; only while it is being opened.

        Raises:
            ConnectionFailed: no answer in time, or an error that is not let pass.
        """
        self._tcp.write(frames.request(op, parameter, value))
        end = min(deadline, self._clock() + ANSWER)
        while self._clock() < end:
            for reply in self._tcp.read(end):
                if not _answers(reply, op, parameter):
                    continue
                if reply.error and not passing:
                    raise ConnectionFailed(
                        f"it refuses {op.name.lower()}: {_text(reply.error)}",
                        where=self.where,
                        remedy="Does another program use it?",
                    )
                return reply
        raise ConnectionFailed(
            "it does not answer", where=self.where, remedy="Is it the command port (82) of a box?"
        )

    def asking(self, op: Op) -> Generator[None, None, None]:
        """Ask while it streams, as a part of a procedure.

        Raises:
            TransitionFailed: no answer in time, or an error.
        """
        self._tcp.forget()
        self._tcp.write(frames.request(op))
        end = self._clock() + ANSWER
        while self._clock() < end:
            for reply in self._tcp.read(0.0):
                if _answers(reply, op, None):
                    if not reply.error:
                        return
                    raise TransitionFailed(
                        f"it refuses {op.name.lower()}: {_text(reply.error)}",
                        where=self.where,
                        remedy="See the box's web page, or use the software bias.",
                    )
            yield
        raise TransitionFailed("it does not answer", where=self.where, remedy=_CHECK)

    # ------------------------------------------------------------------------------------ receiving

    def receive(self, deadline: float, begin: float = 0.0) -> Batch | None:
        """Return what arrived since the last call; None if nothing does by `deadline`.

        Args:
            deadline: monotonic.
            begin: monotonic time until which more is waited for, so that fewer calls do.

        Raises:
            ConnectionLost: the network is gone, or what comes is no measurement.
        """
        left = begin - self._clock()
        if left > 0.0:
            time.sleep(left)
        while True:
            batch = self._take()
            now = self._clock()
            if batch is not None:
                self._heard = now
                return batch
            if now - self._heard > SILENCE:
                self._heard = now
                self.asked_again += 1
                self._tcp.write(frames.request(Op.START))
            if now >= deadline or self._aborted():
                return None
            self._poll.poll(max(0.0, 1e3 * min(deadline - now, PIECE)))

    def _take(self) -> Batch | None:
        if self._receiver is None:
            raise ConnectionLost("the stream is closed", where=self.where, remedy=_CHECK)
        try:
            arrived = self._receiver.receive()
        except OSError as error:
            raise ConnectionLost(
                f"the network fails: {error.strerror or error}", where=self.where, remedy=_CHECK
            ) from error
        if arrived is None:
            return None
        records, kept = frames.decode(arrived.slots, arrived.lengths)
        self._count_malformed(len(arrived.lengths) - len(records), len(records))
        if not len(records):
            return None
        arrivals = arrived.arrivals if kept is None else arrived.arrivals[kept]
        return self._batch(records, arrivals)

    def _batch(self, records: NDArray[Any], arrivals: NDArray[np.float64]) -> Batch | None:
        numbers = self._numbered(records["counter"])
        accepted = self.tracker.take(numbers, numbers, arrivals)
        if accepted.keep is not None:
            records, arrivals = records[accepted.keep], arrivals[accepted.keep]
        if not len(records):
            return None
        restarted = any(event is Event.RESTARTED for event, _ in accepted.events)
        if restarted:
            self.clock_fit.reset()
        return Batch(
            records["status"].astype(np.uint32),
            records["load"].astype(np.float64),
            self.clock_fit.stamp(accepted.ticks, arrivals),
            restarted,
        )

    def _numbered(self, counters: NDArray[np.uint16]) -> NDArray[np.uint32]:
        """Return numbers without the wraps of 16 bits, from 1 on; one that jumps back is below the last."""
        wide = counters.astype(np.int64)
        before = wide[0] - 1 if self._counter is None else self._counter
        steps = ((wide - np.append(before, wide[:-1]) + 0x8000) & 0xFFFF) - 0x8000
        numbers = self._number + np.cumsum(steps)
        self._counter, self._number = int(counters[-1]), int(numbers[-1])
        return numbers.astype(np.uint32)

    def _count_malformed(self, count: int, good: int) -> None:
        self.malformed += count
        self._strange = 0 if good else self._strange + count
        if self._strange >= STRANGE:
            raise ConnectionLost(
                f"{self._strange} datagrams in a row are no measurements",
                where=self.where,
                remedy="Is the box set to several measurements in a datagram? Set output_rate: 1000.",
            )


def _answers(reply: Reply, op: Op, parameter: Parameter | None) -> bool:
    return reply.op == op and (reply.parameter in (parameter, None))


def _text(error: int) -> str:
    return f"{ERRORS.get(error, 'an error that is in no table')} ({error:02X})"

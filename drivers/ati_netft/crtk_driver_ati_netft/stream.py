"""The stream of a sensor over UDP: asked for, kept, and checked; a batch of measurements at a time.

One thread opens and receives. There is no thread here: `RdtStream.receive` takes all that has arrived since
it was called last, which costs less the rarer it is called.
"""

from __future__ import annotations

import errno
import logging
import os
import select
import socket
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from crtk_driver_ati_netft import rdt
from crtk_driver_ati_netft.profiles import Action, Mode, Profile
from crtk_driver_ati_netft.stream_watch import PATIENCE, StreamWatch
from crtk_drivers.errors import ConnectionFailed, ConnectionLost
from crtk_drivers.kit.clock_fit import ClockFit
from crtk_drivers.kit.sensing.datagrams import Receiver, ask_for_buffer, receiver_for
from crtk_drivers.kit.sensing.sequence import Event, SequenceTracker
from crtk_drivers.samples import Vector

RECEIVE_BUFFER: Final = 1 << 20
"""Bytes: a third of a second of the fastest sensor, with one record in a datagram."""
MALFORMED_IN_A_ROW: Final = 1000
"""So many datagrams that are no records, with none between that is, end the connection."""

STOPS: Final = 4
"""Requests to stop, of which each may be lost."""
QUIET: Final = 0.02
"""Seconds without a record, and of three of them at the least, after which it has stopped."""

_CHECK: Final = "Check the address, the cable, and that the sensor is on."

logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Batch:
    """Measurements that arrived together, oldest first, in SI units.

    Attributes:
        sequence: rdt_sequence of each (n,).
        ticks: number of each measurement on the sensor's clock, without wraps (n,).
        status: status word of each (n,).
        values: force in N and torque in N·m, as the sensor gives them (n, 6).
        times: of each measurement, monotonic seconds (n,).
        events: what happened to the stream, with the index from which on it is so.
    """

    sequence: NDArray[np.uint32]
    ticks: NDArray[np.int64]
    status: NDArray[np.uint32]
    values: NDArray[np.float64]
    times: NDArray[np.float64]
    events: tuple[tuple[Event, int], ...] = ()

    def __len__(self) -> int:
        return self.sequence.size


class RdtStream:
    """The stream of one sensor; can be opened and closed again and again, and remembers its counters.

    Args:
        host: address of the sensor.
        profile: its family.
        factors: SI value of one count of each axis (6,); may be set while closed.
        port: of its RDT server.
        mode: how the records come.
        rate: records per second that are expected, for what counts as silence.
        receive_buffer: bytes to ask the kernel for.
        make_receiver: of a non-blocking socket.
        clock: monotonic seconds.
    """

    def __init__(
        self,
        host: str,
        profile: Profile,
        factors: Vector,
        *,
        port: int = rdt.PORT,
        mode: Mode = Mode.REALTIME,
        rate: float = 1000.0,
        receive_buffer: int = RECEIVE_BUFFER,
        make_receiver: Callable[[socket.socket], Receiver] = receiver_for,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        if mode not in profile.starts:
            known = ", ".join(profile.starts)
            raise ValueError(f"{profile.name} has no mode {mode}; it has {known}")
        self.factors = factors
        self.host = host
        self.port = port
        self.tracker = SequenceTracker(profile.rate)
        self.clock_fit = ClockFit()
        self.receive_buffer = 0
        """Bytes that the kernel granted; known when open."""
        self.malformed = 0
        self.takeovers = 0
        self._where = f"RDT {host}:{port}"
        self.profile = profile
        self._mode = mode
        self._wanted_buffer = receive_buffer
        self._make_receiver = make_receiver
        self._clock = clock
        self._watch = StreamWatch()
        self.expect_rate(rate)
        self._socket: socket.socket | None = None
        self._receiver: Receiver | None = None
        self._poll = select.poll()
        self._waking = threading.Lock()
        self._wake = -1
        self._aborted = False
        self._malformed_row = 0
        self._early: Batch | None = None

    def expect_rate(self, rate: float) -> None:
        """Expect so many records per second, for what counts as silence."""
        in_a_datagram = rdt.MOST_RECORDS if self._mode is Mode.BUFFERED else 1
        self._watch.patience = max(PATIENCE, 5.0 * in_a_datagram / rate)

    @property
    def address(self) -> str:
        """Host and port, for messages."""
        return f"{self.host}:{self.port}"

    @property
    def frozen(self) -> bool:
        """Whether records come, but the same measurement again and again."""
        return self.tracker.frozen

    @property
    def record_rate(self) -> float:
        """Records per second as far as it is known, in Hz; 0 before two have arrived."""
        if not self.tracker.step:
            return 0.0
        return (self.clock_fit.tick_rate or self.tracker.rate) / self.tracker.step

    @property
    def counters(self) -> Mapping[str, float]:
        """What happened so far, as numbers; times in s, rates in Hz."""
        p50, p99, most = self.clock_fit.jitter
        return {
            **self.tracker.counters.as_dict(),
            "takeovers": float(self.tracker.counters.takeovers + self.takeovers),
            "malformed": float(self.malformed),
            "receive_buffer": float(self.receive_buffer),
            "kernel_stamps": float(self._receiver is not None and self._receiver.kernel_stamps),
            "tick_rate": self.clock_fit.tick_rate,
            "clock_resets": float(self.clock_fit.resets),
            "arrival_jitter_p50": p50,
            "arrival_jitter_p99": p99,
            "arrival_jitter_max": most,
        }

    # ----------------------------------------------------------------------------------- connection

    def open(self, deadline: float) -> None:
        """Ask for the stream and wait until it comes.

        Raises:
            ConnectionFailed: not by the monotonic `deadline`.
        """
        self.close()
        self._wake = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        try:
            self._connect()
            self._watch.begin(self._clock())
            why = "nothing answers"
            while self._early is None:
                now = self._clock()
                if now >= deadline or self._aborted:
                    raise ConnectionFailed(
                        f"no measurement arrived: {why}", where=self._where, remedy=_CHECK
                    )
                try:
                    self._early = self.receive(min(deadline, now + 0.05))
                except ConnectionLost as error:
                    why = error.message
                    self._wait(min(deadline, now + 0.05), arrivals=False)
        except BaseException:
            self._release()
            raise

    def abort(self) -> None:
        """End an `open` that waits, from any thread; later ones fail."""
        self._aborted = True
        with self._waking:
            if self._wake >= 0:
                os.eventfd_write(self._wake, 1)

    def close(self) -> None:
        """Stop the stream and disconnect. May be called twice."""
        try:
            self._stop()
        except (ConnectionLost, OSError) as error:
            logger.debug("%s", error)
        self._release()

    def _stop(self) -> None:
        """Ask it to stop, again as long as it goes on: nothing says that a request has come."""
        receiver, rate = self._receiver, self.record_rate
        quiet = max(QUIET, 3.0 / rate) if rate else QUIET
        for _ in range(STOPS):
            if self._socket is None or receiver is None:
                return
            self._send(Action.STOP)
            time.sleep(quiet)
            while receiver.receive() is not None:
                continue  # what was on its way
            time.sleep(quiet)
            if receiver.receive() is None:
                return

    def _connect(self) -> None:
        peer = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket = peer
        peer.setblocking(False)
        self.receive_buffer = ask_for_buffer(peer, self._wanted_buffer)
        try:
            peer.connect((self.host, self.port))
        except OSError as error:
            raise ConnectionFailed(
                f"no way to the sensor: {error}", where=self._where, remedy=_CHECK
            ) from error
        self._receiver = self._make_receiver(peer)
        self._poll = select.poll()
        self._poll.register(peer, select.POLLIN)
        self._poll.register(self._wake, select.POLLIN)
        self._malformed_row = 0
        self.clock_fit.reset()

    def _release(self) -> None:
        self._early = None
        self._receiver = None
        if self._socket is not None:
            self._socket.close()
            self._socket = None
        with self._waking:
            wake, self._wake = self._wake, -1
            if wake >= 0:
                os.close(wake)

    # ------------------------------------------------------------------------------------ requests

    def request(self, action: Action) -> None:
        """Ask the sensor for something; nothing says whether it does it. The stream is asked for again.

        Raises:
            ValueError: this family of sensors does not know it over RDT.
            ConnectionLost: it cannot be sent.
        """
        self._send(action)
        if action is not Action.STOP:
            self._watch.begin(self._clock())

    def hold(self) -> None:
        """Stop the stream until `resume`."""
        self._send(Action.STOP)
        self._watch.end()

    def resume(self) -> None:
        """Ask for the stream again."""
        self._watch.begin(self._clock())

    def send_value(self, command: int, value: int) -> None:
        """Send a setting that a family takes over RDT.

        Raises:
            ConnectionLost: it cannot be sent.
        """
        self._send_bytes(rdt.encode_request(command, value))

    def _send(self, action: Action) -> None:
        if action not in self.profile.actions:
            raise ValueError(f"{self.profile.name} has no request for {action} over RDT")
        self._send_bytes(rdt.encode_request(*self.profile.actions[action]))

    def _start(self) -> None:
        self.tracker.expect_series()
        self._send_bytes(rdt.encode_request(self.profile.starts[self._mode]))

    def _send_bytes(self, request: bytes) -> None:
        try:
            self._peer().send(request)
        except BlockingIOError:
            logger.warning("%s: the send buffer is full", self._where)
        except ConnectionRefusedError:
            # Tells of an earlier datagram, and this one was not sent.
            self._again(request)
        except OSError as error:
            raise self._lost(error) from error

    def _again(self, request: bytes) -> None:
        try:
            self._peer().send(request)
        except OSError as error:
            raise self._lost(error) from error

    # ------------------------------------------------------------------------------------ receiving

    def receive(self, deadline: float, begin: float = 0.0) -> Batch | None:
        """Return what arrived since the last call; None if nothing does by `deadline`.

        Args:
            deadline: monotonic.
            begin: monotonic time until which more is waited for, so that fewer calls do.

        Raises:
            ConnectionLost: the sensor refuses, or the network is gone.
        """
        if self._early is not None:
            early, self._early = self._early, None
            return early
        self._wait(begin, arrivals=False)
        while True:
            looked = self._clock()
            batch = self._take()
            now = self._clock()
            if self._watch.due(looked, now):
                self._start()
            if batch is not None or now >= deadline or self._aborted:
                return batch
            self._wait(min(deadline, now + PATIENCE), arrivals=True)

    def _wait(self, until: float, arrivals: bool) -> None:
        """Wait until a time; with `arrivals`, until something arrives before it."""
        left = until - self._clock()
        if left <= 0.0:
            return
        if arrivals:
            self._poll.poll(left * 1000.0)
        else:
            time.sleep(left)

    def _take(self) -> Batch | None:
        receiver = self._receiver
        if receiver is None:
            raise self._lost(OSError(errno.EBADF, "the stream is closed"))
        try:
            arrived = receiver.receive()
        except OSError as error:
            raise self._lost(error) from error
        if arrived is None:
            return None
        records, source, malformed = rdt.decode_batch(arrived.slots, arrived.lengths)
        if malformed:
            self._count_malformed(malformed, records.size > 0, arrived.lengths)
        if not records.size:
            return None
        self._malformed_row = 0
        arrivals = arrived.arrivals if source is None else arrived.arrivals[source]
        return self._batch(records, arrivals)

    def _batch(self, records: rdt.Records, arrivals: NDArray[np.float64]) -> Batch | None:
        numbers = rdt.native(records)
        unsigned = numbers.view(np.uint32)
        accepted = self.tracker.take(unsigned[:, 0], unsigned[:, 1], arrivals)
        if accepted.keep is not None:
            numbers, unsigned = numbers[accepted.keep], unsigned[accepted.keep]
            arrivals = arrivals[accepted.keep]
        if not len(numbers):
            return None
        # Not when the last record arrived: it may have waited for us.
        new_series = (Event.BEGUN, 0) in accepted.events[:1]
        if self._watch.heard(self._clock(), new_series):
            self.takeovers += 1
            accepted = accepted._replace(events=((Event.TAKEN_OVER, 0), *accepted.events))
        if any(event is Event.RESTARTED for event, _ in accepted.events):
            self.clock_fit.reset()
        times = arrivals
        if not self.tracker.frozen:
            times = self.clock_fit.stamp(accepted.ticks, arrivals)
        return Batch(
            sequence=unsigned[:, 0],
            ticks=accepted.ticks,
            status=unsigned[:, 2],
            values=numbers[:, 3:] * self.factors,
            times=times,
            events=accepted.events,
        )

    def _count_malformed(self, count: int, some_good: bool, lengths: NDArray[Any]) -> None:
        self.malformed += count
        self._malformed_row = 0 if some_good else self._malformed_row + count
        if self._malformed_row >= MALFORMED_IN_A_ROW:
            raise ConnectionLost(
                f"{self._malformed_row} datagrams in a row are no records, the last of "
                f"{int(lengths[-1])} bytes",
                where=self._where,
                remedy="Is this the RDT port (49152) of a NetFT sensor?",
            )

    def _peer(self) -> socket.socket:
        if self._socket is None:
            raise self._lost(OSError(errno.EBADF, "the stream is closed"))
        return self._socket

    def _lost(self, error: OSError) -> ConnectionLost:
        what = "the sensor's RDT port is closed"
        if error.errno != errno.ECONNREFUSED:
            what = f"the network fails: {error.strerror or error}"
        return ConnectionLost(what, where=self._where, remedy=_CHECK)

"""The unit at its port: told what to send, and then heard. There is no thread here."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Mapping
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from crtk_driver_optoforce import frames
from crtk_driver_optoforce.config import OptoForceConfig
from crtk_driver_optoforce.frames import Acknowledgement, Measurement, Message, SerialNumber
from crtk_drivers.device import Steps
from crtk_drivers.errors import ConnectionFailed, ConnectionLost, TransitionFailed
from crtk_drivers.kit import until
from crtk_drivers.kit.lateness import Lateness
from crtk_drivers.kit.serial_port import SerialPort

__all__ = ["Batch", "OptoForceLink"]

PATIENCE: Final = 0.3
"""Seconds in which the unit answers, before it is told again while it is being opened."""
ANSWER: Final = 1.0
"""Seconds that it has for an answer while it measures."""
APART: Final = 0.005
"""Seconds between two configurations; the unit needs 2 ms."""
WRAP: Final = 1 << 16
AHEAD: Final = 1.0
"""Seconds by which numbers may run ahead of what they were at most: they lay waiting, and came at once."""
_REMEDY: Final = "Is it the sensor's port, and is no other program connected to it?"


class Batch(NamedTuple):
    """Measurements that came together, oldest first.

    Attributes:
        counts: of all axes (n, axes).
        status: status words (n,).
        times: when each was measured, monotonic seconds (n,).
    """

    counts: NDArray[np.float64]
    status: NDArray[np.uint32]
    times: NDArray[np.float64]


class OptoForceLink:
    """One unit. It belongs to the I/O thread; it can be opened again and again, and remembers its counters.

    Args:
        config: where it is, and what it is told.
        aborted: whether to give up what waits.
    """

    def __init__(self, config: OptoForceConfig, aborted: Callable[[], bool]) -> None:
        self._config = config
        self._aborted = aborted
        self._port = SerialPort(config.port, config.baud)
        self._decoder = frames.stream_decoder()
        self._acknowledged: deque[Acknowledgement] = deque(maxlen=8)
        self._unanswered = 0
        """Configurations that were sent; answers do not say which one they are of."""
        self.serial_number = ""
        self.is_open = False
        self._last: Measurement | None = None
        self._total = 0
        self._lead = -np.inf
        self._lateness = Lateness()
        self._corrupt = self._strange = 0
        self.received = self.lost = self.doubled = 0

    @property
    def where(self) -> str:
        """For messages."""
        return f"optoforce, {self._port.where}"

    @property
    def counters(self) -> Mapping[str, float]:
        """Measurements so far, and what became of them."""
        return {
            "received": self.received,
            "lost": self.lost,
            "doubled": self.doubled,
            "corrupt": self._corrupt + self._decoder.corrupt,
            "strange_bytes": self._strange + self._decoder.strange,
        }

    def open(self, deadline: float) -> None:
        """Connect, tell it rate and filter, and wait for the first measurement. A zero of its own is removed.

        Raises:
            ConnectionFailed: not by the monotonic `deadline`, or it is another sensor.
        """
        self.close()
        self._port.open(deadline)
        try:
            self._corrupt += self._decoder.corrupt
            self._strange += self._decoder.strange
            self._decoder = frames.stream_decoder()
            self._configure(deadline)
            self._port.write(frames.ASK_SERIAL)
            self.serial_number = ""
            self._wait(
                min(deadline, time.monotonic() + PATIENCE), SerialNumber
            )  # some do not answer
            self._last, self._lead = None, -np.inf
            self._lateness.reset()
            if not self._wait(deadline, Measurement):
                raise ConnectionFailed(
                    "it answers, and sends no measurements", where=self.where, remedy=_REMEDY
                )
        except BaseException:
            self._port.close()
            raise
        self.is_open = True

    def close(self) -> None:
        """Disconnect; it goes on sending. May be called twice."""
        self.is_open = False
        self._port.close()

    def _configure(self, deadline: float) -> None:
        self._acknowledged.clear()
        self._unanswered = 0
        while time.monotonic() < deadline and not self._aborted():
            self._send(zero=False)
            if self._wait(min(deadline, time.monotonic() + PATIENCE), Acknowledgement):
                error = self._acknowledged.popleft().error
                if not error:
                    return
                raise ConnectionFailed(
                    f"it refuses rate and filter with error {error}",
                    where=self.where,
                    remedy="Try the rate and the filter that it has: 100 Hz, 15 Hz.",
                )
        raise ConnectionFailed("it does not answer", where=self.where, remedy=_REMEDY)

    def _send(self, *, zero: bool) -> None:
        config = self._config
        self._port.write(frames.configuration(config.rate, config.low_pass, zero=zero))
        self._unanswered += 1

    def _wait(self, deadline: float, kind: type[Message]) -> bool:
        while not self._aborted() and (messages := self._receive(deadline)):
            if any(isinstance(message, kind) for message in messages):
                return True
        return False

    def zeroing(self, on: bool) -> Steps:
        """Let the unit count the present load as zero, or as what it is; a part of a procedure.

        Raises:
            TransitionFailed: it does not confirm it.
        """
        yield from self._told(zero=False)
        if on:
            yield from until(lambda: False, APART)
            yield from self._told(zero=True)

    def _told(self, *, zero: bool) -> Steps:
        yield from self._all_answered()  # what comes late is no answer to this
        self._unanswered = 0
        self._acknowledged.clear()
        self._send(zero=zero)
        if not (yield from self._all_answered()):
            raise TransitionFailed("it does not answer", where=self.where, remedy=_REMEDY)
        if error := self._acknowledged.popleft().error:
            raise TransitionFailed(
                f"it refuses its zero with error {error}",
                where=self.where,
                remedy="Use the software bias.",
            )

    def _all_answered(self) -> Generator[None, None, bool]:
        return until(lambda: not self._unanswered, ANSWER)

    def read(self, deadline: float) -> Batch | None:
        """Return what was measured since the last call; None: nothing by the monotonic `deadline`.

        Raises:
            ConnectionLost: the port is gone, the unit has begun anew, or another sensor hangs at it.
        """
        while messages := self._receive(deadline):
            batch = self._batch(messages, time.monotonic())
            if batch is not None or time.monotonic() >= deadline:
                return batch
        return None

    def _receive(self, deadline: float) -> list[Message]:
        """Return messages as soon as there are any, and take note of answers."""
        while data := self._port.read(deadline):
            messages = self._decoder.feed(data)
            for message in messages:
                if isinstance(message, Acknowledgement):
                    self._acknowledged.append(message)
                    self._unanswered = max(0, self._unanswered - 1)
                elif isinstance(message, SerialNumber):
                    self.serial_number = message.text
            if messages or time.monotonic() >= deadline:
                return messages
        return []

    def _batch(self, messages: Iterable[Message], now: float) -> Batch | None:
        before = self._last
        found = [
            each for each in messages if isinstance(each, Measurement) and self._follows(each, now)
        ]
        if not found:
            return None
        behind = [(found[-1].number - each.number) % WRAP for each in found]
        ahead = 0 if before is None else (found[-1].number - before.number) % WRAP
        newest = now - self._lateness.held_up(ahead / self._config.rate, now)
        return Batch(
            np.array([each.counts for each in found], dtype=np.float64),
            np.array([each.status for each in found], dtype=np.uint32),
            newest - np.array(behind) / self._config.rate,
        )

    def _follows(self, measured: Measurement, now: float) -> bool:
        """Say whether it is a new one; count what did not come before it."""
        axes = self._config.sensors * self._config.axes
        if len(measured.counts) != axes:
            raise ConnectionLost(
                f"it measures {len(measured.counts)} axes, not {axes}",
                where=self.where,
                remedy="Set sensor to what hangs at the unit: 3-axis, 6-axis or 4x3-axis.",
            )
        last, self._last = self._last, measured
        self.received += 1
        if last is None:
            return True
        ahead = (measured.number - last.number) % WRAP
        if not ahead:
            self.doubled += 1
            return False
        self._total += ahead
        lead = self._total - self._config.rate * now
        if lead > self._lead + self._config.rate * AHEAD and self._lead > -np.inf:
            raise ConnectionLost(
                "it counts anew: it was restarted, and its settings are gone",
                where=self.where,
                remedy="It is connected and set again.",
            )
        self._lead = max(self._lead, lead)
        self.lost += ahead - 1
        return True

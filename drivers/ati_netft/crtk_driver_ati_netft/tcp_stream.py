"""Measurements over TCP, for where UDP is blocked: asked for one by one, with 16 bits and our own stamps.

It stands in for `crtk_driver_ati_netft.stream.RdtStream`: the same methods, the same batches.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping

import numpy as np

from crtk_driver_ati_netft import tcp49151
from crtk_driver_ati_netft.profiles import Action
from crtk_driver_ati_netft.stream import Batch
from crtk_driver_ati_netft.tcp49151 import TcpChannel
from crtk_drivers.errors import ConnectionFailed, ConnectionLost, ProtocolError
from crtk_drivers.kit.sensing.sequence import Event
from crtk_drivers.samples import Vector, vector


class TcpStream:
    """The measurements of one sensor; can be opened and closed again and again.

    Args:
        host: address of the sensor.
        port: of its TCP channel.
        period: seconds after which the scale is asked for again; 0: never.
        clock: monotonic seconds.
    """

    frozen = False
    record_rate = 0.0

    def __init__(
        self,
        host: str,
        port: int = tcp49151.PORT,
        period: float = 0.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.host = host
        self.port = port
        self._channel = TcpChannel(host, port, clock)
        self._clock = clock
        self._period = period
        self._next_look = math.inf
        self._looking = self._reading = False
        """Which answer is waited for."""
        self._factors: Vector = vector(np.ones(6))
        self._sequence = 0
        self._bias = False
        self._clear = False
        self._held = False
        self._early: Batch | None = None

    @property
    def address(self) -> str:
        """Host and port, for messages."""
        return f"{self.host}:{self.port}"

    @property
    def counters(self) -> Mapping[str, float]:
        """What happened so far, as numbers."""
        return {"received": float(self._sequence)}

    def open(self, deadline: float) -> None:
        """Connect, ask for the scale, and read once.

        Raises:
            ConnectionFailed: not by the monotonic `deadline`.
            ConnectionLost, ProtocolError: the connection ended; what answers is no such sensor.
        """
        self.close()
        self._channel.open(deadline)
        try:
            self._factors = self._channel.calibration(deadline).factors
            self._held = self._looking = self._reading = False
            self._bias = self._clear = False  # asked for before the connection was lost
            self._look_later()
            self._early = self.receive(deadline)
            if self._early is None:
                raise ConnectionFailed(
                    "no measurement arrived in time",
                    where=self._channel.where,
                    remedy="Check that the sensor is on, and ask for fewer measurements.",
                )
        except BaseException:
            self.close()
            raise

    def abort(self) -> None:
        """End an `open` that waits, from any thread; later ones fail."""
        self._channel.abort()

    def close(self) -> None:
        """Disconnect. May be called twice."""
        self._early = None
        self._channel.close()

    def request(self, action: Action) -> None:
        """Ask the sensor for something, with the next measurement.

        Raises:
            ProtocolError: it cannot be asked for over TCP.
        """
        if action is Action.BIAS:
            self._bias = True
        elif action is Action.CLEAR_LATCH:
            self._clear = True
        else:
            raise ProtocolError(
                f"{action} cannot be asked for over TCP",
                where=self._channel.where,
                remedy="Use UDP, or the sensor's web page.",
            )

    def hold(self) -> None:
        """Ask for nothing until `resume`."""
        self._held = True

    def resume(self) -> None:
        """Ask again."""
        self._held = False

    def receive(self, deadline: float, begin: float = 0.0) -> Batch | None:
        """Return one measurement, None if it does not come by `deadline`; see `RdtStream.receive`.

        Raises:
            ConnectionLost, ProtocolError: the sensor closed the connection, or has another scale; its answer
                is none.
        """
        if self._early is not None:
            early, self._early = self._early, None
            return early
        wait = (deadline if self._held else begin) - self._clock()
        if wait > 0.0:
            time.sleep(wait)
        if self._held:
            return None
        if self._looking or (not self._reading and self._clock() >= self._next_look):
            self._looking = not self._look(deadline)
            if self._looking:
                return None
        is_asked_now = not self._reading
        found = self._channel.read(deadline, bias=self._bias, clear_latch=self._clear)
        if is_asked_now:
            self._bias = self._clear = False
        self._reading = found is None
        if found is None:
            return None
        (status, values), when = found
        self._sequence += 1
        return Batch(
            np.array([self._sequence], np.uint32),
            np.array([self._sequence], np.int64),
            np.array([status], np.uint32),
            np.array([values], np.float64) * self._factors,
            np.array([when]),
            ((Event.BEGUN, 0),) if self._sequence == 1 else (),
        )

    def _look_later(self) -> None:
        self._next_look = self._clock() + self._period if self._period else math.inf

    def _look(self, deadline: float) -> bool:
        """Ask for the scale again; return whether the answer is there, and as before."""
        found = self._channel.calibration_again(deadline)
        if found is None:
            return False
        if not np.array_equal(found.factors, self._factors):
            raise ConnectionLost(
                f"the sensor's scale is another than when it was connected: now {found.scale}",
                where=self._channel.where,
                remedy="The driver asks for it again. Check who sets the sensor.",
            )
        self._look_later()
        return True

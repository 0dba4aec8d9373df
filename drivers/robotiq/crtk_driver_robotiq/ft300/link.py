"""The way to a force sensor: first the end of a stream that may still run, then what it is, then loads."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Mapping
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from crtk_driver_robotiq.ft300 import registers
from crtk_driver_robotiq.ft300.config import Ft300Config
from crtk_driver_robotiq.ft300.registers import Identity
from crtk_driver_robotiq.ft300.stream import FRAME, PERIOD, STOP, stream_decoder
from crtk_drivers.errors import ConnectionFailed, ConnectionLost
from crtk_drivers.kit import Transport, modbus_frames
from crtk_drivers.kit.lateness import Lateness
from crtk_drivers.kit.modbus_frames import Question
from crtk_drivers.kit.modbus_link import ModbusLink
from crtk_drivers.plugins.modbus_ways import framing_of, transport_of

__all__ = ["Batch", "SensorLink"]

BITS: Final = 10
"""Of a byte on a serial line."""
QUIET: Final = 0.1
"""Seconds without a byte after which no stream runs, and the sensor listens."""
PATIENCE: Final = 0.5
"""Seconds in which a stream must end, or begin, before it is asked to again."""
GAP: Final = 3
"""Periods without a measurement that are no mere jitter."""


class Batch(NamedTuple):
    """Measurements: loads (n, 6) in N and N·m, and their times (n,) in monotonic seconds."""

    loads: NDArray[np.float64]
    times: NDArray[np.float64]


class SensorRegisters:
    """What the sensor is asked: registers that somebody names, or else the loads."""

    silent = (
        "Is it powered, and are wiring, baud rate (19200) and address right? Behind a gateway it cannot be "
        "told to end a stream that somebody else has begun: take its power away and give it back."
    )
    other = "Is it an FT 300, and no gripper?"

    def read(self) -> Question:
        """See `RegisterMap`."""
        return modbus_frames.read(*registers.LOADS)

    def write(self, command: Question) -> Question:
        """See `RegisterMap`: it is a question already."""
        return command

    def probe(self, turn: int) -> Question:
        """See `RegisterMap`: some of the loads, by the function for input registers."""
        address, most = registers.LOADS
        return modbus_frames.read(address, 1 + turn % most, modbus_frames.READ_INPUT)

    def variant(self, question: Question) -> None:
        """See `RegisterMap`: all of the loads are needed, and those of the other function are probes."""

    def aside(self, command: Question) -> Question:
        """See `RegisterMap`."""
        return command

    def status(self, question: Question, reply: bytes) -> bytes | None:
        """See `RegisterMap`: the bytes of the registers; None: it was a probe."""
        return None if reply[0] == modbus_frames.READ_INPUT else reply[2:]


class SensorLink:
    """One sensor. It belongs to the I/O thread.

    Args:
        config: where it is.
        aborted: whether to give up what waits.
    """

    def __init__(self, config: Ft300Config, aborted: Callable[[], bool]) -> None:
        self._config = config
        self._aborted = aborted
        self._transport: Transport = transport_of(config, "robotiq-ft300", aborted)
        self._framing = framing_of(config)
        self._asking = ModbusLink(
            SensorRegisters(), self._transport, self._framing, config.reply_timeout
        )
        self._byte_time = BITS / config.baud
        self._decoder = stream_decoder()
        self._newest: float | None = None
        self._lateness = Lateness()
        self._corrupt = self._strange = 0
        self.lost = 0

    @property
    def where(self) -> str:
        """For messages."""
        return self._transport.where

    @property
    def counters(self) -> Mapping[str, float]:
        """What went wrong, counted."""
        return {
            **self._asking.counters,
            "lost": self.lost,
            "corrupt": self._corrupt + self._decoder.corrupt,
            "strange_bytes": self._framing.strange + self._strange + self._decoder.strange,
        }

    def open(self, deadline: float) -> Identity:
        """Connect; return what the sensor says of itself. Afterwards it measures.

        Raises:
            ConnectionFailed: not by the monotonic `deadline`, or something else answers.
        """
        self._asking.open(deadline)
        try:
            if self._config.link != "modbus":
                self._end_stream(deadline)
            parts = (registers.FIRMWARE, registers.SERIAL, registers.YEAR)
            identity = Identity.parse(
                *(self._ask(modbus_frames.read(*which), deadline) for which in parts)
            )
            if not identity.is_sensor:
                raise ConnectionFailed(
                    f"what answers has firmware {identity.firmware!r}, as no FT 300 has",
                    where=self.where,
                    remedy="Is this the sensor's port and address?",
                )
            if self._config.streams:
                self._begin_stream(deadline)
        except BaseException:
            self._transport.close()
            raise
        return identity

    def close(self) -> None:
        """End the stream, since others may want to ask the sensor, and disconnect. May be called twice."""
        if self._config.streams and self._newest is not None:
            self._newest = None
            with contextlib.suppress(ConnectionLost):  # whoever connects next ends it
                self._transport.write(STOP)
        self._transport.close()

    def read(self, deadline: float) -> Batch | None:
        """Return what was measured since; None: nothing by the deadline.

        Raises:
            ConnectionLost: the connection is gone.
            ProtocolError: what answers is no such sensor.
        """
        if self._config.streams:
            return self._streamed(deadline)
        answer = self._asking.exchange(None, deadline)
        if answer is None:
            return None
        load = registers.loads_of(answer.status)
        return Batch(load[np.newaxis], np.array([answer.stamp.monotonic]))

    @property
    def trouble(self) -> tuple[str, str]:
        """Why there is no answer, and what to do."""
        return self._asking.trouble

    # -------------------------------------------------------------------------------------- connecting

    def _end_stream(self, deadline: float) -> None:
        """Stop what may still stream: while it does, nothing is answered."""
        while True:
            self._transport.write(STOP)
            patience = min(deadline, time.monotonic() + PATIENCE)
            while time.monotonic() < patience:
                if not self._transport.read(time.monotonic() + QUIET):
                    return
            self._give_up(deadline, "its stream does not end")

    def _begin_stream(self, deadline: float) -> None:
        """Let it stream: believed when a measurement has come."""
        self._corrupt += self._decoder.corrupt
        self._strange += self._decoder.strange
        self._decoder, self._newest = stream_decoder(), None
        self._lateness.reset()
        begin = modbus_frames.write(registers.STREAM, registers.STREAM_ON)
        while True:
            self._transport.write(self._framing.ask(begin))
            if self._streamed(min(deadline, time.monotonic() + PATIENCE)) is not None:
                return
            self._give_up(deadline, "its stream does not begin")

    def _ask(self, question: Question, deadline: float) -> bytes:
        while True:
            answer = self._asking.exchange(question, min(deadline, time.monotonic() + PATIENCE))
            if answer is not None and answer.delivered is question:
                return answer.status
            self._give_up(deadline, "")

    def _give_up(self, deadline: float, what: str) -> None:
        if self._aborted() or time.monotonic() >= deadline:
            text, remedy = self.trouble
            raise ConnectionFailed(what or text, where=self.where, remedy=remedy)

    # ----------------------------------------------------------------------------------- the stream

    def _streamed(self, deadline: float) -> Batch | None:
        while data := self._transport.read(deadline):
            loads = self._decoder.feed(data)
            if loads:
                sent = time.monotonic() - self._byte_time * (FRAME + self._decoder.pending)
                sent -= self._lateness.held_up(len(loads) * PERIOD, sent)
                times = sent - PERIOD * np.arange(len(loads) - 1, -1, -1.0)
                self._count(len(loads), sent)
                return Batch(np.array(loads), times)
            if time.monotonic() >= deadline:
                break
        return None

    def _count(self, came: int, newest: float) -> None:
        """Count what did not come at all: the stream has no numbers, but a clock."""
        before, self._newest = self._newest, newest
        periods = 0 if before is None else round((newest - before) / PERIOD)
        if periods > max(came, GAP):
            self.lost += periods - came

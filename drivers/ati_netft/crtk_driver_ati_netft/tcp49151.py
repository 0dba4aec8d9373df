"""The sensor's TCP channel (port 49151): one reading for each request. Codec and connection.

Requests are 20 bytes, big-endian. Readings have 16 bits and no sequence number: enough where UDP is blocked,
at a few hundred readings per second. It also tells units and scale where the web server is off. (ATI
9620-05-NET FT, chapter on the TCP interface.)
"""

from __future__ import annotations

import struct
import time
from collections.abc import Callable
from typing import Final, NamedTuple

from crtk_driver_ati_netft import units
from crtk_driver_ati_netft.units import Scale
from crtk_drivers.errors import ConnectionFailed, ProtocolError
from crtk_drivers.kit import TcpTransport
from crtk_drivers.samples import Vector, vector

PORT: Final = 49151
HEADER: Final = 0x1234

_READ_FT, _READ_CALIBRATION = 0, 1
_BIAS, _CLEAR_LATCH = 1, 2

_READING = struct.Struct(">HH6h")
_CALIBRATION = struct.Struct(">HBBII6H")
_ON = "Check the address, the cable, and that the sensor is on."
_REMEDY = "Is this the TCP port (49151) of a NetFT sensor?"


class Reading(NamedTuple):
    """One reading: the upper half of the status word at its place, and 16-bit values (6,)."""

    status: int
    values: tuple[int, ...]


class TcpScale(NamedTuple):
    """What the readings are worth: counts of the stream in one step of a reading, (6,), and their scale."""

    scale: Scale
    steps: tuple[int, ...]

    @property
    def factors(self) -> Vector:
        """SI value of one step of a reading of each axis (6,), in N and N·m."""
        return vector(self.scale.factors * self.steps)


def encode_read(bias: bool = False, clear_latch: bool = False) -> bytes:
    """Return the request for a reading, which may also set the bias and clear the monitor condition."""
    commands = (_BIAS if bias else 0) | (_CLEAR_LATCH if clear_latch else 0)
    return struct.pack(">B15xHH", _READ_FT, 0, commands)


def encode_read_calibration() -> bytes:
    """Return the request for units and scale."""
    return struct.pack(">B19x", _READ_CALIBRATION)


def decode_reading(reply: bytes) -> Reading:
    """Return the reading of a reply.

    Raises:
        ValueError: it is none.
    """
    status, *values = _unpack(_READING, reply)
    return Reading(status << 16, tuple(values))


def decode_calibration(reply: bytes) -> TcpScale:
    """Return the units and the scale of a reply.

    Raises:
        ValueError: it is none, or the units are unknown.
    """
    force_code, torque_code, per_force, per_torque, *steps = _unpack(_CALIBRATION, reply)
    force = units.factor_of_code(units.FORCE, force_code)
    torque = units.factor_of_code(units.TORQUE, torque_code)
    if force is None or torque is None:
        raise ValueError(f"unknown units: codes {force_code} and {torque_code}")
    if not all(steps):
        raise ValueError(f"the scale of a reading is {steps}, not above zero")
    return TcpScale(Scale(per_force, per_torque, force, torque), tuple(steps))


def _unpack(form: struct.Struct, reply: bytes) -> tuple[int, ...]:
    if len(reply) != form.size:
        raise ValueError(f"{len(reply)} bytes, not {form.size}")
    header, *values = form.unpack(reply)
    if header != HEADER:
        raise ValueError(f"the header is 0x{header:04x}, not 0x{HEADER:04x}")
    return tuple(values)


class TcpChannel:
    """One connection. `open`, then ask; one request is on its way at a time.

    Args:
        host, port: of the sensor.
        clock: monotonic seconds.
    """

    def __init__(
        self, host: str, port: int = PORT, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._connection = TcpTransport(host, port, remedy=_ON, clock=clock)
        self.where = self._connection.where
        self._clock = clock
        self._reply = bytearray()
        self._asked_at = 0.0
        self._asked = False

    def open(self, deadline: float) -> None:
        """Connect.

        Raises:
            ConnectionFailed: not by the monotonic `deadline`.
        """
        self._connection.open(deadline)

    def abort(self) -> None:
        """End what waits, from any thread; later calls fail."""
        self._connection.abort()

    def close(self) -> None:
        """Disconnect. May be called twice."""
        self._connection.close()
        self._reply.clear()
        self._asked = False

    def calibration(self, deadline: float) -> TcpScale:
        """Return units and scale.

        Raises:
            ConnectionFailed: no answer by the monotonic `deadline`.
            ConnectionLost, ProtocolError: the connection ended; the answer is none.
        """
        found = self.calibration_again(deadline)
        if found is None:
            raise ConnectionFailed("no answer in time", where=self.where, remedy=_REMEDY)
        return found

    def calibration_again(self, deadline: float) -> TcpScale | None:
        """Return units and scale, None if they do not come by the deadline: the next call goes on waiting.

        No reading may be on its way.

        Raises:
            ConnectionLost, ProtocolError: as for `calibration`.
        """
        if not self._asked:
            self._ask(encode_read_calibration())
        reply = self._await(_CALIBRATION.size, deadline)
        if reply is None:
            return None
        try:
            return decode_calibration(reply)
        except ValueError as error:
            raise ProtocolError(str(error), where=self.where, remedy=_REMEDY) from error

    def read(
        self, deadline: float, *, bias: bool = False, clear_latch: bool = False
    ) -> tuple[Reading, float] | None:
        """Return a reading and its time, halfway between question and answer; None: not by the deadline.

        A question that is not answered yet is not asked again: the next call goes on waiting, and `bias`
        and `clear_latch` are then for naught.

        Raises:
            ConnectionLost, ProtocolError: as for `calibration`.
        """
        if not self._asked:
            self._ask(encode_read(bias, clear_latch))
        reply = self._await(_READING.size, deadline)
        if reply is None:
            return None
        try:
            return decode_reading(reply), (self._asked_at + self._clock()) / 2.0
        except ValueError as error:
            raise ProtocolError(str(error), where=self.where, remedy=_REMEDY) from error

    def _ask(self, request: bytes) -> None:
        self._connection.write(request)
        self._asked, self._asked_at = True, self._clock()

    def _await(self, size: int, deadline: float) -> bytes | None:
        while len(self._reply) < size:
            piece = self._connection.read(deadline, size - len(self._reply))
            if not piece:
                return None
            self._reply += piece
        reply = bytes(self._reply)
        self._reply.clear()
        self._asked = False
        return reply

"""What the data acquisition unit sends and is told: bytes to values, and back. Pure: no I/O.

All numbers are big-endian; each frame ends with the sum of the bytes before it, in 16 bits. Sources: the
drivers of Shadow Robot (optoforce.py) and of JHU (sawOptoForceSensor), and for the bits of the status word
optoforce/status.py of A. Knemeyer, which names them as OptoForce's documentation does.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Final

from crtk_drivers.kit import SeekingDecoder
from crtk_drivers.kit.sensing.status_words import Bit, Meaning, StatusTable

__all__ = [
    "ASK_SERIAL",
    "FILTERS",
    "SPEEDS",
    "STATUS",
    "Acknowledgement",
    "Measurement",
    "SerialNumber",
    "configuration",
    "sensor_concerned",
    "stream_decoder",
]

SPEEDS: Final = {1000: 1, 333: 3, 100: 10, 30: 33, 10: 100}
"""Code of the output rate in Hz."""
FILTERS: Final = {None: 0, 500.0: 1, 150.0: 2, 50.0: 3, 15.0: 4, 5.0: 5, 1.5: 6}
"""Code of its filter's cut-off in Hz; None: it does not filter."""
ASK_SERIAL: Final = bytes.fromhex("AB00120800C5")

_CONFIGURE: Final = bytes.fromhex("AA003203")
_ZERO, _NO_ZERO = 255, 0
_HEAD: Final = b"\xaa"
_HEAD_SIZE: Final = 4
_ACKNOWLEDGED: Final = bytes.fromhex("AA005001")
_SERIAL: Final = bytes.fromhex("AA001208")
_DATA: Final = {bytes((0xAA, 0x07, 0x08, 4 + 2 * axes)): axes for axes in (3, 6, 12)}
"""Axes of a measurement by its head, the last byte of which is the size of what follows."""
_SIZES: Final = {
    _ACKNOWLEDGED: 7,
    _SERIAL: 14,
    **{head: _HEAD_SIZE + head[-1] + 2 for head in _DATA},
}

_ERROR, _SATURATED, _NOTICE = Meaning.ERROR, Meaning.SATURATED, Meaning.NOTICE
STATUS: Final = StatusTable(
    (
        Bit(1 << 15, _ERROR, "an error of the unit that is in no table"),
        Bit(1 << 14, _ERROR, "the unit cannot talk to the sensor"),
        Bit(1 << 13, _ERROR, "error of the data acquisition unit"),
        Bit(1 << 12, _ERROR, "temperature error"),
        Bit(1 << 11, _ERROR, "sensor failure"),
        Bit(1 << 10, _ERROR, "sensor not detected"),
        *(
            Bit(1 << (9 - number), _SATURATED, f"{axis} is overloaded")
            for number, axis in enumerate(("Fx", "Fy", "Fz", "Tx", "Ty", "Tz"))
        ),
        Bit(0xF, _NOTICE, "it says which sensor is concerned"),
    ),
    has_summary=False,
)


@dataclass(frozen=True, slots=True)
class Measurement:
    """One measurement: number (16 bits), status word, counts of each axis, one sensor after the other."""

    number: int
    status: int
    counts: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Acknowledgement:
    """A configuration was taken; an error other than 0: it was not."""

    error: int


@dataclass(frozen=True, slots=True)
class SerialNumber:
    """Who it is."""

    text: str


Message = Measurement | Acknowledgement | SerialNumber


def configuration(rate: int, low_pass: float | None, *, zero: bool) -> bytes:
    """Return what sets all that can be set: rate in Hz, cut-off in Hz, and whether the load counts as zero.

    A unit that is zeroed has to be told otherwise before it is zeroed again, 2 ms before.

    Raises:
        KeyError: there is no such rate or cut-off.
    """
    body = bytes((SPEEDS[rate], FILTERS[low_pass], _ZERO if zero else _NO_ZERO))
    return _summed(_CONFIGURE + body)


def stream_decoder() -> SeekingDecoder[Message]:
    """Return what finds the messages in a stream that may be damaged and begin anywhere."""
    return SeekingDecoder(_HEAD, _size, _parse)


def sensor_concerned(status: int) -> str:
    """Return which of several sensors an error or an overload is of; empty if it is not told."""
    if status & 0x8:
        return "several sensors"
    number = status & 0x7
    return f"sensor {number}" if 1 <= number <= 4 else ""


def _size(data: bytes) -> int:
    if len(data) < _HEAD_SIZE:
        return 0
    size = _SIZES.get(data[:_HEAD_SIZE])
    if size is None:
        raise ValueError("no such frame")
    return size


def _parse(frame: bytes) -> Message:
    head, body = frame[:_HEAD_SIZE], frame[_HEAD_SIZE:-2]
    if _summed(head + body) != frame:
        raise ValueError("its sum is wrong")
    if head == _ACKNOWLEDGED:
        return Acknowledgement(body[0])
    if head == _SERIAL:
        return SerialNumber(body.decode("ascii", "replace").strip("\0 "))
    number, status, *counts = struct.unpack(f">HH{_DATA[head]}h", body)
    return Measurement(number, status, tuple(counts))


def _summed(data: bytes) -> bytes:
    return data + (sum(data) & 0xFFFF).to_bytes(2)

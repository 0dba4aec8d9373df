"""How long frames take on classic CAN, and whether a cycle fits into its period.

A data frame with an 11-bit identifier has 44 bits and 8 for each byte, then 3 between frames. Of the first 34
bits and the data, and the CRC that follows, 4 bits in a row of 5 can force a stuff bit (ISO 11898-1, 10.5).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

from typing_extensions import override

from crtk_driver_canopen.pdo import Pdo
from crtk_drivers.errors import ConfigError

_OVERHEAD: Final = 44
_GAP: Final = 3
_STUFFED: Final = 34
"""Bits of a frame without data that are stuffed: start of frame to CRC."""

_CRC_POLYNOMIAL: Final = 0x4599

HEARTBEAT_BYTES: Final = 1
SDO_BYTES: Final = 8


def plain_bits(size: int) -> int:
    """Return the bits of a frame with `size` bytes and the gap behind it, without stuffing."""
    return _OVERHEAD + 8 * size + _GAP


def worst_bits(size: int) -> int:
    """Return the same with as many stuff bits as there can be."""
    return plain_bits(size) + (_STUFFED + 8 * size - 1) // 4


def exact_bits(cob_id: int, data: bytes) -> int:
    """Return the bits of one frame with the stuff bits that it really has, and the gap behind it.

    Args:
        cob_id: 11 bits.
        data: up to 8 bytes.
    """
    # Start of frame, identifier, RTR, IDE, r0, DLC, data.
    text = f"0{cob_id:011b}000{len(data):04b}" + "".join(f"{byte:08b}" for byte in data)
    crc = 0
    for bit in text:
        high = crc >> 14 & 1
        crc = crc << 1 & 0x7FFF
        if high != int(bit):
            crc ^= _CRC_POLYNOMIAL
    return plain_bits(len(data)) + _stuff_bits(text + f"{crc:015b}")


def _stuff_bits(text: str) -> int:
    stuffed, run, last = 0, 0, ""
    for bit in text:
        run = run + 1 if bit == last else 1
        last = bit
        if run == 5:
            stuffed += 1
            run, last = 1, "1" if bit == "0" else "0"
    return stuffed


@dataclass(frozen=True)
class BusLoad:
    """What a cycle puts on the bus.

    Attributes:
        frames: in a cycle, those that come with every n-th SYNC counted as 1/n.
        bits: of these, without stuffing.
        worst: of these, with as many stuff bits as there can be.
        other: bits per second of heartbeats, and of the SDO traffic that is reckoned with, at worst.
        bitrate: in bit/s.
        period: of the cycle, in s.
    """

    frames: float
    bits: float
    worst: float
    other: float
    bitrate: int
    period: float

    @property
    def least(self) -> float:
        """Share of the bus that the cycle takes without stuffing."""
        return self.bits / self.bitrate / self.period

    @property
    def most(self) -> float:
        """Share of the bus that everything can take."""
        return (self.worst / self.period + self.other) / self.bitrate

    @override
    def __str__(self) -> str:
        least, most = (1e3 * bits / self.bitrate for bits in (self.bits, self.worst))
        return (
            f"{self.frames:g} frames of {least:.2f} to {most:.2f} ms in a period of {1e3 * self.period:g} ms "
            f"at {self.bitrate / 1000:g} kbit/s, and {self.other / 1000:.1f} kbit/s beside them: "
            f"{self.least:.0%} to {self.most:.0%} of the bus"
        )


def cycle_load(
    pdos: Iterable[Pdo],
    *,
    period: float,
    bitrate: int,
    sync_bytes: int = 0,
    heartbeats: Iterable[float] = (),
    sdo_rate: float = 0.0,
) -> BusLoad:
    """Return the load of a cycle: SYNC, the PDOs, heartbeats and SDO.

    PDOs by event count as one in each period.

    Args:
        period: of SYNC, in s.
        bitrate: in bit/s.
        sync_bytes: 1 if SYNC has a counter.
        heartbeats: period of each producer, in s.
        sdo_rate: SDO requests per second, each with its answer.
    """
    frames, bits, worst = 1.0, float(plain_bits(sync_bytes)), float(worst_bits(sync_bytes))
    for pdo in pdos:
        every = pdo.transmission if 1 <= pdo.transmission <= 240 else 1
        frames += 1 / every
        bits += plain_bits(pdo.size) / every
        worst += worst_bits(pdo.size) / every
    other = sum(worst_bits(HEARTBEAT_BYTES) / each for each in heartbeats)
    other += 2 * sdo_rate * worst_bits(SDO_BYTES)
    return BusLoad(frames, bits, worst, other, bitrate, period)


def check_load(load: BusLoad, limit: float, where: str = "") -> None:
    """Refuse a cycle that does not fit.

    Args:
        limit: share of the bus that may be taken at worst, for example 0.8.

    Raises:
        ConfigError: with the arithmetic, and what would fit.
    """
    if load.most <= limit:
        return
    room = limit * load.bitrate - load.other
    if room > 0.0:
        fits = 1e3 * load.worst / room
        remedy = f"A period of {fits:.2f} ms would fit; or use fewer or shorter PDOs, or a higher bit rate."
    else:
        remedy = "Heartbeats alone are too many: give them longer times, or use a higher bit rate."
    raise ConfigError(
        f"the cycle takes {load}; {limit:.0%} are allowed", where=where, remedy=remedy
    )

"""Registers of an FPGA1394 board with a QLA (four axes), firmware 8, and its state as values; no I/O.

Source: JHU mechatronics-software, ``lib/code/AmpIO.cpp`` and ``EncoderVelocity.cpp``, and
mechatronics-firmware, ``BoardRegs-QLA.v`` and ``MotorChannelQLA.v``.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from typing import Final, NamedTuple

HARDWARE: Final = 0x514C4131
"""Register 4 of a board with a QLA: ``QLA1``."""

OTHER_HARDWARE: Final = {
    "DQLA": "two QLAs on one FPGA",
    "dRA1": "a dVRK-Si",
    "BCFG": "no amplifiers yet",
}
"""What else register 4 may say, and what that is."""

FIRMWARE: Final = 8
"""The firmware whose registers these are."""

AXES: Final = 4
"""Of a QLA."""

QUADLETS: Final = 4 + 7 * AXES
"""Of the state, which is a block at address 0: 32 with firmware 8, whose last four are of the motors."""


class Register(IntEnum):
    """Addresses of registers of a board."""

    STATUS = 0
    PHY = 1
    WATCHDOG = 3
    HARDWARE = 4
    FIRMWARE = 7
    IP_ADDRESS = 11
    ETHERNET = 12


def preload(axis: int) -> int:
    """Return the address of the register from which the encoder of an axis (0 to 3) was set."""
    return (axis + 1) << 4 | 4


MIDDLE: Final = 0x800000
"""What an encoder counts from; also its preload as long as nobody has set it."""

_CLOCK: Final = 49.152e6
"""Hz in which boards count time."""

WATCHDOG_STEP: Final = 256.0 / _CLOCK
"""Seconds of one count of the watchdog's period; 0 is none."""

_TIMED_OUT: Final = 1 << 23
_VOLTAGE_GOOD: Final = 1 << 19
_POWER: Final = 1 << 18
_RELAY_CLOSED: Final = 1 << 17
_RELAY: Final = 1 << 16
_SUPPLY_FAULT: Final = 1 << 15
"""Bits of the status."""

_ENCODER_SUPPLY: Final = 1 << 31
"""Bit of the digital inputs: the supply of the encoders has a fault."""

_COUNT: Final = 0xFFFFFF
_OVERFLOW: Final = 1 << 24
"""Of an encoder's position."""

_PERIOD: Final = 0x03FFFFFF
_SLOWER: Final = 1 << 31
_FORWARDS: Final = 1 << 30
_TURNED: Final = 1 << 29
_IMPOSSIBLE: Final = 1 << 28
"""Of an encoder's period: longer than can be counted, its direction, it changed, A and B changed at once."""

_ON: Final = 0x30000000
_COMMAND: Final = 0xFFFF
_SAFETY: Final = 1 << 17
_AMPLIFIER_FAULT: Final = 1 << 16
"""Of a motor: its amplifier is on where both of two bits are, and off where none is; the current that was
written last; the current was not as asked for; a fault."""


class AxisState(NamedTuple):
    """One axis of a board.

    Attributes:
        potentiometer, current: of the converters, 0 to 65535.
        counts: of the encoder, from the middle.
        velocity: counts/s, by the period of the encoder; 0 where that is too long, or it has just turned.
        overflow: the encoder has counted beyond its range, and its position is none.
        jumped: its signals A and B changed at once, which no encoder does.
        is_on: its amplifier is enabled.
        is_tripped: the board has switched it off, since the current was not what was asked for.
        has_fault: its amplifier tells a fault, as when it is too hot.
        is_off: its amplifier is off, and nobody has asked for it.
        command: the current that was written last, of the converter, 0 to 65535.
    """

    potentiometer: int
    current: int
    counts: int
    velocity: float
    overflow: bool
    jumped: bool
    is_on: bool
    is_tripped: bool
    has_fault: bool
    is_off: bool
    command: int


class BoardState(NamedTuple):
    """The state of a board.

    Attributes:
        elapsed: seconds since the block was read before, by its clock.
        board: its number, which its rotary switch sets.
        channels: axes that it says it has.
        timed_out: its watchdog has expired, and all amplifiers are off.
        power: power of the motors is asked for.
        voltage_good: the motors have their voltage.
        relay: the safety relay is asked for.
        relay_closed: it is closed.
        supply_fault: over-voltage or over-current of the motors' supply.
        encoder_supply_fault: the encoders have no good supply.
        inputs: digital inputs and outputs, as they are in the register.
        temperatures: °C, of the amplifiers of the first two axes and of the others.
        axes: four.
    """

    elapsed: float
    board: int
    channels: int
    timed_out: bool
    power: bool
    voltage_good: bool
    relay: bool
    relay_closed: bool
    supply_fault: bool
    encoder_supply_fault: bool
    inputs: int
    temperatures: tuple[float, float]
    axes: tuple[AxisState, ...]


def board_of(status: int) -> int:
    """Return the number of the board that has this status."""
    return status >> 24 & 0x0F


def elapsed_of(timestamp: int) -> float:
    """Return the seconds since a block was read before, which its first quadlet tells."""
    return (timestamp + 1) / _CLOCK


def switched_on(status: int) -> str:
    """Return what a status says is on, in words; empty if nothing is."""
    told = (
        ("motor power is on", status & _POWER),
        ("amplifiers are on", status & (1 << AXES) - 1),
    )
    return " and ".join(words for words, is_so in told if is_so)


def state_of(block: Sequence[int]) -> BoardState:
    """Return the state that a block tells.

    Args:
        block: 32 quadlets, read at address 0.

    Raises:
        ValueError: it has another number of quadlets.
    """
    if len(block) != QUADLETS:
        raise ValueError(f"the state has {len(block)} quadlets, not {QUADLETS}")
    timestamp, status, inputs, temperature = block[:4]
    axes = map(_axis, block[4:8], block[8:12], block[12:16], block[28:32])
    return BoardState(
        elapsed=elapsed_of(timestamp),
        board=board_of(status),
        channels=status >> 28,
        timed_out=bool(status & _TIMED_OUT),
        power=bool(status & _POWER),
        voltage_good=bool(status & _VOLTAGE_GOOD),
        relay=bool(status & _RELAY),
        relay_closed=bool(status & _RELAY_CLOSED),
        supply_fault=bool(status & _SUPPLY_FAULT),
        encoder_supply_fault=bool(inputs & _ENCODER_SUPPLY),
        inputs=inputs,
        temperatures=((temperature >> 8 & 0xFF) / 2.0, (temperature & 0xFF) / 2.0),
        axes=tuple(axes),
    )


def _axis(analog: int, encoder: int, period: int, motor: int) -> AxisState:
    return AxisState(
        analog >> 16,
        analog & 0xFFFF,
        (encoder & _COUNT) - MIDDLE,
        _velocity(period),
        encoder & _OVERFLOW != 0,
        period & _IMPOSSIBLE != 0,
        motor & _ON == _ON,
        motor & _SAFETY != 0,
        motor & _AMPLIFIER_FAULT != 0,
        motor & _ON == 0,
        motor & _COMMAND,
    )


def _velocity(period: int) -> float:
    """Return counts/s: four in a period of the encoder."""
    if period & (_SLOWER | _TURNED):
        return 0.0
    speed = 4.0 * _CLOCK / max(period & _PERIOD, 1)
    return speed if period & _FORWARDS else -speed

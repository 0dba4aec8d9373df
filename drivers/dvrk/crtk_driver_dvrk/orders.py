"""What a board is told, as the quadlets of a block that is written at address 0; firmware 8, no I/O.

One block is one packet: currents, amplifiers and power are written together, or not at all. What a block does
not speak of stays as it is.

Source: JHU mechatronics-software, ``lib/code/AmpIO.cpp`` (``VALID_BIT``, ``MOTOR_ENABLE_MASK``,
``PWR_ENABLE``, ``RELAY_ON``), and mechatronics-firmware, ``MotorChannelQLA.v`` and ``BoardRegs-QLA.v``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

from crtk_driver_dvrk.registers import AXES, WATCHDOG_STEP

_VALID: Final = 0x80000000
_ENABLE_MASK: Final = 0x20000000
_ENABLE: Final = 0x10000000
_POWER_MASK: Final = 0x00080000
_POWER: Final = 0x00040000
_RELAY_MASK: Final = 0x00020000
_RELAY: Final = 0x00010000

HIGHEST: Final = 0xFFFF
"""Of a current, and of the watchdog's period, as boards take them."""

LONGEST_WATCHDOG: Final = HIGHEST * WATCHDOG_STEP
"""Seconds."""


class Motor(NamedTuple):
    """What one motor is told.

    Attributes:
        current: of the converter, 0 to 65535.
        amplifier: on, off, or as it is (None).
    """

    current: int
    amplifier: bool | None = None


def order(
    board: int,
    motors: Mapping[int, Motor],
    *,
    power: bool | None = None,
    relay: bool | None = None,
) -> tuple[int, ...]:
    """Return the six quadlets of a block.

    Args:
        board: its number, without which the block is for nobody.
        motors: by axis, 0 to 3.
        power: of the motors; switching it on also clears an expired watchdog and tripped amplifiers.
        relay: the safety relay.

    Raises:
        ValueError: there is no such axis, or a current is none.
    """
    told = [0] * AXES
    for axis, motor in motors.items():
        if not 0 <= axis < AXES:
            raise ValueError(f"a QLA has no axis {axis}")
        if not 0 <= motor.current <= HIGHEST:
            raise ValueError(f"{motor.current} is no current of the converter")
        told[axis] = _VALID | motor.current | _switch(motor.amplifier, _ENABLE_MASK, _ENABLE)
    control = _switch(power, _POWER_MASK, _POWER) | _switch(relay, _RELAY_MASK, _RELAY)
    return board << 8 | AXES + 2, *told, control


def _switch(on: bool | None, mask: int, bit: int) -> int:
    if on is None:
        return 0
    return mask | bit if on else mask


def watchdog_counts(seconds: float) -> int:
    """Return the period of a watchdog as boards take it.

    Raises:
        ValueError: it would be none, or is longer than they count.
    """
    counts = round(seconds / WATCHDOG_STEP)
    if not 0 < counts <= HIGHEST:
        raise ValueError(f"a watchdog of {seconds:g} s: at most {LONGEST_WATCHDOG:.3f} s, above 0")
    return counts

"""The limits that servos have in their own EEPROM, as a second line behind those of the driver.

Velocity Limit (44) bounds Goal Velocity and Profile Velocity, Min and Max Position Limit (52, 48; in protocol
1 the angle limits, 6 and 8) Goal Position in position mode, Current Limit (38) Goal Current (e-manual, X
series). All are rounded outwards, so that what the configuration allows is possible. A servo refuses a goal
beyond them, whoever sends it. Nothing is read or written here.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Final, NamedTuple

from crtk_driver_dynamixel.control_tables import ControlTable
from crtk_driver_dynamixel.joints import Chain, ChainServo, servo_range
from crtk_driver_dynamixel.models import OperatingMode
from crtk_driver_dynamixel.servo_state import ServoState

TOLD: Final = 3
"""Limits that are told one by one; `crtk-driver dynamixel limits --no-write` tells all."""


class OwnLimit(NamedTuple):
    """One limit of a servo.

    Attributes:
        register: its name.
        wanted: count that the configuration wants.
        read: count that it has.
        is_least: it bounds from below.
        text: what is wanted, in SI and of the joint.
    """

    register: str
    wanted: int
    read: int
    is_least: bool
    text: str

    @property
    def differs(self) -> bool:
        """Whether it has to be written."""
        return self.wanted != self.read

    @property
    def is_wider(self) -> bool:
        """Whether the servo would go further than the configuration."""
        return self.read < self.wanted if self.is_least else self.read > self.wanted


def own_limits(
    chain: Chain, servo: ChainServo, table: ControlTable, read: Mapping[str, int]
) -> tuple[OwnLimit, ...]:
    """Return the limits of a servo that the configuration says something of, as they are and should be.

    Positions are left out in modes of more than one turn, in which their limits do not count; the velocity
    of a gripper, whose servo has none of its own; and currents without a `current_limit`.

    Args:
        chain: calibrated.
        servo: of this chain.
        read: its registers by name.
    """
    return tuple(
        OwnLimit(name, wanted, read[name], is_least, text)
        for name, wanted, is_least, text in _wanted(chain, servo)
        if name in table and name in read
    )


def wider(chain: Chain, states: Mapping[int, ServoState]) -> str:
    """Return which servos, by place, would go further than the configuration, in words; empty if none.

    Of more than `TOLD` limits the others are counted.
    """
    told = [
        f"{chain.servos[place].place} {limit.register} {limit.read} for {limit.wanted} ({limit.text})"
        for place, state in states.items()
        for limit in own_limits(chain, chain.servos[place], state.table, state.values)
        if limit.is_wider
    ]
    others = [f"and {len(told) - TOLD} more"] if len(told) > TOLD else []
    return "; ".join(told[:TOLD] + others)


def _wanted(chain: Chain, servo: ChainServo) -> Iterator[tuple[str, int, bool, str]]:
    units, family = servo.units, servo.units.model.family
    if servo.joint < len(chain.joints) and family.velocity_unit > 0.0:
        velocity = chain.limits[servo.joint].velocity
        counts = math.ceil(velocity * units.gear / family.velocity_unit - 1e-6)
        yield "velocity_limit", max(1, counts), False, f"{velocity:.3g} rad/s"
    if units.mode is OperatingMode.POSITION:
        ends = servo_range(servo.config)
        low, high = sorted(units.count(end) for end in ends)
        least, most = max(family.lowest, math.floor(low + 1e-6)), math.ceil(high - 1e-6)
        text = f"range {ends[0]:.4g} to {ends[1]:.4g} rad"
        for names in (
            ("min_position_limit", "max_position_limit"),
            ("cw_angle_limit", "ccw_angle_limit"),
        ):
            yield names[0], least, True, text
            yield names[1], min(family.highest, most), False, text
    current = servo.config.current_limit
    if servo.current_limit is not None and current is not None:
        yield (
            "current_limit",
            math.ceil(current / units.model.current_unit - 1e-6),
            False,
            f"{current:g} A",
        )

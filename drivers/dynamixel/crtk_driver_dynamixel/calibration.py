"""Calibration: where the middle of each servo really is, kept in a file that belongs to one chain.

The arm is put into a pose whose joint positions are known (half way, or a mark), the counts are read, and
`calibrate` says by how many counts each servo is off: its `shift`, applied by this driver, or a homing offset
in the servo's EEPROM, where that takes it. Joints of more than one turn come back from a power-off within
one turn: `turn_shift` finds the turn they are in.

Homing Offset (20) of the X series, e-manual: present position = position + offset; position mode takes
-1024 to 1024 counts and ignores others.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import yaml
from pydantic import Field

from crtk_driver_dynamixel.models import OperatingMode
from crtk_driver_dynamixel.units import Servo
from crtk_drivers.config import Settings, from_file, load
from crtk_drivers.errors import ConfigError

Identity = tuple[str, str, int, str]
"""Joint, bus, id and model of a servo: they have no serial number to tell it by."""


class ServoCalibration(Settings):
    """What was found for one servo."""

    joint: str = Field(max_length=64, description="Joint that it moves.")
    bus: str = Field(max_length=64, description="Bus that it is on.")
    id: int = Field(ge=0, le=252, description="Its id.")
    model: str = Field(max_length=40, description="Its model.")
    shift: int = Field(
        default=0,
        ge=-(2**31),
        lt=2**31,
        description="Counts that its middle is off, for the driver.",
    )
    homing_offset: int = Field(
        default=0, ge=-(2**31), lt=2**31, description="Homing Offset in its EEPROM, in counts."
    )

    def applied_to(self, servo: Servo) -> Servo:
        """Return what the counts of a servo mean with this calibration."""
        homing = servo.model.family.homing_in_force(self.homing_offset)
        return replace(servo, shift=self.shift, homing=homing)


class Calibration(Settings):
    """The calibration of a chain: the content of its file."""

    version: Literal[1] = Field(default=1, description="Of the format.")
    servos: tuple[ServoCalibration, ...] = Field(description="One for each servo.")

    @property
    def by_place(self) -> Mapping[tuple[str, int], ServoCalibration]:
        """What was found for each servo, by its bus and id."""
        return {(servo.bus, servo.id): servo for servo in self.servos}

    def check(self, servos: Iterable[Identity], where: str = "calibration") -> None:
        """Make sure that this calibration is of these servos.

        Raises:
            ConfigError: it is of other ones; says which differ.
        """
        own = {(s.bus, s.id): (s.joint, s.model) for s in self.servos}
        chain = {(bus, number): (joint, model) for joint, bus, number, model in servos}
        problems = [
            f"it has no servo {number} on {bus} ({chain[bus, number][0]})"
            for bus, number in chain.keys() - own.keys()
        ]
        problems += [
            f"servo {number} on {bus} ({own[bus, number][0]}) is not in the chain"
            for bus, number in own.keys() - chain.keys()
        ]
        for key in own.keys() & chain.keys():
            if own[key] != chain[key]:
                problems.append(
                    f"servo {key[1]} on {key[0]} is {' '.join(own[key])} there and "
                    f"{' '.join(chain[key])} here"
                )
        if len(own) != len(self.servos):
            problems.append("a servo is in it twice")
        if problems:
            raise ConfigError(
                f"the calibration is not of this chain: {'; '.join(sorted(problems))}",
                where=where,
                remedy="Calibrate again: crtk-driver dynamixel calibrate.",
            )


def unshifted(servo: Servo, count: int, homing_offset: int) -> int:
    """Return the count of the encoder itself, from a present position and the homing offset in force."""
    if servo.mode is OperatingMode.POSITION:
        return count - servo.model.family.homing_in_force(homing_offset)
    return count - homing_offset


def calibrate(
    servos: Sequence[tuple[Identity, Servo]],
    counts: Sequence[int],
    homing_offsets: Sequence[int],
    positions: Sequence[float],
    *,
    in_eeprom: bool = False,
) -> Calibration:
    """Return the calibration by which the servos are at these positions.

    Args:
        servos: of the chain, with its signs, offsets and gears.
        counts: present position of each.
        homing_offsets: that were in force when these were read.
        positions: of each servo's joint, in rad.
        in_eeprom: put it into the homing offset where the servo's mode takes it; otherwise, and where it
            does not fit, the driver does it alone and the homing offset is 0.

    Raises:
        ValueError: sequences of different lengths, or a position that is not finite.
    """
    found = []
    for (identity, servo), count, homing, position in zip(
        servos, counts, homing_offsets, positions, strict=True
    ):
        if not math.isfinite(position):
            raise ValueError(f"{identity[0]} has no position")
        plain = Servo(servo.model, servo.sign, servo.gear, servo.offset)
        shift = unshifted(servo, count, homing) - round(plain.count(position))
        if servo.mode is not OperatingMode.POSITION:
            shift = _within_a_turn(shift, servo.model.family.counts)
        fits = in_eeprom and abs(shift) <= servo.model.family.homing_limit
        joint, bus, number, model = identity
        found.append(
            ServoCalibration(
                joint=joint,
                bus=bus,
                id=number,
                model=model,
                shift=0 if fits else shift,
                homing_offset=-shift if fits else 0,
            )
        )
    return Calibration(servos=tuple(found))


def _within_a_turn(counts: int, turn: int) -> int:
    return (counts + turn // 2) % turn - turn // 2


def turn_shift(
    servo: Servo, count: int, lower: float, upper: float, last: float | None = None
) -> int:
    """Return the whole turns, in counts, by which a servo that was powered off is elsewhere than it counts.

    Args:
        servo: in a mode of more than one turn.
        count: its present position.
        lower, upper: range of its joint, in rad: it is taken to be within, or beyond an end by no more than
            a quarter of what the range lacks to a turn.
        last: position of the joint before the power went, in rad; it moved less than half a turn of the
            servo since. None if not known.

    Returns:
        what to add to the servo's shift.

    Raises:
        ConfigError: several turns are within the range and `last` is not known, or none is.
    """
    turn = servo.model.family.counts
    period = turn * servo.model.family.position_unit / servo.gear
    now = servo.position(count)
    if last is not None:
        turns = round((last - now) / period)
        return -servo.sign * turns * turn
    one_count = servo.model.family.position_unit / servo.gear
    slack = max(one_count, 0.25 * (period - (upper - lower)))
    least = math.ceil((lower - slack - now) / period)
    most = math.floor((upper + slack - now) / period)
    if least == most:
        return -servo.sign * least * turn
    if least > most:
        raise ConfigError(
            f"no turn of the servo at count {count} puts its joint between {lower:.4f} and {upper:.4f} rad",
            remedy="Move the joint into its range by hand, or calibrate again.",
        )
    raise ConfigError(
        f"the joint may be in any of {most - least + 1} turns, from {now + least * period:.4f} to "
        f"{now + most * period:.4f} rad",
        remedy="Name a file with the key turns, or home the joint: its position was lost with the power.",
    )


def save_calibration(path: Path | str, calibration: Calibration) -> None:
    """Write a calibration; the file is replaced as a whole or not at all.

    Raises:
        ConfigError: it cannot be written.
    """
    head = "# Calibration of a chain of DYNAMIXEL servos. Counts; see docs/dynamixel.md.\n"
    write_whole(Path(path), head, calibration.model_dump(mode="json"))


def configured_calibration(path: str) -> Calibration | None:
    """Return the calibration that a configuration names by its key; None if it names none.

    Raises:
        ConfigError: missing, or not such a file; with its line.
    """
    return load_calibration(path) if path else None


def load_calibration(path: Path | str) -> Calibration:
    """Read what `save_calibration` wrote.

    Raises:
        ConfigError: missing, or not such a file; with its line.
    """
    return load(Calibration, from_file(Path(path)))


def write_whole(path: Path, head: str, values: object) -> None:
    """Write a file of YAML; it is replaced as a whole or not at all, and is on the disk then.

    Raises:
        ConfigError: it cannot be written.
    """
    new = path.with_name(f"{path.name}.new")
    try:
        with new.open("w", encoding="utf-8") as file:
            file.write(head + yaml.safe_dump(values, sort_keys=False))
            file.flush()
            os.fsync(file.fileno())
        os.replace(new, path)
        _sync_folder(path.parent)
    except OSError as error:
        raise ConfigError(
            f"cannot be written: {error.strerror}", where=str(path), remedy="Check path and rights."
        ) from error


def _sync_folder(folder: Path) -> None:
    """Have the names in a folder on the disk: the old file would else be back after a loss of power."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)

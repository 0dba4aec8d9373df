"""What driving an arm needs of dVRK's file of inputs and outputs; reading it needs none of this.

Source: ``saw-robot-io.schema.json`` of sawRobotIO1394, version 6 (SI units), and what
``mtsRobot1394.cpp`` there does with it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any, Final, Literal

from pydantic import Field

from crtk_driver_dvrk.arm_file import (
    IO_FILE,
    Finite,
    Linear,
    Part,
    RobotName,
    chosen_robot,
    document,
    validated,
)
from crtk_driver_dvrk.orders import HIGHEST
from crtk_drivers.errors import ConfigError

_SCALES: Final = 0.05
"""By how much of them the two scales of a current may contradict each other."""

_ZERO: Final = 0.1
"""A that may be measured where the converter is told no current."""

NotNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]


class _Limits(Part):
    lower: Finite
    upper: Finite


class _Drive(Part):
    current_to_bits: Linear
    bits_to_current: Linear
    effort_to_current: Linear
    maximum_current: Annotated[float, Field(gt=0.0, allow_inf_nan=False)]


class _Encoder(Part):
    position_limits_soft: _Limits | None = None


class _Actuator(Part):
    board_id: int
    axis_id: int
    joint_type: Literal["REVOLUTE", "PRISMATIC", "CONTINUOUS", "FIXED", "UNDEFINED"] = "REVOLUTE"
    drive: _Drive
    encoder: _Encoder = _Encoder()


class _Tolerance(Part):
    distance: NotNegative
    latency: NotNegative


class _Potentiometers(Part):
    tolerances: tuple[_Tolerance, ...] = ()


class _Robot(RobotName):
    only_io: bool = Field(default=False, alias="only_IO")
    number_of_brakes: int = 0
    brakes: tuple[Any, ...] = ()
    actuators: tuple[_Actuator, ...] = Field(min_length=1)
    potentiometers: _Potentiometers = _Potentiometers()


class _Port(Part):
    robots: tuple[_Robot, ...] = Field(min_length=1)


@dataclass(frozen=True)
class Motor:
    """One motor of an arm, as it is driven. Positions in rad (m), efforts in N·m (N), currents in A.

    Attributes:
        board, axis: where it is.
        is_linear: its joint is prismatic.
        to_bits, of_bits: what a current is for the converters, and the other way.
        effort_to_current: A for an effort of 1.
        most: the largest current that the file allows.
        lower, upper: soft limits of its position; infinite if the file has none.
        apart: how far its potentiometer may be from its encoder; 0: that is not looked at.
        latency: seconds for which it may be farther.
    """

    board: int
    axis: int
    is_linear: bool
    to_bits: Linear
    of_bits: Linear
    effort_to_current: float
    most: float
    lower: float
    upper: float
    apart: float
    latency: float

    @property
    def where(self) -> str:
        """For messages."""
        return f"axis {self.axis} of board {self.board}"

    @property
    def zero(self) -> int:
        """What no current is for the converter."""
        return round(self.to_bits.offset)


def read_motors(path: str, robot: str = "") -> tuple[Motor, ...]:
    """Return the motors of an arm, in the order of its actuators.

    Args:
        path: of the file of inputs and outputs.
        robot: name of the arm there; the only one if empty.

    Raises:
        ConfigError: the arm cannot be driven by what the file says; with the place.
    """
    remedy = "Driving needs drive.current_to_bits, effort_to_current and maximum_current of each actuator."
    port = validated(_Port, document(path, IO_FILE), path, remedy)
    found = chosen_robot(port.robots, robot, path)
    _refuse_undriven(found, path)
    tolerances = found.potentiometers.tolerances
    count = len(found.actuators)
    if tolerances and len(tolerances) != count:
        raise ConfigError(
            f"{found.name}: {len(tolerances)} potentiometers.tolerances for {count} actuators",
            where=path,
            remedy="Give one for each, in their order, as dVRK reads them; or none.",
        )
    motors = []
    for at, actuator in enumerate(found.actuators):
        _check(f"{found.name}: actuators.{at}", actuator, path)
        drive, limits = actuator.drive, actuator.encoder.position_limits_soft
        motors.append(
            Motor(
                board=actuator.board_id,
                axis=actuator.axis_id,
                is_linear=actuator.joint_type == "PRISMATIC",
                to_bits=drive.current_to_bits,
                of_bits=drive.bits_to_current,
                effort_to_current=drive.effort_to_current.scale,
                most=drive.maximum_current,
                lower=limits.lower if limits else -math.inf,
                upper=limits.upper if limits else math.inf,
                apart=tolerances[at].distance if tolerances else 0.0,
                latency=tolerances[at].latency if tolerances else 0.0,
            )
        )
    return tuple(motors)


def _refuse_undriven(robot: _Robot, path: str) -> None:
    """Refuse arms that this driver must not let go, or that have nothing to drive."""
    brakes = max(robot.number_of_brakes, len(robot.brakes))
    if brakes:
        raise ConfigError(
            f"{robot.name} has {brakes} brakes, which hold it without power and must be released by currents "
            "of their own",
            where=path,
            remedy="This driver releases no brakes. Leave out `drive` to read the arm; drive it with dVRK's "
            "own program.",
        )
    if robot.only_io:
        raise ConfigError(
            f"{robot.name} is only_IO: it has no motors", where=path, remedy="Leave out `drive`."
        )


def _check(place: str, actuator: _Actuator, path: str) -> None:
    """Refuse conversions with which a current would not be what it should be."""
    drive, limits = actuator.drive, actuator.encoder.position_limits_soft
    told, sensed = drive.current_to_bits.scale, drive.bits_to_current.scale
    if not abs(told * sensed - 1.0) <= _SCALES:
        raise ConfigError(
            f"{place}.drive: current_to_bits and bits_to_current contradict each other: their scales are "
            f"{told:g} and {sensed:g}",
            where=path,
            remedy="Make the file anew with dVRK's generator.",
        )
    for amperes in (-drive.maximum_current, 0.0, drive.maximum_current):
        bits = drive.current_to_bits.of(amperes)
        if not 0.0 <= round(bits) <= HIGHEST:
            raise ConfigError(
                f"{place}.drive.current_to_bits: {amperes:g} A would be {bits:.0f}, which the converter "
                "does not have",
                where=path,
                remedy="Correct maximum_current, or calibrate the currents anew.",
            )
    at_zero = drive.bits_to_current.of(drive.current_to_bits.offset)
    if not abs(at_zero) <= _ZERO:
        raise ConfigError(
            f"{place}.drive: current_to_bits and bits_to_current contradict each other: what is no current "
            f"for the one is {at_zero:.3f} A for the other",
            where=path,
            remedy="Correct their offsets, or calibrate the currents anew.",
        )
    if drive.effort_to_current.scale == 0.0 or drive.effort_to_current.offset != 0.0:
        raise ConfigError(
            f"{place}.drive.effort_to_current: its scale must not be 0, and its offset must",
            where=path,
            remedy="No effort is no current, here as in dVRK's program.",
        )
    if limits is not None and not limits.lower < limits.upper:
        raise ConfigError(
            f"{place}.encoder.position_limits_soft: {limits.lower:g} is not below {limits.upper:g}",
            where=path,
            remedy="Correct them, or leave them out.",
        )

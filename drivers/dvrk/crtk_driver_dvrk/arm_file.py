"""What an arm is: dVRK's own files, and only what reading its state needs of them.

The one is that of the arm's inputs and outputs, which dVRK's generator makes of the calibration of each arm
(``sawRobotIO1394-PSM1-12345.json``): which axis of which board each actuator is, and how bits become rad, A,
V. The other, optional, has a coupling matrix, as the files of instruments and arms do.

Source: ``saw-robot-io.schema.json`` of sawRobotIO1394, version 6 (SI units), and the files of
sawIntuitiveResearchKit.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from crtk_driver_dvrk.registers import AXES
from crtk_drivers.config.capped_file import read_capped
from crtk_drivers.errors import ConfigError
from crtk_drivers.samples import Array

MOST_BYTES: Final = 1 << 20
MOST_ACTUATORS: Final = 16

IO_FILE: Final = "a file of inputs and outputs of dVRK (sawRobotIO1394-….json)"

Finite = Annotated[float, Field(allow_inf_nan=False)]
Matrix = tuple[tuple[Finite, ...], ...]
Model = TypeVar("Model", bound=BaseModel)
NamedRobot = TypeVar("NamedRobot", bound="RobotName")


class Part(BaseModel):
    """Part of a file of dVRK; what is not needed is not looked at."""

    model_config = ConfigDict(extra="ignore", frozen=True)


class Linear(Part):
    """``scale * x + offset``."""

    scale: Finite
    offset: Finite = 0.0

    @property
    def line(self) -> tuple[float, float]:
        """Scale and offset."""
        return self.scale, self.offset

    def of(self, value: float) -> float:
        """Return what a value becomes."""
        return self.scale * value + self.offset


class _Drive(Part):
    bits_to_current: Linear
    effort_to_current: Linear | None = None


class _Encoder(Part):
    bits_to_position: Linear


class _Potentiometer(Part):
    bits_to_voltage: Linear
    voltage_to_position: Linear


class Actuator(Part):
    """One actuator: an axis of a board, and how its bits become rad (m), A and V."""

    board_id: int = Field(ge=0, le=15)
    axis_id: int = Field(ge=0)
    joint_type: Literal["REVOLUTE", "PRISMATIC", "CONTINUOUS", "FIXED", "UNDEFINED"] = "REVOLUTE"
    encoder: _Encoder
    drive: _Drive | None = None
    potentiometer: _Potentiometer | None = None


class DigitalInput(Part):
    """A button or a switch of the arm."""

    name: str = Field(min_length=1, max_length=100)
    board_id: int = Field(ge=0, le=15)
    bit_id: int = Field(ge=0, le=31)
    pressed_value: bool = True


class _PotentiometerCoupling(Part):
    joint_to_actuator: Matrix = Field(default=(), alias="JointToActuatorPosition")


class _Potentiometers(Part):
    coupling: _PotentiometerCoupling = _PotentiometerCoupling()


class RobotName(Part):
    """An arm of a file, of which at least the name is read."""

    name: str


class _Robot(RobotName):
    serial_number: str = ""
    hardware_version: str = "QLA1"
    number_of_actuators: int
    actuators: tuple[Actuator, ...] = Field(min_length=1, max_length=MOST_ACTUATORS)
    potentiometers: _Potentiometers = _Potentiometers()


class _Port(Part):
    robots: tuple[_Robot, ...] = Field(min_length=1)
    digital_inputs: tuple[DigitalInput, ...] = ()


class _Coupling(Part):
    actuator_to_joint: Matrix = Field(alias="ActuatorToJointPosition", min_length=1)


class _Coupled(Part):
    coupling: _Coupling


@dataclass(frozen=True)
class Arm:
    """An arm.

    Attributes:
        name, serial_number: as its file says.
        actuators: in the order of vectors.
        inputs: those on its boards, by the names under which they are told.
        coupling: (n, n): positions of actuators to those of joints.
        sensed: (n, n): what potentiometers measure to positions of actuators; most sit at these.
    """

    name: str
    serial_number: str
    actuators: tuple[Actuator, ...]
    inputs: dict[str, DigitalInput]
    coupling: Array
    sensed: Array

    @property
    def boards(self) -> tuple[int, ...]:
        """Numbers of its boards, in the order in which actuators name them."""
        return tuple(dict.fromkeys(actuator.board_id for actuator in self.actuators))

    @property
    def has_potentiometers(self) -> bool:
        """Whether each actuator has one."""
        return all(actuator.potentiometer is not None for actuator in self.actuators)

    @property
    def has_efforts(self) -> bool:
        """Whether the effort of each actuator follows from its current."""
        return all(
            actuator.drive is not None and actuator.drive.effort_to_current is not None
            for actuator in self.actuators
        )


def read_arm(io: str, robot: str = "", coupling: str = "") -> Arm:
    """Return the arm of dVRK's files.

    Args:
        io: path of the file of inputs and outputs.
        robot: name of the arm there; the only one if empty.
        coupling: path of the file with the coupling matrix; actuators are joints if empty.

    Raises:
        ConfigError: they cannot be read, are none of these, or say what cannot be; names file and place.
    """
    port = validated(_Port, document(io, IO_FILE), io, f"Is it {IO_FILE}?")
    found = chosen_robot(port.robots, robot, io)
    _check(found, io)
    count = len(found.actuators)
    boards = {actuator.board_id for actuator in found.actuators}
    inputs = {_told(each.name): each for each in port.digital_inputs if each.board_id in boards}
    return Arm(
        name=found.name,
        serial_number=found.serial_number,
        actuators=found.actuators,
        inputs=inputs,
        coupling=_coupling(coupling, count),
        sensed=_square(
            found.potentiometers.coupling.joint_to_actuator,
            count,
            io,
            "potentiometers.coupling.JointToActuatorPosition",
        ),
    )


def document(path: str, kind: str) -> Any:
    """Return what a JSON file of dVRK holds.

    Args:
        path: of the file.
        kind: what it should be, for errors.

    Raises:
        ConfigError: it cannot be read, is no JSON, or is of an older release.
    """
    data = read_capped(Path(path), MOST_BYTES, kind)
    try:
        found = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise ConfigError(
            f"is no JSON: {error}",
            where=path,
            remedy=f"Give {kind}. XML files are of older releases: make it anew with dVRK's generator.",
        ) from error
    if isinstance(found, dict) and "Robots" in found:
        raise ConfigError(
            "is of an older release of dVRK (Robots, in deg and mm)",
            where=path,
            remedy="Make it anew with the generator of a release that writes `robots`, in SI units.",
        )
    return found


def validated(model: type[Model], found: Any, path: str, remedy: str) -> Model:
    """Return what a document says, as a model.

    Raises:
        ConfigError: with the first place that does not fit.
    """
    try:
        return model.model_validate(found)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(map(str, first["loc"])) or "the file"
        more = error.error_count() - 1
        beside = f" (and {more} more)" if more else ""
        raise ConfigError(
            f"{place}: {first['msg']}{beside}",
            where=path,
            remedy=remedy,
        ) from error


def chosen_robot(robots: Sequence[NamedRobot], name: str, path: str) -> NamedRobot:
    """Return the arm of a file that has a name; the only one if that is empty.

    Raises:
        ConfigError: there is none, or there are several.
    """
    names = [each.name for each in robots]
    if not name and len(robots) > 1:
        raise ConfigError(
            f"has {len(robots)} arms", where=path, remedy=f"Give `robot`: {', '.join(names)}."
        )
    for each in robots:
        if name in ("", each.name):
            return each
    raise ConfigError(
        f"has no arm {name!r}", where=path, remedy=f"Give `robot`: {', '.join(names)}."
    )


def _check(robot: _Robot, path: str) -> None:
    """Refuse what no arm with QLA boards can be."""
    if robot.hardware_version != "QLA1":
        raise ConfigError(
            f"{robot.name} has boards of the kind {robot.hardware_version}",
            where=path,
            remedy="This driver reads boards with a QLA (QLA1).",
        )
    if robot.number_of_actuators != len(robot.actuators):
        raise ConfigError(
            f"{robot.name}: number_of_actuators is {robot.number_of_actuators}, and there are "
            f"{len(robot.actuators)} actuators",
            where=path,
            remedy="Has it been cut? Make it anew with dVRK's generator.",
        )
    taken: dict[tuple[int, int], int] = {}
    for at, actuator in enumerate(robot.actuators):
        if actuator.axis_id >= AXES:
            raise ConfigError(
                f"{robot.name}: actuators.{at}.axis_id is {actuator.axis_id}",
                where=path,
                remedy=f"A QLA has the axes 0 to {AXES - 1}.",
            )
        if actuator.encoder.bits_to_position.scale == 0.0:
            raise ConfigError(
                f"{robot.name}: actuators.{at}.encoder.bits_to_position.scale is 0", where=path
            )
        efforts = actuator.drive.effort_to_current if actuator.drive is not None else None
        if efforts is not None and efforts.scale == 0.0:
            raise ConfigError(
                f"{robot.name}: actuators.{at}.drive.effort_to_current.scale is 0", where=path
            )
        place = actuator.board_id, actuator.axis_id
        other = taken.setdefault(place, at)
        if other != at:
            raise ConfigError(
                f"{robot.name}: actuators {other} and {at} are both axis {place[1]} of board {place[0]}",
                where=path,
                remedy="Correct board_id and axis_id.",
            )


def _coupling(path: str, count: int) -> Array:
    """Return the matrix from actuators to joints; a smaller one is of the last actuators, an instrument's."""
    if not path:
        return np.eye(count)
    kind = "a file of dVRK with a coupling matrix (that of an instrument, or of an arm)"
    remedy = "It needs coupling.ActuatorToJointPosition."
    found = validated(_Coupled, document(path, kind), path, remedy)
    matrix = _square(
        found.coupling.actuator_to_joint, count, path, "coupling.ActuatorToJointPosition"
    )
    if np.linalg.cond(matrix) > _SINGULAR:
        raise ConfigError(
            "coupling.ActuatorToJointPosition cannot be inverted: several actuators would be one joint",
            where=path,
        )
    return matrix


def _square(rows: Matrix, count: int, path: str, place: str) -> Array:
    """Return a matrix of all actuators; what rows do not speak of is as it is."""
    matrix, size = np.eye(count), len(rows)
    if size > count or any(len(row) != size for row in rows):
        raise ConfigError(
            f"{place} has {size} rows of {', '.join(map(str, sorted({len(row) for row in rows})))}",
            where=path,
            remedy=f"The arm has {count} actuators: it must be square, and no larger.",
        )
    if size:
        matrix[count - size :, count - size :] = rows
    return matrix


_SINGULAR: Final = 1e9


def _told(name: str) -> str:
    """Return the name of a digital input as readings are called."""
    return re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_") or "input"

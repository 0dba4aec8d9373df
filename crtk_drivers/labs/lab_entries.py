"""What can stand in a lab file, each table as a class; `crtk_drivers.labs.lab_file` reads it."""

from __future__ import annotations

import re
from typing import Annotated, Any, Final, Self

from pydantic import AfterValidator, Field, field_validator, model_validator

from crtk_drivers.config import PoseConfig, Settings, SpaceConfig
from crtk_drivers.config.variables import checked_variables
from crtk_drivers.labs.carried import Carried
from crtk_drivers.motion.teleop.teleop_settings import TeleopSettings

NAME: Final = r"^[A-Za-z][A-Za-z0-9_]*$"
"""Of a device or a program: it becomes a ROS namespace, an attribute and a file."""

NAMESPACE: Final = r"(/[A-Za-z_][A-Za-z0-9_]*)+"

ENCLAVE: Final = rf"/|{NAMESPACE}"

HOST_NAME: Final = r"[A-Za-z0-9]([A-Za-z0-9._-]*[A-Za-z0-9])?"
"""Source: RFC 1123, section 2.1; and the underscore, which Linux takes too."""

ALL_MACHINES: Final = "all"
"""In place of the name of a machine: the whole lab, on whatever machine this is."""

DRIVER_ENCLAVE: Final = "crtk_driver"
"""Last part of the enclave of a driver, as `crtk-driver policy` names it."""

Length = Annotated[float, Field(ge=-100.0, le=100.0)]


def _is_command(command: tuple[str, ...]) -> tuple[str, ...]:
    if command and not command[0].strip():
        raise ValueError("names no program: the first word is empty")
    for word in command:
        if not word:
            raise ValueError("has an empty argument: leave it out")
        if "\0" in word:
            raise ValueError(f"has a NUL character in {word!r}, which no program can be given")
    return command


def _is_machine(machine: str) -> str:
    if machine and not re.fullmatch(HOST_NAME, machine):
        raise ValueError(
            f"{machine!r} is no host name: letters and digits; -, _ and . between them"
        )
    if machine.casefold() == ALL_MACHINES:
        raise ValueError(f"{machine!r} is no machine: --machine {ALL_MACHINES} is the whole lab")
    return machine


Machine = Annotated[str, AfterValidator(_is_machine)]

Command = Annotated[tuple[str, ...], AfterValidator(_is_command)]
"""Program and arguments; whether the program is there, `require_commands` looks."""


class ToolEntry(Settings):
    """What hangs on a sensor."""

    mass: float = Field(gt=0.0, le=1000.0, description="In kg.")
    center_of_mass: tuple[Length, Length, Length] = Field(
        default=(0.0, 0.0, 0.0), description="In the sensor's frame, in m."
    )


class MarkerEntry(Settings):
    """A marker of a tracker on an arm."""

    on: str = Field(description="The device that carries it.")
    mounting: PoseConfig = Field(
        default=PoseConfig(),
        description="Its pose in the frame of the `measured_cp` of `on`: what is true, which is told to a "
        "simulator alone.",
    )


class CarriedEntry(Settings):
    """A sensor on an arm, and what hangs on it; or a tracker, and its markers on arms."""

    on: str = Field(
        default="",
        description="The device that carries it: a sensor or a gripper on an arm; or the gripper between "
        "whose fingers a sensor lies.",
    )
    mounting: PoseConfig = Field(
        default=PoseConfig(),
        description="Of a sensor: its pose in the frame of the `measured_cp` of `on`. What gravity does to "
        "its tool depends on the orientation alone.",
    )
    tool: ToolEntry | None = Field(
        default=None,
        description="Of a sensor: what really hangs on it. Its simulator feels the weight, if `on` is "
        "simulated too, and the bench holds what it finds against it.",
    )
    markers: dict[str, MarkerEntry] = Field(
        default_factory=dict,
        description="Of a tracker: its tools that are fixed to arms, by their names. Its simulator sees them "
        "where these are, if they are simulated too and `stands` is given; the bench moves the first one.",
    )
    stands: PoseConfig | None = Field(
        default=None,
        description="Of a tracker: its pose in the frame in which the arms tell their poses: what is true, "
        "which is told to its simulator alone.",
    )

    @model_validator(mode="after")
    def _has_carrier(self) -> Self:
        for key in ("mounting", "tool"):
            if key in self.model_fields_set and not self.on:
                raise ValueError(f"{key}: needs `on`, the device that carries it")
        if self.stands is not None and not self.markers:
            raise ValueError("stands: needs `markers`, the tools that are on arms")
        return self

    @property
    def carriers(self) -> tuple[str, ...]:
        """The devices that carry it or its markers, each once: the one that the bench moves comes first."""
        every = (*(marker.on for marker in self.markers.values()), self.on)
        return tuple(dict.fromkeys(name for name in every if name))

    def markers_on(self, carrier: str) -> tuple[str, ...]:
        """Return the names of its markers that a device carries."""
        return tuple(name for name, marker in self.markers.items() if marker.on == carrier)

    @property
    def carried(self) -> Carried:
        """The same as values."""
        x, y, z, w = self.mounting.pose.orientation.tolist()
        if self.tool is None:
            return Carried(orientation=(x, y, z, w))
        return Carried(self.tool.mass, self.tool.center_of_mass, (x, y, z, w))


class DeviceEntry(CarriedEntry):
    """One device of a lab."""

    plugin: str = Field(description="Which driver: a name of `crtk-driver list`.")
    namespace: str = Field(
        default="", description="On ROS; the name of the device with a slash before it if empty."
    )
    config: str = Field(
        default="",
        description="File of its settings, as for `crtk-driver <plugin> --config`, beside the lab file.",
    )
    settings: dict[str, Any] = Field(
        default_factory=dict, description="Its settings, over those of `config`."
    )
    sim: bool = Field(default=False, description="Always simulate it, also without --sim.")
    sim_options: dict[str, Any] = Field(
        default_factory=dict, description="Options of its simulator."
    )
    after: tuple[str, ...] = Field(
        default=(), description="Devices that must measure before it is started, beside `on`."
    )
    machine: Machine = Field(
        default="",
        description="Host name of the machine that starts it; empty: the lab's `machine`.",
    )
    enclave: str = Field(
        default="",
        description="Its enclave of SROS2; where `environment` or the shell switches security on, "
        "NAMESPACE/crtk_driver if empty, as `crtk-driver policy` names it.",
    )
    space: SpaceConfig | None = Field(
        default=None,
        description="Where, and how fast, `crtk-driver bench` may move it; not at all if left out.",
    )
    identity: dict[str, str] = Field(
        default_factory=dict,
        description="What its readings must say before the bench does more than read: "
        '{ serial = "20195000123" }.',
    )
    power_off: Command = Field(
        default=(),
        description="Program and arguments that take its power away; run when the bench loses hold of it.",
    )

    @field_validator("enclave")
    @classmethod
    def _is_enclave(cls, enclave: str) -> str:
        if enclave and not re.fullmatch(ENCLAVE, enclave):
            raise ValueError("is no enclave: a path as of a namespace, as in /arm/crtk_driver")
        return enclave

    @field_validator("namespace")
    @classmethod
    def _is_namespace(cls, namespace: str) -> str:
        if namespace and not re.fullmatch(NAMESPACE, namespace):
            raise ValueError(
                "is not a namespace: letters, digits and _ after each /, as in /bench/arm"
            )
        return namespace


class ProgramEntry(Settings):
    """A program that works with the devices."""

    command: Command = Field(min_length=1, description="Program and arguments.")
    after: tuple[str, ...] | None = Field(
        default=None, description="Devices that must measure before it is started; all if null."
    )
    machine: Machine = Field(
        default="",
        description="Host name of the machine that starts it; empty: the lab's `machine`.",
    )


class BoundEntry(Settings):
    """Another bound than the default one."""

    value: float = Field(
        allow_inf_nan=False, description="The bound, in the unit of the measurement."
    )
    lower: float | None = Field(
        default=None,
        allow_inf_nan=False,
        description="The lower one, of a measurement that has two.",
    )
    because: str = Field(min_length=1, description="Why; it is told in the report.")


class LabSettings(Settings):
    """A lab."""

    name: str = Field(default="lab", pattern=NAME, description="Of the lab.")
    machine: Machine = Field(
        default="",
        description="Of a lab on several machines: the one that starts what names none.",
    )
    devices: dict[str, DeviceEntry] = Field(min_length=1, description="By name.")
    programs: dict[str, ProgramEntry] = Field(default_factory=dict, description="By name.")
    environment: dict[str, bool | int | str] = Field(
        default_factory=dict,
        description="Variables for every process of the lab, over the shell's: { ROS_DOMAIN_ID = 42 }.",
    )
    features: dict[str, bool | float | str] = Field(
        default_factory=dict,
        description="What else stands in the lab, for its own tests: { tracker = true, block = 0.03 }.",
    )
    faults: bool = Field(
        default=False,
        description="The bench may cut the links to real devices; CRTK_BENCH_FAULTS=1 must say so too.",
    )
    bounds: dict[str, BoundEntry] = Field(
        default_factory=dict, description="By the id of a measurement of the bench."
    )
    teleop: TeleopSettings | None = Field(
        default=None, description="For `crtk-driver teleop`: who leads and who follows."
    )

    @field_validator("environment")
    @classmethod
    def _are_variables(cls, given: dict[str, bool | int | str]) -> dict[str, bool | int | str]:
        return dict(checked_variables(given))


class TeleopLabSettings(LabSettings):
    """A lab of which nothing but the teleoperation is used: its devices may be none of ours."""

    devices: dict[str, DeviceEntry] = Field(default_factory=dict, description="By name.")
    teleop: TeleopSettings = Field(description="Who leads and who follows.")

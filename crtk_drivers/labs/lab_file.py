"""The lab file: which devices there are, how each is reached, and what is started with them.

name = "bench"

[devices.arm]
plugin = "ur"
settings = { host = "192.168.1.10", model = "ur5e" }

[devices.ft]
plugin = "ati-netft"
on = "arm"
tool = { mass = 0.482, center_of_mass = [0.0, 0.0, 0.06] }
settings = { host = "192.168.1.1" }

[programs.teleop]
command = ["python", "teleop.py"]
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from graphlib import CycleError, TopologicalSorter
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Any, Final, Self

from pydantic import AfterValidator, Field, field_validator, model_validator

from crtk_drivers import plugins
from crtk_drivers.config import (
    DeviceConfig,
    Layer,
    PoseConfig,
    Settings,
    SpaceConfig,
    from_file,
    from_values,
    load,
    values_of,
    with_node,
)
from crtk_drivers.errors import ConfigError, CrtkError, PluginError
from crtk_drivers.errors.near_names import near_names
from crtk_drivers.labs.carried import Carried
from crtk_drivers.motion.teleop.teleop_settings import TeleopSettings
from crtk_drivers.plugins import DevicePlugin

NAME: Final = r"^[A-Za-z][A-Za-z0-9_]*$"
"""Of a device or a program: it becomes a ROS namespace, an attribute and a file."""

NAMESPACE: Final = r"(/[A-Za-z_][A-Za-z0-9_]*)+"


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
    devices: dict[str, DeviceEntry] = Field(min_length=1, description="By name.")
    programs: dict[str, ProgramEntry] = Field(default_factory=dict, description="By name.")
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


@dataclass(frozen=True)
class LabDevice:
    """A device as it will be started: its settings are checked.

    Attributes:
        name: in the lab.
        plugin: its driver.
        namespace: on ROS.
        config: its settings, checked.
        values: the same as they were written, in its file and the lab file.
        sim: it is simulated.
        sim_options: of its simulator.
        after: names of the devices that must measure before.
        coupled: what its simulator follows, the carriers by their namespaces; None if nothing: neither it
            nor these are real.
        entry: as it was written, with all that concerns the bench.
    """

    name: str
    plugin: DevicePlugin
    namespace: str
    config: DeviceConfig
    values: Mapping[str, Any]
    sim: bool
    sim_options: Mapping[str, Any]
    after: tuple[str, ...]
    entry: DeviceEntry
    coupled: CarriedEntry | None = None

    @property
    def simulated(self) -> bool:
        """No hardware is behind it: a simulator is, or it is a model in memory."""
        return self.sim or self.plugin.is_model

    @property
    def address(self) -> str:
        """Where the hardware is, as the settings say; empty for one that is simulated or has no address."""
        if self.sim:
            return ""
        found = [attrgetter(key)(self.config) for key in self.plugin.addresses]
        return " ".join(str(value) for value in found if value not in (None, ""))


@dataclass(frozen=True)
class LabProgram:
    """A program that is started when the devices that it needs measure."""

    name: str
    command: tuple[str, ...]
    after: tuple[str, ...]


@dataclass(frozen=True)
class Lab:
    """What a lab file says.

    Attributes:
        name: of the lab.
        path: of the file.
        devices: by name, those that others come after first.
        programs: by name.
        settings: as they were written, with all that concerns the bench.
        bound_places: where each of its bounds was written, for messages.
    """

    name: str
    path: Path
    devices: Mapping[str, LabDevice]
    programs: Mapping[str, LabProgram]
    settings: LabSettings
    bound_places: Mapping[str, str] = field(default_factory=dict)


class TeleopLabSettings(LabSettings):
    """A lab of which nothing but the teleoperation is used: its devices may be none of ours."""

    devices: dict[str, DeviceEntry] = Field(default_factory=dict, description="By name.")
    teleop: TeleopSettings = Field(description="Who leads and who follows.")


@dataclass(frozen=True)
class LabTeleop:
    """The teleoperation of a lab file, and the namespaces of the two."""

    settings: TeleopSettings
    leader: str
    follower: str


def load_teleop(path: str | Path) -> LabTeleop:
    """Read the table ``[teleop]`` of a lab file. The settings of its devices are not looked at.

    Raises:
        ConfigError: with what is wrong, and the line.
    """
    layer = from_file(path)
    settings = load(TeleopLabSettings, layer)
    leader, follower = (
        _namespace_of(getattr(settings.teleop, side), settings, layer.place(("teleop", side)))
        for side in ("leader", "follower")
    )
    if leader == follower:
        raise ConfigError(
            f"leader and follower are both {leader}",
            where=layer.place(("teleop", "follower")),
            remedy="A device cannot follow itself.",
        )
    return LabTeleop(settings.teleop, leader, follower)


def _namespace_of(name: str, settings: LabSettings, place: str) -> str:
    """Return the namespace of a device of the lab, or of any device, that is named by its namespace."""
    if re.fullmatch(NAMESPACE, name):
        return name
    if name not in settings.devices:
        meant = near_names(name, settings.devices)
        raise ConfigError(
            f"there is no device {name!r}",
            where=place,
            remedy=f"Did you mean {meant[0]!r}?"
            if meant
            else f"Give one of this file ({', '.join(settings.devices) or 'it has none'}), or the "
            "namespace of any: /MTMR.",
        )
    return settings.devices[name].namespace or f"/{name}"


def load_lab(path: str | Path, *, sim: bool = False, only: tuple[str, ...] = ()) -> Lab:
    """Read a lab file and check all that it says, the settings of every device included.

    Args:
        path: of a TOML or YAML file.
        sim: simulate every device that has a simulator.
        only: names of the devices that are wanted, and no programs; empty: everything.

    Raises:
        ConfigError: with what is wrong, and the line.
    """
    path = Path(path)
    layer = from_file(path)
    settings = load(LabSettings, layer)
    _check_names(settings, layer)
    for name in only:
        _require(name, settings, str(path))
    wanted = {name: settings.devices[name] for name in settings.devices if not only or name in only}
    found = {name: _device(name, entry, layer, path, sim) for name, entry in wanted.items()}
    _check_alone(found, layer)
    if settings.teleop is not None:
        for side in ("leader", "follower"):
            name = getattr(settings.teleop, side)
            _namespace_of(name, settings, layer.place(("teleop", side)))
    order = _ordered(found, settings, layer)
    devices = {name: _coupled(found[name], found) for name in order}
    programs = {} if only else dict(_programs(settings, layer))
    places = {name: layer.place(("bounds", name)) for name in settings.bounds}
    return Lab(settings.name, path, devices, programs, settings, places)


def _device(name: str, entry: DeviceEntry, lab: Layer, path: Path, sim: bool) -> LabDevice:
    place = lab.place(("devices", name, "plugin"))
    try:
        plugin = plugins.device(entry.plugin)
    except PluginError as error:
        raise ConfigError(error.message, where=place, remedy=error.remedy) from error
    below = from_file(path.parent / entry.config) if entry.config else from_values({})
    own = _part(lab, ("devices", name, "settings"), entry.settings)
    config: Any = load(with_node(plugin.config), below, own)
    if entry.sim and plugin.sim is None:
        raise ConfigError(f"{entry.plugin} has no simulator", where=place, remedy="Leave sim out.")
    known = plugin.markers(config)
    for marker in entry.markers:
        if marker not in known:
            raise ConfigError(
                f"there is no tool {marker!r} that it sees",
                where=lab.place(("devices", name, "markers")),
                remedy=f"There is: {', '.join(known) or 'none'}.",
            )
    simulator = plugin.sim if entry.sim or sim else None
    if simulator is not None:
        model = plugins.simulator(simulator).Config
        load(model, _part(lab, ("devices", name, "sim_options"), entry.sim_options))
    else:
        try:
            plugin.check_real(config)
        except CrtkError as error:
            where = lab.place(("devices", name))
            raise ConfigError(error.message, where=where, remedy=error.remedy) from error
    return LabDevice(
        name,
        plugin,
        entry.namespace or f"/{name}",
        config,
        values_of(below, own),
        simulator is not None,
        entry.sim_options if simulator is not None else {},
        tuple(dict.fromkeys((*entry.carriers, *entry.after))),
        entry,
    )


def _coupled(device: LabDevice, devices: Mapping[str, LabDevice]) -> LabDevice:
    """Return a device that knows what its simulator follows: nothing of it is real."""
    entry, plugin = device.entry, device.plugin
    where = {name: each.namespace for name, each in devices.items() if each.simulated}
    given: dict[str, Any] = {}
    if entry.tool is not None and entry.on in where and plugin.sim_load is not None:
        given |= {"on": where[entry.on], "mounting": entry.mounting, "tool": entry.tool}
    if entry.stands is not None and plugin.sim_put is not None:
        known = plugin.markers(device.config)
        seen = {
            name: marker.model_copy(update={"on": where[marker.on]})
            for name, marker in entry.markers.items()
            if marker.on in where and known[name]
        }
        given |= {"markers": seen, "stands": entry.stands} if seen else {}
    return replace(device, coupled=CarriedEntry(**given)) if given and device.sim else device


def _part(lab: Layer, key: tuple[str, ...], values: Mapping[str, Any]) -> Layer:
    """Return a table of the lab file as a layer of its own, with the lines of its keys."""
    size = len(key)
    places = {
        at[size:]: place for at, place in lab.places.items() if at[:size] == key and at != key
    }
    return Layer(values, lab.place(key), places)


def _programs(settings: LabSettings, lab: Layer) -> Iterator[tuple[str, LabProgram]]:
    for name, entry in settings.programs.items():
        after = tuple(settings.devices) if entry.after is None else entry.after
        for other in after:
            _require(other, settings, lab.place(("programs", name, "after")))
        yield name, LabProgram(name, entry.command, after)


def _check_names(settings: LabSettings, lab: Layer) -> None:
    for kind, names in (("devices", settings.devices), ("programs", settings.programs)):
        for name in names:
            if not re.fullmatch(NAME, name):
                raise ConfigError(
                    f"{name!r} is no name",
                    where=lab.place((kind, name)),
                    remedy="Use letters, digits and underscores, a letter first.",
                )


def _check_alone(devices: Mapping[str, LabDevice], lab: Layer) -> None:
    """Refuse two devices in one namespace, or at one address."""
    for kind, value_of in (
        ("namespace", lambda device: device.namespace),
        (
            "address",
            lambda device: (device.plugin.name, device.address) if device.address else None,
        ),
    ):
        owners: dict[Any, str] = {}
        for name, device in devices.items():
            value = value_of(device)
            if value is not None and owners.setdefault(value, name) != name:
                told = value if isinstance(value, str) else value[1]
                raise ConfigError(
                    f"{owners[value]} and {name} have one {kind}: {told}",
                    where=lab.place(("devices", name)),
                    remedy="A device has one driver.",
                )


def _ordered(devices: Mapping[str, LabDevice], settings: LabSettings, lab: Layer) -> list[str]:
    sorter: TopologicalSorter[str] = TopologicalSorter()
    for name, device in devices.items():
        for other in device.after:
            _require(other, settings, lab.place(("devices", name)))
        sorter.add(name, *(other for other in device.after if other in devices))
    try:
        return list(sorter.static_order())
    except CycleError as error:
        raise ConfigError(
            f"each waits for the next: {', '.join(error.args[1])}",
            where=str(lab.source),
            remedy="Look at `on` and `after`.",
        ) from error


def _require(name: str, settings: LabSettings, place: str) -> None:
    if name not in settings.devices:
        raise ConfigError(
            f"there is no device {name!r}",
            where=place,
            remedy=f"There is: {', '.join(settings.devices)}.",
        )

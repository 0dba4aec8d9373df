"""The lab file: which devices there are, how each is reached, and what is started with them.

name = "bench"

[devices.arm]
plugin = "ur"
settings = { host = "192.168.1.10", model = "ur5e" }

[devices.ft]
plugin = "ati-netft"
on = "arm"
tool = { mass = 0.482, center_of_mass = [0.0, 0.0, 0.06] }
settings = { host = "192.168.1.20" }

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

from pydantic import Field, field_validator, model_validator

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
from crtk_drivers.labs.carried import Carried
from crtk_drivers.plugins import DevicePlugin

NAME: Final = r"^[A-Za-z][A-Za-z0-9_]*$"
"""Of a device or a program: it becomes a ROS namespace, an attribute and a file."""

NAMESPACE: Final = r"(/[A-Za-z_][A-Za-z0-9_]*)+"


Length = Annotated[float, Field(ge=-100.0, le=100.0)]


class ToolEntry(Settings):
    """What hangs on a sensor."""

    mass: float = Field(gt=0.0, le=1000.0, description="In kg.")
    center_of_mass: tuple[Length, Length, Length] = Field(
        default=(0.0, 0.0, 0.0), description="In the sensor's frame, in m."
    )


class CarriedEntry(Settings):
    """A sensor on an arm, and what hangs on it."""

    on: str = Field(
        default="", description="The device that carries it: a sensor or a gripper on an arm."
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

    @model_validator(mode="after")
    def _has_carrier(self) -> Self:
        for key in ("mounting", "tool"):
            if key in self.model_fields_set and not self.on:
                raise ValueError(f"{key}: needs `on`, the device that carries it")
        return self

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
    power_off: tuple[str, ...] = Field(
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

    command: tuple[str, ...] = Field(min_length=1, description="Program and arguments.")
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
        felt_on: namespace of the simulated device that carries it, if its own simulator feels its tool as
            that one turns; empty if it does not.
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
    felt_on: str = ""

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
        tuple(dict.fromkeys((*((entry.on,) if entry.on else ()), *entry.after))),
        entry,
    )


def _coupled(device: LabDevice, devices: Mapping[str, LabDevice]) -> LabDevice:
    """Return a device that knows whether its simulator feels its tool: nothing of it is real."""
    carrier = devices.get(device.entry.on)
    if device.entry.tool is None or carrier is None or not device.sim:
        return device
    if device.plugin.sim_load is None or not carrier.simulated:
        return device
    return replace(device, felt_on=carrier.namespace)


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

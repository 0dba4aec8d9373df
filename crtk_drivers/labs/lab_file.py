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

import os
from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from graphlib import CycleError, TopologicalSorter
from operator import attrgetter
from pathlib import Path
from types import MappingProxyType
from typing import Any

from crtk_drivers import plugins
from crtk_drivers.config import (
    DeviceConfig,
    Layer,
    from_file,
    from_values,
    load,
    values_of,
    with_node,
)
from crtk_drivers.config.variables import SECURED, absolute
from crtk_drivers.errors import ConfigError, CrtkError, PluginError
from crtk_drivers.labs.lab_entries import (
    ALL_MACHINES,
    DRIVER_ENCLAVE,
    BoundEntry,
    CarriedEntry,
    DeviceEntry,
    LabSettings,
)
from crtk_drivers.labs.lab_outline import (
    check_places,
    load_outline,
    namespace_of,
    require_device,
)
from crtk_drivers.labs.machines import Elsewhere, Shares, named_machine
from crtk_drivers.plugins import DevicePlugin

__all__ = [
    "BoundEntry",
    "CarriedEntry",
    "DeviceEntry",
    "Elsewhere",
    "Lab",
    "LabDevice",
    "LabProgram",
    "LabSettings",
    "load_lab",
    "require_devices",
]


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
        enclave: of SROS2; empty: what ROS 2 takes if nothing is said.
        machine: which starts it; empty where the lab file names no machine.
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
    enclave: str = ""
    machine: str = ""

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

    @property
    def is_on_a_network(self) -> bool:
        """Whether other machines could reach it too: it has a host, and that is not its own machine."""
        host = str(getattr(self.config, "host", None) or "")
        return bool(host) and host != "localhost" and not host.startswith("127.")


@dataclass(frozen=True)
class LabProgram:
    """A program that is started when the devices that it needs measure."""

    name: str
    command: tuple[str, ...]
    after: tuple[str, ...]
    machine: str = ""


@dataclass(frozen=True)
class Lab:
    """What a lab file says.

    Attributes:
        name: of the lab.
        path: of the file.
        devices: by name, those that others come after first.
        programs: by name.
        settings: as they were written, with all that concerns the bench.
        environment: variables for every process of it, over those of the shell: of the file, and given.
        machine: whose share this is; empty, or ``all``: it is the whole lab.
        machines: that the lab file names; none if it names none.
        elsewhere: the devices that other machines start, by name.
        bound_places: where each of its bounds was written, for messages.
    """

    name: str
    path: Path
    devices: Mapping[str, LabDevice]
    programs: Mapping[str, LabProgram]
    settings: LabSettings
    bound_places: Mapping[str, str] = field(default_factory=dict)
    environment: Mapping[str, str] = field(default_factory=dict)
    machine: str = ""
    machines: tuple[str, ...] = ()
    elsewhere: Mapping[str, Elsewhere] = field(default_factory=dict)

    @property
    def everywhere(self) -> dict[str, LabDevice | Elsewhere]:
        """Its devices on whatever machine, by name."""
        return {**self.devices, **self.elsewhere}

    @property
    def left_out(self) -> str:
        """Which devices other machines start, in words; empty if none does."""
        machines = dict.fromkeys(other.machine for other in self.elsewhere.values())
        return "; ".join(
            f"{', '.join(name for name, other in self.elsewhere.items() if other.machine == machine)} "
            f"on {machine}"
            for machine in machines
        )


def require_devices(lab: Lab) -> None:
    """Refuse the share of a machine that has no device.

    Raises:
        ConfigError: it has none.
    """
    if not lab.devices:
        raise ConfigError(
            f"{lab.machine} starts no device of this lab; others start {lab.left_out}",
            where=str(lab.path),
            remedy=f"Do this there; or with --machine {ALL_MACHINES}, for the whole lab on this machine.",
        )


def load_lab(
    path: str | Path,
    *,
    sim: bool = False,
    only: tuple[str, ...] = (),
    environment: Mapping[str, str] = MappingProxyType({}),
    machine: str = ALL_MACHINES,
) -> Lab:
    """Read a lab file and check all that it says, the settings of every device included.

    Args:
        path: of a TOML or YAML file.
        sim: simulate every device that has a simulator.
        only: names of the devices that are wanted, and no programs; empty: everything.
        environment: variables over those of the file.
        machine: whose share is wanted; the devices of the others are `elsewhere` then. Empty: of the
            machine that is called as this one; ``all``: the whole lab. See `named_machine`.

    Raises:
        ConfigError: with what is wrong, and the line.
    """
    path = Path(path)
    outline = load_outline(path)
    settings, layer, shares = outline.settings, outline.layer, outline.shares
    here = named_machine(shares, machine)
    for name in only:
        _require_here(name, shares, here)
    wanted = [name for name in outline.entries(only) if shares.is_of(("devices", name), here)]
    variables = {**outline.environment, **absolute(environment, Path())}
    is_secured = {**os.environ, **variables}.get(SECURED) == "true"

    def checked(name: str) -> LabDevice:
        device = _device(name, settings.devices[name], layer, path, sim, is_secured)
        return replace(device, machine=shares.owners.get(("devices", name), ""))

    found = {name: checked(name) for name in wanted}
    elsewhere = {
        name: Elsewhere(
            name, entry.plugin, namespace_of(name, entry), shares.owners["devices", name]
        )
        for name, entry in settings.devices.items()
        if not shares.is_of(("devices", name), here)
    }
    drivers = {device.plugin.name for device in found.values()}
    others: dict[str, LabDevice] = {}
    for name, other in elsewhere.items():
        if other.plugin in drivers:
            with suppress(ConfigError):  # which is told where it is started
                others[name] = checked(name)
    _check_alone({**found, **others}, elsewhere, layer)
    order = _ordered({**found, **elsewhere}, settings, layer)
    devices = {name: _coupled(found[name], found) for name in order if name in found}
    programs = {} if only else dict(_programs(settings, layer, shares, here))
    return Lab(
        settings.name,
        path,
        devices,
        programs,
        settings,
        outline.bound_places,
        variables,
        machine=here,
        machines=shares.machines,
        elsewhere=elsewhere,
    )


def _device(
    name: str, entry: DeviceEntry, lab: Layer, path: Path, sim: bool, is_secured: bool
) -> LabDevice:
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
    namespace = namespace_of(name, entry)
    return LabDevice(
        name,
        plugin,
        namespace,
        config,
        values_of(below, own),
        simulator is not None,
        entry.sim_options if simulator is not None else {},
        tuple(dict.fromkeys((*entry.carriers, *entry.after))),
        entry,
        enclave=entry.enclave or (f"{namespace}/{DRIVER_ENCLAVE}" if is_secured else ""),
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


def _programs(
    settings: LabSettings, lab: Layer, shares: Shares, here: str
) -> Iterator[tuple[str, LabProgram]]:
    for name, entry in settings.programs.items():
        after = tuple(settings.devices) if entry.after is None else entry.after
        for other in after:
            require_device(other, settings, lab.place(("programs", name, "after")))
        if shares.is_of(("programs", name), here):
            machine = shares.owners.get(("programs", name), "")
            yield name, LabProgram(name, entry.command, after, machine)


def _check_alone(
    devices: Mapping[str, LabDevice], elsewhere: Mapping[str, Elsewhere], lab: Layer
) -> None:
    """Refuse two devices in one namespace, or at one address."""
    everywhere: list[LabDevice | Elsewhere] = [*devices.values(), *elsewhere.values()]
    spaces = ((each.namespace, each.name, each.namespace) for each in everywhere)
    addresses = [
        (
            (
                device.plugin.name,
                device.address,
                "" if device.is_on_a_network else device.machine,
            ),
            device.name,
            device.address,
        )
        for device in devices.values()
        if device.address
    ]
    check_places("namespace", spaces, lab)
    check_places("address", addresses, lab)


def _ordered(names: Collection[str], settings: LabSettings, lab: Layer) -> list[str]:
    """Return names of devices, those that others come after first, on whatever machines they are."""
    sorter: TopologicalSorter[str] = TopologicalSorter()
    for name in names:
        entry = settings.devices[name]
        after = dict.fromkeys((*entry.carriers, *entry.after))
        for other in after:
            require_device(other, settings, lab.place(("devices", name)))
        sorter.add(name, *(other for other in after if other in names))
    try:
        return list(sorter.static_order())
    except CycleError as error:
        raise ConfigError(
            f"each waits for the next: {', '.join(error.args[1])}",
            where=str(lab.source),
            remedy="Look at `on` and `after`.",
        ) from error


def _require_here(name: str, shares: Shares, here: str) -> None:
    if not shares.is_of(("devices", name), here):
        owner = shares.owners["devices", name]
        raise ConfigError(
            f"{name} is started by {owner}, and this machine is {here}",
            remedy=f"Start it there; or here as that machine does, --machine {owner}.",
        )

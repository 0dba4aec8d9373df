"""What a package says of a device that it brings: `DevicePlugin`, and tools for people beside it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from types import MappingProxyType
from typing import Any

from crtk_drivers.config import (
    AttachedConfig,
    DeviceConfig,
    Layer,
    Settings,
    from_file,
    from_values,
    load,
)
from crtk_drivers.device import Device, DeviceKind
from crtk_drivers.errors import ConfigError, PluginError
from crtk_drivers.plugins.finder import Finder
from crtk_drivers.plugins.sim_plugin import RunningSim
from crtk_drivers.samples import Pose, Wrench
from crtk_drivers.wrappers.base_frame import PlacedDevice
from crtk_drivers.wrappers.confined import ConfinedDevice

__all__ = ["DeviceLink", "DevicePlugin", "LinkAccess", "SimFault", "Tool", "required"]


def _same_config(config: Any, sim: RunningSim) -> Any:
    return config


def _nothing(config: Any) -> None:
    pass


def required(key: str, example: str) -> Callable[[DeviceConfig], None]:
    """Return a `check_real` that asks for an address, such as ``required("host", "192.168.1.10")``."""

    def check(config: DeviceConfig) -> None:
        if not getattr(config, key):
            raise ConfigError(
                f"{key}: is required for real hardware",
                remedy=f"Give its address (--{key.replace('_', '-')} {example}), or use --sim.",
            )

    return check


def _no_tool(config: Any) -> AttachedConfig | None:
    return None


def _no_markers(config: Any) -> Mapping[str, str]:
    return MappingProxyType({})


def _no_options(config: Any) -> Mapping[str, Any]:
    return MappingProxyType({})


@dataclass(frozen=True)
class DeviceLink:
    """How a driver reaches its device: what a relay, which cuts that, must know.

    Attributes:
        host: of the device, where it is in a network.
        tcp, udp: its ports there, by name.
        serial: its serial lines: the port and the rate in bit/s, by name.
        can: its CAN buses: with what python-can opens them, by name. Through a relay each is a door for
            socketcand, at a port of `tcp` of that name.
    """

    host: str = ""
    tcp: Mapping[str, int] = field(default_factory=dict)
    udp: Mapping[str, int] = field(default_factory=dict)
    serial: Mapping[str, tuple[str, int]] = field(default_factory=dict)
    can: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


@dataclass(frozen=True)
class LinkAccess:
    """Where a configuration has its link, for `DevicePlugin`.

    Attributes:
        of: the link of a configuration, or of its simulator that runs; None if no relay can cut it.
        at: the configuration that reaches the device at another place.
    """

    of: Callable[[Any, RunningSim | None], DeviceLink | None]
    at: Callable[[Any, DeviceLink], Any]


class SimFault(StrEnum):
    """What happens to a simulated device because a test of the bench asks for it; in words, of real ones."""

    EMERGENCY_STOP = "its emergency stop is pressed"
    BLOCK = "a block of `width` m lies between its fingers"
    COVER = "a tool of it is covered"


@dataclass(frozen=True)
class Tool:
    """A command for people beside the node: ``crtk-driver <device> <tool>``. It starts no node.

    Attributes:
        name: as it is typed.
        summary: one line for the help.
        run: does it with a configuration (with ``--sim`` one that points at a running simulator) and
            options, writes what people want to know to the terminal, and returns the exit code.
        options: the class of its own options, as for a configuration.
        arguments: those of its options that are typed without their names, in this order.
        check_real: instead of that of the plugin, for a tool that needs less or more.
    """

    name: str
    summary: str
    run: Callable[[Any, Any], int]
    options: type[Settings] = Settings
    arguments: tuple[str, ...] = ()
    check_real: Callable[[Any], None] | None = None

    def __post_init__(self) -> None:
        if not issubclass(self.options, Settings):
            raise PluginError(
                f"tool {self.name!r}: the options {self.options.__name__} must be a class derived from "
                "Settings (crtk_drivers.config)"
            )


@dataclass(frozen=True)
class DevicePlugin:
    """All that the core needs to bring up one kind of device.

    Attributes:
        name: the same as that of the entry point: ``crtk-driver <name>``.
        summary: one line for people.
        config: the class of its configuration.
        create: makes the device of a configuration; touches no hardware, may import libraries.
        check_real: raises ConfigError if the configuration lacks what only real hardware needs, such
            as an address; not called for a simulator.
        sim: name of its simulator; None if it has none.
        extra: the extra of its distribution that brings its libraries; empty if it needs none.
        addresses: the keys that say where real hardware is: ``host``, ``bus.channel``; given beside a
            simulator they are refused.
        sim_config: the configuration that points at a running simulator.
        sim_options: the options of the simulator that suit a configuration (model, ...).
        sim_load: puts a wrench on the sensor of a running simulator, in the sensor's frame, beside all else
            that acts on it, until the next one; None if its simulator feels none. Raises RuntimeError.
        markers: the tools that a tracker of this configuration sees, by the names that their namespaces end
            with: what its simulator knows each by, empty if it does not.
        sim_put: lets a tool of a running simulator, by what that knows it by, be at a pose in the frame of
            the tracker from a time on, in ns since the epoch; None if it has none. Raises RuntimeError.
        sim_faults: which faults of its simulator these are, as far as it has them.
        finder: looks for hardware of this kind; None if nobody can.
        tools: commands for people, to look at hardware, scan a bus, calibrate, ...
        typical: values of a configuration whose CRTK commands are listed where the default has no joints.
        link: how it reaches its device, so that the bench can cut that; None if it cannot.
        tool: what hangs at the tool of an arm of this configuration, if it names any.
        sim_tool: the options of the simulator of an arm that hang a simulated device at its tool.
        at_tool: the configuration of a device that hangs at the tool of the arm at an address; None if it
            cannot hang at one.
        tool_line: how the serial line of the tool is to be for it, by the keys that the arm has for that.
        is_model: it is computed in this process, and no hardware is behind it.
        kind: which commands a type checker knows of a device of this distribution, see
            `crtk_drivers.front.kinds`.
    """

    name: str
    summary: str
    config: type[DeviceConfig]
    create: Callable[[Any], Device]
    sim: str | None = None
    extra: str = ""
    addresses: tuple[str, ...] = ()
    check_real: Callable[[Any], None] = _nothing
    sim_config: Callable[[Any, RunningSim], Any] = _same_config
    sim_options: Callable[[Any], Mapping[str, Any]] = _no_options
    sim_load: Callable[[RunningSim, Wrench], None] | None = None
    markers: Callable[[Any], Mapping[str, str]] = _no_markers
    sim_put: Callable[[RunningSim, str, Pose, int], None] | None = None
    sim_faults: Mapping[SimFault, str] = field(default_factory=dict)
    finder: Finder | None = None
    tools: tuple[Tool, ...] = ()
    typical: Mapping[str, Any] = field(default_factory=dict)
    tool: Callable[[Any], AttachedConfig | None] = _no_tool
    sim_tool: Callable[[RunningSim], Mapping[str, Any]] = _no_options
    at_tool: Callable[[Any, str], Any] | None = None
    tool_line: Mapping[str, Any] = field(default_factory=dict)
    is_model: bool = False
    link: LinkAccess | None = None
    kind: DeviceKind = DeviceKind.ANY

    def make(self, config: DeviceConfig) -> Device:
        """Return the device of a configuration, with the kinematics, the space and the place that it names.

        Raises:
            ConfigError, MissingExtra: it cannot be made.
        """
        device = self.create(config)
        if config.kinematics is not None:
            from crtk_drivers.wrappers.kinematic_model import (
                ModelledDevice,  # pinocchio is not needed otherwise
            )

            device = ModelledDevice(device, config.kinematics)
        if config.space is not None:
            device = ConfinedDevice(device, config.space.joints, config.space.speed)
        if config.base is not None:
            device = PlacedDevice(device, replace(config.base.pose, frame_id=config.base.frame_id))
        return device

    def check_simulated(self, layer: Layer) -> None:
        """Make sure that nobody asks for a simulator and for real hardware in one breath.

        A file is no such layer: what is written for the hardware may be rehearsed with a simulator.

        Raises:
            ConfigError: the layer has one of the `addresses`.
        """
        for address in self.addresses:
            key = tuple(address.split("."))
            if layer.says(key):
                raise ConfigError(
                    f"{address} is where real hardware is, and a simulator was asked for, which "
                    "has an address of its own",
                    where=layer.place(key),
                    remedy="Leave out one of the two.",
                )

    def load_config(
        self, config: Mapping[str, Any] | str | Path | None, values: Mapping[str, Any]
    ) -> DeviceConfig:
        """Return the configuration of a file or mapping, with single values over it.

        Raises:
            ConfigError: with every mistake in it.
        """
        below = from_file(config) if isinstance(config, str | Path) else from_values(config or {})
        return load(self.config, below, from_values(values))

"""What `crtk-driver <device>` and `crtk-driver check <device>` share: from options to a session."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from crtk_drivers import plugins
from crtk_drivers.cli.typed_options import (
    SETTING_PREFIX,
    Parameters,
    given_settings,
    option,
    setting_options,
)
from crtk_drivers.config import (
    DeviceConfig,
    Layer,
    NodeConfig,
    from_assignments,
    from_file,
    from_values,
    load,
    with_node,
)
from crtk_drivers.config.keys import heading_of, setting_names
from crtk_drivers.device import Device
from crtk_drivers.errors import ConfigError
from crtk_drivers.labs.lab_file import CarriedEntry
from crtk_drivers.plugins import DevicePlugin
from crtk_drivers.ros.names import checked_namespace

if TYPE_CHECKING:
    from crtk_drivers.session import Session

_RESERVED = frozenset(
    {
        "--config",
        "--faults",
        "--help",
        "--log-format",
        "--log-level",
        "--ns",
        "--record",
        "--set",
        "--sim",
        "--sim-carried",
        "--sim-set",
    }
)
"""A device's key with one of these names is set with ``--set``."""


@dataclass(frozen=True)
class Launch:
    """A device with its checked configuration, ready to be opened.

    `carried` says which devices on ROS carry it or its markers, for its simulator to follow.
    """

    plugin: DevicePlugin
    config: DeviceConfig
    node: NodeConfig = field(default_factory=NodeConfig)
    sim: bool = False
    sim_options: Mapping[str, Any] = field(default_factory=dict)
    carried: CarriedEntry | None = None

    def open(self) -> Session:
        """Return its session, not started; the simulator, if one is wanted, is running."""
        from crtk_drivers.session import open_session  # not needed to show a help

        return open_session(
            self.plugin.name, self.config, sim=self.sim, sim_options=self.sim_options
        )

    @contextmanager
    def reached(self) -> Iterator[DeviceConfig]:
        """The configuration that points at the hardware, or at a simulator that runs meanwhile."""
        from crtk_drivers.session import reached  # not needed to show a help

        with reached(
            self.plugin, self.config, sim=self.sim, sim_options=self.sim_options
        ) as config:
            yield config


def launch_options(plugin: DevicePlugin) -> Parameters:
    """Return the options that say what is opened and how."""
    simulator = [
        option(
            "sim",
            bool,
            False,
            "--sim",
            help="Start a simulator and connect to that: no hardware is needed.",
        )
    ]
    fault_options = [
        option(
            "faults",
            Path | None,
            None,
            "--faults",
            metavar="FILE",
            help="With --sim: a file of faults that the simulator plays.",
            rich_help_panel="Simulator",
        ),
        option(
            "sim_set",
            list[str],
            [],
            "--sim-set",
            metavar="KEY=VALUE",
            help=f"With --sim: an option of the simulator; see crtk-driver sim {plugin.sim} --help.",
            rich_help_panel="Simulator",
        ),
    ]
    carried_options = [
        option(
            "sim_carried",
            list[str],
            [],
            "--sim-carried",
            metavar="KEY=VALUE",
            help="With --sim: `on`, `mounting` and `tool`, or `stands` and `markers`, as in a lab file, "
            "where `on` is a namespace: its simulator feels the tool as that arm turns, or sees the markers "
            "where the arms have them. For simulated arms.",
            rich_help_panel="Simulator",
        )
    ]
    general = [
        option(
            "config",
            Path | None,
            None,
            "--config",
            "-c",
            metavar="FILE",
            help="TOML or YAML file of settings; options given here override it.",
        ),
        option(
            "assignments",
            list[str],
            [],
            "--set",
            "-s",
            metavar="KEY=VALUE",
            help="Any setting, also one inside a table: --set limits.max_step=0.2. "
            f"`crtk-driver schema {plugin.name}` lists them all.",
        ),
    ]
    common = setting_names(DeviceConfig)
    own_panel = f"Settings of {plugin.name}"
    settings = setting_options(
        plugin.config,
        lambda name: (
            heading_of(plugin.config, name) or ("Common settings" if name in common else own_panel)
        ),
        _RESERVED,
    )
    shared = {f"{SETTING_PREFIX}{name}" for name in common}
    own_first = sorted(settings, key=lambda each: each.name in shared)
    has_sim = plugin.sim is not None
    return [
        *(simulator if has_sim else ()),
        *general,
        *own_first,
        *(fault_options if has_sim else ()),
        *(carried_options if plugin.sim_load or plugin.sim_put else ()),
    ]


def launch_of(plugin: DevicePlugin, given: Mapping[str, Any]) -> Launch:
    """Return what the options ask for.

    Raises:
        ConfigError: with every mistake in it.
    """
    model = with_node(plugin.config)
    sim = bool(given.get("sim"))
    typed = [given_settings(plugin.config, given), from_assignments(model, given["assignments"])]
    for layer in typed if sim else ():
        plugin.check_simulated(layer)
    files: list[Layer] = [from_file(given["config"])] if given["config"] else []
    config: Any = load(model, *files, *typed)
    options, carried = _sim_options(plugin, sim, given), _carried(sim, given)
    return Launch(plugin, config, config.node, sim, options, carried)


def described(plugin: DevicePlugin, given: Mapping[str, Any]) -> tuple[Device, NodeConfig]:
    """Return the device that the options describe, not open, and what its node is to serve.

    Where they say nothing at all of the device, it is a typical one.

    Raises:
        ConfigError: with every mistake in it.
    """
    launch = launch_of(plugin, given)
    config: DeviceConfig = launch.config
    assigned = [each for each in given["assignments"] if not each.startswith("node.")]
    if not (given_settings(plugin.config, given).values or given["config"] or assigned):
        config = load(plugin.config, from_values(plugin.typical))
    return plugin.make(config), launch.node


def _carried(sim: bool, given: Mapping[str, Any]) -> CarriedEntry | None:
    assignments: Sequence[str] = given.get("sim_carried", ())
    if not assignments:
        return None
    if not sim:
        raise _for_simulator("--sim-carried")
    found = load(CarriedEntry, from_assignments(CarriedEntry, assignments, "--sim-carried"))
    for namespace in found.carriers:
        checked_namespace(namespace)
    return found


def _for_simulator(option: str) -> ConfigError:
    return ConfigError(
        "is for the simulator only", where=option, remedy="Add --sim, or leave it out."
    )


def _sim_options(plugin: DevicePlugin, sim: bool, given: Mapping[str, Any]) -> dict[str, Any]:
    assignments: Sequence[str] = given.get("sim_set", ())
    faults: Path | None = given.get("faults")
    if not sim and (assignments or faults):
        raise _for_simulator("--faults" if faults else "--sim-set")
    if not sim or plugin.sim is None:
        return {}
    model = plugins.simulator(plugin.sim).Config
    options = dict(from_assignments(model, assignments, "--sim-set").values)
    return options | ({"faults": str(faults)} if faults else {})

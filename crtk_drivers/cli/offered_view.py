"""What a device offers, as ``crtk-driver list NAME`` shows it: commands, units, and what is beyond CRTK."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from rich.table import Table
from rich.text import Text

from crtk_drivers import plugins
from crtk_drivers.cli.name_lists import numbered
from crtk_drivers.cli.terminal import OUT
from crtk_drivers.commands import Payload, units_for
from crtk_drivers.device import Device
from crtk_drivers.device.offered import offered
from crtk_drivers.errors.wording import worded
from crtk_drivers.kinematics.joint_axes import joint_units
from crtk_drivers.plugins import DevicePlugin

_UNITS = {
    Payload.POSE: "m, unit quaternion",
    Payload.TWIST: "m/s, rad/s",
    Payload.WRENCH: "N, N·m",
}
"""Of values whose type says them; the summaries of numbers have theirs."""


def print_offered(plugin: DevicePlugin) -> None:
    """Print what a device offers as it is configured without a file."""
    device = plugins.typical_device(plugin)
    if device is None:
        OUT.print("What it offers depends on its configuration.")
        return
    commands = _table("command", "units", "what it is")
    units = joint_units(device)
    for name, command in offered(device).items():
        commands.add_row(Text(name, "cyan"), Text(units_for(command, units)), Text(command.summary))
    OUT.print(commands)
    parts = {"": device, **{f"{name}/": part for name, part in device.children.items()}}
    joints = [line for prefix, part in parts.items() for line in _joints(prefix, part)]
    if joints:
        OUT.print(Text("\njoints: ", "dim").append("; ".join(joints)))
    services = {
        f"{prefix}{name}": each.summary
        for prefix, part in parts.items()
        for name, each in part.services.items()
    }
    _describe_extras("service", "crtk-driver call NAMESPACE SERVICE", services, {})
    inputs = {
        f"{prefix}{name}": each
        for prefix, part in parts.items()
        for name, each in part.inputs.items()
    }
    readings = {
        f"{prefix}{each.told_as(name)}": each
        for prefix, part in parts.items()
        for name, each in part.readings.items()
    }
    for title, how, rows in (
        ("input", "in Python arm.INPUT(value), on ROS a topic", inputs),
        ("reading", "crtk-driver echo NAMESPACE READING", readings),
    ):
        summaries = {name: each.summary for name, each in rows.items()}
        payloads = {name: each.payload for name, each in rows.items()}
        _describe_extras(title, how, summaries, payloads)


def _joints(prefix: str, device: Device) -> Iterator[str]:
    """Yield the joints of a device by unit: ``x, y (m)``; without one where it is not known."""
    by_unit: dict[str, list[str]] = {}
    for name, unit in zip(device.capabilities.joints, joint_units(device), strict=True):
        by_unit.setdefault(unit, []).append(f"{prefix}{name}")
    for unit, names in by_unit.items():
        yield f"{', '.join(names)} ({unit or 'rad or m, as configured'})"


def _describe_extras(
    title: str, how: str, summaries: Mapping[str, str], payloads: Mapping[str, Payload]
) -> None:
    """Print what a device has beyond CRTK, a line for each name or numbered names; nothing without any."""
    if not summaries:
        return
    table = _table(title, *(["type"] if payloads else []), "what it is")
    for shown, first in numbered(summaries).items():
        kind = [_type_words(payloads[first])] if payloads else []
        table.add_row(Text(shown, "cyan"), *kind, Text(summaries[first]))
    OUT.print()
    OUT.print(Text(f"{title}s, beyond CRTK: ", "bold").append(worded(how), "dim"), soft_wrap=True)
    OUT.print(table)


def _type_words(payload: Payload) -> str:
    units = _UNITS.get(payload, "")
    return f"{payload}{units and f' ({units})'}"


def _table(*columns: str) -> Table:
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="dim")
    for column in columns:
        table.add_column(column)
    return table

"""``crtk-driver state``: how a running device is, why, where it stands, and what to do next."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from rich.table import Table
from rich.text import Text

from crtk_drivers.cli.name_lists import numbered, short_names
from crtk_drivers.cli.reaching import units_by_joint
from crtk_drivers.cli.status_line import STATE_STYLES
from crtk_drivers.cli.terminal import ERR, OUT
from crtk_drivers.client import RemoteDevice
from crtk_drivers.client.survey import Report, reported, survey
from crtk_drivers.errors import CrtkError, TransitionFailed
from crtk_drivers.errors.wording import printable, worded
from crtk_drivers.ros.manifest import headline
from crtk_drivers.samples import JointState, Pose
from crtk_drivers.state import OperatingState, Status

NEXT: Mapping[OperatingState, str] = {
    OperatingState.DISABLED: "crtk-driver enable {0}",
    OperatingState.ENABLED: "crtk-driver move --help, or crtk-driver disable {0}",
    OperatingState.PAUSED: "crtk-driver resume {0}",
    OperatingState.FAULT: "remove the cause, then crtk-driver enable {0}",
}
"""What to do in a state; {0} is the namespace."""

_REMEDIED = "do what the reason says, then crtk-driver enable {0}"
_MOST_NAMES = 12
"""Services, inputs or readings that are named: more would push the state off the screen."""
_REMEDY = re.compile(r"\.\s+\S")
"""In a reason: another sentence. The first one says what happened, those after it what to do."""

_PLACES = {"measured_js", "measured_cp"}
_TROUBLE = (OperatingState.PAUSED, OperatingState.FAULT)


def print_all() -> int:
    """Print which devices there are, and return 1 if there are none."""
    with ERR.status("looking for CRTK devices ..."):
        found = survey()
    if not found:
        ERR.print("There is no CRTK device.")
        ERR.print(
            "  Is a driver running, and are ROS_DOMAIN_ID and ROS_AUTOMATIC_DISCOVERY_RANGE the same "
            + worded("on both sides? Without one: crtk-driver ur --ns /ur5 --sim"),
            soft_wrap=True,
        )
        return 1
    table = Table(box=None, show_header=False, pad_edge=False, padding=(0, 3, 0, 0))
    for namespace, status in found.items():
        table.add_row(
            Text(namespace, "bold cyan"),
            Text("silent", "red") if status is None else status_words(status),
        )
    OUT.print(table)
    return 0


def print_device(device: RemoteDevice) -> int:
    """Print all that is known of a device now, and return 0."""
    status = device.operating_state()
    heading = Text(device.namespace, "bold cyan")
    if about := headline(device.manifest):
        heading.append(f"  {about}", "dim")
    OUT.print(heading, soft_wrap=True)
    report = _report(device)
    following = NEXT[status.state]
    if report.connecting:
        OUT.print(Text(worded(printable(report.text)), "yellow"), soft_wrap=True)
        following = "wait, then crtk-driver state {0}"
    else:
        OUT.print(status_words(status))
        if report.text not in ("", *OperatingState):  # one of a moment before says no reason
            style = STATE_STYLES[status.state] if status.state in _TROUBLE else ""
            reason = Text("reason: ").append(worded(printable(report.text)), style)
            OUT.print(reason, soft_wrap=True)
            if status.state is OperatingState.FAULT and _REMEDY.search(report.text):
                following = _REMEDIED
    OUT.print(
        Text(f"next: {worded(following.format(device.namespace))}", "dim"),
        soft_wrap=True,
    )
    if not report.connecting and _PLACES & set(device.crtk_commands):
        OUT.print()
        print_position(device)
    OUT.print(Text("\noffers: ", "dim").append(short_names(device.crtk_commands)))
    for extras in ("services", "inputs", "readings"):
        names = [
            each["name"].removeprefix(f"{device.namespace}/")
            for each in device.manifest.get(extras, {}).values()
        ]
        shown = list(numbered(names))
        if len(shown) > _MOST_NAMES:
            more = f"{len(shown) - _MOST_NAMES} more: crtk-driver list NAME"
            shown = [*shown[:_MOST_NAMES], f"and {worded(more)}"]
        if shown:
            OUT.print(Text(f"{extras}: ", "dim").append("  ".join(shown)))
    return 0


def status_words(status: Status) -> Text:
    """Return the operating state with what is unusual about it, or that it is not known yet."""
    if status.connecting:
        return Text(worded(printable(status.detail)), "yellow")
    return Text.assemble(
        (status.state, STATE_STYLES[status.state]),
        ("  homed" if status.is_homed else "  not homed", "" if status.is_homed else "yellow"),
        ("  busy" if status.is_busy else "", "cyan"),
    )


@contextmanager
def explained(device: RemoteDevice) -> Iterator[None]:
    """Let a failed change of state say why the device is as it is now."""
    try:
        yield
    except TransitionFailed as failed:
        reason = _report(device).text.rstrip(".")
        is_said = reason.partition(". ")[0] in failed.message
        if is_said or reason in tuple(OperatingState):
            raise
        raise TransitionFailed(
            f"{failed.message}: {reason}",
            where=failed.where,
            remedy=f"Remove the cause. What comes next: crtk-driver state {device.namespace}",
        ) from failed


def _report(device: RemoteDevice) -> Report:
    if not device.manifest:  # another maker's, which tells nothing of the kind
        return Report()
    try:
        return reported(device)
    except CrtkError:
        return Report()


def print_position(device: RemoteDevice) -> None:
    """Print where joints and tool are; says so where that is not known."""
    offered = device.crtk_commands
    if "measured_js" in offered:
        _print_joints(device, offered)
    if "measured_cp" in offered:
        try:
            pose = device.measured_cp()
        except CrtkError as error:
            OUT.print(Text(f"tool: {error.message}", "yellow"))
        else:
            OUT.print(Text(f"tool  {pose_words(pose)}"))


def _print_joints(device: RemoteDevice, offered: Mapping[str, Any]) -> None:
    try:
        measured: JointState = device.measured_js()
    except CrtkError as error:
        OUT.print(Text(f"joints: {error.message}", "yellow"))
        return
    limits = {joint["name"]: joint for joint in device.manifest.get("joints", ())}
    setpoint = _setpoint(device) if "setpoint_js" in offered else None
    table = Table(box=None, pad_edge=False, padding=(0, 3, 0, 0), header_style="dim")
    table.add_column("joint", overflow="fold")
    for heading in (f"measured ({', '.join(joint_units(device))})", "setpoint", "range"):
        table.add_column(heading, justify="right", overflow="fold")
    for index, position in enumerate(measured.position.tolist()):
        name = measured.name[index] if measured.name else str(index + 1)
        limit = limits.get(name)
        table.add_row(
            Text(printable(name)),
            f"{position:.4f}",
            "" if setpoint is None else f"{setpoint.position[index]:.4f}",
            ""
            if limit is None
            else " .. ".join(_bound(limit.get(end)) for end in ("lower", "upper")),
        )
    OUT.print(table)


def joint_unit(device: RemoteDevice, joint: str) -> str:
    """Return the unit of a joint's position, as far as the device says it: ``rad``, ``m``, or both."""
    return units_by_joint(device).get(joint) or "rad or m"


def joint_units(device: RemoteDevice) -> list[str]:
    """Return the units of the joints' positions that occur; both ``rad`` and ``m`` where one is not known."""
    found = set(units_by_joint(device).values()) or {""}
    if "" in found:
        found = found - {""} | {"rad", "m"}
    return sorted(found, key=lambda unit: (unit != "rad", unit))


def _bound(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


def _setpoint(device: RemoteDevice) -> JointState | None:
    try:
        setpoint: JointState = device.setpoint_js()
    except CrtkError:
        return None
    return setpoint


def pose_words(pose: Pose) -> str:
    """Return a pose in m with its quaternion x, y, z, w, as `move --pose` takes it."""
    position = " ".join(f"{value:.4f}" for value in pose.position)
    orientation = " ".join(f"{value:.4f}" for value in pose.orientation)
    frame = f"  in {printable(pose.frame_id)}" if pose.frame_id else ""
    return f"{position} m  {orientation}{frame}"

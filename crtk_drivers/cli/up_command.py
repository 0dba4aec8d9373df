"""``crtk-driver up``: all devices of a lab, one process each; and ``crtk-driver lab``: its file."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Final

import typer
from rich.table import Table
from rich.text import Text

from crtk_drivers.cli.help_pages import HelpfulCommand, HelpfulGroup
from crtk_drivers.cli.lab_scan import scanned_lab
from crtk_drivers.cli.lab_view import shown
from crtk_drivers.cli.log_setup import LogFormat, set_up_logging
from crtk_drivers.cli.reaching import prepare
from crtk_drivers.cli.terminal import ERR, OUT, plain
from crtk_drivers.config.variables import SEARCH_PATHS, assignments, checked_variables, merged
from crtk_drivers.errors import ConfigError
from crtk_drivers.errors.wording import worded
from crtk_drivers.labs import Lab, load_lab
from crtk_drivers.labs.bench.bounds import check_bounds
from crtk_drivers.labs.bench.catalogue import QUANTITIES
from crtk_drivers.labs.child import Child, Phase
from crtk_drivers.labs.lab_commands import require_commands
from crtk_drivers.labs.lab_entries import ALL_MACHINES
from crtk_drivers.labs.lab_file import require_devices
from crtk_drivers.labs.libraries import require_libraries
from crtk_drivers.labs.machines import NoMachineOfLab
from crtk_drivers.labs.reachable import doubts_between, why_closed
from crtk_drivers.labs.supervisor import LOOK_PERIOD, Supervisor
from crtk_drivers.labs.unit_environment import (
    closed_to_others,
    doubts,
    hidden,
    not_working,
    origin,
    unit_environment,
)
from crtk_drivers.labs.units import units_of, write_units
from crtk_drivers.ros import environment
from crtk_drivers.status.marked_processes import left_behind
from crtk_drivers.status.stop_request import stop_signals

SimOption = Annotated[
    bool, typer.Option("--sim", help="Simulate every device: no hardware is needed.")
]
MachineOption = Annotated[
    str,
    typer.Option(
        "--machine",
        metavar="NAME",
        help="Which machine of the lab this is; all: the whole lab. [dim]\\[default: by host name][/dim]",
        show_default=False,
    ),
]
LabFile = Annotated[Path, typer.Argument(metavar="LAB", help="The lab file.", show_default=False)]

logger = logging.getLogger(__name__)

EARLIER_ENDS_WITHIN: Final = 25.0
"""Seconds in which what an `up` that was killed has left ends: a device stops its hardware first."""

_UNITS: Final = Path("/etc/systemd/system")

app = typer.Typer()
lab_app = typer.Typer(cls=HelpfulGroup, no_args_is_help=True, rich_markup_mode="rich")


@app.command("up", cls=HelpfulCommand)
def _up(
    lab: LabFile,
    devices: Annotated[
        list[str] | None,
        typer.Argument(metavar="[DEVICE]...", help="Only these, and no programs."),
    ] = None,
    sim: SimOption = False,
    logs: Annotated[
        Path | None,
        typer.Option(
            "--logs", metavar="DIR", help="For logs. [dim]\\[default: logs/NAME-TIME][/dim]"
        ),
    ] = None,
    log_level: Annotated[
        str, typer.Option("--log-level", help="Least severe records that are shown.")
    ] = "info",
    systemd: Annotated[
        str | None,
        typer.Option(
            "--systemd",
            metavar="DIR",
            help="Start nothing: write units of systemd into this folder; - prints them.",
        ),
    ] = None,
    place: Annotated[
        str | None,
        typer.Option(
            "--for",
            metavar="DIR",
            help="With --systemd: where the files will be when systemd reads them. "
            "[dim]\\[default: where they are written][/dim]",
        ),
    ] = None,
    variables: Annotated[
        list[str] | None,
        typer.Option(
            "--env",
            metavar="NAME=VALUE",
            help="A variable for every process of the lab, over `environment` of the lab file.",
        ),
    ] = None,
    machine: MachineOption = "",
) -> None:
    """Bring up all devices of a lab, one process each, until Ctrl-C.

    They start in order, each once what carries it measures; one that ends is started again, DISABLED.
    Ctrl-C stops programs first, then the devices. Of a lab on several machines it starts the share of this
    one, and shows the devices of the others as they are seen on ROS.
    """
    found = load_lab(
        lab,
        sim=sim,
        only=tuple(devices or ()),
        environment=_typed_variables(variables or ()),
        machine=machine,
    )
    if place is not None and systemd in (None, "-"):
        raise ConfigError(
            "is where units will be that are written into another folder",
            where="--for",
            remedy="Give --systemd DIR beside it.",
        )
    if systemd is not None:
        raise typer.Exit(make_units(found, systemd, place))
    raise typer.Exit(bring_up(found, logs, log_level))


@lab_app.callback()
def _lab() -> None:
    """Write a lab file to start from, or check one."""


@lab_app.command("new", cls=HelpfulCommand)
def _lab_new(
    lab: Annotated[Path, typer.Argument(metavar="LAB", help="Where.")] = Path("lab.toml"),
    scan: Annotated[
        bool,
        typer.Option("--scan", help="Ask serial ports and CAN buses who is there; nothing moves."),
    ] = False,
    at: Annotated[
        list[str] | None,
        typer.Option(
            "--at", metavar="PLACE", help="With --scan: look only here, as /dev/ttyUSB0 or can0."
        ),
    ] = None,
) -> None:
    """Write a lab file to start from. Nothing is overwritten."""
    if at and not scan:
        raise ConfigError("is where --scan looks", where="--at", remedy="Add --scan.")
    raise typer.Exit(write_lab(lab, tuple(at or ()) if scan else None))


@lab_app.command("check", cls=HelpfulCommand)
def _lab_check(
    lab: LabFile,
    sim: SimOption = False,
    machine: MachineOption = "",
    no_ros: Annotated[
        bool,
        typer.Option("--no-ros", help="Do not look for the devices of other machines."),
    ] = False,
) -> None:
    """Check a lab file with the settings of all its devices, and show what would be started.

    Of a lab on several machines the settings of this one's devices are checked, and what is seen of the
    others on ROS. Exit code 1: something is wrong between them. 2: the file is wrong.
    """
    raise typer.Exit(check_lab(lab, sim, machine, looks=not no_ros))


app.add_typer(lab_app, name="lab")


def _typed_variables(typed: Sequence[str]) -> dict[str, str]:
    """Return variables that were typed as ``NAME=VALUE``.

    Raises:
        ConfigError: one is no such pair, or cannot be right.
    """
    found: dict[str, str] = {}
    for each in typed:
        name, mark, found[name] = each.partition("=")
        if not mark:
            raise ConfigError(
                f"{each!r} gives no value", where="--env", remedy=f"Write --env {each}=VALUE."
            )
    try:
        return checked_variables(found)
    except ValueError as error:
        raise ConfigError(str(error), where="--env") from error


def bring_up(lab: Lab, logs: Path | None, log_level: str) -> int:
    """Run a lab until Ctrl-C, and return the exit code: 0 if all of it was seen to end well.

    Raises:
        ConfigError: the lab file cannot be used, or the folder for logs cannot be written.
    """
    set_up_logging(ERR, log_level, LogFormat.TEXT)
    require_libraries(lab)
    require_commands(lab)
    _wait_for_earlier(lab)
    _check_ros(lab)
    for doubt in doubts_between(lab, os.environ):
        logger.warning("%s", doubt)
    stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%S")
    folder = logs or Path("logs") / f"{lab.name}-{stamp}"
    try:
        supervisor = Supervisor(lab, folder)
    except OSError as error:
        raise ConfigError(
            f"logs cannot be written: {error}", where=str(folder), remedy="Give another --logs."
        ) from error
    logger.info(
        "%s: %d devices, %d programs; logs in %s",
        lab.name,
        len(lab.devices),
        len(lab.programs),
        folder,
    )
    if lab.left_out:
        logger.info("%s: this is %s; others start %s", lab.name, lab.machine, lab.left_out)
    with stop_signals() as stop, shown(supervisor) as show:
        try:
            while not stop.is_set() and not supervisor.is_over:
                supervisor.step()
                show()
                time.sleep(LOOK_PERIOD)
            failed = [child for child in supervisor.children if _has_failed(child)]
        finally:
            supervisor.stop(show)
    return _conclusion(supervisor, failed)


def _check_ros(lab: Lab) -> None:
    """Make sure that devices of a lab can use ROS 2, which the lab file may say where to find.

    Raises:
        MissingExtra, ConfigError: they cannot.
    """
    environment.adopt(lab.environment)
    if not any(name in lab.environment for name in SEARCH_PATHS):
        environment.check()
    elif why := not_working(lab, merged(os.environ, lab.environment)):
        raise ConfigError(
            f"its devices cannot use ROS 2: {why}",
            where=str(lab.path),
            remedy="Look at its table `environment`.",
        )


def _wait_for_earlier(lab: Lab) -> None:
    """Wait until all has ended that an `up` of this lab has started which was killed.

    Raises:
        ConfigError: it does not end; second copies beside it would command the same devices.
    """
    group = str(lab.path.resolve())
    deadline = time.monotonic() + EARLIER_ENDS_WITHIN
    if found := left_behind(group):
        logger.warning("%s: waits for what an earlier `up` has left to end", lab.name)
    while found:
        if time.monotonic() > deadline:
            raise ConfigError(
                f"what an earlier `up` has started still runs: {', '.join(map(str, found))}",
                where=group,
                remedy=f"End it: kill -9 {' '.join(str(each.pid) for each in found)}",
            )
        time.sleep(LOOK_PERIOD)
        found = left_behind(group)


def _conclusion(supervisor: Supervisor, failed: Sequence[Child]) -> int:
    """Log how a lab ended, of which some had failed before, and return the exit code."""
    name = supervisor.lab.name
    bad = [child for child in supervisor.children if child in failed or not child.ended_well]
    if not bad:
        logger.info("%s: all stopped; exit code 0", name)
        return 0
    logger.error("%s: exit code 1:", name)
    for child in bad:
        logger.error("  %s: %s", child.name, child.why)
    return 1


def make_units(lab: Lab, folder: str, place: str | None = None) -> int:
    """Write the units of a lab into a folder, or print those of /etc/systemd/system for ``-``.

    Returns:
        0; 1 if a node does not start in the environment of these units.

    Raises:
        ConfigError: the lab file cannot be used, this machine has no device of it, or the units cannot be
            written.
    """
    require_devices(lab)
    require_libraries(lab)
    variables = unit_environment(lab)
    if folder == "-":
        for name, text in units_of(lab, _UNITS).items():
            OUT.print(f"# ==> {name}\n{text}", soft_wrap=True, markup=False, highlight=False)
    else:
        for file in write_units(lab, Path(folder), None if place is None else Path(place)):
            OUT.print(str(file), soft_wrap=True, markup=False, highlight=False)
    lines = ["Environment of the units, for every client too:"]
    lines += [f"  {name}={value}  ({origin(lab, name)})" for name, value in variables.items()]
    lines += doubts(variables)
    lines += doubts_between(lab, variables)
    if lab.left_out:
        lines.append(f"These are the units of {lab.machine}. Others start {lab.left_out}.")
    if lab.programs:
        lines.append(f"Without a unit: {', '.join(lab.programs)}. Programs are started by `up`.")
    lines += [
        f"The users of these units may not read {path}: {closed} is closed to others. Install or move "
        "what is there elsewhere, for example into /opt."
        for closed, path in closed_to_others(lab, variables).items()
    ]
    lines += [
        f"These units do not see {path}: each has a /tmp and a /var/tmp of its own. Move it elsewhere, for "
        "example into /opt."
        for path in hidden(lab, variables)
    ]
    why = not_working(lab, variables)
    if why:
        lines.append(f"These units cannot start as they are: {why}")
    for line in lines:
        ERR.print(line, soft_wrap=True, markup=False, highlight=False)
    return 1 if why else 0


def _has_failed(child: Child) -> bool:
    return child.phase is Phase.ENDED and child.code != 0


def check_lab(path: Path, sim: bool, machine: str = "", *, looks: bool = True) -> int:
    """Check a lab file, print what would be started, and return the exit code.

    On a machine that is none of the lab's the settings of all devices are checked, and nothing that is
    installed.

    Args:
        path: of the file.
        sim: simulate every device.
        machine: which machine of the lab this is; empty: by its host name.
        looks: look for the devices of other machines on ROS.

    Returns:
        1 if something is wrong between the machines of the lab, else 0.

    Raises:
        ConfigError: with what is wrong, and the line.
    """
    checked = "settings, libraries and commands are checked"
    try:
        lab = load_lab(path, sim=sim, machine=machine)
    except NoMachineOfLab as error:
        ERR.print(f"{error.message}: the settings of all of them are checked", soft_wrap=True)
        lab = load_lab(path, sim=sim, machine=ALL_MACHINES)
        checked = "settings are checked; libraries and commands are on the machines of the lab"
    else:
        require_libraries(lab)
        require_commands(lab)
    check_bounds(lab, QUANTITIES)
    OUT.print(_plan(lab))
    if lab.environment:
        OUT.print(f"\nenvironment: {assignments(lab.environment)}", markup=False, highlight=False)
    variables = merged(os.environ, lab.environment)
    for doubt in doubts_between(lab, variables):
        OUT.print(Text(f"\n{doubt}", "yellow"), soft_wrap=True)
    OUT.print(f"\n{plain(str(path))} can be used: {checked}, nothing was started")
    if lab.left_out:
        OUT.print(f"To be checked there: {lab.left_out}", markup=False, highlight=False)
    if not lab.elsewhere:
        return 0
    if why_closed(variables):
        return 1  # they cannot see each other, as was said
    if not looks:
        return 0
    environment.adopt(lab.environment)
    prepare()
    from crtk_drivers.cli.lab_between import check_between  # it needs rclpy

    return check_between(lab)


def _plan(lab: Lab) -> Table:
    table = Table(title=lab.name, title_justify="left", box=None, pad_edge=False)
    is_on_several = len(lab.machines) > 1
    for column in (
        "",
        *(("machine",) if is_on_several else ()),
        "driver",
        "namespace",
        "at",
        "after",
    ):
        table.add_column(column)
    for name, machine, *words in _planned(lab):
        told = (machine, *words) if is_on_several else words
        table.add_row(Text(name, "bold cyan"), *map(Text, told))
    return table


def _planned(lab: Lab) -> Iterator[tuple[str, ...]]:
    """Yield name, machine, driver or command, namespace, address, and what comes before, of each process."""
    for device in lab.devices.values():
        at = "a simulator" if device.sim else device.address
        after = ", ".join(device.after)
        yield device.name, device.machine, device.plugin.name, device.namespace, at, after
    for other in lab.elsewhere.values():
        yield other.name, other.machine, other.plugin, other.namespace, "", ""
    for program in lab.programs.values():
        command, after = " ".join(program.command), ", ".join(program.after)
        yield program.name, program.machine, command, "", "", after
    for name, entry in lab.settings.programs.items():
        if name not in lab.programs:
            yield name, entry.machine or lab.settings.machine, " ".join(entry.command), "", "", ""


def write_lab(path: Path, places: tuple[str, ...] | None = None) -> int:
    """Write a lab file to start from; nothing is overwritten. Return 1 if nothing was found to write.

    Args:
        path: of the file.
        places: look there for hardware, or everywhere if empty; None: write an example.

    Raises:
        ConfigError: there is one, or it cannot be written.
    """
    if path.suffix != ".toml":
        raise ConfigError(f"{path}: a lab file is TOML", remedy=f"For example: {path}.toml")
    if path.exists():
        raise _is_there(path)
    if places is None:
        text = files("crtk_drivers.cli").joinpath("templates/lab.toml").read_text("utf-8")
        next_step = f"Try it without hardware: crtk-driver up {path} --sim"
    else:
        text = scanned_lab(places)
        next_step = f"Complete it: crtk-driver lab check {path} names what is missing."
    if not text:
        ERR.print(f"Nothing was found: {path} is not written.", soft_wrap=True)
        return 1
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError as error:
        raise _is_there(path) from error
    except OSError as error:
        raise ConfigError(f"cannot be written: {error.strerror}", where=str(path)) from error
    OUT.print(f"{path} is written. {worded(next_step)}", soft_wrap=True)
    return 0


def _is_there(path: Path) -> ConfigError:
    return ConfigError("is there already", where=str(path), remedy="Choose another name.")

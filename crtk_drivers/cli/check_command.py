"""``crtk-driver check <device>``: is everything ready to run it? A table of verdicts with remedies."""

from __future__ import annotations

import logging
import resource
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any

import typer
from rich.table import Table
from rich.text import Text

from crtk_drivers import plugins
from crtk_drivers.cli.launch import Launch, launch_of, launch_options
from crtk_drivers.cli.plugin_group import PluginGroup, Source
from crtk_drivers.cli.terminal import ERR, OUT, plain
from crtk_drivers.cli.typed_options import make_command
from crtk_drivers.device import Severity
from crtk_drivers.errors import CommandRefused, ConfigError, CrtkError, MissingExtra
from crtk_drivers.errors.wording import worded
from crtk_drivers.plugins import DevicePlugin
from crtk_drivers.ros import environment
from crtk_drivers.state import OperatingState
from crtk_drivers.status.counter_groups import grouped

if TYPE_CHECKING:
    from crtk_drivers.engine import Engine
    from crtk_drivers.session import Session

MEASURING_TIME = 1.0
"""Seconds over which the rate is measured."""

RATE_TOLERANCE = 0.02
LATE_SHARE = 0.005
_CAUSE_FIRST = "Remove the cause, then enable."
_SETTLING_TIME = 0.3
_POLL = 0.02


class Verdict(StrEnum):
    """Of one check. Only a failure makes the exit code 1."""

    OK = "ok"
    WARNING = "warning"
    FAILED = "failed"


_STYLES = {Verdict.OK: "green", Verdict.WARNING: "yellow", Verdict.FAILED: "bold red"}


@dataclass(frozen=True)
class Finding:
    """The outcome of one check."""

    what: str
    verdict: Verdict
    result: str
    remedy: str = ""


def build(plugin: DevicePlugin, panel: str) -> Any:
    """Return the command that checks a device."""

    def run(context: typer.Context, **given: Any) -> int:
        return check_device(plugin, given)

    help_text = (
        f"Check that {plain(plugin.name)} is ready to run. Connects and reads; enables nothing and "
        "moves nothing."
    )
    return make_command(plugin.name, run, launch_options(plugin), help=help_text, panel=panel)


def check_device(plugin: DevicePlugin, given: Mapping[str, Any]) -> int:
    """Check, print the table, and return 1 if anything failed, otherwise 0.

    Raises:
        ConfigError: the configuration cannot be used, so that there is nothing to check.
    """
    launch = launch_of(plugin, given)
    logging.getLogger().addHandler(logging.NullHandler())  # the table tells it all
    with ERR.status(f"checking {plain(plugin.name)} ..."):
        findings = list(_findings(launch))
    OUT.print(_table(findings))
    count = Counter(finding.verdict for finding in findings)
    OUT.print()
    if failed := count[Verdict.FAILED]:
        OUT.print(f"[bold red]not ready[/]: {failed} of {len(findings)} checks failed")
        return 1
    warnings = count[Verdict.WARNING]
    but = f", with {warnings} warning{'s' if warnings > 1 else ''}" if warnings else ""
    OUT.print(f"[bold green]ready[/]{but}")
    return 0


def _table(findings: list[Finding]) -> Table:
    table = Table(box=None, pad_edge=False, header_style="dim")
    for column in ("check", "verdict", "result"):
        table.add_column(column, overflow="fold", no_wrap=column != "result")
    for finding in findings:
        result = Text(worded(finding.result))
        if finding.remedy:
            result.append(f"\n{worded(finding.remedy)}", _STYLES[finding.verdict])
        table.add_row(Text(finding.what), Text(finding.verdict, _STYLES[finding.verdict]), result)
    return table


def _findings(launch: Launch) -> Iterator[Finding]:
    yield from _check_link(launch)
    yield _check_ros()
    yield _check_real_time()


def _check_link(launch: Launch) -> Iterator[Finding]:
    try:
        session = launch.open()
    except ConfigError:
        raise
    except CrtkError as error:
        what = "libraries" if isinstance(error, MissingExtra) else "simulator"
        yield Finding(what, Verdict.FAILED, error.message, error.remedy)
        return
    yield Finding("configuration", Verdict.OK, session.engine.where)
    started = time.monotonic()
    with session:
        connected = _check_connection(session, started)
        yield connected
        if connected.verdict is Verdict.OK:
            # First: it takes a second, in which a device reports more of itself.
            rate = list(_check_rate(session.engine))
            yield from _check_state(session.engine)
            yield from rate
            for name, engine in {"": session.engine, **session.children}.items():
                yield from _check_enable(engine, f"enable {name}".strip())


def _check_connection(session: Session, started: float) -> Finding:
    engine = session.engine
    deadline = started + session.config.open_timeout + session.config.sample_timeout + 1.0
    while time.monotonic() < deadline:
        if engine.connected and engine.has_sample:
            took = time.monotonic() - started
            return Finding("reachable", Verdict.OK, f"first sample after {took:.2f} s")
        time.sleep(_POLL)
    return Finding(
        "reachable",
        Verdict.FAILED,
        engine.status.cause or "connected, but no sample arrived",
        engine.status.remedy
        or ("" if engine.status.cause else "Is its stream allowed, and the network free?"),
    )


def _check_state(engine: Engine) -> Iterator[Finding]:
    status = engine.status
    detail = f": {status.detail}" if status.detail else ""
    verdict = {
        OperatingState.FAULT: Verdict.FAILED,  # whether `enable` resets it, only trying shows
        OperatingState.PAUSED: Verdict.WARNING,
    }.get(status.state, Verdict.OK)
    # The detail ends with the device's own remedy, if there is one.
    remedy = _CAUSE_FIRST if verdict is Verdict.FAILED and not status.remedy else ""
    yield Finding("operating state", verdict, f"{status.state}{detail}", remedy)
    health = engine.health()
    if health.device:
        words = {note.key: note.text for note in health.notes}
        units = engine.device.counter_units
        lines = grouped(health.device, words, engine.capabilities.joints, units)
        yield Finding("device counters", Verdict.OK, "\n".join(lines))
    for note in health.notes:
        if note.severity is not Severity.INFO:
            yield Finding("note", Verdict.WARNING, f"{note.key}: {note.text}")


def _check_rate(engine: Engine) -> Iterator[Finding]:
    time.sleep(_SETTLING_TIME)
    before, began = engine.health(), time.monotonic()
    time.sleep(MEASURING_TIME)
    after, ended = engine.health(), time.monotonic()
    cycles = after.cycles - before.cycles
    rate = cycles / (ended - began)
    late = after.late_cycles - before.late_cycles
    expected = after.rate_expected
    slow = rate < (1.0 - RATE_TOLERANCE) * expected
    yield Finding(
        "rate",
        Verdict.WARNING if slow else Verdict.OK,
        f"{rate:.1f} Hz of {expected:g} Hz over {MEASURING_TIME:g} s",
        "Close other programs, use a wired network, or a real-time kernel." if slow else "",
    )
    many = late > LATE_SHARE * max(cycles, 1)
    yield Finding(
        "late cycles",
        Verdict.WARNING if many else Verdict.OK,
        f"{late} of {cycles}, longest {1e3 * after.worst_cycle:.1f} ms",
        "Allow real-time priority (below), or lower the load of this machine." if many else "",
    )


def _check_enable(engine: Engine, what: str) -> Iterator[Finding]:
    """Yield what would refuse `enable` now.

    It is the last check: some devices need the second before to report all that stands in the way.
    """
    status = engine.status
    obstacles = [(_reason(error), error.remedy) for error in engine.device.obstacles]
    if not obstacles:
        yield Finding(what, Verdict.OK, "no known obstacle")
    for reason, remedy in obstacles:
        if status.state is OperatingState.FAULT and reason in status.detail:
            continue  # the operating state has said it
        yield Finding(what, Verdict.FAILED, reason, remedy)


def _reason(error: CrtkError) -> str:
    text = error.detail if isinstance(error, CommandRefused) else error.message
    return text.removeprefix("enable: ")


def _check_ros() -> Finding:
    try:
        environment.check()
    except CrtkError as error:
        remedy = f"{error.remedy} (Plain Python needs no ROS.)".strip()
        return Finding("ROS 2", Verdict.WARNING, error.message, remedy)
    return Finding("ROS 2", Verdict.OK, "rclpy and all messages found")


def _check_real_time() -> Finding:
    soft, hard = resource.getrlimit(resource.RLIMIT_RTPRIO)
    highest = max(soft, hard) if resource.RLIM_INFINITY not in (soft, hard) else 99
    if highest > 0:
        return Finding("real-time priority", Verdict.OK, f"allowed up to {highest}")
    return Finding(
        "real-time priority",
        Verdict.WARNING,
        "not allowed for this user",
        "Run `sudo groupadd -f realtime; sudo usermod -aG realtime $USER`. "
        "Add `@realtime - rtprio 98` to /etc/security/limits.conf. Log in again.",
    )


class CheckGroup(PluginGroup):
    """One command for each device."""

    source = Source(plugins.devices, build, plugins.device, "Devices")


app = typer.Typer()
check_app = typer.Typer(cls=CheckGroup, no_args_is_help=True, rich_markup_mode="rich")


@check_app.callback()
def _check() -> None:
    """Check that a device, or its simulator, is ready to run."""


app.add_typer(check_app, name="check")

"""What ``crtk-driver bench`` does: runs as a terminal shows them, and what is made of their results."""

from __future__ import annotations

import json
import logging
import os
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any, Final

import typer
from rich.cells import cell_len
from rich.live import Live
from rich.padding import Padding
from rich.spinner import Spinner
from rich.table import Table
from rich.text import Text

from crtk_drivers.cli.log_setup import LogFormat, set_up_logging
from crtk_drivers.cli.terminal import ERR, OUT, ask
from crtk_drivers.errors import ConfigError
from crtk_drivers.labs import Lab, load_lab
from crtk_drivers.labs.bench import history, report
from crtk_drivers.labs.bench.acquisition import SAFETY_LETTERS, Suite
from crtk_drivers.labs.bench.allowed import BenchOptions
from crtk_drivers.labs.bench.catalogue import TESTS
from crtk_drivers.labs.bench.folder import default_folder, finish
from crtk_drivers.labs.bench.results import Run, read_run
from crtk_drivers.labs.bench.run import judged_again, run_bench
from crtk_drivers.labs.lab_commands import require_commands
from crtk_drivers.labs.lab_file import require_devices
from crtk_drivers.labs.libraries import require_libraries
from crtk_drivers.labs.verdicts.judging import Comparison, Verdict, with_unit
from crtk_drivers.ros import environment
from crtk_drivers.status.stop_request import StopRequest, stop_signals

STYLES: Final = {
    Verdict.PASS: "green",
    Verdict.FAIL: "bold red",
    Verdict.INCONCLUSIVE: "yellow",
    Verdict.SKIPPED: "dim",
}

_TITLES: Final = {test.id: f"{test.id} {test.name}" for test in TESTS}
_INDENT: Final = 10
"""Columns before a reason that stands below its test."""

logger = logging.getLogger(__name__)


def run(
    path: Path,
    *,
    devices: Sequence[str],
    sim: bool,
    suite: Suite,
    only: Sequence[str],
    may_move: bool,
    may_travel: Sequence[str],
    at_once: int,
    against: str,
    out: Path | None,
    inconclusive_ok: bool,
    regression_fails: bool,
    machine: str = "",
) -> int:
    """Test a lab, keep what was found, and return the exit code.

    Raises:
        ConfigError: it cannot be started as asked.
    """
    set_up_logging(ERR, "info", LogFormat.TEXT)
    lab = load_lab(path, sim=sim, only=tuple(devices), machine=machine)
    require_devices(lab)
    if lab.left_out:
        logger.info("left out: %s; this is %s", lab.left_out, lab.machine)
    require_libraries(lab)
    require_commands(lab, programs=False)
    environment.adopt(lab.environment)
    folder = out or default_folder(lab)
    earlier = history.earlier_of(lab, folder.parent, against)
    options = BenchOptions(suite, tuple(only), may_move, folder, tuple(may_travel), at_once)
    with stop_signals() as stop, _stopped_by_ctrl_z(lab, may_move, stop), _shown(stop) as show:
        try:
            found = run_bench(lab, options, show, stop, _seen(ask, stop))
        except OSError as error:
            raise ConfigError(
                f"results cannot be written: {error.strerror}", where=str(folder)
            ) from error
    enough = history.ENOUGH if against == "all" else 1
    found, trouble = finish(found, folder, earlier, enough)
    _print_skipped(found)
    _tell(found, folder)
    if trouble:
        logger.error("%s", trouble)
        return report.ABORTED
    return report.exit_code(
        found, inconclusive_ok=inconclusive_ok, regression_fails=regression_fails
    )


@contextmanager
def _stopped_by_ctrl_z(lab: Lab, may_move: bool, stop: StopRequest) -> Iterator[None]:
    """Within, Ctrl-Z is Ctrl-C where hardware may move: nobody is there to stop it if this process sleeps."""
    if not may_move or all(device.simulated for device in lab.devices.values()):
        yield
        return

    def handler(number: int, frame: FrameType | None) -> None:
        os.write(2, b"\nCtrl-Z ends the run as Ctrl-C does: asleep, it could stop nothing.\n")
        stop.set()

    before = signal.signal(signal.SIGTSTP, handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTSTP, before)


def baseline(folder: Path) -> int:
    """Make a run the baseline of its devices.

    Raises:
        ConfigError: it is no run that came to its end.
    """
    found = history.make_baseline(folder)
    kinds = {True: "simulated", False: "real"}
    for device in found.devices:
        told = f"{device.name}, {kinds[device.simulated]}: {device.verdict} on {found.started}"
        OUT.print(f"{told} is what --against baseline compares with", soft_wrap=True)
    return 0


def again(folder: Path, lab_file: Path | None) -> int:
    """Judge the recordings of a run anew, with the bounds that a lab file has now; return the exit code.

    Raises:
        ConfigError: there is no such run.
    """
    found = judged_again(folder, lab_file)
    OUT.print(_verdicts(found))
    bounds = lab_file or Path(found.lab_file)
    told = f"the bounds of {bounds}" if bounds.is_file() else f"default bounds: {bounds} is gone"
    OUT.print(f"Judged anew with {told}.", soft_wrap=True)
    OUT.print(Text.assemble((found.verdict, STYLES[found.verdict]), f": {report.summary(found)}"))
    return report.exit_code(found)


def list_tests() -> int:
    """Print the tests."""
    table = Table(box=None, pad_edge=False)
    for column in ("test", "", "suite", "class", "what is done", "measured"):
        table.add_column(column)
    for test in TESTS:
        measured = ", ".join(quantity.title for quantity in test.quantities)
        table.add_row(
            Text(test.id, "bold cyan"),
            test.name,
            test.acquisition.suite,
            SAFETY_LETTERS[test.acquisition.safety],
            test.acquisition.summary,
            measured,
        )
    OUT.print(table)
    OUT.print(
        "\nClasses: R reads, E enables, S moves a little (0.1 rad, 20 mm at most), L through its space, "
        "X takes a process away, XL in motion.",
        style="dim",
    )
    return 0


def list_figures() -> int:
    """Print the figures: their ids, by which a lab file bounds them."""
    table = Table(box=None, pad_edge=False)
    for column in ("figure", "", "unit", "test", "judged", "worse"):
        table.add_column(column)
    for test in TESTS:
        for quantity in test.quantities:
            is_told = quantity.comparison is Comparison.TOLD
            table.add_row(
                Text(quantity.id, "bold cyan"),
                quantity.title,
                quantity.unit,
                test.id,
                "only told" if is_told else quantity.comparison,
                quantity.worse,
            )
    OUT.print(table)
    return 0


def show(folders: Sequence[Path]) -> int:
    """Print what runs found: one in full, several as a trend.

    Raises:
        ConfigError: one of them is no run.
    """
    runs = [read_run(folder) for folder in folders]
    if len(runs) == 1:
        OUT.print(_verdicts(runs[0]))
        _tell(runs[0], folders[0])
        return report.exit_code(runs[0])
    table = Table(box=None, pad_edge=False)
    for column in ("device", "measurement", ""):
        table.add_column(column)
    for one in runs:
        table.add_column(one.started[:19].replace("T", " "), justify="right")
    titles = {
        history.key_of(device, found): found.title
        for one in runs
        for device, test in one.tests
        for found in test.measurements
    }
    both = {key.device for key in titles if key.simulated} & {
        key.device for key in titles if not key.simulated
    }
    for key, title in titles.items():
        values = [_value(one, key) for one in runs]
        name = f"{key.device}, simulated" if key.simulated and key.device in both else key.device
        table.add_row(*map(Text, (name, title, key.part)), *values)
    OUT.print(table)
    return 0


def print_schema() -> int:
    """Print the schema of ``run.json``."""
    typer.echo(json.dumps(Run.model_json_schema(), indent=2))
    return 0


def _value(found: Run, key: history.Key) -> Text:
    for device, test in found.tests:
        for measured in test.measurements:
            if history.key_of(device, measured) == key and measured.value is not None:
                return Text(with_unit(measured.value, measured.unit), STYLES[measured.verdict])
    return Text("")


def _tell(found: Run, folder: Path) -> None:
    for device, test in found.tests:
        for measured in test.measurements:
            if measured.regressed:
                where = f"{device.name} {test.id} {test.name}"
                told = f"{where}: worse than it was: {measured.told}: {measured.regressed}"
                OUT.print(Text(told, "yellow"), soft_wrap=True)
    if not found.complete:
        OUT.print(Text(f"This run did not come to its end: {found.ended_by}", "bold red"))
    OUT.print(Text.assemble((found.verdict, STYLES[found.verdict]), f": {report.summary(found)}"))
    path = folder / "report.html" if folder.is_dir() else folder
    if path.exists():
        OUT.print(f"Report: {path}", soft_wrap=True)


def _print_skipped(found: Run) -> None:
    """Print in a line which tests were skipped, and why: none of them was shown while the bench ran."""
    if skipped := "; ".join(
        f"{name} {', '.join(tests)}" + (f" ({reason})" if reason else "")
        for (name, reason), tests in _skipped(found).items()
    ):
        OUT.print(Text(f"skipped: {skipped}", "dim"), soft_wrap=True)


def _skipped(found: Run) -> dict[tuple[str, str], list[str]]:
    """Return the skipped tests, as `M7 effective rate`, by their device and their reason."""
    skipped: dict[tuple[str, str], list[str]] = {}
    for device, test in found.tests:
        if test.verdict is Verdict.SKIPPED:
            tests = skipped.setdefault((device.name, test.reason), [])
            tests.append(f"{test.id} {test.name}")
    return skipped


def _verdicts(found: Run) -> Table:
    table = Table(box=None, pad_edge=False)
    for column in ("device", "test", "", "verdict", ""):
        table.add_column(column, overflow="fold")
    for device, test in found.tests:
        if test.verdict is Verdict.SKIPPED:
            continue
        told = test.reason or "; ".join(measured.told for measured in test.measurements)
        table.add_row(
            Text(device.name),
            Text(test.id),
            Text(test.name),
            Text(test.verdict, STYLES[test.verdict]),
            Text(told),
        )
    for (name, reason), tests in _skipped(found).items():
        verdict = Text(Verdict.SKIPPED, STYLES[Verdict.SKIPPED])
        table.add_row(Text(name), "", "", verdict, Text(f"{', '.join(tests)}: {reason}"))
    return table


def _seen(tell: Callable[..., None], stop: StopRequest) -> Callable[..., None]:
    """Return what tells the operator, and ends the run as Ctrl-C does where nobody reads that any more."""

    def told(*arguments: Any) -> None:
        try:
            tell(*arguments)
        except OSError:
            ERR.quiet = True
        if ERR.quiet:
            stop.set()

    return told


@contextmanager
def _shown(stop: StopRequest) -> Iterator[Any]:
    """Show each test as it ends, and on a terminal the one that runs."""
    began = time.monotonic()
    running: set[tuple[str, str]] = set()
    live = Live(console=ERR, transient=True, refresh_per_second=8) if ERR.is_terminal else None

    def progress(device: str, test: str, verdict: Verdict | None, told: str) -> None:
        if verdict is None:
            running.add((device, test))
        else:
            running.discard((device, test))
            if verdict is not Verdict.SKIPPED:
                _print_result(time.monotonic() - began, device, test, verdict, told)
        if live is not None:
            doing = ", ".join(f"{device} {_TITLES[test]}" for device, test in sorted(running))
            live.update(Spinner("dots", Text(doing)) if doing else Text(""))

    if live is None:
        yield _seen(progress, stop)
        return
    with live:
        yield _seen(progress, stop)


def _print_result(seconds: float, device: str, test: str, verdict: Verdict, told: str) -> None:
    """Print how a test ended; what leaves no room in its line on a terminal stands below, wrapped."""
    line = Text.assemble(
        (f"{seconds:6.1f} s  ", "dim"),
        (f"{device:12s} ", "bold cyan"),
        (f"{verdict:13s}", STYLES[verdict]),
        _TITLES.get(test, ""),
    )
    if not ERR.is_terminal or line.cell_len + 2 + cell_len(told) <= ERR.width:
        ERR.print(line.append(f"  {told}" if told else ""), soft_wrap=True)
        return
    ERR.print(line)
    ERR.print(Padding(Text(told, overflow="fold"), (0, 0, 0, _INDENT)))

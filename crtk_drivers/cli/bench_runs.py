"""What ``crtk-driver bench`` does: runs as a terminal shows them, and what is made of their results."""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import typer
from rich.live import Live
from rich.spinner import Spinner
from rich.table import Table
from rich.text import Text

from crtk_drivers.cli.log_setup import LogFormat, set_up_logging
from crtk_drivers.cli.terminal import ERR, OUT
from crtk_drivers.errors import ConfigError
from crtk_drivers.labs import load_lab
from crtk_drivers.labs.bench import history, report
from crtk_drivers.labs.bench.catalogue import TESTS
from crtk_drivers.labs.bench.declared import SAFETY_LETTERS, Suite
from crtk_drivers.labs.bench.results import Run, read_run, write_run
from crtk_drivers.labs.bench.run import BenchOptions, judged_again, run_bench
from crtk_drivers.labs.verdicts.judging import Verdict
from crtk_drivers.status.stop_request import stop_signals

STYLES: Final = {
    Verdict.PASS: "green",
    Verdict.FAIL: "bold red",
    Verdict.INCONCLUSIVE: "yellow",
    Verdict.SKIPPED: "dim",
}

logger = logging.getLogger(__name__)


def run(
    path: Path,
    *,
    devices: Sequence[str],
    sim: bool,
    suite: Suite,
    only: Sequence[str],
    may_move: bool,
    against: str,
    out: Path | None,
    inconclusive_ok: bool,
    regression_fails: bool,
) -> int:
    """Test a lab, keep what was found, and return the exit code.

    Raises:
        ConfigError: it cannot be started as asked.
    """
    set_up_logging(ERR, "info", LogFormat.TEXT)
    lab = load_lab(path, sim=sim, only=tuple(devices))
    folder = out or Path("runs") / f"{datetime.now(UTC).strftime('%Y%m%dT%H%M%SZ')}-{lab.name}"
    earlier = _earlier(against, folder, lab.name)
    options = BenchOptions(suite, tuple(only), may_move, folder)
    with stop_signals() as stop, _shown() as show:
        try:
            found = run_bench(lab, options, show, stop)
        except OSError as error:
            raise ConfigError(
                f"results cannot be written: {error.strerror}", where=str(folder)
            ) from error
    found = history.compared(found, earlier, history.ENOUGH if against == "all" else 1)
    _keep(found, folder, earlier)
    _tell(found, folder)
    return report.exit_code(
        found, inconclusive_ok=inconclusive_ok, regression_fails=regression_fails
    )


def again(folder: Path, lab_file: Path | None) -> int:
    """Judge the recordings of a run anew, with the bounds that a lab file has now; return the exit code.

    Raises:
        ConfigError: there is no such run.
    """
    found = judged_again(folder, lab_file)
    OUT.print(_verdicts(found))
    OUT.print(report.summary(found))
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
        "\nClasses: R reads, E enables, S moves a little (0.1 rad, 20 mm at most), L anywhere in its space, "
        "X takes a process away, XL in motion.",
        style="dim",
    )
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
        table.add_column(one.started[:16], justify="right")
    keys = dict.fromkeys(
        (device.name, found.key, found.title)
        for one in runs
        for device, test in one.tests
        for found in test.measurements
    )
    for name, key, title in keys:
        values = [_value(one, name, key) for one in runs]
        table.add_row(name, title, key[1], *values)
    OUT.print(table)
    return 0


def print_schema() -> int:
    """Print the schema of ``run.json``."""
    typer.echo(json.dumps(Run.model_json_schema(), indent=2))
    return 0


def _value(found: Run, device: str, key: tuple[str, str]) -> Text:
    for one, test in found.tests:
        if one.name != device:
            continue
        for measured in test.measurements:
            if measured.key == key and measured.value is not None:
                return Text(f"{measured.value:.4g} {measured.unit}", STYLES[measured.verdict])
    return Text("")


def _earlier(against: str, folder: Path, lab: str) -> dict[history.Key, list[tuple[str, float]]]:
    """Return what a run is compared with: all earlier ones, the newest of them, or one that is named."""
    if against == "all":
        return history.read_index(folder.parent, lab)
    if against == "previous":
        every = history.read_index(folder.parent, lab)
        newest = max((run for values in every.values() for run, _ in values), default="")
        return {
            key: [value for value in values if value[0] == newest] for key, values in every.items()
        }
    return history.earlier_values([Path(against)], lab)


def _keep(found: Run, folder: Path, earlier: dict[history.Key, list[tuple[str, float]]]) -> None:
    try:
        write_run(found, folder)
        (folder / "junit.xml").write_text(report.junit(found), "utf-8")
        (folder / "report.html").write_text(report.html(found, earlier), "utf-8")
        history.add_to_index(found, folder.parent, folder.name)
    except OSError as error:
        logger.error("%s: results cannot be written: %s", folder, error.strerror)


def _tell(found: Run, folder: Path) -> None:
    for device, test in found.tests:
        for measured in test.measurements:
            if measured.regressed:
                told = f"{device.name} {test.id}: worse than it was: {measured.told}: {measured.regressed}"
                OUT.print(told, style="yellow", soft_wrap=True)
    if not found.complete:
        OUT.print(f"This run did not come to its end: {found.ended_by}", style="bold red")
    OUT.print(Text.assemble((found.verdict, STYLES[found.verdict]), f": {report.summary(found)}"))
    path = folder / "report.html" if folder.is_dir() else folder
    if path.exists():
        OUT.print(f"Report: {path}", soft_wrap=True)


def _verdicts(found: Run) -> Table:
    table = Table(box=None, pad_edge=False)
    for column in ("device", "test", "", "verdict", ""):
        table.add_column(column)
    for device, test in found.tests:
        told = test.reason or "; ".join(measured.told for measured in test.measurements)
        table.add_row(
            device.name, test.id, test.name, Text(test.verdict, STYLES[test.verdict]), told
        )
    return table


@contextmanager
def _shown() -> Iterator[Any]:
    """Show each test as it ends, and on a terminal the one that runs."""
    began = time.monotonic()
    running: dict[str, None] = {}
    live = Live(console=ERR, transient=True, refresh_per_second=8) if ERR.is_terminal else None

    def progress(device: str, test: str, verdict: Verdict | None, told: str) -> None:
        name = f"{device} {test}".strip()
        if verdict is None:
            running[f"{name} {told}"] = None
        else:
            for key in [key for key in running if key.startswith(name)]:
                del running[key]
            if verdict is not Verdict.SKIPPED:
                line = Text.assemble(
                    (f"{time.monotonic() - began:6.1f} s  ", "dim"),
                    (f"{device:12s} ", "bold cyan"),
                    f"{test:4s} ",
                    (f"{verdict:13s}", STYLES[verdict]),
                    told,
                )
                if ERR.is_terminal:
                    ERR.print(line, overflow="ellipsis", no_wrap=True)
                else:
                    ERR.print(line, soft_wrap=True)
        if live is not None:
            doing = ", ".join(running)
            live.update(Spinner("dots", Text(doing, overflow="ellipsis")) if doing else Text(""))

    if live is None:
        yield progress
        return
    with live:
        yield progress

"""``crtk-driver conform``: whether a device of any maker does on ROS 2 what CRTK says."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer
from rich.table import Table
from rich.text import Text

from crtk_drivers.cli.help_pages import HelpfulCommand
from crtk_drivers.cli.reaching import (
    FIND_TIMEOUT,
    Interrupted,
    Timeout,
    interruptible,
    prepare,
)
from crtk_drivers.cli.terminal import ERR, OUT, ask, plain, print_error
from crtk_drivers.config import from_file, load
from crtk_drivers.errors import ConfigError, ConnectionFailed
from crtk_drivers.ros.names import checked_namespace
from crtk_drivers.status.stop_request import INTERRUPTED

if TYPE_CHECKING:
    from crtk_drivers.client.conformance.expectations import Expectations
    from crtk_drivers.client.conformance.findings import Judged
    from crtk_drivers.client.conformance.outcome import Outcome

LISTEN_TIME: Final = 5.0
NOTHING_JUDGED: Final = 3
_STYLES: Final = {
    "CONFORMS": "green",
    "DIVERGES": "bold red",
    "UNDETERMINED": "yellow",
    "NOT OFFERED": "dim",
}


app = typer.Typer()


@app.command("conform", cls=HelpfulCommand)
def _conform(
    namespace: Annotated[
        str, typer.Argument(metavar="NAMESPACE", help="Of the device: /ur5.", show_default=False)
    ] = "",
    may_move: Annotated[
        bool,
        typer.Option(
            "--may-move",
            help="Also command it: enable, disable, bad input, and small motions. It needs room.",
        ),
    ] = False,
    may_home: Annotated[
        bool,
        typer.Option(
            "--may-home", help="With --may-move: also home it, which moves it as it likes."
        ),
    ] = False,
    by_hand: Annotated[
        bool,
        typer.Option(
            "--by-hand",
            help="With --may-move: somebody stands beside it, and pushes it when asked to.",
        ),
    ] = False,
    expect: Annotated[
        Path | None,
        typer.Option("--expect", metavar="FILE", help="Tolerances, steps, ranges: TOML or YAML."),
    ] = None,
    only: Annotated[
        str,
        typer.Option("--only", metavar="ID,...", help="These clauses: QOS-1, or QOS for its kind."),
    ] = "",
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Write the report there: HTML, JSON, JUnit."),
    ] = None,
    listen: Annotated[
        float, typer.Option("--listen", metavar="SECONDS", min=0.5, help="How long to listen.")
    ] = LISTEN_TIME,
    timeout: Timeout = FIND_TIMEOUT,
    is_list: Annotated[
        bool, typer.Option("--list", help="Print the clauses, and which are tested; no device.")
    ] = False,
) -> None:
    """Judge a device, of any maker, by the clauses of CRTK. Without --may-move it only listens and asks.

    Ends with 0 if no MUST diverges, 1 if one does, 3 if nothing could be judged. Ctrl-C holds the device,
    and brings it back to the state in which it was found.

    Examples:

        crtk-driver conform /ur5
        crtk-driver conform /PSM1 --only NAM,TYP,QOS
        crtk-driver conform /ur5 --may-move --out report
        crtk-driver conform /ur5 --may-move --by-hand --only MOV-3,MOV-23
    """
    from crtk_drivers.client.conformance.clauses import chosen
    from crtk_drivers.client.conformance.expectations import Expectations

    ids = chosen(only.split(","))
    if is_list:
        _print_list(ids)
        raise typer.Exit(0)
    if not namespace:
        raise ConfigError(
            "which device?", where="NAMESPACE", remedy="Give its namespace: /ur5; see `state`."
        )
    checked_namespace(namespace, "")
    expected = load(Expectations, *([from_file(expect)] if expect is not None else []))
    prepare()
    outcome = _examined(namespace, ids, expected, may_move, may_home, by_hand, listen, timeout)
    OUT.print(_table(outcome.results))
    raise typer.Exit(_told(outcome, out))


def _examined(
    namespace: str,
    ids: tuple[str, ...],
    expected: Expectations,
    may_move: bool,
    may_home: bool,
    by_hand: bool,
    listen: float,
    timeout: float,
) -> Outcome:
    from crtk_drivers.client.conformance.probe.examining import examine
    from crtk_drivers.client.conformance.trial import Leave

    with ERR.status(f"{plain(namespace)} ...") as status, interruptible():
        try:
            return examine(
                namespace,
                ids,
                listen,
                timeout,
                may_move,
                expected,
                lambda text: status.update(f"{plain(text)} ..."),
                Leave(may_home, ask if by_hand else None),
            )
        except ConnectionFailed as error:
            print_error(error)
            raise typer.Exit(NOTHING_JUDGED) from None
        except Interrupted:
            left = ": it was told to hold, and brought back" if may_move else ""
            ERR.print(f"[yellow]interrupted:[/] {plain(namespace)}{left}")
            raise typer.Exit(INTERRUPTED) from None


def _told(outcome: Outcome, out: Path | None) -> int:
    """Say what was found in a few lines, write the report, and return the exit code."""
    from crtk_drivers.client.conformance.findings import exit_code
    from crtk_drivers.client.conformance.outcome import statement

    count = Counter(each.finding.verdict.value for each in outcome.results)
    OUT.print()
    OUT.print(Text(", ".join(f"{count[each]} {each}" for each in _STYLES if count[each])))
    if outcome.ended:
        OUT.print(Text(f"the trials ended early: {outcome.ended}", "yellow"))
    OUT.print(Text(statement(outcome), "bold"))
    if out is not None:
        from crtk_drivers.client.conformance.report_files import write_report

        for path in write_report(outcome, out):
            OUT.print(Text(f"wrote {path}", "dim"))
    return exit_code(outcome.results)


def _print_list(ids: Iterable[str]) -> None:
    from crtk_drivers.client.conformance.clauses import CLAUSES

    table = Table(box=None, pad_edge=False, header_style="dim")
    for column in ("clause", "level", "source", "needs", ""):
        table.add_column(column, overflow="fold", no_wrap=column in ("clause", "level"))
    for each in ids:
        clause = CLAUSES[each]
        needs = clause.needs.name.lower()
        table.add_row(each, clause.level, clause.source, needs, Text(clause.text))
    OUT.print(table)


def _table(results: Iterable[Judged]) -> Table:
    from crtk_drivers.client.conformance.rounds import BY_HAND, NOT_PERMITTED

    table = Table(box=None, pad_edge=False, header_style="dim")
    for column in ("clause", "level", "verdict", "what is asked, and what was seen"):
        table.add_column(column, overflow="fold", no_wrap=column in ("clause", "level", "verdict"))
    alike: dict[str, list[str]] = {NOT_PERMITTED: [], BY_HAND: []}
    for each in results:
        clause, finding = each.clause, each.finding
        if finding.text in alike:
            alike[finding.text].append(clause.id)
            continue
        style = _STYLES[finding.verdict]
        seen = Text(f"{clause.text}\n", "" if each.is_violated else "dim")
        seen.append(finding.text, style if finding.verdict == "DIVERGES" else "")
        for line in finding.evidence:
            seen.append(f"\n  {line}", style)
        table.add_row(clause.id, clause.level, Text(finding.verdict, style), seen)
    for why, ids in alike.items():
        if ids:
            table.add_row("", "", Text("UNDETERMINED", "yellow"), Text(f"{why}: {', '.join(ids)}"))
    return table

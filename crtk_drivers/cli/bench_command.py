"""``crtk-driver bench``: the devices of a lab under test, with verdicts."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from typing_extensions import override

from crtk_drivers.cli import bench_runs
from crtk_drivers.cli.help_pages import HelpfulCommand, HelpfulGroup
from crtk_drivers.cli.up_command import LabFile, MachineOption, SimOption
from crtk_drivers.labs.bench.acquisition import Suite


class BenchGroup(HelpfulGroup):
    """``bench LAB`` is ``bench run LAB``."""

    @override
    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if args and args[0] not in self.commands and args[0] not in ("--help", "-h"):
            args = ["run", *args]
        return super().parse_args(ctx, args)


app = typer.Typer()
bench_app = typer.Typer(cls=BenchGroup, no_args_is_help=True, rich_markup_mode="rich")


@bench_app.callback()
def _bench() -> None:
    """Test the devices of a lab, and keep verdicts, figures and recordings.

    `crtk-driver bench LAB` runs it. A real device is only read, unless --may-move is given, and the lab file
    says by `space` where it may go.
    """


@bench_app.command("run", cls=HelpfulCommand)
def _bench_run(
    lab: LabFile,
    devices: Annotated[
        list[str] | None,
        typer.Option("--device", metavar="NAME", help="Only this one; may be repeated."),
    ] = None,
    sim: SimOption = False,
    suite: Annotated[
        Suite,
        typer.Option(
            "--suite",
            metavar="|".join(Suite),
            help="rest only reads; each of the next has all before it, for longer.",
        ),
    ] = Suite.QUICK,
    only: Annotated[
        str, typer.Option("--only", metavar="ID,ID", help="These tests, whatever their suite.")
    ] = "",
    may_move: Annotated[
        bool,
        typer.Option(
            "--may-move", help="Real devices may be enabled and moved. Stand beside them."
        ),
    ] = False,
    may_travel: Annotated[
        list[str] | None,
        typer.Option(
            "--may-travel",
            metavar="NAME",
            help="With --may-move: this real device may go to the ends of its space. May be repeated.",
        ),
    ] = None,
    at_once: Annotated[
        int,
        typer.Option(
            "--at-once",
            metavar="N",
            min=1,
            help="Test so many simulated devices at the same time: sooner, where the machine has time.",
        ),
    ] = 1,
    against: Annotated[
        str,
        typer.Option(
            "--against",
            metavar="all|previous|baseline|RUN",
            help="What the figures are compared with: earlier runs of the lab, simulated with simulated.",
        ),
    ] = "all",
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", metavar="DIR", help="For the results. [dim]\\[default: runs/TIME-NAME][/dim]"
        ),
    ] = None,
    inconclusive: Annotated[
        bool, typer.Option("--inconclusive-ok", help="Exit with 0 though something is not decided.")
    ] = False,
    regression: Annotated[
        bool, typer.Option("--regression-fails", help="Exit with 1 if a figure became worse.")
    ] = False,
    machine: MachineOption = "",
) -> None:
    """Test the devices of a lab; of one on several machines, those of this one.

    Exit codes: 0 passed, 1 failed, 3 not decided or all skipped, 4 it did not come to its end or cannot be
    kept, 2 it cannot be started as asked. A simulated device may always be moved.
    """
    raise typer.Exit(
        bench_runs.run(
            lab,
            devices=devices or (),
            sim=sim,
            suite=suite,
            only=[name for name in only.split(",") if name],
            may_move=may_move,
            may_travel=may_travel or (),
            at_once=at_once,
            against=against,
            out=out,
            inconclusive_ok=inconclusive,
            regression_fails=regression,
            machine=machine,
        )
    )


@bench_app.command("list", cls=HelpfulCommand)
def _bench_list(
    figures: Annotated[
        bool, typer.Option("--figures", help="The figures, with their ids for `bounds`.")
    ] = False,
) -> None:
    """List the tests: what each does, measures and may do."""
    raise typer.Exit(bench_runs.list_figures() if figures else bench_runs.list_tests())


@bench_app.command("baseline", cls=HelpfulCommand)
def _bench_baseline(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of the run.")],
) -> None:
    """Make a run the baseline: what --against baseline compares its devices with."""
    raise typer.Exit(bench_runs.baseline(run))


@bench_app.command("show", cls=HelpfulCommand)
def _bench_show(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN...", help="Folders of runs.")],
) -> None:
    """Show what a run found; of several, how the figures went."""
    raise typer.Exit(bench_runs.show(runs))


@bench_app.command("again", cls=HelpfulCommand)
def _bench_again(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of the run.")],
    lab: Annotated[
        Path | None,
        typer.Option("--lab", help="Take bounds from this lab file instead of the run's."),
    ] = None,
) -> None:
    """Judge the recordings of a run anew, with other bounds or a newer version. Nothing is overwritten."""
    raise typer.Exit(bench_runs.again(run, lab))


@bench_app.command("schema", cls=HelpfulCommand)
def _bench_schema() -> None:
    """Print the JSON schema of run.json."""
    raise typer.Exit(bench_runs.print_schema())


app.add_typer(bench_app, name="bench")

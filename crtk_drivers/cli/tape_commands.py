"""``crtk-driver plot`` and ``crtk-driver convert``: recordings as pictures, pages and tables."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

import typer

from crtk_drivers.cli.help_pages import HelpfulCommand
from crtk_drivers.cli.terminal import ERR, OUT, plain
from crtk_drivers.errors import ConfigError, MissingExtra, RecordingError
from crtk_drivers.recording import Recording, opened
from crtk_drivers.recording.foreign import Foreign

app = typer.Typer()

File = Annotated[
    Path, typer.Argument(metavar="FILE", help="An MCAP file: run.mcap.", show_default=False)
]


@app.command("plot", cls=HelpfulCommand)
def _plot(
    file: File,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE",
            help="The page; the picture goes beside it. Beside the recording if left out.",
        ),
    ] = None,
    begin: Annotated[
        float, typer.Option("--from", metavar="SECONDS", min=0.0, help="Since it began.")
    ] = 0.0,
    end: Annotated[
        float, typer.Option("--to", metavar="SECONDS", min=0.0, help="Since it began.")
    ] = math.inf,
) -> None:
    """Draw a recording: a page (HTML, one file, no script) and a picture (PNG, by the extra `plot`).

    Joints, velocities, efforts, forces, setpoints beside what was measured, errors, the way of the tool;
    states, commands and refusals as bands. What was cut off is mended first.

    Examples:

        crtk-driver plot run.mcap
        crtk-driver plot run.mcap --from 12 --to 14.5 -o fault.html
    """
    from crtk_drivers.labs.tapes.contents import contents_of
    from crtk_drivers.labs.tapes.pages import all_figures, html, png

    if not begin < end:
        raise ConfigError("must be before --to", where=f"--from {begin:g}")
    recording, told = opened_and_told(file)
    page = output or file.with_suffix(".html")
    with ERR.status(f"reading {plain(str(file))} ..."):
        contents = contents_of(recording, begin, end)
        figures = all_figures(contents, begin)
    _tell_note(file, contents.note)
    _write(page, html(recording, contents, figures, told).encode())
    written = [str(page)]
    if figures:
        try:
            picture = png(figures)
        except MissingExtra as error:
            ERR.print(f"[yellow]no picture:[/] {plain(str(error))}", soft_wrap=True)
        else:
            _write(page.with_suffix(".png"), picture)
            written.append(str(page.with_suffix(".png")))
    OUT.print(*map(plain, written), soft_wrap=True)


@app.command("convert", cls=HelpfulCommand)
def _convert(
    file: File,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", metavar="DIR", help="Folder of the tables; beside the recording."
        ),
    ] = None,
    to: Annotated[
        Literal["csv", "parquet"],
        typer.Option("--to", metavar="csv|parquet", help="Parquet takes the extra `parquet`."),
    ] = "csv",
    topic: Annotated[
        list[str] | None,
        typer.Option("--topic", "-t", metavar="TOPIC", help="Only this one. May be given again."),
    ] = None,
) -> None:
    """Write a recording as tables, a file a topic: times and stamps in ns, and what the message says.

    A type that is not known is written as its bytes. What was cut off is mended first.

    Examples:

        crtk-driver convert run.mcap
        crtk-driver convert run.mcap --to parquet -t /ur5/measured_js
    """
    from crtk_drivers.labs.tapes.tables import convert

    recording, _ = opened_and_told(file)
    folder = output or file.with_suffix("")
    with ERR.status(f"reading {plain(str(file))} ..."):
        written, note = convert(recording, folder, to, topic or ())
    _tell_note(file, note)
    for name, path, rows in written:
        OUT.print(f"{plain(str(path))}  {rows} of {plain(name)}", soft_wrap=True)


def opened_and_told(file: Path) -> tuple[Recording | Foreign, str]:
    """Return a recording and what is to be known of it, which is also printed.

    Raises:
        RecordingError: it cannot be read, or holds nothing.
    """
    recording, told = opened(file)
    if told:
        ERR.print(f"[yellow]{plain(str(file))}:[/] {plain(told)}", soft_wrap=True)
    if not sum(recording.counts.values()):
        raise RecordingError("holds no message", where=str(file))
    return recording, told


def _tell_note(file: Path, note: str) -> None:
    if note:
        ERR.print(f"[yellow]{plain(str(file))}:[/] {plain(note)}", soft_wrap=True)


def _write(path: Path, data: bytes) -> None:
    try:
        path.write_bytes(data)
    except OSError as error:
        raise RecordingError(
            f"cannot be written: {error.strerror or error}",
            where=str(path),
            remedy="See whether the disk is full, and whether the folder can be written.",
        ) from error

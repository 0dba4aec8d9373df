"""``crtk-driver record``: topics of devices that run, of any maker, into MCAP files."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from crtk_drivers.cli.help_pages import HelpfulCommand
from crtk_drivers.cli.reaching import FIND_TIMEOUT, Timeout, prepare
from crtk_drivers.cli.terminal import ERR, plain
from crtk_drivers.errors import ConfigError, ConnectionFailed
from crtk_drivers.recording import Recorder, Split, Totals
from crtk_drivers.recording.cdr_transforms import TOPICS
from crtk_drivers.ros.names import checked_namespace
from crtk_drivers.samples import ClockOffset
from crtk_drivers.status.stop_request import stop_signals

if TYPE_CHECKING:
    from crtk_drivers.client.recorded_clocks import RecordedClocks
    from crtk_drivers.client.topic_recorder import TopicRecorder

LOOK_PERIOD: Final = 0.2
"""Seconds between two looks at the graph, and two lines."""
MEGABYTE: Final = 1_000_000

app = typer.Typer()


@app.command("record", cls=HelpfulCommand)
def _record(
    namespace: Annotated[
        list[str],
        typer.Argument(metavar="NAMESPACE...", help="Of devices: /ur5 /ft.", show_default=False),
    ],
    output: Annotated[
        Path,
        typer.Option("--output", "-o", metavar="FILE", help="The file, which is made."),
    ],
    topic: Annotated[
        list[str] | None,
        typer.Option(
            "--topic",
            "-t",
            metavar="TOPIC",
            help="Only this one, in each namespace, or by its full name. May be given again.",
        ),
    ] = None,
    tf: Annotated[
        bool,
        typer.Option("--tf", help="Also /tf and /tf_static: where all frames of the graph are."),
    ] = False,
    split_size: Annotated[
        float,
        typer.Option(
            "--split-size", metavar="MB", min=0.0, help="MB after which a new file begins."
        ),
    ] = 0.0,
    split_time: Annotated[
        float,
        typer.Option(
            "--split-time",
            metavar="SECONDS",
            min=0.0,
            help="Seconds after which a new file begins.",
        ),
    ] = 0.0,
    keep_free: Annotated[
        float,
        typer.Option(
            "--keep-free",
            metavar="MB",
            min=0.0,
            help="MB of the disk that are left free; what does not fit is lost, and counted.",
        ),
    ] = 200.0,
    duration: Annotated[
        float,
        typer.Option("--for", metavar="SECONDS", min=0.0, help="End after so long; else Ctrl-C."),
    ] = 0.0,
    timeout: Timeout = FIND_TIMEOUT,
) -> None:
    """Record what devices of any maker tell and are told on ROS 2, until Ctrl-C.

    A driver of ours records itself at full rate: crtk-driver ur --record run.mcap.

    Examples:

        crtk-driver record /ur5 -o run.mcap
        crtk-driver record /ur5 /ft -t measured_js -o run.mcap
        crtk-driver record /ur5 --tf -o run.mcap
        crtk-driver record /ur5 -o run.mcap --split-size 500 --for 3600
    """
    for each in namespace:
        checked_namespace(each, "")
    if output.exists():
        raise ConfigError(
            "is there already", where=f"--output {output}", remedy="Choose another name."
        )
    prepare()
    split = Split(int(split_size * MEGABYTE), split_time)
    raise typer.Exit(
        _recorded(
            namespace,
            topic or [],
            TOPICS if tf else (),
            output,
            split,
            int(keep_free * MEGABYTE),
            duration,
            timeout,
        )
    )


def _recorded(
    namespaces: list[str],
    topics: list[str],
    beside: Sequence[str],
    output: Path,
    split: Split,
    keep_free: int,
    duration: float,
    timeout: float,
) -> int:
    from crtk_drivers.client.recorded_clocks import RecordedClocks
    from crtk_drivers.client.ros_link import Link
    from crtk_drivers.client.topic_recorder import TopicRecorder

    metadata = {"crtk_drivers record": {"namespaces": " ".join(namespaces)}}
    with stop_signals() as stop:
        link = Link("crtk_record")
        link.start()
        try:
            recorder = Recorder(output, metadata=metadata, split=split, keep_free=keep_free)
            taker = TopicRecorder(link, recorder, namespaces, topics, beside)
            recorder.start()
            clocks = RecordedClocks(link, recorder, taker)
            began = time.monotonic()
            try:
                with ERR.status("looking ...") as shown:
                    before, since = 0, began
                    while not stop.is_set() and not 0.0 < duration <= time.monotonic() - began:
                        taker.look()
                        _warn(clocks)
                        now = time.monotonic()
                        if not taker.has_devices and now - began > timeout:
                            break
                        totals = recorder.totals
                        rate = (totals.taken - before) / max(1e-3, now - since)
                        before, since = totals.taken, now
                        shown.update(plain(_line(totals, rate, now - began, len(taker.topics))))
                        time.sleep(LOOK_PERIOD)
            finally:
                taker.close()
                clocks.close()
                _warn(clocks)
                totals = recorder.close()
        finally:
            link.close()
    if not taker.has_devices:
        output.unlink()
        raise ConnectionFailed(
            f"nothing is published in {', '.join(namespaces)} within {timeout:g} s"
            f"{''.join(f'; {topic} {why}' for topic, why in taker.unknown.items())}",
            remedy="Is the driver running, and is ROS_DOMAIN_ID the same? See: crtk-driver state",
        )
    _tell(totals, taker, recorder.series.paths, time.monotonic() - began)
    return 0


def _line(totals: Totals, rate: float, seconds: float, topics: int) -> str:
    megabytes = totals.size / MEGABYTE
    return (
        f"{seconds:.0f} s  {topics} topics  {rate:.0f} messages/s  {megabytes:.1f} MB  "
        f"{totals.lost} dropped{f'  {totals.error}' if totals.error else ''}"
    )


def _warn(clocks: RecordedClocks) -> None:
    for namespace, offset in clocks.newly_apart():
        ERR.print(f"[yellow]clock:[/] {plain(_apart(namespace, offset))}", soft_wrap=True)


def _apart(namespace: str, offset: ClockOffset) -> str:
    side = "ahead of" if offset.value > 0.0 else "behind"
    return (
        f"that of {namespace} is {abs(offset.value):.3f} s {side} this computer's "
        f"(±{1e3 * offset.uncertainty:.1f} ms); `plot` will draw this recording by arrival, not by stamps. "
        "Synchronise the machines by chrony or PTP"
    )


def _tell(totals: Totals, taker: TopicRecorder, paths: list[Path], seconds: float) -> None:
    for topic, why in taker.unknown.items():
        ERR.print(f"[yellow]not recorded:[/] {plain(topic)} {plain(why)}")
    names = ", ".join(str(path) for path in paths)
    ERR.print(
        f"{totals.written} messages in {seconds:.1f} s, {totals.size / MEGABYTE:.1f} MB: {plain(names)}; "
        f"{totals.lost} dropped, {taker.missed} did not come",
        soft_wrap=True,
    )

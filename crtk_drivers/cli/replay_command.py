"""``crtk-driver replay``: a recording again, as topics, or as commands to an arm."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Final

import numpy as np
import typer
from rich.table import Table

from crtk_drivers.cli.help_pages import HelpfulCommand
from crtk_drivers.cli.reaching import (
    FIND_TIMEOUT,
    Timeout,
    held_when_interrupted,
    is_seen_to_stand,
    need,
    prepare,
    reached,
)
from crtk_drivers.cli.tape_commands import File, opened_and_told
from crtk_drivers.cli.terminal import ERR, OUT, plain
from crtk_drivers.errors import (
    CommandRefused,
    ConfigError,
    MotionAborted,
    Reason,
    RecordingError,
)
from crtk_drivers.labs.tapes.rows import row_of
from crtk_drivers.recording import Recording
from crtk_drivers.recording.cdr_transforms import TOPICS as FRAMES
from crtk_drivers.recording.foreign import Foreign
from crtk_drivers.recording.order import in_order
from crtk_drivers.ros.names import checked_namespace
from crtk_drivers.state import OperatingState
from crtk_drivers.status.stop_request import stop_signals

if TYPE_CHECKING:
    from rich.status import Status

    from crtk_drivers.client import RemoteDevice
    from crtk_drivers.client.ros_link import Link
    from crtk_drivers.labs.tapes.joint_path import JointPath

STREAM_RATE: Final = 125.0
"""Commands a second."""
LONGEST_STEP: Final = 2.0 / STREAM_RATE
"""Seconds by which the way goes on at most from one command to the next, however late that is."""
LONGEST_PAUSE: Final = 0.5
"""Seconds between two commands after which it ends: nobody expects that the arm goes on."""
LOOK_TIME: Final = 3.5
"""Seconds in which a device that is there already is found, also if the first exchange is lost."""
LOOK_PERIOD: Final = 0.02
HOLD_TIMEOUT: Final = 5.0

app = typer.Typer()


@app.command("replay", cls=HelpfulCommand)
def _replay(
    file: File,
    namespace: Annotated[
        str,
        typer.Option("--ns", metavar="NAMESPACE", help="Where its topics are; or the arm."),
    ],
    rate: Annotated[
        float,
        typer.Option("--rate", metavar="FACTOR", min=0.01, max=100.0, help="Times as fast."),
    ] = 1.0,
    commands: Annotated[
        bool,
        typer.Option("--commands", help="Let the arm at --ns do it again. It moves."),
    ] = False,
    source: Annotated[
        str,
        typer.Option("--from", metavar="NAMESPACE", help="Of the device in it, if it has several."),
    ] = "",
    yes: Annotated[
        bool, typer.Option("--yes", help="With --commands: go to the start without asking.")
    ] = False,
    timeout: Timeout = FIND_TIMEOUT,
) -> None:
    """Publish what a device told once more, or let an arm go the way of its joints again.

    Topics have the stamps of then, and commands are not among them, nor /tf, which is of all. With
    --commands the way is checked against the limits of the arm, the way to its start is shown and asked for,
    and the arm goes there by move_jp; the driver's own limits hold as ever. Ctrl-C holds the arm.

    Examples:

        crtk-driver replay run.mcap --ns /then
        crtk-driver replay run.mcap --ns /ur5 --commands --rate 0.5
    """
    checked_namespace(namespace)
    recording, _ = opened_and_told(file)
    if commands:
        raise typer.Exit(_command(recording, namespace, source, rate, yes, timeout))
    raise typer.Exit(_publish(recording, namespace, source, rate))


def _publish(recording: Recording | Foreign, namespace: str, source: str, rate: float) -> int:
    from crtk_drivers.client.republishing import Republisher, is_command
    from crtk_drivers.client.ros_link import Link

    inputs = _inputs(recording)
    topics = {
        topic: type_name
        for topic, type_name in recording.topics.items()
        if topic.startswith(f"{source.rstrip('/')}/")
        if not is_command(topic) and topic not in inputs and topic not in FRAMES
    }
    if not topics:
        raise RecordingError(
            f"has nothing of {source or 'any device'} that is told",
            where=str(recording.path),
            remedy=f"It has: {', '.join(recording.topics)}.",
        )
    prepare()
    link = Link("crtk_replay")
    link.start()
    try:
        taken = _taken(link, namespace)
        if taken:
            raise ConfigError(
                f"a device is there: {taken[0]} is published",
                where=f"--ns {namespace}",
                remedy="Choose another namespace; or add --commands to move it.",
            )
        player = Republisher(link, topics, recording.latched, namespace)
        for topic, why in player.unknown.items():
            ERR.print(f"[yellow]not published:[/] {plain(topic)}: {plain(why)}", soft_wrap=True)
        with stop_signals() as stop, ERR.status("playing ...") as shown:

            def told(count: int, seconds: float) -> bool:
                shown.update(f"{seconds:.1f} s  {count} messages")
                return not stop.is_set()

            count = player.play(in_order(recording.messages(*topics)), rate, told)
        player.close()
    finally:
        link.close()
    ERR.print(f"{count} messages of {len(player.names)} topics in {plain(namespace)}")
    return 0


def _taken(link: Link, namespace: str) -> list[str]:
    """Return what is published in a namespace, as soon as anything is found there."""
    deadline = time.monotonic() + LOOK_TIME
    while True:
        topics = sorted(
            topic for topic in link.topics() if topic.startswith(f"{namespace.rstrip('/')}/")
        )
        taken = [topic for topic in topics if link.publishers(topic)]
        if taken or time.monotonic() > deadline:
            return taken
        time.sleep(LOOK_PERIOD)


def _inputs(recording: Recording | Foreign) -> set[str]:
    """Return the topics by which the devices took values beyond CRTK, as their manifests told."""
    found: set[str] = set()
    for topic in recording.topics:
        if not topic.endswith("/crtk_capabilities"):
            continue
        for message in recording.messages(topic):
            try:
                content = json.loads(str(row_of(message)[2].get("data")))
                found |= {str(taken["name"]) for taken in content.get("inputs", {}).values()}
            except (ValueError, TypeError, KeyError, AttributeError):
                continue
    return found


def _command(
    recording: Recording | Foreign,
    namespace: str,
    source: str,
    rate: float,
    yes: bool,
    timeout: float,
) -> int:
    from crtk_drivers.labs.tapes.joint_path import joint_path, refused

    path = joint_path(recording, source)
    with reached(namespace, timeout) as device:
        for name in ("move_jp", "servo_jp", "hold"):
            need(device, name)
        joints = device.manifest.get("joints")
        if not joints:
            raise ConfigError(
                "does not tell the limits of its joints, by which the way is checked",
                where=device.namespace,
                remedy="Only drivers that publish crtk_capabilities can be given a recording.",
            )
        why = refused(path, joints, rate)
        if why:
            raise RecordingError(
                f"cannot be done by {device.namespace}: {why}", where=str(recording.path)
            )
        _require_enabled(device)
        _show_way(device, path, rate)
        if not yes and not typer.confirm("Go to the start, and then this way?", err=True):
            return 1
        # Of a terminal that is gone the end of what is shown fails: the hold comes before that.
        with ERR.status("going to the start ...") as shown, held_when_interrupted(device) as heed:
            _go(device, path, rate, shown, heed)
        error = float(np.max(np.abs(device.measured_jp(age=0) - path.positions[-1])))
        OUT.print(f"[green]done[/]: it ends {error:.4f} rad or m from where the recording does")
    return 0


def _require_enabled(device: RemoteDevice) -> None:
    status = device.operating_state()
    if status.state is not OperatingState.ENABLED:
        raise CommandRefused(
            "replay",
            Reason.NOT_ENABLED,
            f"the device is {status.state}",
            where=device.namespace,
            remedy=f"crtk-driver enable {device.namespace}",
        )


def _show_way(device: RemoteDevice, path: JointPath, rate: float) -> None:
    here, start = device.measured_jp(), path.positions[0]
    span = np.ptp(path.positions, axis=0)
    table = Table(box=None)
    for heading in ("joint", "now", "start", "way to the start", "range of the motion"):
        table.add_column(heading, justify="left" if heading == "joint" else "right")
    for index, joint in enumerate(device.manifest["joints"]):
        numbers = here[index], start[index], start[index] - here[index], span[index]
        table.add_row(plain(str(joint["name"])), *(f"{value:.4f}" for value in numbers))
    OUT.print(table)
    OUT.print(f"rad or m; the motion takes {path.seconds / rate:.1f} s, from {plain(path.topic)}")


def _go(
    device: RemoteDevice, path: JointPath, rate: float, shown: Status, heed: Callable[[], None]
) -> None:
    device.move_jp(path.positions[0]).wait()
    refusals: list[CommandRefused] = []
    forget = device.on_refusal(refusals.append)
    try:
        at, before, why = 0.0, time.monotonic(), ""
        while at < path.seconds + rate / STREAM_RATE:
            heed()
            if not why:
                device.servo_jp(path.at(at))
            state = device.operating_state().state
            if refusals or state is not OperatingState.ENABLED:
                why = str(refusals[0]) if refusals else f"the device is {state}"
            if why:
                device.hold()
                raise MotionAborted(
                    f"ended after {at / rate:.2f} s, and held: {why}", where=device.namespace
                )
            shown.update(f"{at / rate:.1f} of {path.seconds / rate:.1f} s")
            time.sleep(max(0.0, before + 1.0 / STREAM_RATE - time.monotonic()))
            now = time.monotonic()
            if now - before > LONGEST_PAUSE:
                why = f"this program stood still for {now - before:.1f} s"
            # The way does not go on meanwhile: the arm would go across.
            at, before = at + rate * min(now - before, LONGEST_STEP), now
        device.hold()
        stands = is_seen_to_stand(device, HOLD_TIMEOUT)
        state = device.operating_state().state
    finally:
        forget()
    # The last command may come after the hold, and is refused then.
    refusals = [each for each in refusals if each.reason is not Reason.STREAM_ENDED]
    if refusals or state is not OperatingState.ENABLED or not stands:
        why = str(refusals[0]) if refusals else f"the device is {state}"
        raise MotionAborted(
            f"held at the end: {why}" if stands else "was not seen to stand at the end",
            where=device.namespace,
            remedy="" if stands else "Look at it; crtk-driver hold stops it, too.",
        )

"""``crtk-driver teleop``: one device leads another one, by pedals, until Ctrl-C."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer
from rich.live import Live
from rich.text import Text

from crtk_drivers.cli.help_pages import HelpfulCommand
from crtk_drivers.cli.log_setup import LogFormat, set_up_logging
from crtk_drivers.cli.pedal_keys import keys_of
from crtk_drivers.cli.reaching import FIND_TIMEOUT, Interrupted, Timeout, interruptible, prepare
from crtk_drivers.cli.terminal import ERR, plain
from crtk_drivers.errors import ConnectionLost
from crtk_drivers.labs.lab_outline import LabTeleop, load_teleop
from crtk_drivers.motion.teleop.jaws import share_of
from crtk_drivers.motion.teleop.machine import Coupled, Phase
from crtk_drivers.ros import environment

if TYPE_CHECKING:
    from crtk_drivers.client.teleop import Pedal, Teleoperation

logger = logging.getLogger(__name__)

LIVE_PERIOD: Final = 0.1
STYLES: Final = {
    Phase.HELD: "bold red",
    Phase.RELEASED: "bold",
    Phase.ALIGNING: "bold yellow",
    Phase.FOLLOWING: "bold green",
}

app = typer.Typer()


@app.command("teleop", cls=HelpfulCommand)
def _teleop(
    lab: Annotated[
        Path,
        typer.Argument(metavar="LAB", help="A lab file with [teleop].", show_default=False),
    ],
    enable: Annotated[
        bool, typer.Option("--enable", help="Enable both first. Nothing is homed.")
    ] = False,
    timeout: Timeout = FIND_TIMEOUT,
) -> None:
    """Let one device lead another one, by pedals, as `teleop` in a lab file says, until Ctrl-C.

    It ends with 0 when the follower was seen to stand after the last hold, else with 1.

    Example:

        crtk-driver teleop lab.toml --enable
    """
    raise typer.Exit(teleoperate(load_teleop(lab), enable, timeout))


def teleoperate(given: LabTeleop, enable: bool, timeout: float) -> int:
    """Run it, and return the exit code.

    Raises:
        MissingExtra, ConfigError: ROS 2 cannot be used here, or a device lacks what it needs.
        ConnectionFailed: a device is not there.
        CommandRefused, TransitionFailed: it cannot be enabled.
        ConnectionLost: the follower was not seen to stand at the end.
    """
    environment.adopt(given.environment)
    prepare()
    from crtk_drivers.client.teleop import Teleoperation, reached_sides, topic_pedals

    settings = given.settings
    keys = {
        name: pedal.key
        for name, pedal in (("clutch", settings.clutch), ("engage", settings.engage))
        if pedal is not None and pedal.key
    }
    with ExitStack() as stack:
        pressed = stack.enter_context(keys_of(keys))
        with ERR.status(f"looking for {plain(given.leader)} and {plain(given.follower)} ..."):
            link, leader, follower = stack.enter_context(
                reached_sides(given.leader, given.follower, timeout)
            )
        if enable:
            for device in (leader, follower):
                if "operating_state" in device.crtk_commands and not device.is_enabled():
                    device.enable()
        set_up_logging(ERR, "info", LogFormat.TEXT)
        pedals: dict[str, Pedal] = {**topic_pedals(link, settings), **pressed}
        loop = Teleoperation(settings, leader, follower, pedals)
        stack.callback(loop.close)
        with interruptible() as asked:
            try:
                with suppress(Interrupted), _shown(loop) as show:
                    loop.run(asked, show)
                logger.info("it ends: both are held")
            finally:
                problem = loop.end()
    if problem:
        raise ConnectionLost(
            problem, where=given.follower, remedy="Look at it; crtk-driver hold stops it, too."
        )
    return 0


@contextmanager
def _shown(loop: Teleoperation) -> Iterator[Callable[[Coupled], None]]:
    """A live line on a terminal; in a log the loop tells each change of its phase."""
    if not ERR.is_terminal:
        yield lambda coupled: None
        return
    with Live(console=ERR, auto_refresh=False, transient=True) as live:
        began, due, steps = time.monotonic(), 0.0, 0
        rate = 0.0

        def show(coupled: Coupled) -> None:
            nonlocal began, due, steps, rate
            now = time.monotonic()
            if now < due:
                return
            if now - began >= 1.0:
                rate = (loop.steps - steps) / (now - began)
                began, steps = now, loop.steps
            due = now + LIVE_PERIOD
            live.update(line_of(coupled, loop, rate), refresh=True)

        yield show


def line_of(coupled: Coupled, loop: Teleoperation, rate: float) -> Text:
    """Return how it goes, in one line."""
    settings = loop.settings
    line = Text.assemble(
        (f"{settings.leader} → {settings.follower}", "bold cyan"),
        "  ",
        (coupled.phase, STYLES[coupled.phase]),
        ("  scale ", "dim"),
        f"{settings.scale:g}",
        ("  rate ", "dim"),
        f"{rate:.0f} Hz",
    )
    if coupled.phase is Phase.FOLLOWING:
        line.append("  lag ", "dim")
        line.append(f"{1e3 * coupled.lag[0]:.1f} mm {math.degrees(coupled.lag[1]):.1f}°")
        if settings.gripper is not None and coupled.jaw is not None and not coupled.jaw.is_led:
            share = share_of(settings.gripper, coupled.jaw.at)
            line.append(
                f"  open {settings.gripper.leader} to {share:.0%} to lead the jaw", "yellow"
            )
    elif coupled.reason:
        line.append(f"  {coupled.reason}", "yellow")
    line.no_wrap, line.overflow = True, "ellipsis"
    return line

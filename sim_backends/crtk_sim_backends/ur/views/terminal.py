"""A live picture of a simulated controller in the terminal.

``python -m crtk_sim_backends.ur.views.terminal 127.0.0.2:40001`` watches the one with that control port; the
option `view` of the simulator starts it. It fits 80 x 24 characters. Where the output is no terminal, it
writes a line a second.
"""

from __future__ import annotations

import argparse
import logging
import math
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Final, TextIO

from rich.console import Console, Group
from rich.live import Live
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from crtk_sim_backends.command_line import stopped_by_signals
from crtk_sim_backends.control import ControlError
from crtk_sim_backends.process import Readiness
from crtk_sim_backends.ur.views.scene import BAD, GOOD, JOINTS
from crtk_sim_backends.watching import NICENESS, Found, Life, address, pictures

PERIOD: Final = 0.1
LINE_PERIOD: Final = 1.0
"""Seconds from one picture, and from one line, to the next."""

_FIRST: Final = 0.5  # s for what else is told at the start, which stays above the picture
_BAR: Final = 25  # characters
_NEAR: Final = 0.95  # of a limit

Show = Callable[[Found, Found | None], None]


def bar(value: float, limit: float | None) -> str:
    """Return where a joint is between its limits, as text; from -360 to 360 degrees where it has none."""
    share = value / (limit or 2.0 * math.pi)
    place = round((max(-1.0, min(1.0, share)) + 1.0) / 2.0 * (_BAR - 1))
    cells = ["."] * _BAR
    cells[_BAR // 2] = "|"
    cells[place] = "O"
    return "[" + "".join(cells) + "]"


def _mode(name: str) -> str:
    style = "green" if name in GOOD else "bold red" if name in BAD else "yellow"
    return f"[{style}]{name}[/]"


def _share(value: float) -> str:
    filled = round(20 * max(0.0, min(1.0, value)))
    return "#" * filled + "." * (20 - filled)


def _plain(text: str) -> str:
    """Return a text of a program without what would command the terminal."""
    return "".join(each if each.isprintable() else " " for each in text)


class Screen:
    """The picture as text; remembers the last one for the share of time that the simulator is busy."""

    def __init__(self) -> None:
        self._last: tuple[float, float] | None = None
        self._busy = 0.0

    def render(self, arm: Found, found: Found | None, now: float) -> Group:
        """Return the lines; `now` is the monotonic time, s."""
        title = Text(f"{arm['title']}, software {arm['version']}, at {arm['host']}", style="bold")
        if found is None:
            return Group(title, Text("the simulator does not answer: it hangs", style="bold red"))
        self._note(found["busy"], now)
        return Group(
            title,
            *map(Text.from_markup, self._state(found)),
            "",
            self._joints(arm, found),
            "",
            *self._tool(found),
            "",
            *self._loop(found),
            *self._remarks(found),
        )

    def _note(self, busy: float, now: float) -> None:
        if self._last is not None and now > self._last[0]:
            self._busy = (busy - self._last[1]) / (now - self._last[0])
        self._last = now, busy

    def _state(self, found: Found) -> Iterator[str]:
        control = "remote" if found["remote"] else "local"
        yield (
            f"robot {_mode(found['robot_mode'])}   safety {_mode(found['safety_mode'])}   "
            f"{control} control"
        )
        program = escape(_plain(found["program"])[:40])
        yield f"program {_mode(found['runtime_state'])} {program}"
        slider = found["target_speed_fraction"]
        yield (
            f"speed slider {_share(slider)} {100 * slider:3.0f} %   "
            f"scaling {100 * found['speed_scaling']:3.0f} %"
        )

    def _joints(self, arm: Found, found: Found) -> Table:
        table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="dim")
        table.add_column("joint", no_wrap=True)
        for name in ("deg", "between its limits", "deg/s", "A"):
            table.add_column(name, justify="right", no_wrap=True)
        for index, name in enumerate(JOINTS):
            q, limit = found["actual_q"][index], arm["position"][index]
            near = limit is not None and abs(q) > _NEAR * limit
            table.add_row(
                name,
                f"{math.degrees(q):.2f}",
                Text(bar(q, limit), style="bold red" if near else ""),
                f"{math.degrees(found['actual_qd'][index]):.1f}",
                f"{found['actual_current'][index]:.2f}",
            )
        return table

    def _tool(self, found: Found) -> Iterator[str]:
        x, y, z, *turn = found["actual_TCP_pose"]
        yield f"TCP    x {x:8.4f}  y {y:8.4f}  z {z:8.4f} m"
        yield "       rotation vector " + "  ".join(f"{value:7.3f}" for value in turn) + " rad"
        force = "  ".join(f"{value:7.1f}" for value in found["actual_TCP_force"][:3])
        yield f"force  {force} N"

    def _loop(self, found: Found) -> Iterator[Text]:
        slow = found["reached"] < 0.95 * found["speed"]
        yield Text.assemble(
            f"time {found['time']:.2f} s, ",
            (f"{found['reached']:.2f} times real time", "bold red" if slow else ""),
            f", wanted {found['speed']:g}",
        )
        yield Text(
            f"periods {found['ticks']}, late {found['late']}, left out {found['skipped']}, "
            f"worst {1e3 * found['worst_delay']:.1f} ms, busy {100 * self._busy:.0f} %"
        )
        clients = ", ".join(f"{name} {count}" for name, count in found["clients"].items() if count)
        yield Text(f"clients: {clients or 'none'}", overflow="ellipsis", no_wrap=True)

    def _remarks(self, found: Found) -> Iterator[Text]:
        faults = ", ".join(found["faults"])
        yield Text(
            f"faults: {faults or 'none'}",
            style="bold red" if faults else "",
            overflow="ellipsis",
            no_wrap=True,
        )
        if found["popup"]:
            yield Text(
                f"pop-up: {_plain(found['popup'])}",
                style="yellow",
                overflow="ellipsis",
                no_wrap=True,
            )


def line(found: Found | None) -> str:
    """Return the picture in one line."""
    if found is None:
        return "the simulator does not answer: it hangs"
    q = " ".join(f"{math.degrees(value):.2f}" for value in found["actual_q"])
    pose = " ".join(f"{value:.4f}" for value in found["actual_TCP_pose"])
    modes = " ".join(found[name] for name in ("robot_mode", "safety_mode", "runtime_state"))
    return f"{found['time']:.2f} s {modes} q {q} deg, TCP {pose}, late {found['late']}"


@contextmanager
def _screen() -> Iterator[Show]:
    screen = Screen()
    console = Console(highlight=False)
    with Live(console=console, screen=True, auto_refresh=False) as live:

        def show(arm: Found, found: Found | None) -> None:
            live.update(screen.render(arm, found, time.monotonic()), refresh=True)

        yield show


@contextmanager
def _lines(output: TextIO) -> Iterator[Show]:
    def show(arm: Found, found: Found | None) -> None:
        output.write(line(found) + "\n")
        output.flush()

    yield show


def watch(control: tuple[str, int], life: Life, output: TextIO) -> None:
    """Show the simulator with that control socket until `life` is over or it has ended.

    Raises:
        ControlError: it cannot be reached.
    """
    screen = output.isatty()
    if screen and life.wait(_FIRST):
        return
    with _screen() if screen else _lines(output) as show:
        period = PERIOD if screen else LINE_PERIOD
        for arm, found in pictures(control, ("arm", "picture"), period, life.wait):
            show(arm, found)


def main(arguments: Sequence[str] | None = None) -> int:
    """Watch the simulator that the command line names; 1 when it cannot be reached or has ended."""
    parser = argparse.ArgumentParser(prog="python -m crtk_sim_backends.ur.views.terminal")
    parser.description = "A live picture of a simulated UR controller in the terminal."
    parser.add_argument("control", type=address, help="its control socket, HOST:PORT")
    for pipe in ("--ready-fd", "--parent-fd"):
        parser.add_argument(pipe, type=int, default=None, help=argparse.SUPPRESS)
    given: Any = parser.parse_args(arguments)
    logging.basicConfig(format="%(name)s: %(message)s")
    os.nice(NICENESS)
    Readiness(given.ready_fd, None).tell(host=given.control[0], ports={})
    life = Life(given.parent_fd)
    try:
        with stopped_by_signals(life.end):
            watch(given.control, life, sys.stdout)
    except ControlError as error:
        if given.parent_fd is None:
            sys.stderr.write(f"{error}\n")
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())

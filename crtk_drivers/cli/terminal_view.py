"""``crtk-driver view --terminal``: devices as a live table with bars and sparklines, for a shell over ssh."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Iterator, Mapping
from typing import Final

from rich.columns import Columns
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from crtk_drivers.cli.state_view import status_words
from crtk_drivers.cli.status_line import STATE_STYLES
from crtk_drivers.client.view.drawable import Trace, traces_of
from crtk_drivers.client.view.watched import WatchedDevice
from crtk_drivers.client.view.watcher import Watcher
from crtk_drivers.errors.wording import worded
from crtk_drivers.kinematics.drawn import DrawnChain
from crtk_drivers.ros.manifest import headline
from crtk_drivers.state import Status

__all__ = ["TerminalView", "bar", "sparkline"]

PERIOD: Final = 0.2
"""Seconds from one picture to the next."""
BAR: Final = 16
"""Columns of a bar."""
SPARKS: Final = 24
"""Values of a sparkline, one in a column."""
TOLD: Final = 4
"""Refusals that are shown."""

_EIGHTHS: Final = "▁▂▃▄▅▆▇█"
_SHOWN: Final = {"measured_js": ("position",), "measured_cf": ("force", "torque")}
_POSE: Final = {"measured_cp": ("position",)}  # where there is nothing of the former
_LEVELS: Final = ("green", "yellow", "red", "yellow")  # as diagnostic_msgs numbers them
_LEAST: Final = 1e-3  # range of a sparkline, in the value's unit


def bar(value: float, low: float, high: float, width: int = BAR) -> Text:
    """Return where a value stands between two ends; red within 3 % of one, or beyond it."""
    share = (value - low) / (high - low)
    at = min(width - 1, math.floor(min(1.0, max(0.0, share)) * width))
    style = "red" if not 0.03 < share < 0.97 else "cyan"
    return Text.assemble(("─" * at, "dim"), ("●", style), ("─" * (width - 1 - at), "dim"))


def sparkline(values: Iterator[float] | deque[float]) -> str:
    """Return values as a line of blocks from the least to the largest; one that is not finite is a gap."""
    numbers = list(values)
    finite = [value for value in numbers if math.isfinite(value)]
    if not finite:
        return " " * len(numbers)
    low, high = min(finite) / 2.0, max(finite) / 2.0  # of twice as much there may be no float
    middle, span = (low + high) / 2.0, max(high - low, _LEAST / 2.0)
    steps = len(_EIGHTHS)
    return "".join(
        _EIGHTHS[min(steps - 1, int(((value / 2.0 - middle) / span + 0.5) * steps))]
        if math.isfinite(value)
        else " "
        for value in numbers
    )


class TerminalView:
    """What is shown of the devices of a watcher."""

    def __init__(self, watcher: Watcher) -> None:
        self._watcher = watcher
        self._before: dict[tuple[str, str, str, str], deque[float]] = {}
        self._spans: dict[tuple[str, str, str], float] = {}

    def run(self, console: Console, once: bool = False) -> None:
        """Show them until Ctrl-C; `once`, or where there is no terminal: as they are now."""
        if once or not console.is_terminal:
            console.print(self.picture())
            return
        with Live(console=console, auto_refresh=False, screen=True) as live:
            while True:
                live.update(self.picture(), refresh=True)
                time.sleep(PERIOD)

    def picture(self) -> RenderableType:
        """Return what is known now."""
        self._watcher.looked()
        shown = [self._device(device) for device in self._watcher]
        told = sorted(
            (
                (each.at, device.namespace, each)
                for device in self._watcher
                for each in device.refusals
            ),
            key=lambda row: row[0],
        )
        lines: list[RenderableType] = [
            Columns([Group(*each, Text()) for each in shown], padding=(0, 4))
        ]
        if not shown:
            lines.append(Text("There is no CRTK device yet; looking.", "yellow"))
        for at, namespace, each in told[-TOLD:]:
            refusal = each.refusal
            lines.append(
                Text.assemble(
                    (time.strftime("%H:%M:%S ", time.localtime(at)), "dim"),
                    (namespace, "bold cyan"),
                    f" refused {refusal.command}: {worded(refusal.message)}",
                    (f"  {worded(refusal.remedy)}", "green"),
                )
            )
        lines.append(Text("Ctrl-C ends the view; nothing else ends with it.", "dim"))
        return Group(*lines)

    def _device(self, device: WatchedDevice) -> list[RenderableType]:
        status = device.status()
        heading = Text.assemble((device.namespace, "bold cyan"), "  ", _state(device, status))
        if about := headline(device.manifest):
            heading.append(f"  {about}", "dim")
        lines: list[RenderableType] = [heading]
        for thing, words, level, values in self._watcher.reports(device.namespace).values():
            rate = values.get("rate (Hz)")
            if rate is not None:
                heading.append(f"  {float(rate):.0f}/{values['expected rate (Hz)']} Hz", "dim")
            is_news = level and not (status is not None and words == status.state.value)
            if is_news:
                lines.append(Text(f"{thing}: {worded(words)}", _LEVELS[min(level, 3)]))
        table = self._table(device)
        if table.row_count:
            lines.append(table)
        return lines

    def _table(self, device: WatchedDevice) -> Table:
        table = Table(box=None, show_header=False, pad_edge=False, padding=(0, 2, 0, 0))
        for justify in ("left", "right", "left", "left", "left"):
            table.add_column(justify=justify, no_wrap=True)
        seen = device.look()
        wanted = _SHOWN if set(_SHOWN) & set(seen) else _POSE
        limits = {joint["name"]: joint for joint in device.manifest.get("joints", ())}
        for name, parts in wanted.items():
            if name not in seen:
                continue
            valid = seen[name].wall_ns != 0
            for trace in traces_of(seen[name].value):
                if trace.part in parts:
                    self._rows(table, device, name, trace, limits, valid)
        return table

    def _rows(
        self,
        table: Table,
        device: WatchedDevice,
        name: str,
        trace: Trace,
        limits: Mapping[str, Mapping[str, float | None]],
        valid: bool,
    ) -> None:
        for each, value in zip(trace.names, trace.values, strict=True):
            number, unit, digits = _as_read(device.chain, each, trace, value)
            ends = limits.get(each, {})
            low, high = ends.get("lower"), ends.get("upper")
            if low is None or high is None:
                span = self._span((device.namespace, name, trace.part), value, trace.unit)
                low, high = -span, span
            before = self._before.setdefault(
                (device.namespace, name, trace.part, each), deque(maxlen=SPARKS)
            )
            before.append(value if valid else math.nan)
            label = each if name == "measured_js" else f"{trace.part} {each}"
            table.add_row(
                Text(label, "" if valid else "dim"),
                Text(f"{number:.{digits}f}", "" if valid else "red"),
                Text(unit, "dim"),
                bar(value, low, high) if math.isfinite(value) else Text("not finite", "red"),
                Text(sparkline(before), "cyan"),
            )

    def _span(self, key: tuple[str, str, str], value: float, unit: str) -> float:
        """Return an end of the scale of values without limits, which holds all that was seen."""
        least = 2.0 * math.pi if unit.startswith("rad") else 1.0
        if math.isfinite(value):
            self._spans[key] = max(self._spans.get(key, least), 1.04 * abs(value))
        return self._spans.get(key, least)


def _state(device: WatchedDevice, status: Status | None) -> Text:
    silence = device.silence()
    if silence:
        return Text(silence, "red")
    if status is None:
        return Text("tells no operating state", "yellow")
    words = status_words(status)
    if status.cause:
        words.append(f"  {worded(status.cause)}", STATE_STYLES[status.state])
    return words


def _as_read(
    chain: DrawnChain | None, joint: str, trace: Trace, value: float
) -> tuple[float, str, int]:
    """Return a value with its unit as a person reads it: degrees and mm of joints of which that is known."""
    if trace.part == "position" and chain is not None and joint in chain.names:
        if chain.slides[chain.names.index(joint)]:
            return 1e3 * value, "mm", 1
        return math.degrees(value), "°", 1
    return value, trace.unit, 3

"""``crtk-driver view --terminal``: bars and sparklines, on a terminal, in a pipe, and how it ends."""

from __future__ import annotations

import math
import os
import pty
import re
import select
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Iterator

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from crtk_drivers.cli.terminal_view import BAR, bar, sparkline
from crtk_drivers.testing.loopback import LoopbackConfig
from rigs.loopback_node import serve
from rigs.programs import COMMAND, Start

NAMESPACE = "/view_terminal"
LONG = 50.0
VIEW = (COMMAND, "view", NAMESPACE, "--terminal")


@pytest.fixture(scope="module")
def gantry() -> Iterator[None]:
    with serve(LoopbackConfig(), NAMESPACE, []):
        yield


@pytest.mark.parametrize(
    ("value", "column", "style"),
    [(0.0, 8, "cyan"), (-1.0, 0, "red"), (1.0, 15, "red"), (5.0, 15, "red"), (0.5, 12, "cyan")],
)
def test_a_bar_shows_where_a_value_stands(value: float, column: int, style: str) -> None:
    drawn = bar(value, -1.0, 1.0)
    assert drawn.plain.index("●") == column
    assert len(drawn.plain) == BAR
    assert any(span.style == style for span in drawn.spans)


@pytest.mark.parametrize(
    ("values", "line"),
    [
        ([0.0, 1.0], "▁█"),
        ([0.0, 0.0], "▅▅"),
        ([0.0, 7.0, 3.5], "▁█▅"),
        ([math.nan, 0.0, 1.0], " ▁█"),
        ([math.nan], " "),
        ([], ""),
    ],
)
def test_a_sparkline_goes_from_the_least_to_the_largest(values: list[float], line: str) -> None:
    assert sparkline(deque(values)) == line


@example([8.98846567431158e307])
@example([-1.7e308, 1.7e308])
@given(st.lists(st.floats(), max_size=30))
def test_any_values_make_a_line_of_that_length(values: list[float]) -> None:
    assert len(sparkline(deque(values))) == len(values)


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_any_value_has_its_place(value: float) -> None:
    assert len(bar(value, -1.0, 1.0).plain) == BAR


def test_in_a_pipe_the_devices_are_told_once(start: Start, gantry: None) -> None:
    with start(*VIEW, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        told, errors = process.communicate(timeout=LONG)
    assert process.returncode == 0, errors
    assert f"{NAMESPACE}  DISABLED" in told
    assert re.search(r"^yaw +0\.0 +° +─+●─+", told, re.MULTILINE)
    assert "\x1b" not in told


def test_on_a_terminal_it_is_live_until_it_is_interrupted(gantry: None) -> None:
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-m", *VIEW],
        stdin=theirs,
        stdout=theirs,
        stderr=theirs,
        env=os.environ | {"TERM": "xterm"},
    )
    os.close(theirs)
    try:
        seen = b""
        deadline = time.monotonic() + LONG
        while seen.count(b"yaw") < 3 or NAMESPACE.encode() not in seen:
            assert time.monotonic() < deadline, seen[-2000:]
            if select.select([ours], (), (), 0.5)[0]:
                seen += os.read(ours, 1 << 16)
        process.send_signal(signal.SIGINT)
        while True:  # what it wrote last may be read when it has ended
            assert time.monotonic() < deadline
            if select.select([ours], (), (), 0.1)[0]:
                try:
                    seen += os.read(ours, 1 << 16)
                except OSError:  # the other end is closed
                    break
        assert process.wait(LONG) == 0
        assert b"\x1b[?1049l" in seen  # the screen of before is back
        assert b"Traceback" not in seen
    finally:
        process.kill()
        process.wait()
        os.close(ours)


def test_control_is_for_the_page(start: Start, gantry: None) -> None:
    with start(*VIEW, "--control", stderr=subprocess.PIPE) as process:
        _, errors = process.communicate(timeout=LONG)
    assert process.returncode == 2
    assert "--control: is for the page" in errors


def test_a_page_tells_its_address_and_ends_when_it_is_told_to(start: Start, gantry: None) -> None:
    process = start(
        *VIEW[:-1], "--port", "0", "--control", stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    try:
        assert process.stdout is not None
        assert re.fullmatch(r"http://127\.0\.0\.1:\d+/#[\w-]{32}\n", process.stdout.readline())
        process.send_signal(signal.SIGTERM)
        _, errors = process.communicate(timeout=LONG)
        assert process.returncode == 0, errors
        assert "no emergency stop" in errors
    finally:
        process.kill()
        process.wait()

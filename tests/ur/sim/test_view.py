"""The live picture in the terminal: what it shows, and that it leaves the terminal as it was."""

import contextlib
import fcntl
import io
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import termios
import time
from pathlib import Path

import pytest
from rich.console import Console

import crtk_sim_backends
from crtk_sim_backends.ur import SimConfig
from crtk_sim_backends.ur.pace import Pace, Statistics
from crtk_sim_backends.ur.views import picture
from crtk_sim_backends.ur.views.terminal import Screen, bar, line
from rigs.ur_controller import Bench

pytestmark = pytest.mark.usefixtures("cold_start")

ENVIRONMENT = {
    **{name: value for name, value in os.environ.items() if name not in ("COLUMNS", "LINES")},
    "PYTHONPATH": str(Path(crtk_sim_backends.__file__).parents[1]),
    "TERM": "xterm-256color",
}
PATIENCE = 20.0
COLUMNS, LINES = 80, 24
INTO_PICTURE, OUT_OF_PICTURE = "\x1b[?1049h", "\x1b[?1049l"
SHOW_CURSOR, HIDE_CURSOR = "\x1b[?25h", "\x1b[?25l"


class Picture:
    """A controller in virtual time, and its picture as text."""

    def __init__(self, **config):
        self.config = SimConfig(**config)
        self.bench = Bench(self.config.model)
        self.statistics = Statistics()
        self.pace = Pace(0.002, self.config.speed, self.statistics)
        self.screen = Screen()
        self.clients = {"rtde": 2, "dashboard": 1, "primary": 0}
        self.faults = []

    def found(self):
        self.bench.ticks(1)
        return picture.picture(
            self.bench.controller, self.pace, self.statistics, self.clients, self.faults
        )

    def lines(self, now=0.0, found=None):
        arm = picture.arm(self.config, "127.0.0.2")
        console = Console(file=io.StringIO(), width=COLUMNS, height=LINES, record=True)
        console.print(self.screen.render(arm, found or self.found(), now))
        return console.export_text().splitlines()


def test_everything_is_shown_on_a_terminal_of_80_by_24():
    shown = Picture(model="ur10e", version="5.21.0", speed=10.0)
    shown.bench.start(
        "  set_tcp(p[0, 0, 0.1, 0, 0, 0])\n  movej([1.0, -1.5, 1.5, -1.5, -1.5, 0.5])"
    )
    shown.bench.seconds(0.5)
    shown.bench.controller.open_popup("look " * 40)
    shown.faults = ["silence"] * 20
    shown.clients = dict.fromkeys(("rtde", "dashboard", "primary_read_only", "realtime"), 63)
    lines = shown.lines()
    text = "\n".join(lines)
    assert len(lines) < LINES
    assert max(map(len, lines)) <= COLUMNS
    for expected in (
        "UR10e, software 5.21.0, at 127.0.0.2",
        "robot RUNNING   safety NORMAL   remote control",
        "program PLAYING test",
        "speed slider #################### 100 %",
        "wanted 10",
        "clients: rtde 63, dashboard 63",
        "faults: silence, silence",
        "pop-up: look look",
    ):
        assert expected in text
    q = shown.bench["actual_q"]
    for index, name in enumerate(("base", "shoulder", "elbow", "wrist 1", "wrist 2", "wrist 3")):
        (row,) = (each for each in lines if each.startswith(name))
        assert float(row.split()[1 + name.count(" ")]) == pytest.approx(
            q[index] * 57.29578, abs=0.3
        )


def test_the_share_of_time_that_the_simulator_is_busy_is_of_the_last_picture():
    shown = Picture()
    shown.statistics.busy = 5.0
    shown.lines(now=100.0)
    shown.statistics.busy = 5.03
    assert "busy 30 %" in "\n".join(shown.lines(now=100.1))


def test_a_program_cannot_put_markup_on_the_screen():
    shown = Picture()
    shown.bench.controller.popup_text = "[bold]\x1b[2J"
    found = {**shown.found(), "program": "[red]x"}
    text = "\n".join(shown.lines(found=found))
    assert "program STOPPED [red]x" in text
    assert "pop-up: [bold]" in text
    assert "\x1b" not in text


def test_a_simulator_that_hangs_is_told():
    shown = Picture()
    arm = picture.arm(shown.config, "127.0.0.2")
    console = Console(file=io.StringIO(), width=COLUMNS, record=True)
    console.print(shown.screen.render(arm, None, 0.0))
    assert "it hangs" in console.export_text()
    assert "it hangs" in line(None)


@pytest.mark.parametrize(
    ("value", "limit", "place"),
    [(0.0, 6.3, 13), (-6.3, 6.3, 1), (6.3, 6.3, 25), (9.0, 6.3, 25), (-9.0, None, 1)],
)
def test_a_bar_shows_where_a_joint_is_between_its_limits(value, limit, place):
    text = bar(value, limit)
    assert text.index("O") == place
    assert len(text) == 27


# ------------------------------------------------------------------------------------------ processes


def simulator(*arguments, **popen):
    return subprocess.Popen(
        [sys.executable, "-m", "crtk_sim_backends.ur", *arguments], env=ENVIRONMENT, **popen
    )


def test_where_there_is_no_terminal_it_writes_lines():
    with simulator("--view", stdout=subprocess.PIPE, text=True) as process:
        try:
            for text in process.stdout:
                if " RUNNING NORMAL STOPPED q 0.00 -89.95 " in text:
                    break
            else:
                pytest.fail("no line of the picture")
        finally:
            process.terminate()
        assert process.wait(PATIENCE) == 0


class Terminal:
    """A pseudo-terminal with a simulator in it."""

    def __init__(self, *arguments):
        self.master, slave = pty.openpty()
        fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("4H", LINES, COLUMNS, 0, 0))
        self.process = simulator(*arguments, stdin=slave, stdout=slave, stderr=slave)
        os.close(slave)
        self.text = ""

    def read_until(self, pattern):
        """Read until the pattern is there; None: to the end, when nobody holds the terminal."""
        deadline = time.monotonic() + PATIENCE
        while pattern is None or not re.search(pattern, self.text):
            ready, _, _ = select.select([self.master], (), (), 0.1)
            assert time.monotonic() < deadline, f"never {pattern!r}: {self.text[-2000:]!r}"
            if ready:
                try:
                    self.text += os.read(self.master, 65536).decode()
                except OSError:  # Linux: the last one has closed it
                    assert pattern is None, f"ended before {pattern!r}: {self.text[-2000:]!r}"
                    return
        return

    def close(self):
        with contextlib.suppress(ProcessLookupError):
            self.process.kill()
        self.process.wait()
        os.close(self.master)


@pytest.fixture
def terminal():
    opened = Terminal("--view")
    yield opened
    opened.close()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_the_terminal_is_left_as_it_was(terminal, number):
    terminal.read_until(r"(?s)stop it with Ctrl-C.*speed slider")
    terminal.process.send_signal(number)
    terminal.read_until(None)
    assert terminal.text.count(INTO_PICTURE) == terminal.text.count(OUT_OF_PICTURE) == 1
    end = terminal.text[terminal.text.index(OUT_OF_PICTURE) :]
    assert terminal.text.rindex(SHOW_CURSOR) > terminal.text.rindex(HIDE_CURSOR)
    assert "Traceback" not in end
    assert terminal.process.wait(PATIENCE) == (-9 if number is signal.SIGKILL else 0)


def test_a_simulator_can_be_watched_that_runs_already():
    from crtk_sim_backends.ur import SIM

    with SIM.spawn() as sim:
        control = f"{sim.host}:{sim.ports['control']}"
        command = [sys.executable, "-m", "crtk_sim_backends.ur.views.terminal", control]
        options = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        with subprocess.Popen(command, env=ENVIRONMENT, **options) as view:
            assert "RUNNING NORMAL" in view.stdout.readline()
            sim.stop()
            assert view.wait(PATIENCE) == 1
            assert "is it still running" in view.stderr.read()

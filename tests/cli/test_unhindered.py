"""Standard error where nobody reads it: a terminal that was stopped, a pipe that is full, another place."""

from __future__ import annotations

import io
import os
import pty
import socket
import subprocess
import sys
import termios
import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import IO

import pytest
from rich.live import Live

from crtk_drivers.cli.terminal import Told
from crtk_drivers.cli.unhindered import Unhindered
from rigs.waiting import LONG, eventually

LEFT_OUT = "lines were left out here: nobody read them."


def says(console: Told, *lines: str) -> None:
    """Print lines, and fail if that waits for somebody."""

    def say() -> None:
        for line in lines:
            console.out(line, highlight=False)

    thread = threading.Thread(target=say, daemon=True)
    thread.start()
    thread.join(LONG)
    assert not thread.is_alive(), "it waits for who reads"


def read_until(descriptor: int, end: str) -> str:
    found = ""
    while end not in found:
        found += os.read(descriptor, 65536).decode()
    return found


@pytest.fixture
def terminal() -> Iterator[tuple[int, IO[str]]]:
    """The end that shows, and standard error there."""
    shows, end = pty.openpty()
    with open(end, "w") as stream:
        yield shows, stream
    os.close(shows)


@pytest.fixture
def pipe() -> Iterator[tuple[int, IO[str]]]:
    """The end that is read, and standard error there."""
    reads, end = os.pipe()
    with open(end, "w") as stream:
        yield reads, stream
    os.close(reads)


def test_a_terminal_that_is_stopped_holds_nobody_up(terminal: tuple[int, IO[str]]) -> None:
    shows, stream = terminal
    console = Told(file=stream, width=80)
    says(console, "before")
    assert read_until(shows, "before\r\n")
    termios.tcflow(stream.fileno(), termios.TCOOFF)  # as Ctrl-S
    for number in range(3):
        says(console, f"line {number}")
    termios.tcflow(stream.fileno(), termios.TCOON)
    says(console, "after")
    found = read_until(shows, "after\r\n")
    assert f"3 {LEFT_OUT}" in found
    assert "line" not in found.replace(LEFT_OUT, "")


@pytest.fixture
def journal() -> Iterator[tuple[int, IO[str]]]:
    """The end that is read, and standard error at a socket, as of a service of systemd."""
    reads, end = socket.socketpair()
    with open(end.detach(), "w") as stream, reads:
        yield reads.fileno(), stream


@pytest.mark.parametrize("where", ["terminal", "pipe", "journal"])
def test_what_is_full_holds_nobody_up(where: str, request: pytest.FixtureRequest) -> None:
    reads, stream = request.getfixturevalue(where)
    console = Told(file=stream, width=80)
    says(console, *["\n".join(["x" * 79] * 500)] * 10)  # a socket takes 200 kB, others less
    assert os.read(reads, 79) == b"x" * 79
    os.set_blocking(reads, False)
    found = ""

    def comes_through() -> bool:
        """A terminal has room a while after it was read."""
        nonlocal found
        says(console, "after")
        with suppress(BlockingIOError):
            found += os.read(reads, 1 << 20).decode()
        return "after" in found

    eventually(comes_through, "what is told once it is read again")
    assert LEFT_OUT in found


@pytest.mark.parametrize("how", ["disk full", "closed"])
def test_what_cannot_be_written_ends_nobody(how: str) -> None:
    with open("/dev/full", "w") as stream:
        if how == "closed":
            stream.close()
        console = Told(file=stream, width=80)
        console.print("before a stop is sent")
        with console.status("hold ..."):
            console.print("and after it")
        assert not console.quiet
        if how != "closed":
            with suppress(OSError):  # it still has what there was no room for
                stream.close()


@pytest.mark.parametrize("closed", ["2>&-", "<&- >&- 2>&-"])
def test_streams_that_were_closed_lead_nowhere(closed: str) -> None:
    """The number of standard error must not go to what is opened next: a device's line."""
    program = (
        "import os, sys\n"
        "from crtk_drivers.cli.unhindered import open_missing_streams\n"
        "open_missing_streams()\n"
        "sys.stderr.write('lost')\n"
        "sys.stdin.read()\n"
        "opened = os.open('/dev/zero', os.O_RDONLY)\n"
        "sys.exit(0 if opened > 2 and os.readlink('/proc/self/fd/2') == os.devnull else 1)\n"
    )
    script = f'exec "$0" -c "$1" {closed}'
    code = subprocess.run(
        ["sh", "-c", script, sys.executable, program], stdin=subprocess.DEVNULL, timeout=LONG
    ).returncode
    assert code == 0


def test_where_it_goes_may_be_changed(pipe: tuple[int, IO[str]], tmp_path: Path) -> None:
    """A file, in which nothing is left out, and then a pipe whose reader goes."""
    reads, stream = pipe
    console = Told(file=stream, width=80)
    says(console, "to the pipe")
    file, again = os.open(tmp_path / "log", os.O_WRONLY | os.O_CREAT), os.dup(stream.fileno())
    os.dup2(file, stream.fileno())
    says(console, "to the file")
    stream.flush()
    os.dup2(again, stream.fileno())
    says(console, "to the pipe again")
    os.close(file), os.close(again)
    assert (tmp_path / "log").read_text() == "to the file\n"
    assert read_until(reads, "again\n") == "to the pipe\nto the pipe again\n"


def test_a_reader_that_has_gone_is_told_no_more() -> None:
    reads, end = os.pipe()
    with open(end, "w") as stream:
        console = Told(file=stream, width=80)
        says(console, "before")
        os.close(reads)
        says(console, "after")
        assert console.quiet


def test_a_terminal_that_has_gone_is_told_no_more() -> None:
    """Who was started from it, and is not ended with it, goes on: its status line is shown there no more."""
    shows, end = pty.openpty()
    with open(end, "w") as stream:
        console = Told(file=stream, width=80, force_terminal=True)
        with Live(console=console, auto_refresh=False) as live:
            live.update("before", refresh=True)
            os.close(shows)
            live.update("after", refresh=True)
            assert console.quiet


def test_a_terminal_that_had_gone_before_is_told_nothing() -> None:
    shows, end = pty.openpty()
    os.close(shows)
    with open(end, "w") as stream:
        console = Told(file=stream, width=80)
        says(console, "hello")
        assert console.quiet
        with pytest.raises(OSError, match="Input/output"):  # what was kept, and cannot be written
            stream.flush()
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)


def test_what_is_no_file_is_written_as_ever() -> None:
    stream = Unhindered(io.StringIO())
    assert stream.write("one\n") == 4
    assert stream.getvalue() == "one\n"

"""The processes of a figure: simulator, driver, clients; each on its own, as users run them."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from bench.recording import DIRECTORY
from crtk_sim_backends import process
from crtk_sim_backends.process import RunningSim

ROOT = Path(__file__).resolve().parent.parent
NAMESPACE = "/bench"
STOP_TIMEOUT = 10.0
_TICKS = os.sysconf("SC_CLK_TCK")
_PAGE = os.sysconf("SC_PAGE_SIZE")


class Usage(NamedTuple):
    """CPU time and memory of a process."""

    at: float
    cpu: float
    rss: int

    def share_since(self, earlier: Usage) -> float:
        """Return the CPU time since `earlier` in percent of one core."""
        return 100.0 * (self.cpu - earlier.cpu) / (self.at - earlier.at)


GONE = Usage(math.nan, math.nan, 0)


def usage(pid: int) -> Usage:
    """Return what a process has used until now (s, bytes); `GONE` if it has ended."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except FileNotFoundError:
        return GONE
    cpu = (int(fields[11]) + int(fields[12])) / _TICKS
    return Usage(time.monotonic(), cpu, int(fields[21]) * _PAGE)


def child_running(pid: int, module: str) -> int:
    """Return the id of the child of `pid` that runs `module`; 0 if there is none."""
    for task in Path(f"/proc/{pid}/task").iterdir():
        for child in (task / "children").read_text().split():
            if module in Path(f"/proc/{child}/cmdline").read_text():
                return int(child)
    return 0


CRTK_DRIVER = [str(Path(sys.executable).with_name("crtk-driver"))]
"""The installed command."""


def module(name: str) -> list[str]:
    """Return the command that runs a module of this checkout."""
    return [sys.executable, "-m", name]


@contextmanager
def on_core(core: int) -> Iterator[None]:
    """Let this thread, and processes that are started within, run on that core alone."""
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {core})
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


@contextmanager
def running(
    command: Sequence[str], records: Path, **environment: str
) -> Iterator[subprocess.Popen[str]]:
    """Run a command in a process of its own, and end it by SIGTERM."""
    child = subprocess.Popen(
        command,
        cwd=ROOT,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, DIRECTORY: str(records), **environment},
    )
    try:
        yield child
    finally:
        if child.poll() is None:
            child.send_signal(signal.SIGCONT)
            child.terminate()
        try:
            child.wait(STOP_TIMEOUT)
        finally:
            child.kill()
            child.wait()
            assert child.stdout is not None
            child.stdout.close()


def wait_up(child: subprocess.Popen[str]) -> None:
    """Wait until a client prints that its node exists."""
    assert child.stdout is not None
    child.stdout.readline()


def wait_ready(child: subprocess.Popen[str]) -> float:
    """Wait until a client prints that it is ready, and return when (monotonic s) that was.

    Raises:
        RuntimeError: it ended before.
    """
    assert child.stdout is not None
    for line in child.stdout:
        if line.startswith("ready"):
            return float(line.split()[1])
    raise RuntimeError(f"{child.args!r} ended before it was ready; see its messages above")


@contextmanager
def simulator(
    records: Path, *, recorded: bool = True, recorder: str = "bench.recorded_sim"
) -> Iterator[RunningSim]:
    """Run the simulated UR controller; `recorded`: with the notes that `recorder` takes.

    With real-time priority, where that is permitted: a controller does not share its processor.
    """
    os.environ[DIRECTORY] = str(records)
    if str(ROOT) not in sys.path:
        sys.path.append(str(ROOT))
    name = recorder if recorded else "crtk_sim_backends.ur"
    with process.spawn(name, ["--realtime"]) as sim:
        yield sim


@contextmanager
def driver(
    sim: RunningSim,
    records: Path,
    publish_rate: float = 500.0,
    *,
    recorded: bool = True,
    environment: Mapping[str, str] | None = None,
) -> Iterator[subprocess.Popen[str]]:
    """Run ``crtk-driver ur`` against `sim`; `recorded`: with notes of its cycles."""
    settings = ("--set", f"node.publish_rate={publish_rate:g}", "--log-level", "warning")
    command = module("bench.recorded_node") if recorded else CRTK_DRIVER
    arguments = ("ur", "--ns", NAMESPACE, "--host", sim.host, *settings)
    with running([*command, *arguments], records, **(environment or {})) as child:
        yield child


@contextmanager
def client(records: Path, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    """Run `bench.ros_client`."""
    command = [*module("bench.ros_client"), "--namespace", NAMESPACE, *arguments]
    with running(command, records) as child:
        yield child


def pids(node: subprocess.Popen[str], sim: RunningSim) -> Mapping[str, int]:
    """Return the processes of one driver by what they are; it has a control process with ur-rtde only."""
    control = child_running(node.pid, "crtk_driver_ur.library.process")
    found = {"node": node.pid, "simulator": sim.pid}
    return {**found, "control process": control} if control else found

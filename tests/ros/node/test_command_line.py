"""`crtk-driver loopback` as a process: comes up, honours ROS arguments, ends cleanly on a signal."""

import json
import signal
import subprocess
import sys
import sysconfig
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from crtk_drivers.client import connect
from crtk_drivers.ros.environment import PROFILES, RANGE
from rigs import programs
from rigs.programs import COMMAND, Program, Start
from rigs.waiting import LONG

pytest.importorskip("rclpy")
pytestmark = pytest.mark.ros

ENTRY_POINT = """[crtk_drivers.devices]
loopback = crtk_drivers.testing.loopback:PLUGIN
runaway = runaway:PLUGIN
"""
RUNAWAY = """
from dataclasses import replace

from crtk_drivers.device import StopPolicy
from crtk_drivers.testing.loopback import PLUGIN as LOOPBACK, LoopbackDevice


class Runaway(LoopbackDevice):
    has_stopped = False

    @property
    def capabilities(self):
        return replace(super().capabilities, stop=StopPolicy(0.0, "never", 0.2))


PLUGIN = replace(LOOPBACK, name="runaway", create=Runaway)
"""


Begin = Callable[..., Program]


@pytest.fixture
def begin(start: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Begin]:
    """Start the command line with this distribution as if it were installed."""
    info = tmp_path / "crtk_drivers-9.8.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: crtk-drivers\nVersion: 9.8\n")
    (info / "entry_points.txt").write_text(ENTRY_POINT)
    (tmp_path / "runaway.py").write_text(RUNAWAY)
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    started: list[Program] = []

    def run(*arguments: str) -> Program:
        started.append(start(COMMAND, *arguments, stderr=subprocess.PIPE))
        return started[-1]

    yield run
    for process in started:
        with process:
            process.kill()


def wait_for(process: Program, text: str) -> list[dict[str, str]]:
    """Return the log records up to the first that holds `text`."""
    assert process.stderr is not None
    records = []
    for line in process.stderr:
        records.append(json.loads(line))
        if text in records[-1]["message"]:
            return records
    raise AssertionError(f"{text!r} was never logged: {records}")


SCRIPT = Path(sysconfig.get_path("scripts"), "crtk-driver")


@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGTERM])
def test_it_runs_until_a_signal(end: signal.Signals) -> None:
    command = [SCRIPT, "loopback", "--ns", "/demo", "--log-format", "json", "--rate", "50"]
    command += ["--sample-timeout", "10"]  # a busy machine is no fault, of which it would warn
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        try:
            ends_well(process, end)
        finally:
            process.kill()


def ends_well(process: Program, end: signal.Signals) -> None:
    records = wait_for(process, "DISABLED")
    assert records[-1]["message"] == "loopback /demo  DISABLED"
    assert "  crtk-driver state /demo\n  crtk-driver enable /demo\n" in records[0]["message"]
    process.send_signal(end)
    assert process.wait(LONG) == 0
    assert process.stderr is not None
    rest = [json.loads(line) for line in process.stderr]
    assert [record for record in rest if record["level"] in ("warning", "error")] == []


@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGTERM])
def test_it_ends_with_1_where_nobody_saw_the_arm_stand(begin: Begin, end: signal.Signals) -> None:
    process = begin("runaway", "--ns", "/runaway", "--log-format", "json")
    wait_for(process, "DISABLED")
    with connect("/runaway", timeout=LONG) as arm:
        arm.enable(LONG)
    process.send_signal(end)
    _, text = process.communicate(timeout=LONG)
    assert process.returncode == 1, text
    assert "a stop has not been carried out within 0.2 s" in text
    assert "Traceback" not in text


def test_ros_arguments_reach_the_node(begin: Begin) -> None:
    process = begin("loopback", "--ros-args", "-p", "tf_rate:=fast")
    _, text = process.communicate(timeout=LONG)
    assert process.returncode == 2
    assert "tf_rate" in text
    assert "Traceback" not in text


def test_it_shares_no_memory_with_others_and_tells_its_remapped_namespace(
    begin: Begin, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in {RANGE: "LOCALHOST", **dict.fromkeys(PROFILES, "")}.items():
        monkeypatch.setenv(name, value)
    remapped = ("--ros-args", "-r", "__ns:=/elsewhere")
    process = begin("loopback", "--ns", "/apart", "--log-format", "json", *remapped)
    records = wait_for(process, "DISABLED")
    assert "state /elsewhere" in records[0]["message"]
    assert records[-1]["message"].startswith("loopback /elsewhere  DISABLED")
    mapped = Path(f"/proc/{process.pid}/maps").read_text()
    assert "libfastrtps" in mapped, "it runs on Fast DDS"
    assert "/dev/shm/fastrtps" not in mapped


@pytest.mark.parametrize("module", ["pydantic", "typer", "rclpy"])
def test_ctrl_c_while_it_starts_ends_it_without_a_traceback(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: str
) -> None:
    """Also where an exception is lost: where Python looks after the locks of its imports, as here."""
    interrupting = f"""
import os, signal, sys, weakref
def interrupt(_):
    os.kill(os.getpid(), signal.SIGINT)
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            sys.meta_path.remove(self)
            lock = Finder()
            self.lock = weakref.ref(lock, interrupt)
            del lock
sys.meta_path.insert(0, Finder())
"""
    (tmp_path / "sitecustomize.py").write_text(interrupting)
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    with programs.start(COMMAND, "loopback", "--ns", "/demo", stderr=subprocess.PIPE) as process:
        _, text = process.communicate(timeout=LONG)
    assert (process.returncode, text) == (130, "")

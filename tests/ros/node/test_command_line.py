"""`crtk-driver loopback` as a process: comes up, honours ROS arguments, ends cleanly on a signal."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from crtk_drivers.client import connect
from crtk_drivers.ros.environment import PROFILES, RANGE

pytest.importorskip("rclpy")
pytestmark = pytest.mark.ros

MAIN = "import sys; from crtk_drivers.cli import main; sys.exit(main())"
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

Start = Callable[..., subprocess.Popen[str]]


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    """Start the command line with this distribution as if it were installed."""
    info = tmp_path / "crtk_drivers-9.8.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: crtk-drivers\nVersion: 9.8\n")
    (info / "entry_points.txt").write_text(ENTRY_POINT)
    (tmp_path / "runaway.py").write_text(RUNAWAY)
    path = os.pathsep.join([str(tmp_path), *filter(None, sys.path)])
    started: list[subprocess.Popen[str]] = []

    def run(*arguments: str, **environment: str) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [sys.executable, "-c", MAIN, *arguments],
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": path, **environment},
        )
        started.append(process)
        return process

    yield run
    for process in started:
        with process:
            process.kill()


def wait_for(process: subprocess.Popen[str], text: str) -> list[dict[str, str]]:
    """Return the log records up to the first that holds `text`."""
    assert process.stderr is not None
    records = []
    for line in process.stderr:
        records.append(json.loads(line))
        if text in records[-1]["message"]:
            return records
    raise AssertionError(f"{text!r} was never logged: {records}")


@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGTERM])
def test_it_runs_until_a_signal(start: Start, end: signal.Signals) -> None:
    process = start("loopback", "--ns", "/demo", "--log-format", "json", "--rate", "50")
    records = wait_for(process, "DISABLED")
    assert records[-1]["message"] == "loopback /demo  DISABLED"
    assert "crtk-driver state /demo   crtk-driver enable /demo" in records[0]["message"]
    process.send_signal(end)
    assert process.wait(10) == 0
    assert process.stderr is not None
    rest = [json.loads(line) for line in process.stderr]
    assert [record for record in rest if record["level"] in ("warning", "error")] == []


@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGTERM])
def test_it_ends_with_1_where_nobody_saw_the_arm_stand(start: Start, end: signal.Signals) -> None:
    process = start("runaway", "--ns", "/runaway", "--log-format", "json")
    wait_for(process, "DISABLED")
    with connect("/runaway", timeout=20.0) as arm:
        arm.enable(20.0)
    process.send_signal(end)
    _, text = process.communicate(timeout=20)
    assert process.returncode == 1, text
    assert "a stop has not been carried out within 0.2 s" in text
    assert "Traceback" not in text


def test_ros_arguments_reach_the_node(start: Start) -> None:
    process = start("loopback", "--ros-args", "-p", "tf_rate:=fast")
    _, text = process.communicate(timeout=20)
    assert process.returncode == 2
    assert "tf_rate" in text
    assert "Traceback" not in text


def test_it_shares_no_memory_with_others_and_tells_its_remapped_namespace(start: Start) -> None:
    said = {RANGE: "LOCALHOST", **dict.fromkeys(PROFILES, "")}
    remapped = ("--ros-args", "-r", "__ns:=/elsewhere")
    process = start("loopback", "--ns", "/apart", "--log-format", "json", *remapped, **said)
    records = wait_for(process, "DISABLED")
    assert "state /elsewhere" in records[0]["message"]
    assert records[-1]["message"].startswith("loopback /elsewhere  DISABLED")
    mapped = Path(f"/proc/{process.pid}/maps").read_text()
    assert "libfastrtps" in mapped, "it runs on Fast DDS"
    assert "/dev/shm/fastrtps" not in mapped


@pytest.mark.parametrize("module", ["pydantic", "typer", "rclpy"])
def test_ctrl_c_while_it_starts_ends_it_without_a_traceback(
    start: Start, tmp_path: Path, module: str
) -> None:
    interrupting = f"""
import os, signal, sys
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            sys.meta_path.remove(self)
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Finder())
"""
    (tmp_path / "sitecustomize.py").write_text(interrupting)
    process = start("loopback", "--ns", "/demo")
    _, text = process.communicate(timeout=20)
    assert (process.returncode, text) == (130, "")

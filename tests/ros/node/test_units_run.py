"""The command of a unit in an environment that is empty but for what the unit says, as systemd runs it."""

import os
import re
import shlex
import shutil
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from crtk_drivers.client import connect
from crtk_drivers.errors.exit_codes import NOT_INSTALLED
from rigs.installed_ros import InstalledRos, installed_ros
from rigs.waiting import LONG

pytest.importorskip("rclpy")
pytestmark = [pytest.mark.ros, pytest.mark.timeout(240)]

LAB = """
name = "bench"
[devices.one]
plugin = "loopback"
namespace = "/units/one"
"""


@pytest.fixture(scope="module")
def ros(tmp_path_factory: pytest.TempPathFactory) -> InstalledRos:
    return installed_ros(tmp_path_factory.mktemp("installed"))


def written(
    ros: InstalledRos, folder: Path, said: str = "", **shell: str
) -> subprocess.CompletedProcess[str]:
    """Write units in a shell that has some variables and no others."""
    lab = folder / "lab.toml"
    lab.write_text(said + LAB)
    words = ("-m", "crtk_drivers.cli", "up", str(lab), "--systemd", str(folder / "units"))
    return subprocess.run(
        [str(ros.python), *words],
        env={"PATH": os.environ["PATH"], "HOME": str(folder), **shell},
        capture_output=True,
        text=True,
        timeout=LONG,
    )


def command_of(folder: Path, *left_out: str) -> list[str]:
    """What systemd starts, and with which variables."""
    text = (folder / "units" / "crtk-bench-one.service").read_text()
    lines = re.findall("^(Environment|ExecStart)=(.*)$", text, re.MULTILINE)
    words = {name: [] for name, _ in lines}
    for name, line in lines:
        plain = line.replace("%S", str(folder)).replace("%L", str(folder)).replace("%%", "%")
        words[name] += shlex.split(plain)
    kept = [word for word in words["Environment"] if word.partition("=")[0] not in left_out]
    return [shutil.which("env") or "env", "-i", *kept, *words["ExecStart"]]


@contextmanager
def running(command: list[str], folder: Path) -> Iterator[subprocess.Popen[str]]:
    with (folder / "unit.log").open("w") as log:
        process = subprocess.Popen(command, env={}, stdout=log, stderr=log, text=True)
    try:
        yield process
    finally:
        process.kill()
        process.wait(LONG)


def test_a_unit_runs_as_the_shell_that_wrote_it(ros: InstalledRos, tmp_path: Path) -> None:
    here = {"ROS_DOMAIN_ID": os.environ["ROS_DOMAIN_ID"]}
    done = written(ros, tmp_path, **ros.shell, **here)
    assert done.returncode == 0, done.stderr
    with running(command_of(tmp_path), tmp_path) as process:
        with connect("/units/one", timeout=LONG) as one:
            assert one.measured_js(wait=LONG).position.size == 4
        process.send_signal(signal.SIGTERM)
        assert process.wait(LONG) == 0, (tmp_path / "unit.log").read_text()


def test_what_is_missing_may_come_back(ros: InstalledRos, tmp_path: Path) -> None:
    assert written(ros, tmp_path, **ros.shell).returncode == 0
    with running(command_of(tmp_path, "PYTHONPATH"), tmp_path) as process:
        assert process.wait(LONG) == NOT_INSTALLED
    assert "rclpy is not installed" in (tmp_path / "unit.log").read_text()
    text = (tmp_path / "units" / "crtk-bench-one.service").read_text()
    assert str(NOT_INSTALLED) not in re.findall("RestartPreventExitStatus=(.*)", text)[0].split()


def test_writing_says_why_a_unit_cannot_run(ros: InstalledRos, tmp_path: Path) -> None:
    done = written(ros, tmp_path)
    assert done.returncode == 1
    assert "These units cannot start as they are: rclpy is not installed" in done.stderr


def test_the_lab_file_may_say_where_ros_is(ros: InstalledRos, tmp_path: Path) -> None:
    table = ", ".join(f'{name} = "{value}"' for name, value in ros.shell.items())
    done = written(ros, tmp_path, f"environment = {{ {table} }}\n")
    assert done.returncode == 0, done.stderr


def test_a_unit_without_its_keys_is_told(ros: InstalledRos, tmp_path: Path) -> None:
    secured = {"ROS_SECURITY_ENABLE": "true", "ROS_SECURITY_STRATEGY": "Enforce"}
    done = written(ros, tmp_path, **ros.shell, **secured, ROS_SECURITY_KEYSTORE=str(tmp_path))
    assert done.returncode == 1
    assert "ROS 2 does not start" in done.stderr
    assert "/units/one/crtk_driver" in done.stderr

"""A process of the bench that stands still: another one notices, and what it moved is held and left."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
import time
from functools import partial
from multiprocessing.connection import Listener
from pathlib import Path

import pytest

from crtk_drivers import plugins
from crtk_drivers.labs import load_lab
from crtk_drivers.labs.bench import host
from crtk_drivers.labs.bench.acquisition import Suite
from crtk_drivers.labs.bench.allowed import BenchOptions
from crtk_drivers.labs.bench.calls import HostOrder
from crtk_drivers.labs.bench.door import Door, DoorClosed, Refused
from crtk_drivers.labs.bench.results import read_run
from crtk_drivers.labs.bench.run import run_bench
from crtk_drivers.samples import JointState, vector
from crtk_drivers.session import Session
from crtk_drivers.status.stop_request import StopRequest
from rigs.processes import children_of, has_ended, process_of
from rigs.waiting import LONG, eventually

GANTRY = '[devices.gantry]\nplugin = "loopback"\nsettings = { rate = 200 }\n'
OFF = 'power_off = ["sh", "-c", "date +%s.%N > off"]\n'
MOVES = Path("data", "gantry-sines.mcap")
"""The recording of M5, in the folder of the run."""


def until_it_moves(run: Path) -> None:
    recording = run / MOVES
    eventually(lambda: recording.exists() and recording.stat().st_size > 50_000, "it moves")


@pytest.mark.usefixtures("cold_bench")
def test_a_frozen_conductor_leaves_no_device_moving(tmp_path: Path) -> None:
    """The driver holds and leaves it, then its power is taken, and the run ends and says why."""
    path, run = tmp_path / "lab.toml", tmp_path / "run"
    path.write_text(GANTRY + OFF)
    driver: list[int] = []

    def freeze() -> None:
        until_it_moves(run)
        conductor = process_of("labs.bench.conductor")
        driver.append(process_of("labs.bench.host", conductor))
        os.kill(conductor, signal.SIGSTOP)

    freezing = threading.Thread(target=freeze)
    freezing.start()
    options = BenchOptions(Suite.QUICK, ("M5",), may_move=False, out=run)
    found = run_bench(load_lab(path), options, lambda *_: None, StopRequest())
    freezing.join()
    assert not found.complete
    assert re.fullmatch(
        r"the conductor's process \d+ stood still \(.*\), and was killed", found.ended_by
    )
    ((_, test),) = found.tests
    assert test.reason == found.ended_by
    assert has_ended(driver[0])
    log = (run / "gantry.log").read_text()
    assert "the bench stands still for" in log
    assert log.count("held, and left") == 1
    assert (tmp_path / "off").exists()


@pytest.mark.usefixtures("cold_bench")
def test_the_verdict_names_a_frozen_driver(tmp_path: Path) -> None:
    """The power is taken, the run ends, and the process is not left."""
    path, run = tmp_path / "lab.toml", tmp_path / "run"
    path.write_text(GANTRY + OFF)
    driver: list[int] = []

    def freeze() -> None:
        until_it_moves(run)
        driver.append(process_of("labs.bench.host"))
        os.kill(driver[0], signal.SIGSTOP)

    freezing = threading.Thread(target=freeze)
    freezing.start()
    options = BenchOptions(Suite.QUICK, ("M5",), may_move=False, out=run)
    found = run_bench(load_lab(path), options, lambda *_: None, StopRequest())
    freezing.join()
    ((_, test),) = found.tests
    assert test.reason.endswith(f"no answer in 2 s; the driver's process {driver[0]} is stopped")
    assert (tmp_path / "off").exists()
    assert has_ended(driver[0])


@pytest.mark.timeout(240)
def test_a_frozen_bench_leaves_nothing_powered(tmp_path: Path) -> None:
    """Its conductor holds and leaves all; when it goes on, it says so, and takes no power."""
    (tmp_path / "lab.toml").write_text(GANTRY + OFF)
    command = [sys.executable, "-m", "crtk_drivers.cli", "bench", "lab.toml", "--only", "M5,M12"]
    with subprocess.Popen(
        [*command, "--out", "run"], cwd=tmp_path, stderr=subprocess.DEVNULL
    ) as bench:
        try:
            until_it_moves(tmp_path / "run")
            started = children_of(bench.pid)
            assert len(started) >= 2
            bench.send_signal(signal.SIGSTOP)
            eventually(lambda: all(map(has_ended, started)), "all that it has started ends")
            bench.send_signal(signal.SIGCONT)
            assert bench.wait(LONG) == 4
        finally:
            bench.kill()
    found = read_run(tmp_path / "run")
    assert found.ended_by == (
        f"the process {bench.pid} of the bench stood still: everything was held and left"
    )
    assert "is gone: everything is held and left" in (tmp_path / "run" / "log.txt").read_text()
    assert not (tmp_path / "off").exists()


def test_a_frozen_driver_keeps_nobody_who_connects(tmp_path: Path) -> None:
    """The kernel takes the connection; the proof that both know the key never comes."""
    path = str(tmp_path / "door")
    with Listener(path, "AF_UNIX"):
        began = time.monotonic()
        with pytest.raises(DoorClosed, match=r"does not answer within 0\.3 s"):
            Door(path, b"key", 0.3)
        assert time.monotonic() - began < LONG


def stream(door: Door, goal: JointState) -> None:
    """Send it again and again, until that is refused."""
    while True:
        door.submit("servo_jp", goal)
        time.sleep(0.005)


def test_nothing_moves_a_device_that_is_left(tmp_path: Path) -> None:
    """Another connection of a bench that died may still stream."""
    plugin = plugins.device("loopback")
    config = plugin.config()
    order = HostOrder("loopback", config, str(tmp_path / "door"), b"key")
    serving = threading.Thread(
        target=partial(host.Host(Session(plugin, config), order).serve, StopRequest())
    )
    serving.start()
    first = Door(order.door, order.key, LONG)
    first.call("about", within=LONG)
    with Door(order.door, order.key, LONG) as second:
        second.call("state_command", "enable", LONG, within=LONG)
        goal = JointState(position=vector(second.call("glance").values["measured_js"][0].position))
        first.close()
        with pytest.raises(Refused, match="the bench was lost"):
            stream(second, goal)
        with pytest.raises((Refused, DoorClosed)):
            second.call("state_command", "enable", LONG, within=LONG)
    serving.join(LONG)
    assert not serving.is_alive()

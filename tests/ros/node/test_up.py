"""`crtk-driver up`: the devices of a lab as processes, kept running, and stopped in order."""

import os
import re
import signal
import time
from pathlib import Path

import numpy as np
import pytest

import crtk_drivers
from crtk_drivers.client import connect
from crtk_drivers.errors import ConnectionFailed
from crtk_drivers.geometry.quaternions import matrix_from_quaternion
from rigs.lab_up import up
from rigs.waiting import LONG

pytest.importorskip("rclpy")
pytestmark = [pytest.mark.ros, pytest.mark.timeout(240)]

LAB = """
[devices.one]
plugin = "loopback"
namespace = "/up/one"

[devices.two]
plugin = "loopback"
namespace = "/up/two"
on = "one"
"""
PROGRAM = """
[programs.work]
command = ["sh", "-c", "echo up; exec sleep 1000"]
"""
UNREACHABLE = """
[devices.far]
plugin = "ur"
settings = { host = "127.0.0.99" }
"""

CARRIED = """
[devices.arm]
plugin = "virtual"
namespace = "/up/arm"
settings.rate = 100

[devices.ft]
plugin = "ati-netft"
namespace = "/up/ft"
on = "arm"
sim = true
tool = { mass = 0.8 }
settings.rate = 100
"""


def is_gone(pid: int) -> bool:
    try:
        return "State:\tZ" in Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return True


def until_gone(*pids: int) -> None:
    deadline = time.monotonic() + LONG
    while not all(map(is_gone, pids)):
        assert time.monotonic() < deadline, f"still there: {pids}"
        time.sleep(0.02)


def test_all_come_up_in_order_are_kept_running_and_stopped(start, tmp_path):
    with up(start, tmp_path, LAB + PROGRAM) as lab:
        work = lab.until(r"work: started, process (\d+)")
        first = lab.until(r"one: started, process (\d+)")
        told = [line for line in lab.lines if re.search("started|measures", line)]
        order = [re.search(r"(one|two|work): (started|measures)", line).groups() for line in told]
        assert order.index(("one", "measures")) < order.index(("two", "started"))
        assert order.index(("two", "measures")) < order.index(("work", "started"))
        with connect("/up/two", timeout=LONG) as two:
            two.enable()
            os.kill(first, signal.SIGKILL)
            lab.until("one: ended by SIGKILL .* started again in 1 s")
            second = lab.until(r"one: started, process (\d+)", count=2)
            lab.until("one: measures", count=2)
            with connect("/up/one", timeout=LONG) as one:
                assert one.operating_state().state == "DISABLED"
            assert two.is_enabled(), "the others go on"
        with crtk_drivers.lab(tmp_path / "lab.toml", timeout=LONG) as devices:
            assert list(devices) == ["one", "two"]
            assert devices.two.is_enabled()
            assert not devices["one"].is_enabled()
            with pytest.raises(AttributeError, match=r"no device 'three'\. It has: one, two"):
                _ = devices.three
        assert lab.end() == 0
        told = "".join(lab.lines)
        assert re.search(r"work: ended in .*two: stopped in .*one: stopped in ", told, re.DOTALL)
        assert lab.lines[-1].endswith("lab: all stopped; exit code 0\n")
        until_gone(second, work)
    assert (tmp_path / "work.log").read_text() == "up\n"


def test_a_lab_meets_its_clients_in_its_own_domain(start, tmp_path, monkeypatch):
    domain = os.environ["ROS_DOMAIN_ID"]
    monkeypatch.setenv("ROS_DOMAIN_ID", domain)  # what the client adopts is taken back
    said = f"environment = {{ ROS_DOMAIN_ID = {int(domain) % 101 + 1} }}\n"
    with up(start, tmp_path, said + LAB.split("[devices.two]")[0]) as lab:
        lab.until("one: measures")
        with pytest.raises(ConnectionFailed):
            connect("/up/one", timeout=0.5)
        with crtk_drivers.lab(tmp_path / "lab.toml", timeout=LONG) as devices:
            assert devices.one.operating_state().state == "DISABLED"
        assert lab.end() == 0


def test_no_device_outlives_its_lab_and_one_that_is_not_there_keeps_nobody(start, tmp_path):
    with up(start, tmp_path, UNREACHABLE + LAB.replace('on = "one"', "")) as lab:
        pids = [lab.until(rf"{name}: started, process (\d+)") for name in ("far", "one", "two")]
        lab.until("one: measures")
        lab.until("two: measures")
        lab.until("far: FAULT .*Connection refused")
        lab.process.kill()
        until_gone(*pids)
    assert "whoever started this is gone" in (tmp_path / "one.log").read_text()


def test_devices_of_a_frozen_up_end_and_come_back_with_it(start, tmp_path):
    with up(start, tmp_path, LAB.split("[devices.two]")[0]) as lab:
        first = lab.until(r"one: started, process (\d+)")
        lab.until("one: measures")
        with connect("/up/one", timeout=LONG) as one:
            one.enable()
        lab.process.send_signal(signal.SIGSTOP)
        until_gone(first)
        lab.process.send_signal(signal.SIGCONT)
        lab.until("one: ended with exit code 0 .* started again")
        lab.until("one: measures", count=2)
        with connect("/up/one", timeout=LONG) as one:
            assert one.operating_state().state == "DISABLED"
        assert lab.end() == 0
    assert "whoever started this is gone or stands still" in (tmp_path / "one.log").read_text()


def test_a_device_that_cannot_be_started_is_told_and_not_tried_again(start, tmp_path):
    with up(
        start, tmp_path, LAB.split("[devices.two]")[0] + 'settings = { axes = "many" }\n'
    ) as lab:
        assert lab.process.wait(LONG) == 2
        lab._reader.join(LONG)
    assert "lab.toml:" in "".join(lab.lines)


def test_one_that_is_still_starting_ends_well(start, tmp_path):
    with up(start, tmp_path, LAB) as lab:
        pid = lab.until(r"one: started, process (\d+)")
        assert lab.end() == 0
        until_gone(pid)


@pytest.mark.slow  # test_carried.py has it without ROS
def test_a_simulated_sensor_feels_its_tool_also_after_a_restart(start, tmp_path):
    def until_felt(ft, arm):
        """Wait until the weight pulls where the arm says that down is."""
        deadline = time.monotonic() + LONG
        while True:
            down = -matrix_from_quaternion(arm.measured_cp(wait=LONG).orientation)[2]
            force = ft.measured_cf(wait=LONG).force
            if np.allclose(force, 0.8 * 9.80665 * down, atol=0.05):
                return down
            assert time.monotonic() < deadline, f"never: {force} along {down}"
            time.sleep(0.02)

    with up(start, tmp_path, CARRIED) as lab:
        lab.until("ft: measures")
        with connect("/up/arm", timeout=LONG) as arm, connect("/up/ft", timeout=LONG) as ft:
            first = until_felt(ft, arm)
            arm.enable()
            arm.move_jp(arm.measured_js(wait=LONG).position + np.repeat((0.0, 0.7), 3)).wait(LONG)
            assert not np.allclose(until_felt(ft, arm), first, atol=0.1)
            os.kill(lab.until(r"ft: started, process (\d+)"), signal.SIGKILL)
            lab.until("ft: measures", count=2)
            until_felt(ft, arm)
            os.kill(lab.until(r"arm: started, process (\d+)"), signal.SIGKILL)
            lab.until("arm: measures", count=2)
            assert np.allclose(until_felt(ft, arm), first, atol=1e-3), "it begins where it began"
        assert lab.end() == 0

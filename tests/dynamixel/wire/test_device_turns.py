"""Joints of more than one turn, over losses of power and of the driver: known, or not homed."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from rigs.dynamixel_bench import PATIENT, driver_at, eventually, place, sim_for

SCREW = {"id": 1, "model": "xm430-w350", "mode": "extended_position", "lower": -20.0, "upper": 20.0}
FAR = 8.998

DRIVER = """
import sys, time
sys.path[:0] = {path!r}
from rigs.dynamixel_bench import driver_at

class Sim:
    ttys = {ttys!r}

with driver_at(Sim(), {values!r}) as bench:
    bench.arm.enable()
    bench.arm.home()
    bench.arm.move_jp([9.5])
    time.sleep(60.0)
"""


@pytest.fixture
def values(tmp_path):
    joints = {"screw": {**SCREW, "velocity": 3.0, "acceleration": 20.0}}
    return {**PATIENT, "turns": str(tmp_path / "turns.yaml"), "joints": joints, "watchdog": 0.2}


@pytest.fixture
def sim(values):
    with sim_for(values) as sim:
        yield sim


def angle(sim) -> float:
    return sim.control.outputs()["bus1/1"]["angle"]


def power_cycle(sim) -> None:
    sim.control.inject("power_off")
    sim.control.clear()
    eventually(lambda: sim.control.status()["time"] > 0, "it starts")


def close_in_order(sim, values) -> None:
    with driver_at(sim, values) as bench:
        bench.arm.enable()
        bench.arm.home()
        bench.arm.disable()


def killed_in_motion(sim, values) -> None:
    """A driver that is killed while the joint turns, far from where it was when it began."""
    path = [str(Path(__file__).parents[2]), *filter(None, sys.path)]
    text = DRIVER.format(path=path, ttys=sim.ttys, values=values)
    process = subprocess.Popen([sys.executable, "-c", text])
    try:
        eventually(lambda: angle(sim) > FAR - 0.5, "it turns")
    finally:
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
    eventually(lambda: abs(sim.control.outputs()["bus1/1"]["velocity"]) < 1e-3, "it stands")


@pytest.mark.slow
def test_killed_and_without_power_it_is_not_homed(sim, values):
    close_in_order(sim, values)
    killed_in_motion(sim, values)
    power_cycle(sim)
    with driver_at(sim, values) as bench:
        assert not bench.status.is_homed
        (note,) = [note.text for note in bench.arm.health().notes if note.key == "not homed"]
        assert "joint screw (servo 1 on main) may be in another turn" in note
        bench.arm.enable()
        with bench.nothing_moves():
            bench.arm.home()
        eventually(lambda: bench.status.is_homed, "somebody has looked")


@pytest.mark.slow
def test_killed_with_power_all_along_it_counts_on(sim, values):
    close_in_order(sim, values)
    killed_in_motion(sim, values)
    with driver_at(sim, values) as bench:
        assert bench.status.is_homed
        assert bench.arm.measured_js().position[0] == pytest.approx(angle(sim), abs=4e-3)


def test_ended_in_order_it_is_known(sim, values):
    close_in_order(sim, values)
    with driver_at(sim, values) as bench:
        bench.arm.enable()
        assert bench.arm.move_jp([8.0]).wait(20.0)
        bench.until_still()
        bench.arm.disable()
    power_cycle(sim)
    with driver_at(sim, values) as bench:
        assert bench.status.is_homed
        assert bench.arm.measured_js().position == pytest.approx([8.0], abs=8e-3)


def test_turned_without_power_it_is_not_homed(sim, values):
    close_in_order(sim, values)
    place(sim, 1, 2.2)
    power_cycle(sim)
    with driver_at(sim, values) as bench:
        assert not bench.status.is_homed
        bench.arm.enable()
        bench.arm.home()
        eventually(lambda: bench.status.is_homed, "somebody has looked")
        bench.arm.unhome()
        eventually(lambda: not bench.status.is_homed, "given up")
    with driver_at(sim, values) as bench:
        assert not bench.status.is_homed, "and that is kept"


def test_without_a_file_nothing_is_taken_for_granted(sim, values):
    with driver_at(sim, values) as bench:
        assert not bench.status.is_homed

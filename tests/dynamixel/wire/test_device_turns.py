"""Joints of more than one turn, over losses of power and of the driver: known, or not homed."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from crtk_driver_dynamixel import PLUGIN
from crtk_driver_dynamixel.turns import TurnsFile
from crtk_drivers.errors import ConnectionLost
from rigs.dynamixel_bench import (
    BOOT_TIME,
    LONG,
    PATIENT,
    REGISTERS,
    SYNC_READ,
    configuration,
    driver_at,
    eventually,
    patient,
    place,
    sim_for,
)

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
    return {**PATIENT, "turns": str(tmp_path / "turns.yaml"), "joints": joints, "watchdog": 1.0}


@pytest.fixture
def sim(values):
    with sim_for(values) as sim:
        yield sim


def angle(sim) -> float:
    return sim.control.outputs()["bus1/1"]["angle"]


def power_cycle(sim) -> None:
    sim.control.inject("power_off")
    sim.control.clear()
    started = sim.control.status()["time"]
    eventually(lambda: sim.control.status()["time"] > started + BOOT_TIME, "it starts")


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
    values["joints"]["screw"]["velocity"] = 4.5
    close_in_order(sim, values)
    with driver_at(sim, values) as bench:
        bench.arm.enable()
        assert bench.arm.move_jp([7.0]).wait(20.0)
        bench.until_still()
        bench.arm.disable()
    power_cycle(sim)
    with driver_at(sim, values) as bench:
        assert bench.status.is_homed
        assert bench.arm.measured_js().position == pytest.approx([7.0], abs=8e-3)


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


# The device alone, as an I/O thread drives it.


@pytest.fixture(autouse=True)
def _patient():
    with patient():
        yield


class Alone:
    """A device in this thread, opened."""

    def __init__(self, sim, values):
        self.sim = sim
        self.device = PLUGIN.create(configuration(sim, {**values, "fast_read": False}))
        self.device.open(time.monotonic() + LONG)
        self.sample = None
        self.until(lambda: self.sample is not None, "it measures")

    def read(self):
        self.sample = self.device.read(time.monotonic() + 0.01) or self.sample

    def do(self, steps):
        for _ in steps:
            self.read()

    def until(self, test, what):
        def reached():
            self.read()
            return test()

        eventually(reached, what)

    def die(self):
        """As if the process had been killed: nothing is said any more, and nothing written."""
        for bus in self.device.link._buses.values():
            bus.close()

    @property
    def position(self) -> float:
        return self.sample.values["measured_js"].position[0]

    def assert_known(self):
        assert self.device.is_homed
        self.assert_position()

    def assert_position(self):
        assert self.position == pytest.approx(angle(self.sim), abs=6e-3)


def turns_of(values):
    return TurnsFile(values["turns"]).load()


def shifts_of(values):
    """Which are kept soon, by a thread of its own."""
    found = turns_of(values)
    return found.shifts if found else {}


def test_turns_that_were_forgotten_meanwhile_are_not_believed_after_a_crash(sim, values):
    """The shift that was found with the servo's restart is that of the file, too."""
    place(sim, 1, 8.0)
    alone = Alone(sim, values)
    alone.do(alone.device.home())
    alone.do(alone.device.enable())
    sim.control.inject("overload", id=1)
    alone.until(lambda: alone.device.condition.reason, "overload")
    alone.do(alone.device.enable())
    alone.assert_known()
    eventually(lambda: shifts_of(values).get("main/1") == -4096, "it is kept")
    alone.die()
    Alone(sim, values).assert_known()


def test_a_guess_is_no_more_than_that_after_a_crash(sim, values):
    place(sim, 1, 8.0)
    for _ in range(2):
        alone = Alone(sim, values)
        assert not alone.device.is_homed
        alone.do(alone.device.enable())
        alone.die()
    alone = Alone(sim, values)
    alone.do(alone.device.home())
    eventually(lambda: shifts_of(values), "it is kept")
    alone.die()
    Alone(sim, values).assert_known()


def test_a_line_that_is_lost_is_not_an_end_in_order(sim, values):
    """Nobody knows what the servo does from then on: it may turn as far as it likes."""
    close_in_order(sim, values)
    assert turns_of(values).clean
    alone = Alone(sim, values)
    assert alone.device.is_homed
    sim.control.inject("unplug")
    with pytest.raises(ConnectionLost):
        alone.until(lambda: False, "it is gone")
    alone.device.close()
    assert not turns_of(values).clean
    place(sim, 1, angle(sim) + 6.283)
    sim.control.clear()
    assert not Alone(sim, values).device.is_homed


def test_an_end_while_it_turns_is_not_one_in_order(sim, values):
    close_in_order(sim, values)
    alone = Alone(sim, values)
    sim.control.inject("push", id=1, torque=0.5)
    eventually(lambda: abs(sim.control.outputs()["bus1/1"]["velocity"]) > 1.0, "it turns")
    alone.device.close()
    assert not turns_of(values).clean


def test_a_servo_that_does_not_say_whether_it_lost_its_power_is_not_back(sim, values):
    place(sim, 1, 8.0)
    alone = Alone(sim, {**values, "silent_timeout": 2.5})
    link = alone.device.link
    sim.control.inject("power_off")
    alone.until(lambda: not link.answers(0), "it is silent")
    asked = {"code": SYNC_READ, "address": REGISTERS["torque_enable"][0]}
    sim.control.inject("message", **asked, times=4)
    sim.control.clear("power_off")
    alone.until(lambda: link.answers(0), "it is back")
    assert sim.control.status()["buses"]["bus1"]["tampered"] == 4
    alone.assert_position()

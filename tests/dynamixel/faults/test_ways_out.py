"""How a driver leaves servos that turn, by whatever way it ends, and how the next one finds them."""

import threading
import time

import pytest

from crtk_driver_dynamixel import PLUGIN, stopping
from crtk_driver_dynamixel.part import LEAVE_TIME
from crtk_drivers.device import Mode, Setpoint
from crtk_drivers.errors import StopUnconfirmed
from crtk_drivers.samples import vector
from rigs.dynamixel_bench import (
    LONG,
    SYNC_WRITE,
    WEIGHTLESS,
    arm_values,
    configuration,
    driver_at,
    eventually,
    patient,
    set_upright,
    sim_for,
)

WATCHDOG = 1.0
"""Seconds; the test is the driver, and may get no time for a while."""
VALUES = arm_values(mode_switch_dwell=0.0)
MOVING = {"servo_jv": [0.5, 0, 0, 0, 0, 0], "servo_jf": [0.6, 0, 0, 0, 0, 0]}
SOON = 0.5
"""Seconds, as for users, in which servos stand, where those are waited out before a port is closed."""
MOST = 30
"""More messages than a close has."""


@pytest.fixture(scope="module")
def shared():
    with sim_for(VALUES, servos=WEIGHTLESS) as sim:
        yield sim


@pytest.fixture
def sim(shared):
    set_upright(shared)
    return shared


@pytest.fixture(autouse=True)
def _patient():
    with patient():
        yield


# The device alone, as an I/O thread drives it.


class Alone:
    """A device in this thread, enabled, whose waist turns by velocity."""

    def __init__(self, sim, **values):
        self.sim = sim
        self.device = PLUGIN.create(configuration(sim, {**VALUES, "watchdog": WATCHDOG, **values}))

    def turning(self, name: str = "servo_jv"):
        device = self.device
        device.open(time.monotonic() + LONG)
        self.read()
        for _ in device.enable():
            self.read()
        mode = Mode.JOINT_VELOCITY if name == "servo_jv" else Mode.JOINT_EFFORT
        end = time.monotonic() + LONG
        while self.waist["velocity"] < 0.25:
            assert time.monotonic() < end
            device.write(Setpoint(mode, vector(MOVING[name])))
            self.read()
        return device

    def read(self) -> None:
        self.device.read(time.monotonic() + 0.01)

    @property
    def waist(self) -> dict:
        return self.sim.control.outputs()["bus1/1"]


def until_still(sim) -> None:
    eventually(
        lambda: all(abs(s["velocity"]) < 5e-3 for s in sim.control.outputs().values()), "it stands"
    )


@pytest.mark.sweep(4)
@pytest.mark.parametrize("effect", ["lost", "late"])
@pytest.mark.parametrize("name", MOVING)
def test_one_message_on_the_way_to_a_close(sim, name, effect):
    for number in range(1, MOST):
        alone = Alone(sim)
        device = alone.turning(name)
        before = sim.control.status()["buses"]["bus1"]["tampered"]
        sim.control.inject("message", code=SYNC_WRITE, number=number, effect=effect)
        device.stop()
        device.close()
        until_still(sim)
        was_hit = sim.control.status()["buses"]["bus1"]["tampered"] > before
        sim.control.clear()
        if not was_hit:
            break
        sim.control.call("place", id=1, angle=0.0)
    assert number > 2
    assert not was_hit


@pytest.mark.parametrize("name", MOVING)
def test_a_stop_that_cannot_be_read_back_is_said_and_the_watchdog_stays(sim, name, monkeypatch):
    """The wire is deaf from the stop on: the servos stop by themselves, as nobody disarms them."""
    monkeypatch.setattr(stopping, "STOP_TIME", SOON)
    device = Alone(sim).turning(name)
    sim.control.inject("lost")
    device.stop()
    assert not device.has_stopped
    with pytest.raises(StopUnconfirmed, match=r"joint waist .*not seen to have stopped"):
        device.close()
    if name == "servo_jv":
        until_still(sim)
    eventually(
        lambda: sim.control.outputs()["bus1/1"]["bus_watchdog"] == -1, "its watchdog has tripped"
    )


def test_a_driver_that_is_held_up_as_it_closes_sees_that_all_have_stopped(sim, monkeypatch):
    monkeypatch.setattr(stopping, "STOP_TIME", SOON)
    device = Alone(sim, watchdog=0.0).turning()
    exchange, held_up = device.link.exchange, [1.2 * LEAVE_TIME]

    def late_exchange():
        if held_up:
            time.sleep(held_up.pop())
        return exchange()

    monkeypatch.setattr(device.link, "exchange", late_exchange)
    device.stop()
    device.close()
    assert device.has_stopped
    until_still(sim)


@pytest.mark.slow  # test_faults.py has a bad wire
def test_a_burst_of_noise_in_motion(sim):
    """Longer than a servo may be silent: whatever gets through and whatever does not, nothing turns on."""
    values = {**VALUES, "watchdog": 0.1, "silent_timeout": 0.25, "latency_budget": 0.02}
    for number in range(4):
        with driver_at(sim, values) as bench:
            bench.enable()
            bench.stream(
                "servo_jv", MOVING["servo_jv"], lambda: bench.servos()[1]["velocity"] > 0.25
            )
            sim.control.inject("corrupt", every=1)
            sim.control.inject("lost", every=2 + number)
            time.sleep(0.6)  # the fault itself
            sim.control.clear()
            eventually(lambda: bench.engine.connected, "it is there again")
            bench.until_still()
            with bench.nothing_moves(counts=4):
                bench.cycles(20)
            assert bench.status.state in ("FAULT", "DISABLED"), bench.status


def test_nothing_is_said_on_the_line_to_a_servo_that_may_still_turn(sim):
    """Its watchdog counts every instruction on the line, also those of a driver that has just begun."""
    first = Alone(sim)
    first.turning()
    first.device.link.close()  # as if its process had died
    assert first.waist["velocity"] > 0.25
    second = Alone(sim)
    second.device.open(time.monotonic() + LONG)
    try:
        assert abs(second.waist["velocity"]) < 5e-3
        assert "torque is on" in second.device.found
        assert "waist" in second.device.found
    finally:
        second.device.close()


@pytest.mark.parametrize("disable", ["torque_off", "hold"])
def test_disable_stops_what_was_found_turning(sim, disable):
    """Without a watchdog, too: another program left it so."""
    first = Alone(sim, watchdog=0.0)
    first.turning()
    first.device.link.close()
    second = Alone(sim, watchdog=0.0, disable=disable)
    second.device.open(time.monotonic() + LONG)
    try:
        assert second.device.found == (
            "torque is on: waist, shoulder, elbow, forearm_roll, wrist_angle, wrist_rotate; "
            "joint waist (servo 1 on main) turns"
        )
        assert second.waist["velocity"] > 0.25, "it is not stopped unasked"
        for _ in second.device.disable():
            second.read()
        until_still(sim)
        assert second.waist["torque"] is (disable == "hold")
    finally:
        second.device.close()


def test_on_close_power_off(sim):
    with driver_at(sim, {**VALUES, "on_close": "power_off"}) as bench:
        bench.enable()
    assert not any(servo["torque"] for servo in sim.control.outputs().values())
    with driver_at(sim, VALUES) as bench:
        bench.enable()
    assert all(servo["torque"] for servo in sim.control.outputs().values())
    with driver_at(sim, {**VALUES, "on_close": "power_off"}):
        pass
    assert all(servo["torque"] for servo in sim.control.outputs().values()), "not enabled: left"


@pytest.mark.parametrize("name", MOVING)
def test_a_stop_does_not_need_the_thread_that_is_stuck(sim, name):
    """Nor a watchdog of the servos: what the core's own watchdog asks for reaches the line at once."""
    alone = Alone(sim, watchdog=0.0)
    device = alone.turning(name)
    mark = sim.control.status()["instructions"]
    began = time.monotonic()
    other = threading.Thread(target=device.stop)
    other.start()
    other.join(LONG)
    assert time.monotonic() - began < LONG / 2.0, "it waited"
    if name == "servo_jv":
        until_still(sim)
    else:
        eventually(lambda: alone.waist["torque_applied"] == 0.0, "it exerts nothing")
    sent = [entry["code"] for entry in sim.control.trace(after=mark)]
    assert sent == [SYNC_WRITE] * len(sent), "nothing of the thread of the line"
    assert not device.has_stopped, "nobody has read it back"
    device.close()
    assert device.has_stopped

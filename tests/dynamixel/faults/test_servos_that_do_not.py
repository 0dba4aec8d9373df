"""Servos that do not do what they are told, and do not say so: reset, blocked, deaf, a turn elsewhere."""

import contextlib
import math

import pytest

from crtk_drivers.commands import Kind
from crtk_drivers.errors import CommandRefused, TransitionFailed
from rigs.dynamixel_bench import (
    LONG,
    SYNC_WRITE,
    WEIGHTLESS,
    arm_values,
    driver_at,
    eventually,
    set_upright,
    sim_for,
)

VALUES = arm_values(mode_switch_dwell=0.0)
WAIST = "joint waist (servo 1 on main)"
STARTUP = 60
ZERO = [0.0] * 6


@pytest.fixture(scope="module")
def shared():
    with sim_for(VALUES, servos=WEIGHTLESS) as sim:
        yield sim


@pytest.fixture
def sim(shared):
    set_upright(shared)
    return shared


def write(sim, id, address, data):
    sim.control.call("write", id=id, address=address, data=data)


# 18: a dip of the supply.


def test_a_servo_that_takes_torque_by_itself_is_set_up_not_to(sim):
    write(sim, 1, STARTUP, "01")
    with driver_at(sim, VALUES) as bench:
        bench.enable()
        assert {(w.id, w.address, w.data) for w in bench.eeprom_writes()} >= {(1, STARTUP, b"\0")}
    sim.control.inject("power_off", id=1)
    sim.control.clear()
    eventually(lambda: sim.control.outputs()["bus1/1"]["powered"], "it is there")
    assert sim.control.outputs()["bus1/1"]["torque"] is False


def test_a_servo_that_may_not_be_set_up_is_refused(sim):
    with driver_at(sim, VALUES) as bench:
        bench.enable()
        bench.arm.disable()
        bench.arm.gripper.disable()
    write(sim, 1, STARTUP, "01")
    with (
        driver_at(sim, {**VALUES, "write_eeprom": False}) as bench,
        pytest.raises(TransitionFailed, match="startup_configuration 1 to 0"),
    ):
        bench.arm.enable(timeout=LONG)
    write(sim, 1, STARTUP, "00")


@pytest.mark.parametrize("watchdog", [1.0, 0.0])
def test_a_servo_that_was_reset_is_a_fault(sim, watchdog):
    """Also where its start-up configuration was changed after enable, so that it has torque again."""
    with driver_at(sim, {**VALUES, "watchdog": watchdog}) as bench:
        bench.enable()
        write(sim, 1, STARTUP, "01")
        sim.control.inject("power_off", id=1)
        sim.control.clear()
        bench.until_state("FAULT", f"{WAIST}: it was reset")
        assert bench.servos()[1]["torque"] is True
        assert abs(bench.servos()[1]["angle"]) < 0.02
        write(sim, 1, STARTUP, "00")


def test_a_servo_that_was_reset_in_somebodys_hand_is_a_fault(sim):
    with driver_at(sim, VALUES) as bench:
        bench.enable()
        bench.arm.free()
        eventually(lambda: bench.servos()[1]["torque"] is False, "it is free")
        write(sim, 1, STARTUP, "01")
        sim.control.inject("power_off", id=1)
        sim.control.clear()
        bench.until_state("FAULT", f"{WAIST}: it was reset")
        write(sim, 1, STARTUP, "00")


# 16: goals that do not arrive, and joints that do not move.


def test_a_goal_that_is_lost_is_sent_again(sim):
    with driver_at(sim, VALUES) as bench:
        bench.enable()
        goal = [0.3, *ZERO[1:]]
        assert bench.arm.move_jp(goal).wait(LONG)
        sim.control.inject("message", code=SYNC_WRITE, address=116)
        bench.arm.servo_jp([0.31, *ZERO[1:]])
        eventually(
            lambda: abs(bench.servos()[1]["angle"] - 0.31) < 0.003, "it arrives all the same"
        )
        assert bench.status.state == "ENABLED"


def test_a_servo_that_takes_no_goals_is_a_fault(sim):
    """Its own limits were narrowed behind our back: it refuses, and nobody answers a group write."""
    with driver_at(sim, VALUES) as bench:
        bench.enable()
        bench.cycles(3)
        write(sim, 1, 48, (2200).to_bytes(4, "little").hex())
        bench.arm.move_jp([0.6, *ZERO[1:]])
        bench.until_state("FAULT", "waist")
        bench.until_still()
        write(sim, 1, 48, (4095).to_bytes(4, "little").hex())


def test_a_blocked_joint_does_not_jump_when_it_comes_free(sim):
    with driver_at(sim, VALUES) as bench:
        bench.enable()
        sim.control.inject("stuck", id=1)
        bench.arm.move_jp([0.8, *ZERO[1:]])
        bench.until_state("FAULT", "waist")
        eventually(lambda: bench.device.has_stopped, "it has stopped")
        with bench.nothing_moves(counts=4):
            sim.control.clear()
            bench.cycles(20)


def test_following_is_declared():
    with sim_for(VALUES) as sim, driver_at(sim, VALUES, start=False) as bench:
        following = bench.device.capabilities.following
        assert following.error == (0.35,) * 6
        assert following.arrival == (0.1,) * 6
        assert bench.session.children["gripper"].device.capabilities.following is None, "it grips"
        slow = {**VALUES, "joints": {"waist": {"profile_velocity": 0.2}}}
        with driver_at(sim, slow, start=False) as other:
            declared = other.device.capabilities
            assert declared.following.error == (math.inf, *(0.35,) * 5), "it takes its time"
            assert declared.following.arrival == (0.1,) * 6
            assert declared.move_limits[0].velocity == 0.2
            assert declared.move_limits[1:] == declared.limits[1:]


# 2: a turn is not lost.


@pytest.mark.parametrize("name", ["servo_jv", "servo_jf"])
def test_a_joint_that_left_its_turn_is_a_fault_and_stays_where_it_is(sim, name):
    """Position mode would count it a turn elsewhere, and lead it on in the same direction."""
    with driver_at(sim, {**VALUES, "stream_timeout": 2.0}) as bench:
        bench.enable()
        kind = Kind.VELOCITY if name == "servo_jv" else Kind.EFFORT
        bench.stream(name, ZERO, lambda: bench.device.part.kind is kind)
        with contextlib.suppress(CommandRefused):  # the core stops it beyond its range
            bench.place(joint_1=3.4)
            bench.arm.hold()
        bench.until_state("FAULT")
        eventually(lambda: bench.servos()[1]["torque"], "it is held")
        bench.until_still()
        angle = bench.servos()[1]["angle"]
        assert "outside its own limits" in bench.device.condition.reason
        assert bench.arm.measured_js(age=0).position[0] == pytest.approx(angle, abs=0.01)
        with bench.nothing_moves(), pytest.raises(TransitionFailed, match="by hand"):
            bench.arm.enable(timeout=LONG)
        bench.place(joint_1=0.0)
        bench.arm.enable(timeout=LONG)
        assert bench.arm.measured_js().position[0] == pytest.approx(0.0, abs=0.01)

"""AX, MX with protocol 1.0 and XL-320: they take torque with a goal, and have modes of their own."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from crtk_drivers.errors import CommandRefused, CrtkError, TransitionFailed
from rigs.dynamixel_bench import (
    BOOT_TIME,
    LONG,
    PATIENT,
    DynamixelBench,
    driver_at,
    dynamixel_bench,
    eventually,
    opened,
    place,
    sim_for,
)

OLDER = ["ax-12a", "xl-320", "mx-28-1.0"]
ANGLE_LIMITS, TORQUE, GOAL_POSITION, MOVING_SPEED, TORQUE_MODE, GOAL_TORQUE = 6, 24, 30, 32, 70, 71
PROTOCOL_TYPE = 13
SHOCK = 4
FAST = 0.05
"""rad/s; what stands is slower."""


def values(model: str, **joint: Any) -> dict[str, Any]:
    first = {"id": 1, "model": model, "velocity": 3.0, **joint}
    return {**PATIENT, "joints": {"a": first, "b": {"id": 2, "model": model, "velocity": 3.0}}}


def write(sim: Any, address: int, *numbers: int, size: int = 2) -> None:
    """As another program would."""
    data = "".join(number.to_bytes(size, "little").hex() for number in numbers)
    sim.control.call("write", id=1, address=address, data=data)


def speed(sim: Any) -> float:
    return abs(float(sim.control.outputs()["bus1/1"]["velocity"]))


def until_started(sim: Any) -> None:
    started = sim.control.status()["time"]
    eventually(lambda: sim.control.status()["time"] > started + BOOT_TIME, "it starts")


@contextmanager
def left_turning(model: str, joint: dict[str, Any]) -> Iterator[Any]:
    """A simulated servo that another program has left in motion."""
    with sim_for(joint, servos=f"1:{model},2:{model}", return_delay=0) as sim:
        if model == "mx-64-1.0":
            write(sim, TORQUE, 1, size=1)
            write(sim, TORQUE_MODE, 1, size=1)
            write(sim, GOAL_TORQUE, 200)
        else:
            write(sim, ANGLE_LIMITS, 0, 0)
            write(sim, MOVING_SPEED, 300)
        eventually(lambda: speed(sim) > 1.0, "it turns")
        yield sim


# A loss of power. The joint falls meanwhile, and would jump back.


def dip(bench: DynamixelBench) -> None:
    bench.sim.control.inject("power_off", id=1)
    bench.place(joint_1=0.2)
    bench.sim.control.clear()


@pytest.mark.parametrize("model", OLDER)
def test_a_held_servo_that_lost_power_stays_without_torque(model: str) -> None:
    with dynamixel_bench(values(model)) as bench:
        bench.arm.enable(timeout=LONG)
        assert bench.arm.move_jp([0.05, 0.0]).wait(LONG)
        dip(bench)
        bench.until_state("FAULT", "joint a (servo 1 on main): its torque is off")
        with bench.nothing_moves():
            bench.cycles(20)
        assert bench.torques() == [False, True]
        assert bench.angles()[0] == pytest.approx(0.2, abs=0.01)
        with bench.nothing_moves(counts=6):
            bench.arm.enable(timeout=LONG)
        assert bench.torques() == [True, True]


@pytest.mark.parametrize("model", OLDER)
def test_a_streamed_servo_that_lost_power_stays_without_torque(model: str) -> None:
    with dynamixel_bench({**values(model), "stream_timeout": 2.0}) as bench:
        bench.arm.enable(timeout=LONG)

        def stream() -> bool:
            try:
                bench.arm.servo_jp([0.0, 0.0])
            except CommandRefused:
                return True
            time.sleep(0.005)
            return False

        assert not stream()
        dip(bench)
        eventually(stream, "it takes no more")
        bench.until_state("FAULT", "joint a (servo 1 on main): its torque is off")
        bench.cycles(20)
        assert bench.torques() == [False, True]
        assert bench.angles()[0] == pytest.approx(0.2, abs=0.01)


# What another program has left behind.


@pytest.mark.parametrize("model", OLDER)
def test_a_hold_is_not_slowed_by_what_was_left(model: str) -> None:
    """With a moving speed of its own a servo would go on to its goal, long after a stop was seen."""
    with dynamixel_bench(values(model)) as bench:
        write(bench.sim, MOVING_SPEED, 10)
        write(bench.sim, TORQUE, 0, size=1)
        bench.arm.enable(timeout=LONG)
        bench.arm.move_jp([0.3, 0.0])
        eventually(lambda: bench.arm.setpoint_js().position[0] > 0.2, "it is on its way")
        bench.arm.hold()
        bench.cycles(10)
        with bench.nothing_moves(counts=4):
            bench.cycles(40)
        assert bench.angles()[0] > 0.15


@pytest.mark.parametrize("model", ["ax-12a", "mx-28-1.0"])
def test_a_wheel_stands_once_enable_was_refused(model: str) -> None:
    joint = values(model)
    with left_turning(model, joint) as sim, driver_at(sim, joint) as bench:
        assert "joint a (servo 1 on main) turns" in bench.status.detail
        with pytest.raises(TransitionFailed, match="wheel"):
            bench.arm.enable(timeout=LONG)
        assert speed(sim) < FAST


def test_a_multi_turn_servo_stands_once_enable_was_refused() -> None:
    """Its goal is some turns away."""
    joint = values("mx-28-1.0")
    with sim_for(joint, return_delay=0) as sim:
        write(sim, ANGLE_LIMITS, 4095, 4095)
        write(sim, GOAL_POSITION, 20_000, 200)
        eventually(lambda: speed(sim) > 1.0, "it turns")
        with driver_at(sim, joint) as bench:
            with pytest.raises(TransitionFailed, match="multi-turn"):
                bench.arm.enable(timeout=LONG)
            eventually(lambda: speed(sim) < FAST, "it stands")
            assert sim.control.outputs()["bus1/1"]["angle"] < 20.0, "its goal is at 27.5"


def test_a_servo_left_in_torque_mode_is_held() -> None:
    """In it a servo heeds no goal position: it would turn on, with its goals read back."""
    joint = values("mx-64-1.0")
    with left_turning("mx-64-1.0", joint) as sim, driver_at(sim, joint) as bench:
        bench.arm.enable(timeout=LONG)
        with bench.nothing_moves():
            bench.cycles(20)
        assert bench.torques() == [True, True]
        assert bench.arm.move_jp([0.2, 0.0]).wait(LONG)


@pytest.mark.parametrize("model", ["ax-12a", "xl-320"])
@pytest.mark.parametrize("angle", [2.8, -3.0])
def test_a_joint_in_its_dead_zone_is_not_enabled(model: str, angle: float) -> None:
    """It tells the end of its range there, and would turn to it."""
    with dynamixel_bench(values(model)) as bench:
        bench.place(joint_1=angle)
        bench.cycles(3)
        with bench.nothing_moves(), pytest.raises(CrtkError, match="stands at count"):
            bench.arm.enable(timeout=LONG)
        assert bench.torques() == [False, False]
        bench.place(joint_1=2.61)
        bench.cycles(3)
        bench.arm.enable(timeout=LONG)


def test_the_end_of_a_range_can_be_enabled_again() -> None:
    """Goals keep one count from the end, beyond which nothing is measured."""
    with dynamixel_bench(values("ax-12a")) as bench:
        bench.arm.enable(timeout=LONG)
        end = bench.device.capabilities.limits[0].upper
        assert bench.arm.move_jp([end, 0.0]).wait(LONG)
        bench.until_still()
        bench.arm.disable()
        bench.arm.enable(timeout=LONG)


# Limits.


def test_a_profile_velocity_bounds_an_older_servo() -> None:
    with dynamixel_bench(values("ax-12a", profile_velocity=0.3)) as bench:
        bench.arm.enable(timeout=LONG)
        bench.arm.move_jp([0.6, 0.0])
        assert 0.2 < bench.watch(0.5) < 0.4


def test_a_pwm_limit_bounds_an_older_servo() -> None:
    """A push that its whole torque would withstand turns it."""
    for limit, is_turned in ((None, False), (0.2, True)):
        with dynamixel_bench(values("ax-12a", pwm_limit=limit)) as bench:
            bench.arm.enable(timeout=LONG)
            bench.sim.control.inject("push", id=1, torque=0.6)
            bench.watch(0.4)
            assert bool(abs(bench.angles()[0]) > 0.1) is is_turned
            bench.sim.control.clear()
            bench.until_still()


# Resets and errors.


@pytest.mark.parametrize("model", ["xm430-w350", "xl-320"])
def test_a_servo_that_is_reset_as_it_gets_torque_loses_it(model: str) -> None:
    """Nothing else tells of it: without its watchdog, and with the status level of its start."""
    config = {**values(model, profile_velocity=0.3), "watchdog": 0.0, "status_return_level": 2}
    with sim_for(config) as sim, opened(sim, config) as device:
        link, dips = device.link, []  # type: ignore[attr-defined]
        whole = link.write_values

        def weak(wanted: Any) -> None:
            if not dips and any(given.get("torque_enable") for given in wanted.values()):
                dips.append(1)
                sim.control.inject("power_off", id=1)
                sim.control.clear()
                until_started(sim)
            whole(wanted)

        link.write_values = weak

        def enable() -> None:
            for _ in device.enable():
                device.read(time.monotonic() + 1.0)

        with pytest.raises(CrtkError, match=r"a \(servo 1 on main\) was reset as it got torque"):
            enable()
        eventually(lambda: not sim.control.outputs()["bus1/1"]["torque"], "it has no torque")


def test_an_x_servo_with_protocol_1_keeps_its_error() -> None:
    config = values("xm430-w350", protocol=1)
    del config["joints"]["b"]
    with sim_for(config) as sim:
        write(sim, PROTOCOL_TYPE, 1, size=1)
        with driver_at(sim, config) as bench:
            bench.arm.enable(timeout=LONG)
            sim.control.inject("hardware_error", id=1, bit=SHOCK)
            bench.until_state("FAULT", "electrical shock")
            before = len(bench.log.statuses)
            bench.cycles(30)
            assert bench.log.statuses[before:] == []
            assert "electrical shock" in bench.device.condition.reason
            place(sim, 1, 0.0)

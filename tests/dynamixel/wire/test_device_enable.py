"""Connecting, enabling and disabling servos: what is written to them, and that nothing moves."""

import numpy as np
import pytest

from crtk_drivers.errors import TransitionFailed
from rigs.dynamixel_bench import (
    COUNT,
    HARMLESS,
    LONG,
    REBOOT,
    WEIGHTLESS,
    arm_values,
    driver_at,
    eventually,
    set_upright,
    sim_for,
    torque_ons,
)


@pytest.fixture(scope="module")
def shared():
    with sim_for(arm_values(), servos=WEIGHTLESS) as sim:
        yield sim


@pytest.fixture
def sim(shared):
    set_upright(shared)
    return shared


def count_of(angle: float) -> float:
    return 2048 + angle / COUNT


def set_up(sim, **values) -> None:
    """Have a driver write what the configuration wants, and leave without torque."""
    with driver_at(sim, arm_values(**values)) as bench:
        bench.enable()
        bench.arm.disable()
        bench.arm.gripper.disable()


def test_a_servo_on_its_way_stands_once_enable_was_refused(sim):
    """Another program has sent it far, slowly; its torque forbids what enable has to write."""

    def write(address, number, size):
        sim.control.call("write", id=1, address=address, data=number.to_bytes(size, "little").hex())

    def speed():
        return abs(sim.control.outputs()["bus1/1"]["velocity"])

    write(10, 4, 1)  # a profile by time
    write(112, 6000, 4)
    write(64, 1, 1)
    write(116, 3900, 4)
    eventually(lambda: speed() > 0.2, "it turns")
    with driver_at(sim, arm_values()) as bench:
        with pytest.raises(TransitionFailed, match="which its torque forbids"):
            bench.arm.enable(timeout=LONG)
        eventually(lambda: speed() < 0.05, "it stands")
        assert sim.control.outputs()["bus1/1"]["angle"] < 2.0, "its goal is at 2.84"
        bench.arm.disable()


def test_connecting_only_reads(sim):
    set_up(sim)
    with driver_at(sim, arm_values(), start=False) as bench, bench.nothing_moves():
        mark = bench.mark()
        bench.session.start()
        bench.until_connected()
        bench.cycles(20)
        assert {entry["code"] for entry in bench.trace(mark)} <= HARMLESS
        assert not any(bench.torques())
        assert bench.status.state == "DISABLED"


def test_connecting_leaves_torque_that_is_on(sim):
    with driver_at(sim, arm_values(disable="hold")) as bench:
        bench.enable()
    assert all(bench.torques())
    with driver_at(sim, arm_values(), start=False) as bench, bench.nothing_moves():
        mark = bench.mark()
        bench.session.start()
        bench.until_connected()
        bench.cycles(20)
        assert {entry["code"] for entry in bench.trace(mark)} <= HARMLESS
        assert bench.status.state == "DISABLED"
        assert all(bench.torques())
        bench.enable()
        assert all(bench.torques())


def test_a_cycle_is_one_request_for_arm_and_gripper(sim):
    # Nothing is asked for again where an answer is late.
    late = {"latency_budget": 0.5, "silent_timeout": 9.0, "sample_timeout": 10.0}
    with driver_at(sim, arm_values(slow_interval=60.0, **late)) as bench:
        bench.cycles(5)
        before, mark = bench.arm.health().samples, bench.mark()  # between them it goes on
        bench.cycles(50)
        requests, samples = bench.mark() - mark, bench.arm.health().samples - before
        assert requests <= samples + 5


def test_torque_comes_on_with_the_goal_where_the_servo_is(sim):
    with driver_at(sim, arm_values()) as bench:
        bench.place(joint_1=0.4, joint_2=-0.02, joint_5=0.7, joint_7=0.3)
        bench.cycles(3)
        with bench.nothing_moves():
            angles = {id: servo["angle"] for id, servo in bench.servos().items()}
            mark = bench.mark()
            bench.enable()
            bench.cycles(10)
        ons = torque_ons(bench.writes(mark))
        assert sorted(on.id for on in ons) == [1, 2, 3, 4, 5, 6, 7]
        for on in ons:
            goal = on.registers["goal_position"]
            assert goal == pytest.approx(count_of(angles[on.id]), abs=2), f"servo {on.id}"
        assert all(bench.torques())


@pytest.mark.parametrize("mode", ["position", "extended_position", "current_based_position"])
def test_every_position_mode_is_entered_without_a_jump(sim, mode):
    joints = {"elbow": {"mode": mode}, "wrist_angle": {"mode": mode}}
    if mode == "current_based_position":
        joints["elbow"]["current_limit"] = 3.0
    with driver_at(sim, arm_values(joints=joints)) as bench:
        bench.place(joint_3=0.5, joint_5=-0.3)
        bench.cycles(3)
        with bench.nothing_moves():
            mark = bench.mark()
            bench.enable()
            bench.cycles(10)
        wanted = {"position": 3, "extended_position": 4, "current_based_position": 5}[mode]
        ons = {on.id: on for on in torque_ons(bench.writes(mark))}
        assert ons[3].registers.get("operating_mode", wanted) == wanted
        assert ons[3].registers["goal_position"] == pytest.approx(count_of(0.5), abs=30)
        goal = bench.arm.measured_js().position.copy()
        goal[2] -= 0.2
        assert bench.arm.move_jp(goal).wait(LONG)
        bench.until_still()
        assert np.abs(bench.arm.measured_js().position - goal).max() < 5e-3


def test_eeprom_is_written_where_it_differs_and_only_there(sim):
    with driver_at(sim, arm_values(return_delay=20e-6)) as bench:
        mark = bench.mark()
        bench.enable()
        first = {(w.id, w.address, w.data) for w in bench.eeprom_writes(mark)}
        assert {(id, 9, b"\x0a") for id in range(1, 8)} <= first
        bench.arm.disable()
        mark = bench.mark()
        bench.arm.enable()
        assert bench.eeprom_writes(mark) == []
    with driver_at(sim, arm_values(return_delay=20e-6, disable="torque_off")) as bench:
        mark = bench.mark()
        bench.enable()
        assert bench.eeprom_writes(mark) == [], "the next process finds nothing to write either"


def test_eeprom_that_torque_protects_is_not_written(sim):
    with driver_at(sim, arm_values(return_delay=20e-6, disable="hold")) as bench:
        bench.enable()
    with driver_at(sim, arm_values(return_delay=0.0)) as bench, bench.nothing_moves():
        mark = bench.mark()
        with pytest.raises(TransitionFailed, match=r"its torque forbids.*send disable"):
            bench.arm.enable(timeout=LONG)
        assert bench.eeprom_writes(mark) == []
        assert bench.status.state == "FAULT"
        assert "joint waist (servo 1 on main)" in bench.status.detail
        assert all(bench.torques()), "and it still holds"
        bench.arm.disable()
        bench.arm.enable()


def test_without_leave_to_write_eeprom_the_difference_is_told(sim):
    set_up(sim, return_delay=20e-6)
    with driver_at(sim, arm_values(return_delay=0.0, write_eeprom=False)) as bench:
        mark = bench.mark()
        with pytest.raises(TransitionFailed, match=r"return_delay_time 10 to 0.*write_eeprom"):
            bench.arm.enable(timeout=LONG)
        assert bench.eeprom_writes(mark) == []
        assert not any(bench.torques())
    with driver_at(sim, arm_values(return_delay=20e-6, write_eeprom=False)) as bench:
        bench.arm.enable()


def test_disable_takes_the_torque_or_leaves_it(sim):
    with driver_at(sim, arm_values()) as bench:
        bench.enable()
        bench.arm.disable()
        assert bench.torques() == [False] * 6 + [True], "the gripper has a state of its own"
        bench.arm.gripper.disable()
        assert not any(bench.torques())
    with driver_at(sim, arm_values(disable="hold")) as bench:
        bench.enable()
        with bench.nothing_moves():
            bench.arm.disable()
            bench.cycles(20)
        assert all(bench.torques())
        assert bench.status.state == "DISABLED"


@pytest.mark.parametrize(
    ("name", "value"), [("servo_jv", [0.2, 0, 0, 0, 0, 0.2]), ("servo_jf", [0.5, 0, 0, 0, 0, 0.1])]
)
def test_disable_under_a_stream_stays_disabled(sim, name, value):
    with driver_at(sim, arm_values()) as bench:
        bench.enable()
        bench.stream(name, value, lambda: abs(bench.servos()[1]["velocity"]) > 0.05)
        bench.arm.disable()
        bench.cycles(30)
        assert bench.torques() == [False] * 6 + [True]
        assert bench.status.state == "DISABLED"
    with driver_at(sim, arm_values(disable="hold")) as bench:
        bench.enable()
        bench.stream(name, value, lambda: abs(bench.servos()[1]["velocity"]) > 0.05)
        bench.arm.disable()
        bench.until_still()
        with bench.nothing_moves():
            bench.cycles(30)
        assert all(bench.torques())


def test_free_lets_go_and_hold_takes_the_arm_where_it_is(sim):
    with driver_at(sim, arm_values()) as bench:
        bench.enable()
        bench.arm.free()
        bench.cycles(10)
        assert bench.torques() == [False] * 6 + [True]
        assert bench.status.state == "ENABLED"
        bench.place(joint_1=0.3, joint_4=-0.5)
        bench.cycles(3)
        with bench.nothing_moves():
            bench.arm.hold()
            bench.cycles(20)
        assert all(bench.torques())
        assert bench.arm.setpoint_js().position[0] == pytest.approx(0.3, abs=5e-3)
        with bench.nothing_moves(ids=(2, 4, 5, 6)):
            goal = bench.arm.measured_js().position.copy()
            goal[0] = 0.2
            assert bench.arm.move_jp(goal).wait(LONG)


def test_free_in_the_midst_of_a_change_of_mode_lets_go_and_nothing_turns(sim):
    with driver_at(sim, arm_values()) as bench:
        bench.enable()

        def change_begins() -> None:
            if bench.device.part._work is not None:
                bench.engine.on_sample = None
                bench.arm.free()

        bench.engine.on_sample = change_begins
        mark = bench.mark()
        with bench.nothing_moves():
            bench.arm.servo_jv([0.5] + [0.0] * 5)
            eventually(lambda: bench.engine._motion.is_free, "it is free")
            eventually(lambda: bench.device.part._work is None, "the change of mode is over")
            bench.cycles(20)
        assert bench.torques() == [False] * 6 + [True]
        assert {value for _, value in bench.written("goal_velocity", mark)} <= {0}
        assert bench.status.state == "ENABLED"


def test_disable_while_free(sim):
    with driver_at(sim, arm_values()) as bench:
        bench.enable()
        bench.arm.free()
        bench.cycles(10)
        bench.arm.disable()
        bench.cycles(30)
        assert bench.torques() == [False] * 6 + [True]
        assert bench.status.state == "DISABLED"


def test_the_bus_watchdog_is_armed_by_enable_and_disarmed_at_the_end(sim):
    with driver_at(sim, arm_values(watchdog=1.0)) as bench:
        mark = bench.mark()
        bench.enable()
        assert {(id, 50) for id in range(1, 8)} <= set(bench.written("bus_watchdog", mark))
        mark = bench.mark()
    assert {(id, 0) for id in range(1, 8)} <= set(bench.written("bus_watchdog", mark))
    with bench.nothing_moves():
        assert bench.watch(1.1) < 5e-3
    assert all(bench.torques())


def test_no_servo_is_restarted_without_need(sim):
    with driver_at(sim, arm_values()) as bench:
        mark = bench.mark()
        bench.enable()
        assert REBOOT not in {entry["code"] for entry in bench.trace(mark)}


def test_bounds_of_an_earlier_configuration_do_not_stay(sim):
    """Goal Current and Goal PWM outlive the driver that wrote them, and bound every mode."""
    bounds = {"current_limit": 1.0, "pwm_limit": 0.5}
    with driver_at(sim, arm_values(joints={"waist": bounds}, gripper=bounds)) as bench:
        mark = bench.mark()
        bench.enable()
        written = [dict(bench.written(name, mark)) for name in ("goal_current", "goal_pwm")]
        assert [(by_id[1], by_id[7]) for by_id in written] == [(371, 371), (442, 442)]
    with driver_at(sim, arm_values()) as bench:
        mark = bench.mark()
        bench.enable()
        written = [dict(bench.written(name, mark)) for name in ("goal_current", "goal_pwm")]
        assert [(by_id[1], by_id[7]) for by_id in written] == [(2047, 297), (885, 885)]

"""Chains of every shape: packaged arms, grippers, shadows, several buses, both protocols, many turns."""

import math
import time

import numpy as np
import pytest

import crtk_drivers
from crtk_driver_dynamixel import PLUGIN
from crtk_driver_dynamixel.arms import names
from crtk_driver_dynamixel.calibration import Calibration, ServoCalibration, save_calibration
from crtk_driver_dynamixel.gripper import SliderCrank
from crtk_drivers.commands import Kind
from crtk_drivers.config import from_values, load
from crtk_drivers.device import Mode
from crtk_drivers.errors import ConnectionFailed, CrtkError, TransitionFailed
from crtk_drivers.session import Session
from rigs.dynamixel_bench import (
    BOOT_TIME,
    COUNT,
    HARMLESS,
    LONG,
    PATIENT,
    READ,
    REBOOT,
    arm_values,
    configuration,
    driver_at,
    dynamixel_bench,
    eventually,
    lenient,
    opened,
    patient,
    place,
    set_upright,
    sim_for,
    torque_ons,
)
from rigs.dynamixel_packets import status2
from rigs.dynamixel_peer import Peer


@pytest.mark.parametrize("arm", names())
def test_each_packaged_arm_works_out_of_the_box_with_sim(arm):
    with lenient(), crtk_drivers.connect("dynamixel", sim=True, **arm_values(arm)) as device:
        device.enable()
        device.gripper.enable()
        goal = device.measured_js().position + 0.05
        move = device.move_jp(goal)
        grip = device.gripper.measured_js().position + 0.005
        assert device.gripper.move_jp(grip).wait(LONG)
        assert move.wait(LONG)
        eventually(lambda: np.abs(device.measured_js().position - goal).max() < 6e-3, "at the goal")
        device.disable()
        device.gripper.disable()


FINGER = SliderCrank(0.022, 0.036, 0.042)


@pytest.fixture(scope="module")
def shared():
    with sim_for(arm_values()) as sim:
        yield sim


@pytest.fixture
def bench(shared):
    set_upright(shared)
    with driver_at(shared, arm_values()) as bench:
        yield bench


def test_the_opening_of_the_gripper_follows_from_the_angle_of_its_servo(bench):
    for angle in (0.0, 0.4, -0.3):
        bench.place(joint_7=angle)
        wanted = FINGER.opening(angle)
        eventually(
            lambda w=wanted: (
                abs(bench.arm.gripper.measured_js().position[0] - w) < 5e-5  # 50 um
            ),
            f"opening {wanted} m",
        )


def test_the_gripper_moves_while_the_arm_moves_and_is_enabled_alone(bench):
    bench.arm.gripper.enable()
    assert bench.torques() == [False] * 6 + [True]
    assert bench.status.state == "DISABLED"
    bench.arm.enable()
    arm = bench.arm.move_jp([0.4, 0, 0, 0, 0, 0.4])
    assert bench.arm.gripper.move_jp([0.06]).wait(LONG)
    assert arm.wait(LONG)
    bench.until_still()
    assert FINGER.opening(bench.servos()[7]["angle"]) == pytest.approx(0.06, abs=2e-4)
    assert bench.servos()[1]["angle"] == pytest.approx(0.4, abs=5e-3)
    bench.arm.disable()
    assert bench.arm.gripper.is_enabled()
    assert bench.torques() == [False] * 6 + [True]


def test_the_force_of_the_gripper_is_bounded_by_its_current(bench):
    mark = bench.mark()
    bench.arm.gripper.enable()
    (on,) = torque_ons(bench.writes(mark))
    assert on.registers.get("operating_mode", 5) == 5
    assert on.registers["goal_current"] == math.floor(0.8 / 2.69e-3)
    bench.sim.control.inject("stuck", id=7)
    here = float(bench.arm.gripper.measured_js().position[0])
    bench.arm.gripper.move_jp([here - 0.01])
    eventually(lambda: abs(bench.servos()[7]["torque_applied"]) > 1.0, "it grasps")
    stall_current = 2.3  # A, at 4.1 N.m
    assert abs(bench.servos()[7]["torque_applied"]) < 1.05 * 4.1 * 0.8 / stall_current


def test_a_fault_of_the_gripper_is_its_own(bench):
    bench.enable()
    bench.sim.control.inject("overload", id=7)
    gripper = bench.session.children["gripper"]
    bench.until_state("FAULT", "overload", gripper)
    assert bench.status.state == "ENABLED"
    assert bench.arm.move_jp([0.1, 0, 0, 0, 0, 0]).wait(LONG)
    bench.arm.gripper.enable()


def test_a_gripper_without_an_arm():
    gripper = {"id": 7, "model": "xm430-w350", "closed": -0.5, "open": 1.0, "velocity": 3.0}
    with dynamixel_bench({**PATIENT, "gripper": {**gripper, "effort": 1.0}}) as bench:
        assert bench.session.children == {}
        assert bench.engine.capabilities.joints == ("gripper",)
        (step,) = bench.engine.capabilities.velocity_resolution
        assert step == pytest.approx(0.229 * 2.0 * math.pi / 60.0), "what one count of it is"
        bench.arm.enable()
        assert bench.arm.move_jp([0.4]).wait(LONG)
        bench.until_still()
        assert bench.angles() == pytest.approx([0.4], abs=3 * COUNT)
        bench.sim.control.inject("stuck", id=7)
        bench.stream("servo_jf", [0.5], lambda: bench.servos()[7]["torque_applied"] > 0.45)


def test_shadow_servos_turn_their_joint_together():
    with dynamixel_bench(arm_values("vx300s")) as bench:
        mark = bench.mark()
        with bench.nothing_moves():
            bench.enable()
        assert all(bench.torques())
        ons = {on.id: on.registers for on in torque_ons(bench.writes(mark))}
        assert ons[3]["goal_position"] == pytest.approx(ons[2]["goal_position"], abs=2)
        goal = np.array([0.1, 0.2, -0.1, 0.1, 0.1, 0.1])
        mark = bench.mark()
        assert bench.arm.move_jp(goal).wait(LONG)
        bench.until_still()
        followers = {3, 5}
        assert not followers & {id for id, _ in bench.written("goal_position", mark)}
        assert bench.arm.measured_js().position == pytest.approx(goal, abs=6e-3)
        applied = {id: servo["torque_applied"] for id, servo in bench.servos().items()}
        assert abs(applied[2]) == pytest.approx(abs(applied[3]), rel=0.3, abs=0.05), "they share"


def test_shadows_with_goals_of_their_own():
    joints = {
        "lift": {
            "id": 1,
            "model": "xm540-w270",
            "shadows": [{"id": 2, "sign": -1, "follow": "goals"}],
        }
    }
    with dynamixel_bench({**PATIENT, "joints": joints}) as bench:
        mark = bench.mark()
        bench.arm.enable()
        assert bench.arm.move_jp([0.2]).wait(LONG)
        bench.until_still()
        goals = dict(bench.written("goal_position", mark))
        assert goals[1] - 2048 == pytest.approx(0.2 / COUNT, abs=1)
        assert goals[2] - 2048 == pytest.approx(-0.2 / COUNT, abs=1)
        bench.sim.control.inject("silent", id=1)
        bench.until_state("FAULT", "servo 1 on main")
        eventually(
            lambda: abs(bench.arm.measured_js().position[0] - 0.2) < 5e-3,
            "the other servo tells where the joint is",
        )
        bench.sim.control.clear()
        eventually(lambda: bench.device.has_stopped, "it is heard again")


@pytest.mark.parametrize(
    "shadow",
    [
        pytest.param({"sign": 1, "follow": "goals"}, id="sign"),
        pytest.param({"sign": -1, "offset": 0.3, "follow": "goals"}, id="offset"),
        pytest.param({"sign": 1, "follow": "secondary_id", "reverse": False}, id="reverse"),
    ],
)
def test_servos_of_a_joint_that_disagree_are_refused(shadow):
    """With the first setpoint they would turn against each other."""
    ends = {"lower": -2.0, "upper": 2.0}
    lift = {"id": 1, "model": "xm540-w270", **ends, "shadows": [{"id": 2, **shadow}]}
    values = {**PATIENT, "joints": {"lift": lift}}
    with dynamixel_bench(values, servos="1:xm540-w270,2:xm540-w270&1") as bench:
        place(bench.sim, 1, 0.5)
        bench.cycles(3)
        text = r"servo 2 on main\) is at .* rad, and servo 1 of this joint at 0.5.*sign, offset or reverse"
        with bench.nothing_moves():
            with pytest.raises(CrtkError, match=text):
                bench.arm.enable(timeout=LONG)
            bench.cycles(5)
        assert not any(bench.torques())


def test_models_that_report_load_have_no_efforts():
    with dynamixel_bench(arm_values("koch_follower")) as bench:
        assert bench.arm.measured_js().effort.size == 0
        assert "servo_jf" not in bench.arm.crtk_commands
        assert "servo_jv" in bench.arm.crtk_commands
        with bench.nothing_moves(ids=(1, 3, 4, 5, 6)):
            bench.enable()
        bench.stream("servo_jv", [0.3, 0, 0, 0.3, 0], lambda: bench.servos()[4]["velocity"] > 0.25)


LOADS = {
    "a": {"id": 1, "model": "xl430-w250", "pwm_effort": True},
    "b": {"id": 2, "model": "xl430-w250", "pwm_effort": True, "pwm_limit": 0.2},
}
PWM, CURRENT = 16, 0


def test_efforts_through_pwm():
    """Of models that control no current; 1.4 N.m at stall and 11.1 V."""
    with dynamixel_bench({**PATIENT, "joints": LOADS}) as bench:
        assert bench.engine.capabilities.estimates == {Mode.JOINT_EFFORT}
        assert bench.arm.measured_js().effort.size == 0
        bench.enable()
        mark = bench.mark()
        kind = bench.device.part
        with bench.nothing_moves():
            bench.stream("servo_jf", [0.0, 0.0], lambda: kind.kind is Kind.EFFORT)
        # A driver that is held up holds by position, and begins again.
        ons = [on for on in torque_ons(bench.writes(mark)) if on.registers["operating_mode"] == PWM]
        assert {on.id for on in ons} == {1, 2}
        assert {on.registers["goal_pwm"] for on in ons} == {0}
        bench.sim.control.inject("stuck")
        for volts in (11.1, 9.0):
            bench.sim.control.inject("voltage", volts=volts)
            exerted = {
                id: pytest.approx(share, rel=0.06)
                for id, share in ((1, 0.5), (2, 0.2 * 1.4 * volts / 11.1))
            }
            bench.stream(
                "servo_jf",
                [0.5, 0.5],
                lambda e=exerted: {i: s["torque_applied"] for i, s in bench.servos().items()} == e,
            )
        bench.sim.control.clear()
        bench.arm.hold()
        eventually(lambda: bench.device.takes_setpoints, "it holds")
        bench.until_still()
        mark = bench.mark()
        goal = bench.arm.measured_js().position + 0.2
        bench.arm.move_jp(goal).wait(LONG)
        bench.until_still()
        assert bench.angles() == pytest.approx(goal, abs=4 * COUNT)
        written = dict(bench.written("goal_pwm"))
        assert written == {1: 885, 2: 177}, "the voltage is as free as before"


def test_an_effort_through_pwm_does_not_fade_while_the_joint_turns():
    with dynamixel_bench({**PATIENT, "joints": {"a": LOADS["a"]}}, servos="1:xl430-w250") as bench:
        bench.enable()

        def pushes_on():
            servo = bench.servos()[1]
            return servo["velocity"] > 1.0 and servo["torque_applied"] > 0.2

        # Without that it would be 0.07 and less; it fades where the driver is held up.
        bench.stream("servo_jf", [0.3], pushes_on)
        bench.arm.hold()


def test_efforts_by_current_and_by_pwm_in_one_arm():
    joints = {name: {"pwm_effort": True} for name in ("shoulder_pan", "shoulder_lift")}
    with dynamixel_bench(arm_values("koch_follower", joints=joints)) as bench:
        bench.enable()
        mark = bench.mark()
        bench.sim.control.inject("stuck")
        bench.stream(
            "servo_jf",
            [0.4, 0.3, 0.2, 0.0, 0.0],
            lambda: (
                [bench.servos()[id]["torque_applied"] for id in (1, 2, 3)]
                == pytest.approx([0.4, 0.3, 0.2], rel=0.06)
            ),
        )
        modes = {on.id: on.registers["operating_mode"] for on in torque_ons(bench.writes(mark))}
        assert modes == {1: PWM, 2: PWM, 3: CURRENT, 4: CURRENT, 5: CURRENT}


def test_a_chain_on_several_buses():
    joint = {"model": "xm430-w350"}
    values = {
        **PATIENT,
        "buses": {"left": {}, "right": {}},
        "joints": {
            "a": {**joint, "id": 1, "bus": "left"},
            "b": {**joint, "id": 1, "bus": "right"},
            "c": {**joint, "id": 2, "bus": "left"},
        },
    }
    with dynamixel_bench(values) as bench:
        place(bench.sim, 1, 0.5, bus=2)
        eventually(lambda: abs(bench.arm.measured_js().position[1] - 0.5) < 2e-3, "bus 2")
        bench.arm.enable()
        goal = np.array([0.1, 0.4, -0.2])
        assert bench.arm.move_jp(goal).wait(LONG)
        bench.until_still()
        assert bench.angles(1) == pytest.approx([0.1, -0.2], abs=3 * COUNT)
        assert bench.angles(2) == pytest.approx([0.4], abs=3 * COUNT)
        bench.sim.control.inject("unplug", bus=2)
        bench.until_state("FAULT")
        bench.sim.control.clear()
        bench.until_state("DISABLED")
        bench.arm.enable()
        assert bench.arm.move_jp(np.zeros(3)).wait(LONG)


def test_both_protocols_on_one_bus():
    values = {
        **PATIENT,
        "joints": {
            "base": {"id": 1, "model": "xm430-w350"},
            "tip": {"id": 5, "model": "ax-12a", "velocity": 3.0},
        },
    }
    with dynamixel_bench(values) as bench:
        assert {entry["code"] for entry in bench.trace()} <= HARMLESS
        place(bench.sim, 5, 0.3)
        eventually(lambda: abs(bench.arm.measured_js().position[1] - 0.3) < 6e-3, "measured")
        with bench.nothing_moves(counts=6):
            bench.arm.enable()
            bench.cycles(10)
        assert all(bench.torques())
        assert bench.engine.capabilities.stop.link_timeout == 0.0, "ax-12a has no watchdog"
        assert bench.arm.move_jp([0.2, -0.2]).wait(LONG)
        bench.until_still()
        assert bench.angles() == pytest.approx([0.2, -0.2], abs=8e-3)
        bench.sim.control.inject("overload", id=5)
        bench.until_state("FAULT", "joint tip (servo 5 on main): overload")
        refusal = r"servo 5 on main\): overload; a ax-12a knows no restart.*supply of the servo off and on"
        mark = bench.mark()
        with pytest.raises(TransitionFailed, match=refusal):
            bench.arm.enable()
        assert REBOOT not in {entry["code"] for entry in bench.trace(mark)}
        bench.sim.control.inject("power_off", id=5)
        bench.sim.control.clear()
        bench.arm.enable()
        assert all(bench.torques())
        bench.arm.disable()
        assert not any(bench.torques())


def test_a_servo_that_is_not_heard_at_first_is_restarted_all_the_same():
    joints = {name: {"id": id, "model": "xm430-w350"} for name, id in (("base", 1), ("tip", 2))}
    with dynamixel_bench({**PATIENT, "fast_read": False, "joints": joints}) as bench:
        bench.arm.enable()
        bench.sim.control.inject("overload", id=1)
        bench.until_state("FAULT", "overload")
        bench.sim.control.clear()
        mark = bench.mark()
        bench.sim.control.inject("drop", id=1, duration=2.5)
        bench.until_state("FAULT", "servo 1 on main) does not answer")
        bench.arm.enable()
        assert REBOOT in {entry["code"] for entry in bench.trace(mark)}
        assert all(bench.torques())


TURNING = {"id": 1, "model": "xm430-w350", "mode": "extended_position", "lower": -20.0}


def test_turns_are_known_after_a_power_off(tmp_path):
    values = {
        **PATIENT,
        "turns": str(tmp_path / "turns.yaml"),
        "joints": {"screw": {**TURNING, "upper": 20.0}},
    }
    with sim_for(values) as sim:
        place(sim, 1, 7.0)
        with pytest.raises(ConnectionFailed, match=r"screw.*turns"), opened(sim, values, turns=""):
            pass
        file = tmp_path / "turns.yaml"
        file.write_text("positions: {other: 1.0}\n")
        with pytest.raises(ConnectionFailed, match="screw"), opened(sim, values):
            pass
        assert "other" in file.read_text(), "a failure is not the place to learn from"
        file.unlink()
        with driver_at(sim, values) as bench:
            assert bench.arm.measured_js().position == pytest.approx([7.0], abs=4e-3)
            bench.arm.enable()
            assert bench.arm.move_jp([8.0]).wait(LONG)
            bench.until_still()
        sim.control.inject("power_off")
        sim.control.clear()
        started = sim.control.status()["time"]
        eventually(lambda: sim.control.status()["time"] > started + BOOT_TIME, "it starts")
        with driver_at(sim, values) as bench, bench.nothing_moves():
            assert bench.arm.measured_js().position == pytest.approx([8.0], abs=8e-3)
            bench.arm.enable()
            bench.cycles(10)


def test_turns_that_a_servo_forgets_while_it_restarts(tmp_path):
    joints = {
        "screw": {**TURNING, "upper": 20.0},
        "other": {"id": 2, "model": "xm430-w350"},
    }
    values = {**PATIENT, "turns": str(tmp_path / "turns.yaml"), "joints": joints}
    with sim_for(values) as sim:
        place(sim, 1, 8.0)
        with driver_at(sim, values) as bench:
            restart_a_servo(bench)


def restart_a_servo(bench):
    sim = bench.sim
    bench.arm.enable()
    sim.control.inject("overload", id=1)
    bench.until_state("FAULT", "overload")
    with bench.nothing_moves(counts=4):
        bench.arm.enable()
        bench.cycles(10)
    assert sim.control.outputs("bus1/1")["bus1/1"]["reboots"] == 1
    assert bench.arm.measured_js().position[0] == pytest.approx(8.0, abs=6e-3)
    assert bench.arm.move_jp([7.5, 0.0]).wait(LONG)
    bench.until_still()
    assert bench.angles()[0] == pytest.approx(7.5, abs=6e-3)


def test_calibration_shifts_and_homing_offsets(tmp_path):
    file = tmp_path / "calibration.yaml"
    model = "xm430-w350"
    save_calibration(
        file,
        Calibration(
            servos=(
                ServoCalibration(joint="a", bus="main", id=1, model=model, shift=100),
                ServoCalibration(joint="b", bus="main", id=2, model=model, homing_offset=-200),
            )
        ),
    )
    joints = {
        "a": {"id": 1, "model": model, "lower": -2.0, "upper": 2.0},
        "b": {"id": 2, "model": model, "lower": -2.0, "upper": 2.0},
    }
    values = {**PATIENT, "joints": joints, "calibration": str(file)}
    wanted = np.array([-100 * COUNT, -200 * COUNT])
    with dynamixel_bench(values) as bench, bench.nothing_moves():
        assert bench.arm.measured_js().position == pytest.approx(wanted, abs=1.5 * COUNT)
        mark = bench.mark()
        bench.arm.enable()
        assert [w[:3] for w in bench.eeprom_writes(mark) if w.get("homing_offset") is not None] == [
            ("bus1", 2, 20)
        ]
        assert bench.arm.measured_js().position == pytest.approx(wanted, abs=1.5 * COUNT)
        bench.arm.disable()
        mark = bench.mark()
        bench.arm.enable()
        assert bench.eeprom_writes(mark) == []


def test_a_servo_of_another_model_is_told_from_one_that_is_missing():
    values = arm_values()
    wrong = "1:xm540-w270,2:xm540-w270,3:xm430-w350,4:xm430-w350,5:xm430-w350,7:xm430-w350"
    refusal = pytest.raises(ConnectionFailed, match=r"elbow \(servo 3 on main\) is a xm430-w350")
    with sim_for(values, servos=wrong) as sim, refusal, opened(sim, values):
        pass
    missing = "1:xm540-w270,2:xm540-w270,3:xm540-w270,4:xm430-w350,5:xm430-w350,7:xm430-w350"
    with dynamixel_bench(values, start=False, servos=missing) as bench:
        bench.session.start()
        assert "scan" in bench.until_state("FAULT", "joint wrist_rotate (servo 6 on main)")


def test_a_servo_of_a_model_that_nobody_knows_is_told():
    def answer(request):
        told = (9999).to_bytes(2, "little") + b"\x2d"
        asked = int.from_bytes(request[10:12], "little") if request[7] == READ else len(told)
        return status2(1, told.ljust(asked, b"\0"))

    with patient(), Peer() as peer:
        peer.answer_all(answer)
        config = {**PATIENT, "port": peer.name, "joints": {"a": LOADS["a"]}}
        device = PLUGIN.create(load(PLUGIN.config, from_values(config)))
        refusal = r"joint a \(servo 1 on main\): .*model number is 9999.*connect them one at a time"
        with pytest.raises(ConnectionFailed, match=refusal):
            device.open(time.monotonic() + LONG)


def test_the_session_has_one_thread_for_arm_and_gripper():
    with sim_for(arm_values()) as sim:
        session = Session(
            crtk_drivers.plugins.device("dynamixel"), configuration(sim, arm_values())
        )
        buses = {engine.device.bus for engine in session.engines}
        assert len(buses) == 1
        session.close()


def test_an_xl_320_takes_positions_only_and_has_no_watchdog():
    values = {**PATIENT, "joints": {"neck": {"id": 1, "model": "xl-320", "velocity": 2.0}}}
    with dynamixel_bench(values) as bench:
        assert not hasattr(bench.arm, "servo_jv")
        stop = bench.device.capabilities.stop
        assert stop.link_timeout == 0.0
        assert "goes on to its last goal" in stop.description
        with bench.nothing_moves():
            bench.arm.enable()
            bench.cycles(5)
        assert bench.arm.move_jp([0.4]).wait(LONG)
        eventually(lambda: abs(bench.angles()[0] - 0.4) < 0.01, "it is there")
        bench.sim.control.inject("overload", id=1)
        bench.until_state("FAULT", "joint neck (servo 1 on main): overload")
        bench.arm.enable(timeout=LONG)
        assert bench.torques() == [True]


@pytest.mark.parametrize("model", ["xl-320", "ax-12a"])
def test_a_servo_that_was_left_as_a_wheel(model):
    """Its torque would turn it on and on: an XL-320 is set up as a joint, and the others are refused."""
    joint = {"id": 1, "model": model, "velocity": 2.0}
    with dynamixel_bench({**PATIENT, "joints": {"neck": joint}}) as bench:
        address, data = (11, "01") if model == "xl-320" else (6, "00000000")
        bench.sim.control.call("write", id=1, address=address, data=data)
        with bench.nothing_moves():
            if model == "xl-320":
                bench.arm.enable(timeout=LONG)
            else:
                with pytest.raises(TransitionFailed, match="wheel"):
                    bench.arm.enable(timeout=LONG)
            bench.cycles(5)


def test_a_servo_that_answers_no_reads_is_told_so():
    with sim_for(arm_values()) as sim:
        sim.control.call("write", id=3, address=68, data="00")
        with (
            pytest.raises(
                ConnectionFailed, match=r"servo 3 on main\).*Status Return Level is 0.*Wizard"
            ),
            opened(sim, arm_values()),
        ):
            pass


def test_the_first_enable_after_a_calibration_into_the_servo(tmp_path):
    """The range fits with the homing offset that this enable writes, and not without."""
    file = tmp_path / "calibration.yaml"
    model = "xm430-w350"
    servo = ServoCalibration(joint="a", bus="main", id=1, model=model, homing_offset=900)
    save_calibration(file, Calibration(servos=(servo,)))
    joint = {"id": 1, "model": model, "lower": -1.6, "upper": 2.4}
    values = {**PATIENT, "joints": {"a": joint}, "calibration": str(file)}
    with sim_for(values) as sim:
        place(sim, 1, -900 * COUNT)
        sim.control.call("write", id=1, address=52, data=(400).to_bytes(4, "little").hex())
        with driver_at(sim, values) as bench:
            bench.arm.enable(timeout=LONG)
            assert bench.arm.measured_js().position == pytest.approx([0.0], abs=3 * COUNT)

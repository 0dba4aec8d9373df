"""What goes wrong with a controller, its axes and its links: told in words, and nothing moves on its own."""

from __future__ import annotations

import socket
import time
from collections import deque
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from crtk_drivers.errors import CrtkError
from crtk_sim_backends.galil import RunningSim
from rigs.axes_bench import STEP, fault, stands
from rigs.galil_bench import TURN, arm_at, galil, joints, moving, refused
from rigs.waiting import LONG, eventually


@pytest.fixture(scope="module")
def shared() -> Iterator[RunningSim]:
    with galil(travel=45_000, home_at=10_000) as sim:
        yield sim


@pytest.fixture
def sim(shared: RunningSim) -> Iterator[RunningSim]:
    """The controller, started anew, its axes at 0."""
    shared.control.clear()
    shared.control.call("place")
    yield shared
    shared.control.clear()


@pytest.mark.sweep(2)
@pytest.mark.parametrize(
    ("kind", "parameters", "words"),
    [
        ("foreign_stop", {}, "which was not ours: another client or a program"),
        ("encoder_failure", {"axis": "A"}, "stopped by an encoder failure (OA1) (stop code 12)"),
        ("motor_off", {"axis": "B"}, "joint_b: its motor is off"),
        ("amplifier", {"status": 0x1}, "the amplifier tells over-current"),
        ("refuses", {"command": "PA", "code": 6}, "was refused: 6 number out of range"),
    ],
)
def test_a_fault_in_motion_is_told(
    sim: RunningSim, kind: str, parameters: dict[str, Any], words: str
) -> None:
    with moving(sim) as arm:
        sim.control.inject(kind, **parameters)
        fault(arm, words)
        eventually(lambda: stands(sim), "it stands")
        sim.control.clear()
        arm.enable(LONG)
        assert arm.operating_state().state == "ENABLED"


def test_a_blocked_axis_is_switched_off_by_the_controller_itself(sim: RunningSim) -> None:
    with moving(sim, joints=joints(following_error=0.02)) as arm:
        sim.control.inject("blocked", axis="A")
        fault(arm, "off on error (OE1): its position error was more than ER (stop code 8)")
        assert not sim.control.status()["on"][0]


def test_a_limit_switch_stops_the_axis_and_it_can_be_moved_away(sim: RunningSim) -> None:
    sim.control.call("place", counts=20_000)
    with moving(sim, 1.5) as arm:
        fault(arm, "stopped by the forward limit switch or FL (stop code 2)")
        eventually(lambda: stands(sim), "it stands")
        assert sim.control.status()["position"][0] < 47_000
        noted = lambda words: any(words in note.text for note in arm.health().notes)  # noqa: E731
        eventually(lambda: noted("forward limit switch is active"), "it is noted")
        arm.enable(LONG)
        goal = arm.measured_js().position.copy()
        goal[0] -= 0.4
        arm.move_jp(goal).wait(LONG)
        eventually(lambda: not noted("limit switch"), "it is away")


def test_a_controller_that_starts_anew_in_motion_comes_back_disabled(sim: RunningSim) -> None:
    with moving(sim, joints=joints(homing={"method": "here"})) as arm:
        arm.home(LONG)
        assert arm.is_homed()
        sim.control.inject("reset")
        eventually(lambda: arm.health().reconnects > 0 and arm.engine.connected, "it is back")
        eventually(lambda: arm.operating_state().state == "DISABLED", "it is DISABLED")
        eventually(lambda: not arm.is_homed(), "its home is forgotten")
        assert not any(sim.control.status()["on"])


def test_home_is_remembered_by_a_controller_that_was_not_restarted(sim: RunningSim) -> None:
    keys = joints(homing={"method": "here"})
    with arm_at(sim, joints=keys) as arm:
        assert not arm.is_homed()
        arm.enable(LONG)
        arm.home(LONG)
    with arm_at(sim, joints=keys) as arm:
        eventually(arm.is_homed, "it is remembered")
        arm.unhome(LONG)
    with arm_at(sim, joints=keys) as arm:
        assert not arm.is_homed()


def test_home_is_remembered_of_each_axis(sim: RunningSim) -> None:
    """Another arm of the same controller, or one with more joints, was not homed by it."""
    keys = joints(homing={"method": "here"})
    with arm_at(sim, joints={"joint_a": keys["joint_a"]}) as arm:
        arm.enable(LONG)
        arm.home(LONG)
    with arm_at(sim, joints={"joint_b": keys["joint_b"]}) as arm:
        assert not arm.is_homed()
    with arm_at(sim, joints=keys) as arm:
        assert not arm.is_homed()
        arm.enable(LONG)
        arm.home(LONG)
    with arm_at(sim, joints=keys) as arm:
        eventually(arm.is_homed, "it is remembered")


def test_half_a_homing_is_not_remembered(sim: RunningSim) -> None:
    """Its axis was homed before, by an arm without the other one; now it counts from 0 at its switch."""
    homing = {"method": "home", "position": 0.5, "speed": 0.8}
    keys = joints(homing={"method": "here"})
    keys["joint_a"]["homing"] = homing
    alone = {"joint_a": keys["joint_a"]}
    with arm_at(sim, joints=alone) as arm:
        arm.enable(LONG)
        arm.home(LONG)
    with arm_at(sim, joints=keys) as arm:
        arm.enable(LONG)
        sim.control.inject("refuses", command="DP")
        with pytest.raises(CrtkError, match=r"'DP.*' was refused"):
            arm.home(LONG)
        sim.control.clear()
    with arm_at(sim, joints=alone) as arm:
        assert abs(arm.measured_js(age=0).position[0]) < 0.01
        assert not arm.is_homed()


def test_home_at_another_position_is_not_remembered(sim: RunningSim) -> None:
    keys = joints(homing={"method": "here"})
    with arm_at(sim, joints=keys) as arm:
        arm.enable(LONG)
        arm.home(LONG)
    with arm_at(sim, joints=joints(homing={"method": "here", "position": 0.5})) as arm:
        assert not arm.is_homed()
    with arm_at(sim, joints=keys) as arm:
        eventually(arm.is_homed, "it is remembered")


def test_a_home_position_that_is_not_counted_is_not_believed(sim: RunningSim) -> None:
    with arm_at(sim, joints=joints(homing={"method": "here", "position": 0.1})) as arm:
        arm.enable(LONG)
        sim.control.inject("deaf", command="DP")
        with pytest.raises(CrtkError, match="joint_a was not homed: it counts 0, not 1592"):
            arm.home(LONG)
        assert not arm.is_homed()


@pytest.mark.parametrize("method", ["home", "index"])
def test_homing_finds_the_switch_and_the_index(sim: RunningSim, method: str) -> None:
    homing = {"method": method, "position": 0.5, "speed": 0.4}
    keys = joints()
    keys["joint_a"]["homing"] = homing
    with arm_at(sim, joints=keys) as arm:
        arm.enable(LONG)
        arm.home(LONG)
        assert arm.is_homed()
        place = 10_000 if method == "home" else sim.control.status()["position"][0]
        assert sim.control.status()["position"][0] == pytest.approx(place, abs=50)
        if method == "index":
            assert round(place) % 4000 in range(-20, 20) or 4000 - round(place) % 4000 < 20
        eventually(lambda: abs(arm.measured_js().position[0] - 0.5) < 5e-3, "it counts from there")


def test_homing_that_meets_a_limit_switch_fails_with_the_reason(sim: RunningSim) -> None:
    keys = joints()
    keys["joint_a"]["homing"] = {"method": "home", "speed": 1.0}
    with galil(travel=3000, home_at=20_000) as short, arm_at(short, joints=keys) as arm:
        arm.enable(LONG)
        with pytest.raises(CrtkError, match=r"joint_a was not homed: .*forward limit.*CN"):
            arm.home(LONG)
        assert not arm.is_homed()


def test_what_is_refused_in_a_procedure_fails_it(sim: RunningSim) -> None:
    with arm_at(sim, joints=joints(homing={"method": "here", "position": 0.5})) as arm:
        sim.control.inject("refuses", command="SP", code=6)
        with pytest.raises(CrtkError, match=r"'SP .*' was refused: 6 number out of range"):
            arm.enable(LONG)
        assert not any(sim.control.status()["on"])
        sim.control.clear()
        arm.enable(LONG)
        sim.control.inject("refuses", command="DP", code=7)
        with pytest.raises(CrtkError, match=r"'DP.*' was refused: 7 not valid while running"):
            arm.home(LONG)
        assert not arm.is_homed()


def test_axes_that_could_not_be_disabled_are_watched_on(sim: RunningSim) -> None:
    with arm_at(sim) as arm:
        arm.enable(LONG)
        sim.control.inject("refuses", command="MO", code=7)
        with pytest.raises(CrtkError, match=r"'MO.*' was refused: 7 "):
            arm.disable(LONG)
        sim.control.inject("encoder_failure", axis="A")
        told = "stopped by an encoder failure (OA1)"
        eventually(lambda: told in arm.operating_state().detail, told)
        sim.control.clear()


def test_a_stop_is_believed_although_records_are_slow(sim: RunningSim) -> None:
    """It is sent again every 50 ms, which begins nothing anew."""
    with arm_at(sim, record_period=0.04) as arm:
        arm.enable(LONG)
        arm.move_jp(arm.measured_js().position + 1.0)
        eventually(lambda: arm.measured_js().velocity[0] > 0.1, "it moves")
        arm.hold()
        eventually(lambda: arm.engine.device.has_stopped, "it is read back")
        assert arm.operating_state().state == "ENABLED"


def test_a_stop_that_does_nothing_is_not_believed(sim: RunningSim) -> None:
    with arm_at(sim) as arm:
        arm.enable(LONG)
        sim.control.inject("deaf_to_stop")
        move = arm.move_jp(arm.measured_js().position + 1.0)
        eventually(lambda: arm.measured_js().velocity[0] > 0.1, "it moves")
        arm.hold()
        with pytest.raises(CrtkError):
            move.wait(LONG)
        fault(arm, "a stop has not been carried out")
        sim.control.clear()
        eventually(lambda: arm.engine.device.has_stopped, "it is read back when it is carried out")
        seen = arm.health().samples
        eventually(lambda: arm.health().samples > seen + 5, "it is looked at")


@pytest.mark.sweep(4)
@pytest.mark.parametrize(
    ("kind", "parameters"),
    [
        ("loss", {"every": 3}),
        ("duplicate", {"every": 2}),
        ("late", {"every": 5, "by": 2}),
        ("corrupt", {"every": 4}),
        ("short", {"every": 4, "size": 40}),
        ("long", {"every": 4}),
        ("empty", {"every": 3}),
        ("chatter", {}),
    ],
)
def test_what_is_only_now_and_then_is_counted_and_lived_with(
    sim: RunningSim, kind: str, parameters: dict[str, Any]
) -> None:
    with arm_at(sim) as arm:
        arm.enable(LONG)
        sim.control.inject(kind, **parameters)
        goal = arm.measured_js().position + 0.1
        arm.move_jp(goal).wait(LONG)
        assert arm.operating_state().state == "ENABLED"
        counted = {
            "loss": "lost records",
            "corrupt": "bad records",
            "short": "bad records",
            "long": "bad records",
            "chatter": "characters said unasked",
        }
        if kind in counted:
            eventually(lambda: arm.health().device[counted[kind]] > 0, counted[kind])
        elif kind != "late":
            assert arm.health().device["bad records"] == 0
        sim.control.clear()


@pytest.mark.parametrize("kind", ["mute", "half_line", "no_records"])
def test_silence_is_a_lost_link(sim: RunningSim, kind: str) -> None:
    with moving(sim, reply_timeout=0.6, sample_timeout=0.6) as arm:
        sim.control.inject(kind)
        eventually(lambda: arm.operating_state().state == "FAULT", "it is in FAULT")
        sim.control.clear()
        eventually(lambda: arm.operating_state().state == "DISABLED", "it is back")


def test_echo_is_switched_off_and_a_controller_that_keeps_it_is_understood() -> None:
    with galil(echo=True) as sim, arm_at(sim) as arm:
        arm.enable(LONG)
        assert arm.health().device["echoes"] >= 1
        assert any("EO 0" in note.text for note in arm.health().notes)


def test_a_second_client_may_ask_and_disturbs_nobody(sim: RunningSim) -> None:
    place = sim.host, sim.ports["command"]
    with moving(sim, 0.1) as arm, socket.create_connection(place, LONG) as other:
        for _ in range(20):
            other.sendall(b"TP A\r")
            assert other.recv(64).endswith(b":")
        assert arm.operating_state().state == "ENABLED"


def test_whoever_asks_for_records_last_gets_them(sim: RunningSim) -> None:
    """A second driver: the first one sees no data any more, stops, and says so."""
    with moving(sim, 0.1, sample_timeout=0.6) as arm:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
            other.sendto(b"DR 4\r", (sim.host, sim.ports["records"]))
            fault(arm, "sample")
        eventually(lambda: arm.operating_state().state == "DISABLED", "it has them again")


def test_firmware_that_is_not_known_is_refused_unless_its_family_is_given() -> None:
    with galil(revision="DMC9040 Rev 9.9") as sim:
        refused(sim, "it calls itself 'DMC9040 Rev 9.9'")
        with arm_at(sim, model="4000") as arm:
            arm.enable(LONG)
        refused(sim, "has 36 bytes in its data record (QZ), not 30", model="2103")


def test_other_samples_than_of_a_millisecond_are_refused() -> None:
    """Periods of records, and times of pieces, are in samples."""
    with galil(sample_time=250) as sim:
        refused(sim, "its samples take 250 µs (TM), not 1000")


def raw(sim: RunningSim, *commands: str) -> None:
    """Another client says something, and all of it is taken."""
    with socket.create_connection((sim.host, sim.ports["command"]), LONG) as other:
        for command in commands:
            other.sendall(f"{command}\r".encode())
            assert other.recv(64).endswith(b":")


def test_nothing_moves_by_enable_though_a_mode_was_left_on(sim: RunningSim) -> None:
    """Somebody was tracking when the motor lost its power, and his goal is still there."""
    raw(sim, "SH A", "PT 1")
    sim.control.inject("motor_off", axis="A")
    sim.control.clear()
    raw(sim, "PA 20000")
    with arm_at(sim) as arm:
        arm.enable(LONG)
        seen = arm.health().samples
        eventually(lambda: arm.health().samples > seen + 25, "it is looked at")
        assert abs(sim.control.status()["reference"][0]) < 1.0


def test_a_controller_that_was_only_looked_at_keeps_its_power(sim: RunningSim) -> None:
    """Somebody else has switched on, and may hold a load."""
    raw(sim, "SH A")
    with arm_at(sim) as arm:
        assert arm.operating_state().detail == "joint_a has power"
    assert sim.control.status()["on"][0]
    with arm_at(sim) as arm:
        arm.enable(LONG)
    eventually(lambda: not any(sim.control.status()["on"]), "what it switched on is off")


def test_going_and_stopping_keeps_the_limit_of_velocity(sim: RunningSim) -> None:
    with arm_at(sim, tracking="stop_go") as arm:
        arm.enable(LONG)
        move = arm.move_jp(arm.measured_js().position + 2.0)
        seen = [0.0]
        while move.is_busy():
            seen.append(abs(float(arm.measured_js().velocity[0])))
            time.sleep(0.002)
        assert max(seen) < 2.0 * 1.05


def test_an_axis_that_is_not_there_is_refused() -> None:
    with galil(axes=2) as sim:
        refused(sim, "it has the axes AB, and not C")


def test_no_setpoint_is_sent_to_axes_that_nobody_sees(sim: RunningSim) -> None:
    with moving(sim, 0.3, sample_timeout=2.0) as arm:
        sim.control.inject("no_records")
        eventually(lambda: stands(sim), "it stands")
        assert arm.operating_state().state == "ENABLED"
        sim.control.clear()


@pytest.mark.parametrize("tracking", ["pt", "pvt"])
def test_velocities_are_as_asked_however_often(sim: RunningSim, tracking: str) -> None:
    with arm_at(sim, tracking=tracking) as arm:
        arm.enable(LONG)
        seen: deque[float] = deque(maxlen=200)

        def is_as_asked() -> bool:
            arm.servo_jv([0.3, 0.0, 0.0])
            seen.append(float(arm.measured_js().velocity[0]))
            is_full = len(seen) == seen.maxlen
            return is_full and bool(np.median(seen) == pytest.approx(0.3, abs=0.05))

        eventually(is_as_asked, "it is as fast as asked")


@pytest.mark.parametrize("outside", [3.2, -3.2])
def test_a_velocity_does_not_bring_back_at_once_what_is_outside_its_range(
    sim: RunningSim, outside: float
) -> None:
    with arm_at(sim, joints=joints(offset=outside)) as arm:
        arm.enable(LONG)
        assert arm.measured_js().position[0] == pytest.approx(outside, abs=1e-3)
        for _ in range(20):
            arm.servo_jv([0.0, 0.0, 0.0])
            time.sleep(STEP)
        assert np.abs(sim.control.status()["reference"]).max() <= 1.0

        def way() -> float:
            arm.servo_jv([-np.sign(outside) * 0.1, 0.0, 0.0])
            return float(-np.sign(outside) * (arm.measured_js().position[0] - outside))

        eventually(lambda: way() > 0.01, "it goes back")
        assert way() < 0.1


@pytest.mark.sweep(4)
@pytest.mark.parametrize("model", ["52040", "30010", "2143", "1806"])
def test_other_families_move(model: str) -> None:
    one = {"joint_a": joints()["joint_a"]}
    with galil(model=model, axes=1) as sim, arm_at(sim, joints=one) as arm:
        arm.enable(LONG)
        arm.move_jp([0.2]).wait(LONG)
        there = pytest.approx(0.2 * TURN / 6.2832, abs=30)
        eventually(lambda: sim.control.status()["position"][0] == there, "it is there")


@pytest.mark.parametrize("tracking", ["pt", "pvt", "stop_go"])
def test_each_way_of_tracking_arrives(sim: RunningSim, tracking: str) -> None:
    with arm_at(sim, tracking=tracking) as arm:
        arm.enable(LONG)
        goal = arm.measured_js().position + 0.2
        arm.move_jp(goal).wait(LONG)
        eventually(lambda: np.abs(arm.measured_js().position - goal).max() < 2e-3, "it is there")

        def goes_on() -> bool:
            arm.servo_jv([0.3, 0.0, 0.0])
            return bool(arm.measured_js().position[0] > goal[0] + 0.01)

        eventually(goes_on, "it goes on")
        eventually(lambda: stands(sim), "it stands when no more comes")
        assert arm.operating_state().state == "ENABLED"

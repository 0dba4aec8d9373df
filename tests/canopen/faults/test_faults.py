"""Faults of drives, bus and driver process: what state follows, and that nothing moves by itself.

The faults are those of the simulated drives and of the hub, and those of the table F1 to F20 in the
documentation that concern this driver.
"""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from crtk_driver_canopen import PLUGIN, arm_link
from crtk_driver_canopen.bus_state import BusLost
from crtk_driver_canopen.objects import OBJECTS
from crtk_driver_canopen.sdo import Sdo
from crtk_drivers.errors import CommandRefused, MotionAborted, TransitionFailed
from crtk_drivers.front import LocalDevice
from crtk_drivers.session import Session
from rigs.canopen_arm import LISTENING, PERIOD, arm_on, device_of, drives
from rigs.waiting import LONG, eventually

COUNT = 3
FAR = 2.0
CYCLES = 6
"""Cycles in which something that moves by itself would have begun to."""


class Bench:
    """Simulated drives with an arm on them."""

    def __init__(self, sim, arm: LocalDevice) -> None:
        self.sim = sim
        self.arm = arm

    def drives(self) -> list[dict[str, Any]]:
        """What the drives say past the bus."""
        told = self.sim.control.status()["drives"]
        return [told[str(node)]["axes"][0] for node in sorted(map(int, told))]

    def nmt(self, node: int) -> str:
        return self.sim.control.status()["drives"][str(node)]["nmt"]

    def inject(self, kind: str, **parameters: Any) -> None:
        self.sim.control.inject(kind, **parameters)

    def revolutions(self) -> np.ndarray:
        return np.array([drive["revolutions"] for drive in self.drives()])

    def still(self) -> bool:
        return all(abs(drive["velocity"]) < 1.0 for drive in self.drives())

    def detail(self) -> str:
        return self.arm.operating_state().detail

    def state(self) -> str:
        return self.arm.operating_state().state

    def cycles(self, count: int = CYCLES) -> None:
        """Wait for so many samples."""
        samples = self.arm.engine.health().samples
        eventually(lambda: self.arm.engine.health().samples >= samples + count, "samples come")

    def enables(self) -> bool:
        try:
            self.arm.enable(LONG)
        except (TransitionFailed, CommandRefused):
            return False
        return True

    def enable(self) -> None:
        eventually(self.enables, f"it can be enabled: {self.detail()}")

    def start_moving(self, ratio: float = 0.3):
        """Start a move that takes longer than any fault to be told, and return it once all joints move."""
        away = -FAR if self.arm.measured_js().position[0] > 0.0 else FAR
        self.arm.trajectory_j.set_ratio_v(ratio)
        move = self.arm.move_jp([away] * COUNT)
        eventually(lambda: min(abs(drive["velocity"]) for drive in self.drives()) > 1e4, "it moves")
        return move

    def fails(self, move, *words: str) -> None:
        """The state is FAULT with these words, the move is over, and all joints come to rest."""
        eventually(lambda: self.state() == "FAULT", "it is in FAULT")
        with pytest.raises(MotionAborted):
            move.wait(LONG)
        for word in words:
            eventually(lambda word=word: word in self.detail(), f"{word!r} in {self.detail()!r}")
        eventually(self.still, "all stand")

    def recovers(self) -> None:
        """The fault goes away: nothing moves, and enabling helps."""
        self.sim.control.clear()
        eventually(lambda: self.arm.engine.connected, "it is connected")
        self.cycles()
        assert self.state() in ("FAULT", "DISABLED")
        eventually(self.still, "all stand")
        before = self.revolutions()
        self.cycles()
        np.testing.assert_allclose(self.revolutions(), before, atol=0.05)
        self.enable()
        assert [drive["state"] for drive in self.drives()] == ["operation_enabled"] * COUNT
        self.cycles()
        np.testing.assert_allclose(self.revolutions(), before, atol=0.1)
        goal = self.arm.setpoint_js().position + 0.02
        self.arm.move_jp(goal).wait(LONG)
        eventually(
            lambda: np.abs(self.arm.measured_js().position - goal).max() < 1e-2, "it is there"
        )


@contextmanager
def bench_of(sim, **keys: Any) -> Iterator[Bench]:
    arm = LocalDevice(Session(PLUGIN, arm_on(sim, COUNT, **keys)))
    try:
        arm._session.start()
        eventually(lambda: arm.engine.connected and arm.engine.has_sample, "it is connected")
        yield Bench(sim, arm)
    finally:
        arm.close()


@pytest.fixture(scope="module")
def sim():
    with drives(COUNT) as running:
        yield running


@pytest.fixture(scope="module")
def shared(sim):
    with bench_of(sim) as bench:
        yield bench


@pytest.fixture
def bench(shared):
    shared.sim.control.clear()
    eventually(lambda: shared.arm.engine.connected, "it is connected")
    shared.enable()
    yield shared
    shared.sim.control.clear()


# --------------------------------------------------------------------------------- faults in motion

IN_MOTION = [
    ("reset", {"node": 2}, ["node 2 has started anew"]),
    ("power_off", {"node": 2}, ["node 2"]),
    ("silent", {"node": 2}, ["node 2"]),
    ("no_tpdo", {"node": 2}, ["node 2 does not send its PDOs"]),
    ("no_heartbeat", {"node": 2}, ["node 2 is not heard any more"]),
    ("late_tpdo", {"node": 2, "delay": 1.0}, ["node 2 does not send its PDOs"]),
    ("late_tpdo", {"node": 2, "delay": 0.008}, ["node 2 sends its PDOs too late"]),
    ("supply_off", {"node": 2}, ["joint joint_2 (node 2)", "under-voltage"]),
    ("safe_torque_off", {"node": 2}, ["joint joint_2 (node 2)", "of the manufacturer (0xff01)"]),
    ("stuck", {"node": 2}, ["joint joint_2 (node 2)", "following error"]),
    ("local_control", {"node": 2}, ["joint joint_2 (node 2): remote (bit 9) has gone to 0"]),
    ("drop", {"id": 0x182}, ["node 2 does not send its PDOs"]),
    ("drop", {"id": 0x702}, ["node 2 is not heard any more"]),
    ("drop", {"id": 0x080}, []),
    ("drop", {"id": 0x77F}, []),
    ("bus_off", {"node": "native*"}, ["bus-off"]),
    ("down", {"node": "native*"}, ["interface is down"]),
    ("full", {"node": "native*"}, ["no room to send"]),
    ("listen_only", {"node": "native*"}, []),
]


@pytest.mark.sweep(5)
@pytest.mark.parametrize(
    ("kind", "parameters", "words"), IN_MOTION, ids=[f"{k}-{p}" for k, p, _ in IN_MOTION]
)
def test_a_fault_in_motion_stops_all_joints_and_its_end_moves_nothing(
    bench: Bench, kind: str, parameters: dict[str, Any], words: list[str]
) -> None:
    move = bench.start_moving()
    bench.inject(kind, **parameters)
    bench.fails(move, *words)
    bench.recovers()


def test_a_drive_that_was_silent_longer_than_it_waits_for_us_is_set_up_again(bench: Bench) -> None:
    bench.inject("silent", node=2)
    eventually(lambda: bench.nmt(2) == "pre_operational", "it has given us up")
    eventually(lambda: bench.state() == "FAULT", "it is in FAULT")
    bench.sim.control.clear()
    eventually(lambda: "node 2 is not operational any more" in bench.detail(), "it says so")
    bench.recovers()


@pytest.mark.parametrize("policy", ["quick_stop", "hold"])
def test_a_drive_that_comes_back_does_not_go_on_to_an_old_target(policy: str) -> None:
    with drives(COUNT) as sim, bench_of(sim, on_joint_fault=policy) as bench:
        bench.enable()
        move = bench.start_moving()
        bench.inject("no_tpdo", node=2)
        bench.fails(move, "node 2 does not send its PDOs")
        eventually(lambda: not bench.drives()[1]["powered"], "it has been stopped")
        bench.recovers()


ERRORS = {
    "over_current": "continuous over-current at the output",
    "mains_under_voltage": "mains under-voltage",
    "drive_temperature": "excess temperature of the drive",
    "software": "internal software",
    "encoder": "incremental sensor 1 fault",
    "communication": "communication",
    "rpdo_timeout": "RPDO time-out",
    "external": "external error",
    "vendor": "of the manufacturer",
}


def test_emergencies_of_every_class_are_told_in_words_and_end_with_enable(bench: Bench) -> None:
    for error, words in ERRORS.items():
        bench.inject("fault", node=2, error=error, vendor="0102")
        eventually(lambda words=words: words in bench.detail(), f"{words} in {bench.detail()}")
        assert "joint joint_2 (node 2)" in bench.detail()
        assert "vendor bytes 01 02" in bench.detail()
        bench.enable()
        assert bench.detail() == ""


def test_enabling_at_once_after_a_fault_in_motion_cuts_off_no_ramp(bench: Bench) -> None:
    deceleration = {"index": 0x6085, "node": 0}
    nodes = range(1, COUNT + 1)
    call = bench.sim.control.call
    before = call("object", **{**deceleration, "node": 1})
    for node in nodes:
        call("object", **{**deceleration, "node": node}, value=400_000)
    move = bench.start_moving(0.15)  # from which a ramp takes less than a stop may
    bench.inject("fault", node=2, error="over_current")
    eventually(lambda: bench.state() == "FAULT", "it is in FAULT")
    with pytest.raises(MotionAborted):
        move.wait(LONG)
    bench.arm.state_command("enable", 0.0)

    def is_enabled() -> bool:
        for drive in bench.drives():
            assert drive["powered"] or abs(drive["velocity"]) < 1e4, "it coasts"
        return bench.state() == "ENABLED"

    eventually(is_enabled, "it is enabled")
    for node in nodes:
        call("object", **{**deceleration, "node": node}, value=before)


# ---------------------------------------------------------------------------- what it goes on through

DISTURBANCES = [
    ("duplicate", {"every": 2}),
    ("drop", {"every": 40}),
    ("delay", {"seconds": 0.0005}),
    ("error_frames", {"rate": 200.0}),
    ("babbling", {"id": 0x7F0, "rate": 500.0}),
    ("babbling", {"id": 0x001, "rate": 500.0}),
    ("error_passive", {"node": "native*"}),
    ("slow_sdo", {"delay": 1.0}),
    ("no_sdo", {}),
    ("emcy", {"node": 1, "error": "generic"}),
]


@pytest.mark.parametrize(
    ("kind", "parameters"), DISTURBANCES, ids=[f"{k}-{p}" for k, p in DISTURBANCES]
)
def test_a_disturbance_does_not_end_a_move(
    bench: Bench, kind: str, parameters: dict[str, Any]
) -> None:
    bench.inject(kind, **parameters)
    goal = bench.arm.setpoint_js().position * 0.5
    bench.arm.move_jp(goal).wait(LONG)
    eventually(lambda: np.abs(bench.arm.measured_js().position - goal).max() < 1e-2, "it is there")
    assert bench.state() == "ENABLED"


# ------------------------------------------------------------------------------------- power in motion


@pytest.mark.parametrize("command", ["move_jp", "servo_jv", "servo_jf"])
def test_disable_in_motion_takes_the_power_after_the_joints_stand(
    bench: Bench, command: str
) -> None:
    away = -1.0 if bench.arm.measured_js().position[0] > 0.0 else 1.0
    if command == "move_jp":
        bench.start_moving()
    else:
        value = [away * (1.0 if command == "servo_jv" else 3.0)] * COUNT

        def runs() -> bool:
            getattr(bench.arm, command)(value)
            return min(abs(drive["velocity"]) for drive in bench.drives()) > 1e4

        eventually(runs, "it moves")
    bench.arm.disable(LONG)
    drives_now = bench.drives()
    assert not any(drive["powered"] for drive in drives_now)
    assert max(abs(drive["velocity"]) for drive in drives_now) < 1e4
    eventually(bench.still, "all stand")


def test_a_mode_that_a_drive_does_not_take_is_a_fault_that_enable_removes(bench: Bench) -> None:
    bench.inject("ignored_writes", node=2, index=0x6060)

    def refused() -> bool:
        with suppress(CommandRefused):
            bench.arm.servo_jv([0.1] * COUNT)
        return bench.state() == "FAULT"

    eventually(refused, "it is in FAULT")
    assert "joint joint_2 (node 2): it still shows" in bench.detail()
    bench.recovers()


def test_enable_that_is_given_up_leaves_no_drive_that_gets_power_later(bench: Bench) -> None:
    bench.arm.disable(LONG)
    bench.inject("supply_off", node=2)
    bench.arm.state_command("enable", 0.0)
    eventually(lambda: bench.drives()[0]["powered"], "the first has power")
    bench.arm.state_command("disable")
    eventually(
        lambda: not any(drive["powered"] for drive in bench.drives()), "all are switched off"
    )
    bench.sim.control.clear()
    bench.cycles(30)
    assert not any(drive["powered"] for drive in bench.drives())


# ----------------------------------------------------------------------------- setting up, and homing


def test_cycles_that_the_kernel_began_meanwhile_are_not_caught_up_with() -> None:
    with drives(COUNT) as sim:
        own = {"receive_own_messages": True}
        bus = {"interface": "crtk", "channel": sim.paths["crtk"], "options": own}
        with bench_of(sim, sync="kernel", bus=bus) as bench:
            stalled: list[float] = []
            after: list[float] = []

            def stall() -> None:
                if stalled:
                    after.append(time.monotonic() - stalled[0])
                    return
                time.sleep(0.25)
                stalled.append(time.monotonic())

            bench.enable()
            bench.arm.engine.on_sample = stall
            eventually(lambda: len(after) > 20, "it goes on")
            assert sum(seconds < 5 * PERIOD for seconds in after) < 15


def test_setting_up_a_drive_again_neither_delays_the_cycle_nor_lets_the_others_go() -> None:
    with drives(COUNT) as sim, bench_of(sim, on_joint_fault="hold") as bench:
        bench.enable()
        bench.inject("slow_sdo", node=3, delay=0.01)  # in all, longer than drives wait
        bench.inject("reset", node=3)
        eventually(lambda: "node 3 has started anew" in bench.detail(), "it says why")
        eventually(lambda: bench.nmt(3) == "pre_operational", "it has booted")
        bench.arm.state_command("enable", 0.0)
        while not bench.arm.engine.transition_ended:
            assert [drive["powered"] for drive in bench.drives()[:2]] == [True, True]
            time.sleep(0.01)
        assert bench.state() == "ENABLED", bench.detail()


@pytest.mark.slow
def test_a_drive_that_answers_nothing_is_not_enabled_and_the_others_hold() -> None:
    with drives(COUNT) as sim, bench_of(sim, on_joint_fault="hold") as bench:
        bench.enable()
        bench.inject("no_sdo", node=3)
        bench.inject("reset", node=3)
        eventually(lambda: "node 3 has started anew" in bench.detail(), "it says why")
        with pytest.raises(TransitionFailed, match="node 3"):
            bench.arm.enable(LONG)
        sim.control.clear()
        bench.enable()


def refused(sim, words: str, joint: dict[str, Any] | None = None) -> None:
    arm = LocalDevice(Session(PLUGIN, arm_on(sim, COUNT, joint)))
    try:
        arm._session.start()
        eventually(lambda: words in arm.operating_state().detail, words)
        assert not arm.engine.connected
        sim.control.clear()
        eventually(lambda: arm.engine.connected, "it is connected")
    finally:
        arm.close()


@pytest.mark.slow  # test_extreme_values.py has it of any claim
def test_drives_that_cannot_be_trusted_are_refused_until_they_can_be() -> None:
    with drives(COUNT) as sim:
        for index, words in ((0x1016, "1016"), (0x6007, "6007")):
            for node in range(1, COUNT + 1):
                sim.control.call("object", node=node, index=index, sub=index == 0x1016, value=0)
            sim.control.inject("ignored_writes", node=2, index=index)
            refused(sim, words)
        product = sim.control.call("object", node=1, index=0x1018, sub=2)
        sim.control.inject("wrong_identity", node=3, product=product + 1)
        refused(sim, "another device", {"identity": {"product": product}})
        sim.control.inject("no_sdo", node=2)
        refused(sim, "node 2")
        sim.control.inject("silent", node=1)
        refused(sim, "node 1")


def test_a_drive_that_keeps_its_power_is_not_called_disabled() -> None:
    with drives(COUNT) as sim:
        with bench_of(sim, disable="hold") as bench:
            bench.enable()
            bench.inject("local_control", node=2)
            eventually(lambda: bench.state() == "FAULT", "it is in FAULT")
            bench.sim.control.call("object", node=2, index=0x6007, value=0)
        config = arm_on(sim, COUNT, open_timeout=2.0)
        arm = LocalDevice(Session(PLUGIN, config))
        try:
            arm._session.start()
            words = "does not let go of the power that it has: joint joint_2 (node 2)"
            eventually(lambda: words in arm.operating_state().detail, words)
            sim.control.clear()
            eventually(lambda: arm.engine.connected, "it is connected")
            assert not any(drive["powered"] for drive in bench.drives())
        finally:
            arm.close()


HOMED = {"homing": {"method": 24, "speed_switch": 2.0, "speed_zero": 0.5, "required": True}}


def test_a_drive_that_has_started_anew_is_not_homed_any_more() -> None:
    joint = {**HOMED, "homing": {"method": 37, "required": True}}
    with drives(1) as sim:
        arm = LocalDevice(Session(PLUGIN, arm_on(sim, 1, joint)))
        try:
            arm._session.start()
            eventually(lambda: arm.engine.connected and arm.engine.has_sample, "it is connected")
            arm.enable(LONG)
            arm.home(LONG)
            assert arm.is_homed()
            sim.control.inject("reset", node=1)
            eventually(lambda: arm.operating_state().state == "FAULT", "it is in FAULT")
            eventually(lambda: not arm.is_homed(), "it is not homed")
            eventually(lambda: arm.operating_state().state == "DISABLED", "it is connected again")
            assert not arm.is_homed()
        finally:
            arm.close()


def test_homing_begins_after_motion_has_ended_and_its_end_by_disable_stops_it() -> None:
    with drives(1) as sim:
        arm = LocalDevice(Session(PLUGIN, arm_on(sim, 1, {**HOMED, "gear": 10.0})))
        bench = Bench(sim, arm)
        try:
            arm._session.start()
            eventually(lambda: arm.engine.connected and arm.engine.has_sample, "it is connected")
            arm.enable(LONG)

            def runs() -> bool:
                arm.servo_jv([1.0])
                return abs(bench.drives()[0]["velocity"]) > 1e3

            eventually(runs, "it moves")
            arm.home(LONG)
            assert arm.is_homed()
            arm.unhome(LONG)
            arm.state_command("home", 0.0)
            eventually(lambda: bench.drives()[0]["mode"] == 6, "it homes")
            arm.disable(LONG)
            assert not bench.drives()[0]["powered"]
            eventually(bench.still, "it stands")
        finally:
            arm.close()


@pytest.mark.parametrize(
    ("keys", "heard"),
    [
        ({}, "the heartbeat of node 127, which is this computer"),
        ({"master_node": 126}, "PDO 0x201 to node 1"),
        ({"master_node": 126, "heartbeat": {"ours": 0.0, "ours_timeout": 0.0}}, "PDO 0x201"),
    ],
)
def test_a_second_master_refuses_to_start_and_does_not_disturb_the_first(
    bench: Bench, keys: dict[str, Any], heard: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(arm_link, "LEAST_LISTENING", LISTENING)
    move = bench.start_moving(0.5)  # which takes longer than the other one listens
    other = LocalDevice(Session(PLUGIN, arm_on(bench.sim, COUNT, **keys)))
    try:
        other._session.start()
        eventually(lambda: "another master" in other.operating_state().detail, "it is refused")
        assert heard in other.operating_state().detail
        assert not other.engine.connected
    finally:
        other.close()
    move.wait(LONG)
    assert bench.state() == "ENABLED"


def test_the_log_of_frames_goes_on_after_the_bus_was_lost(tmp_path: Path) -> None:
    path = tmp_path / "frames.log"
    with drives(COUNT) as sim, bench_of(sim, candump=str(path)) as bench:
        bench.inject("bus_off", node="native*")
        eventually(lambda: bench.state() == "FAULT", "it is in FAULT")
        bench.sim.control.clear()
        eventually(lambda: bench.state() == "DISABLED", "it is back")
    starts = [line for line in path.read_text().splitlines() if line.endswith(" 000#8000")]
    assert len(starts) >= 2


@pytest.mark.slow
def test_a_job_of_before_a_reconnect_writes_nothing_after_it() -> None:
    with drives(COUNT) as sim, bench_of(sim) as bench:
        link = device_of(bench.arm).link
        before = Sdo(link.master.sdo(1))
        bench.inject("bus_off", node="native*")
        eventually(lambda: bench.state() == "FAULT", "it is in FAULT")
        bench.sim.control.clear()
        eventually(lambda: bench.state() == "DISABLED", "it is back")
        with pytest.raises(BusLost, match="closed meanwhile"):
            before.write(OBJECTS["profile_velocity"], 1)
        assert Sdo(link.master.sdo(1)).read(OBJECTS["profile_velocity"]) != 1


# ---------------------------------------------------------------------------- the process of the driver

PROGRAM = """
import contextlib, json, sys, time
values = json.loads(sys.argv[1])
from crtk_driver_canopen import PLUGIN
from crtk_driver_canopen.bus_state import BusLost
from crtk_driver_canopen.objects import OBJECTS
from crtk_driver_canopen.sdo import Sdo
from crtk_drivers.errors import CommandRefused
from crtk_drivers.front import LocalDevice
from crtk_drivers.session import Session
arm = LocalDevice(Session(PLUGIN, PLUGIN.load_config(values, {})))
arm._session.start()
while not (arm.engine.connected and arm.engine.has_sample):
    time.sleep(0.01)
arm.enable(20.0)
while True:
    with contextlib.suppress(CommandRefused):
        getattr(arm, sys.argv[2])([float(sys.argv[3])] * len(values["joints"]))
    time.sleep(0.02)
"""


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_drives_stop_by_themselves_when_the_driver_is_killed_or_frozen(number: int) -> None:
    with drives(COUNT) as sim:
        config = arm_on(sim, COUNT).model_dump_json(exclude_unset=True)
        program = subprocess.Popen([sys.executable, "-c", PROGRAM, config, "servo_jv", "0.5"])
        bench = Bench(sim, None)
        try:
            eventually(
                lambda: min(abs(drive["velocity"]) for drive in bench.drives()) > 1e4, "it moves"
            )
            os.kill(program.pid, number)
            eventually(
                lambda: not any(drive["powered"] for drive in bench.drives()) and bench.still(),
                "they stand without power",
            )
            before = bench.revolutions()
            if number == signal.SIGSTOP:
                os.kill(program.pid, signal.SIGCONT)
                eventually(lambda: bench.nmt(1) == "operational", "the driver is back")
                assert not any(drive["powered"] for drive in bench.drives())
            np.testing.assert_allclose(bench.revolutions(), before, atol=0.05)
        finally:
            program.kill()
            program.wait(LONG)

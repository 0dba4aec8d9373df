"""Somebody else on the bus: another master, NMT commands, nodes that are changed behind our back."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import can
import pytest

from crtk_driver_canopen import PLUGIN, arm_link
from crtk_drivers.errors import CommandRefused, TransitionFailed
from crtk_drivers.front import LocalDevice
from crtk_drivers.session import Session
from crtk_sim_backends.process import RunningSim
from rigs.beside import beside
from rigs.canopen_arm import LISTENING, arm_of, arm_on, drives
from rigs.waiting import LONG, eventually

COUNT = 2


@pytest.fixture(scope="module")
def sim() -> Iterator[RunningSim]:
    with drives(COUNT) as running:
        yield running


@pytest.fixture(scope="module")
def shared(sim: RunningSim) -> Iterator[LocalDevice]:
    with arm_of(arm_on(sim, COUNT)) as arm:
        yield arm


@pytest.fixture
def arm(shared: LocalDevice) -> LocalDevice:
    eventually(lambda: enables(shared), "it can be enabled")
    return shared


def enables(arm: LocalDevice) -> bool:
    try:
        arm.enable(LONG)
    except (TransitionFailed, CommandRefused):
        return False
    return True


@pytest.fixture
def other(sim: RunningSim) -> Iterator[can.BusABC]:
    """Another client on the bus."""
    with can.Bus(interface="crtk", channel=sim.paths["crtk"]) as bus:
        yield bus


def send(bus: can.BusABC, cob_id: int, data: str = "") -> None:
    bus.send(can.Message(arbitration_id=cob_id, data=bytes.fromhex(data), is_extended_id=False))


def faults(arm: LocalDevice, *words: str) -> None:
    eventually(lambda: arm.operating_state().state == "FAULT", "it is in FAULT")
    for word in words:
        eventually(
            lambda word=word: word in arm.operating_state().detail,
            f"{word!r} in {arm.operating_state().detail!r}",
        )


def powered(sim: RunningSim) -> list[bool]:
    status = sim.control.status()["drives"]
    return [status[str(node)]["axes"][0]["powered"] for node in range(1, COUNT + 1)]


@contextmanager
def repeated(bus: can.BusABC, cob_id: int, data: str) -> Iterator[None]:
    """The frame comes again and again."""

    def run(over: threading.Event) -> None:
        while not over.wait(0.02):
            send(bus, cob_id, data)

    with beside(run):
        yield


# --------------------------------------------------------------------------------------- another master


@pytest.mark.parametrize(
    ("cob_id", "data", "words"),
    [
        (0x080, "", "SYNC that is not ours"),
        (0x202, "0f00000000000008", "PDO 0x202 to node 2"),
        (0x77F, "05", "the heartbeat of node 127, which is this computer"),
    ],
)
def test_another_master_is_a_fault_for_as_long_as_it_is_heard(
    sim: RunningSim, arm: LocalDevice, other: can.BusABC, cob_id: int, data: str, words: str
) -> None:
    with repeated(other, cob_id, data):
        faults(arm, "another master is on this bus: it sends", words)
        eventually(lambda: not any(powered(sim)), "the drives stop and let go")
        with pytest.raises(TransitionFailed, match="another master"):
            arm.enable(LONG)
    eventually(lambda: enables(arm), "it can be enabled again")


def test_who_else_is_on_the_bus_is_told(arm: LocalDevice, other: can.BusABC) -> None:
    send(other, 0x77E, "05")
    send(other, 0x080)
    faults(arm, "SYNC that is not ours; also heard: node 126 (operational)")


def test_a_driver_refuses_a_bus_on_which_somebody_sends_sync(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(arm_link, "LEAST_LISTENING", LISTENING)
    with drives(1) as sim, can.Bus(interface="crtk", channel=sim.paths["crtk"]) as bus:
        arm = LocalDevice(Session(PLUGIN, arm_on(sim, 1)))
        try:
            with repeated(bus, 0x080, ""):
                arm._session.start()
                eventually(
                    lambda: "SYNC that is not ours" in arm.operating_state().detail, "it is refused"
                )
                assert not arm.engine.connected
                assert sim.control.status()["drives"]["1"]["nmt"] == "pre_operational"
            eventually(lambda: arm.engine.connected, "it is connected")
        finally:
            arm.close()


SECOND = """
import sys, time
from crtk_driver_canopen import PLUGIN, arm_link
from crtk_drivers.front import LocalDevice
from crtk_drivers.session import Session
arm_link.LEAST_LISTENING = float(sys.argv[2])
arm = LocalDevice(Session(PLUGIN, PLUGIN.load_config(__import__("json").loads(sys.argv[1]), {})))
arm._session.start()
while (status := arm.operating_state()).connecting or not status.detail:
    time.sleep(0.01)
print(status.detail, flush=True)
arm.close()
"""


def test_a_second_process_for_other_drives_is_refused_and_the_arm_goes_on(
    sim: RunningSim, arm: LocalDevice
) -> None:
    config = arm_on(sim, 1, {"node": COUNT + 1}, master_node=126)
    move = arm.move_jp(arm.setpoint_js().position + 0.2)
    values = config.model_dump_json(exclude_unset=True)
    program = [sys.executable, "-c", SECOND, values, str(LISTENING)]
    told = subprocess.run(program, check=True, capture_output=True, text=True, timeout=60.0).stdout
    assert "another master is on this bus: it sends SYNC that is not ours" in told
    move.wait(LONG)
    assert arm.operating_state().state == "ENABLED"
    arm.move_jp(arm.setpoint_js().position - 0.2).wait(LONG)


# ------------------------------------------------------------------------------- behind the driver's back


@pytest.mark.sweep(4)
@pytest.mark.parametrize(
    ("data", "command", "happened"),
    [
        ("8002", "pre operational", "is not operational any more"),
        ("0202", "stop", "is not operational any more"),
        ("8102", "reset node", "has started anew"),
        ("8202", "reset communication", "has started anew"),
    ],
)
def test_a_node_that_somebody_commands_is_a_fault_that_says_so(
    sim: RunningSim, arm: LocalDevice, other: can.BusABC, data: str, command: str, happened: str
) -> None:
    before = arm.measured_js().position
    send(other, 0x000, data)
    faults(
        arm,
        f"node 2 {happened} (somebody else sent the NMT command '{command}' to node 2)",
        "it is set up again when the arm is enabled",
    )
    eventually(lambda: not powered(sim)[1], "it has no power")
    eventually(lambda: enables(arm), "it can be enabled again")
    assert arm.operating_state().detail == ""
    assert abs(arm.measured_js().position - before).max() < 0.05
    arm.move_jp(arm.setpoint_js().position + 0.02).wait(LONG)


def test_a_drive_that_follows_velocities_stops_when_it_is_not_operational_any_more(
    sim: RunningSim, arm: LocalDevice, other: can.BusABC
) -> None:
    def runs() -> bool:
        arm.servo_jv([0.5] * COUNT)
        drives_now = sim.control.status()["drives"]
        return all(drives_now[node]["axes"][0]["velocity"] > 1e5 for node in drives_now)

    eventually(runs, "it moves")
    send(other, 0x000, "8002")
    faults(arm, "node 2 is not operational any more")
    eventually(lambda: not any(powered(sim)), "they stop and let go")
    eventually(lambda: enables(arm), "it can be enabled again")


def test_a_node_whose_heartbeat_is_switched_off_is_set_up_again(
    arm: LocalDevice, other: can.BusABC
) -> None:
    send(other, 0x602, "2b17100000000000")  # producer heartbeat time 0
    faults(arm, "node 2 is not heard any more")
    eventually(lambda: enables(arm), "it can be enabled again")


def test_a_node_whose_pdo_is_mapped_otherwise_is_a_fault_and_set_up_again(
    arm: LocalDevice, other: can.BusABC
) -> None:
    send(other, 0x602, "23001801820100c0")  # TPDO 1 is not valid any more
    faults(arm, "node 2 does not send its PDOs")
    eventually(lambda: enables(arm), "it can be enabled again")
    arm.move_jp(arm.setpoint_js().position + 0.02).wait(LONG)


def test_a_node_that_starts_anew_while_the_arm_is_disabled_is_a_fault(
    arm: LocalDevice, other: can.BusABC
) -> None:
    arm.disable(LONG)
    send(other, 0x000, "8101")
    faults(arm, "node 1 has started anew")

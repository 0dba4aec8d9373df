"""What the driver tells of boards that it reads, over UDP; and that it changes nothing."""

from __future__ import annotations

import copy
import json
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from crtk_driver_dvrk.plugin import TYPICAL
from crtk_drivers.cli import main
from crtk_drivers.front import LocalDevice
from crtk_sim_backends.dvrk import SIM, RunningSim
from rigs.dvrk_bench import AXES, NODES, PSM, arm_at, notes
from rigs.waiting import eventually

SCALE = np.array(
    [each["encoder"]["bits_to_position"]["scale"] for each in PSM["robots"][0]["actuators"]]
)
COUPLING = np.eye(7)
COUPLING[3:, 3:] = json.loads(Path(TYPICAL["coupling"]).read_text())["coupling"][
    "ActuatorToJointPosition"
]
COUNTS = np.array([1000.0, -2000.0, 30_000.0, 400.0, -500.0, 600.0, 700.0])


@pytest.fixture(scope="module")
def shared() -> Iterator[RunningSim]:
    with SIM.spawn() as sim:
        yield sim


@pytest.fixture
def sim(shared: RunningSim) -> Iterator[RunningSim]:
    """The controller, its motors in the middle, nobody's hand on them."""
    for node in range(2):
        for axis in range(4):
            shared.control.call("turn", node=node, axis=axis)
            shared.control.call("place", node=node, axis=axis)
    yield shared
    shared.control.clear()


@pytest.fixture(scope="module")
def driver(shared: RunningSim) -> Iterator[LocalDevice]:
    """Connected once: reading changes nothing."""
    with arm_at(shared) as arm:
        yield arm


@pytest.fixture
def arm(sim: RunningSim, driver: LocalDevice) -> LocalDevice:
    return driver


def test_joints_are_where_coupling_and_encoders_say(sim: RunningSim, arm: LocalDevice) -> None:
    for node, axis, counts in zip(NODES, AXES, COUNTS, strict=True):
        sim.control.call("place", node=node, axis=axis, counts=counts)
    goal = COUPLING @ (SCALE * COUNTS)
    eventually(lambda: np.allclose(arm.measured_js().position, goal), "joints are there")
    assert arm.measured_js().name == TYPICAL["joint_names"]
    assert not arm.measured_js().velocity.any()


def test_potentiometers_are_a_second_measurement(sim: RunningSim, arm: LocalDevice) -> None:
    sim.control.call("place", node=0, axis=1, counts=20_000)
    at = 4.5 / 65536 * (0x8000 + 2000)
    sensor = PSM["robots"][0]["actuators"][1]["potentiometer"]["voltage_to_position"]
    goal = sensor["scale"] * at + sensor["offset"]
    eventually(lambda: abs(arm.measured2_js().position[1] - goal) < 1e-4, "it is told")
    assert arm.state.potentiometers()[1] == pytest.approx(goal, abs=1e-4)
    assert arm.measured2_js().velocity.size == 0


def test_velocities_are_those_of_the_encoders_periods(sim: RunningSim, arm: LocalDevice) -> None:
    sim.control.call("turn", node=0, axis=0, velocity=-5000.0)
    goal = -5000.0 * SCALE[0]
    eventually(lambda: abs(arm.measured_js().velocity[0] - goal) < 1e-4, "its velocity")
    before = arm.measured_js().position[0]
    eventually(lambda: (arm.measured_js().position[0] - before) * goal > 0.0, "it has moved on")


@pytest.mark.slow
def test_an_arm_that_is_moved_by_hand_can_be_disabled(sim: RunningSim, arm: LocalDevice) -> None:
    """Nothing of ours moves it, so there is no stop to be seen."""
    sim.control.call("turn", node=0, axis=0, velocity=50_000.0)
    arm.enable()
    arm.disable()
    before = arm.health().samples
    eventually(lambda: arm.health().samples > before + 300, "it goes on measuring")
    assert str(arm.operating_state().state) == "DISABLED"


def test_nothing_can_be_commanded(arm: LocalDevice) -> None:
    assert not [name for name in arm.crtk_commands if name.startswith(("servo", "move", "interp"))]
    assert "measured_js" in arm.crtk_commands


def test_switches_are_read_as_the_file_says(sim: RunningSim, arm: LocalDevice) -> None:
    """`pressed_value` is false: low is pressed."""
    sim.control.call("press", node=0, bit=0, high=True)
    eventually(lambda: arm.state.psm1_suj_clutch() is False, "it is not pressed")
    sim.control.call("press", node=0, bit=0, high=False)
    eventually(lambda: arm.state.psm1_suj_clutch() is True, "it is pressed")


def test_power_relay_watchdog_and_amplifiers_are_told(arm: LocalDevice) -> None:
    assert arm.state.motor_power() is False
    assert arm.state.safety_relay() is False
    assert arm.state.watchdog_expired() is False
    assert arm.state.amplifiers() == (0.0,) * 7
    assert arm.state.temperatures() == (31.0, 33.0) * 2
    assert np.abs(arm.state.currents()).max() < 1e-3
    told = notes(arm)
    assert "board 6: FPGA V3, QLA1, firmware 8, node 0; watchdog off" in told
    assert "board 7 power: motors off; safety relay open; 0 of 4 amplifiers on" in told
    assert "encoders: those of board 6, 7 were not set" in told


def test_efforts_come_from_currents(sim: RunningSim, tmp_path: Path) -> None:
    """A current offset of 1 A in the file: joint efforts are those of virtual work."""
    found = copy.deepcopy(PSM)
    for each in found["robots"][0]["actuators"]:
        each["drive"]["bits_to_current"]["offset"] += 1.0
    io = tmp_path / "io.json"
    io.write_text(json.dumps(found))
    scales = [each["drive"]["effort_to_current"]["scale"] for each in PSM["robots"][0]["actuators"]]
    goal = np.linalg.inv(COUPLING).T @ (1.0 / np.array(scales))
    files = {**TYPICAL, "io": str(io)}
    with arm_at(sim, **files) as arm:
        assert arm.measured_js().effort == pytest.approx(goal, rel=1e-3)


def test_reading_writes_nothing_but_address_and_node(sim: RunningSim, arm: LocalDevice) -> None:
    samples = arm.health().samples
    eventually(lambda: arm.health().samples > samples + 20, "it reads")
    address = int.from_bytes(bytes(map(int, sim.host.split("."))), "little")
    for board in sim.control.status()["boards"]:
        assert board["written"] == {"11": address, "1": 0}


@pytest.mark.slow
def test_closing_while_nobody_answers_takes_no_time(sim: RunningSim) -> None:
    with arm_at(sim, open_timeout=60.0) as arm:
        sim.control.inject("silence")
        eventually(lambda: not arm.engine.connected, "it is lost")
        heard = sim.control.status()["datagrams"]
        eventually(lambda: sim.control.status()["datagrams"] > heard + 5, "it tries again")
        threads = threading.active_count()
    assert threading.active_count() < threads


def test_a_scan_tells_boards_as_dvrks_program_does(
    sim: RunningSim, capsys: pytest.CaptureFixture[str]
) -> None:
    where = ["--host", sim.host, "--udp-port", str(sim.ports["boards"]), "--broadcast", ""]
    assert main(["dvrk", "scan", *where]) == 0
    told = capsys.readouterr().out
    assert "Node 0, BoardId 6, FPGA_V3, QLA1, firmware 8" in told
    assert "Node 1, BoardId 7, FPGA_V3, QLA1, firmware 8" in told


def test_readings_tell_nothing_once_the_link_is_closed(sim: RunningSim) -> None:
    with arm_at(sim) as other:
        tell = other.engine.readings["motor_power"].tell
        eventually(lambda: tell() is not None, "it is read")
    assert tell() is None

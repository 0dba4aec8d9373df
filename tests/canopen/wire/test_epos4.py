"""The CANopen arm on simulated Maxon EPOS4: rpm, no 607Ch, a 6502h that lies; and foreign masters on them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import canopen
import numpy as np
import pytest

from crtk_driver_canopen import PLUGIN
from crtk_driver_canopen.bus import BusAddress, CanLink
from crtk_driver_canopen.drive_profile import of_identity
from crtk_driver_canopen.identity import Identity
from crtk_driver_canopen.master import Master
from crtk_driver_canopen.objects import OBJECTS
from crtk_driver_canopen.sdo import Sdo
from crtk_driver_canopen.units import read_unit_objects
from crtk_drivers.errors import CrtkError
from crtk_drivers.front import LocalDevice
from crtk_drivers.session import Session
from crtk_sim_backends.process import RunningSim
from rigs.canopen_arm import arm_of, device_of, drives, patient_arm_on, start_anew
from rigs.waiting import LONG, eventually

TURN = 2.0 * np.pi
JOINT: dict[str, Any] = {
    "gear": 50.0,
    "lower": -3.0,
    "upper": 3.0,
    "velocity": 1.0,
    "acceleration": 10.0,
    "effort": 20.0,
    "following_error": 1.0,
}
CYCLIC = ("csp", "csv", "cst")


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningSim]:
    path = tmp_path_factory.mktemp("epos4") / "epos4.eds"
    with drives(2, personality="epos4", eds=str(path)) as sim:
        yield sim


@pytest.fixture
def sim(shared: RunningSim) -> RunningSim:
    """The drives as they come up."""
    start_anew(shared)
    return shared


@contextmanager
def library(sim: RunningSim) -> Iterator[Any]:
    """Node 1 in the hands of the canopen library, by the EDS of the drive."""
    network = canopen.Network()
    network.connect(interface="crtk", channel=sim.paths["crtk"])
    try:
        drive = network.add_node(1, sim.paths["eds"])
        drive.sdo.RESPONSE_TIMEOUT = LONG
        yield drive
    finally:
        network.disconnect()


def joint(node: int, **keys: Any) -> dict[str, Any]:
    return {"node": node, **JOINT, "modes": CYCLIC, **keys}


def arm(sim: RunningSim, **keys: Any) -> AbstractContextManager[LocalDevice]:
    joints = {f"joint_{node}": joint(node, **keys) for node in (1, 2)}
    return arm_of(patient_arm_on(sim, 0, joints=joints))


def turned(sim: RunningSim) -> list[float]:
    """How far the motors have turned, rad of the joints."""
    drives = sim.control.status()["drives"]
    return [float(drives[n]["axes"][0]["revolutions"]) * TURN / 50.0 for n in ("1", "2")]


def refused(sim: RunningSim, words: str, **keys: Any) -> None:
    """The arm says so, and does not get connected."""
    robot = LocalDevice(Session(PLUGIN, patient_arm_on(sim, 0, joints={"a": joint(1, **keys)})))
    try:
        robot._session.start()
        eventually(lambda: words in robot.operating_state().detail, words)
        assert not robot.engine.connected
    finally:
        robot.close()


def test_coarse_velocities_are_told(sim: RunningSim) -> None:
    """A turn a minute is 0.1 rad/s without a gear."""
    with arm(sim, gear=1.0) as robot:
        notes = " ".join(note.text for note in robot.health().notes)
        assert "velocities count in steps of 0.105 (60A9h): slower ones are 0" in notes
        assert robot.engine.device.velocity_steps == pytest.approx((TURN / 60.0,) * 2)
    start_anew(sim)  # it holds the speed limit of a joint without a gear
    with arm(sim) as robot:
        notes = " ".join(note.text for note in robot.health().notes)
        assert "velocities count in steps" not in notes


def test_it_moves_in_cyclic_modes_that_6502h_does_not_name(sim: RunningSim) -> None:
    assert sim.control.call("object", node=1, index=0x6502) == 0x225
    with arm(sim) as robot:
        robot.enable(LONG)
        start = robot.measured_js().position
        robot.move_jp(start + 0.1).wait(LONG)
        eventually(lambda: np.abs(robot.measured_js().position - start - 0.1).max() < 2e-3, "there")
        assert turned(sim) == pytest.approx(robot.measured_js().position, abs=2e-3)

        def is_as_asked() -> bool:
            robot.servo_jv([0.3, 0.3])
            told = robot.measured_js().velocity  # rpm of the motor, made rad/s
            return bool(np.abs(told - 0.3).max() < 0.05)

        for _ in range(10):
            eventually(is_as_asked, "it is as fast as asked")


def test_units_are_those_of_the_drive(sim: RunningSim) -> None:
    with arm(sim) as robot:
        facts = [axis.facts for axis in device_of(robot).link.axes]
        for each in facts:
            assert each.drive.encoder == 2000
            assert each.drive.rated_torque == pytest.approx(1.0)  # N·m, told in µN·m
            assert each.units.position == pytest.approx(TURN / 2000 / 50)
            assert each.units.velocity == pytest.approx(TURN / 60 / 50)
            assert each.units.effort == pytest.approx(0.05)
        rpm = 60.0 * 50.0 / TURN
        assert sim.control.call("object", node=1, index=0x607F) == np.ceil(1.2 * rpm)


def test_another_encoder_is_read(sim: RunningSim) -> None:
    with library(sim) as node:
        node.sdo[0x3010][1].raw = 1024
    with arm(sim) as robot:
        assert [axis.facts.drive.encoder for axis in device_of(robot).link.axes] == [4096, 2000]


def test_home_is_where_30b0h_says(sim: RunningSim) -> None:
    homing = {"method": 37, "position": 0.5, "required": True}
    with arm(sim, homing=homing) as robot:
        robot.enable(LONG)
        assert not robot.is_homed()
        robot.home(LONG)
        eventually(lambda: robot.is_homed(), "it is homed")
        eventually(lambda: np.abs(robot.measured_js().position - 0.5).max() < 1e-2, "it is there")
        counts = round(0.5 * 50 * 2000 / TURN)
        assert sim.control.call("object", node=1, index=0x30B0) == counts


def test_a_lost_sensor_takes_the_home_away(sim: RunningSim) -> None:
    with arm(sim, homing={"method": 37, "required": True}) as robot:
        robot.enable(LONG)
        robot.home(LONG)
        eventually(lambda: robot.is_homed(), "it is homed")
        sim.control.inject("fault", node=2, error="encoder")
        eventually(lambda: "position sensor breach" in robot.operating_state().detail, "it is told")
        eventually(lambda: not robot.is_homed(), "its home is lost")


def test_safe_torque_off_is_told_by_its_own_error(sim: RunningSim) -> None:
    with arm(sim) as robot:
        sim.control.inject("safe_torque_off", node=1)
        with pytest.raises(CrtkError, match="safe torque off is active"):
            robot.enable(LONG)
        sim.control.clear()
        robot.enable(LONG)


def test_without_the_profile_it_is_refused_with_what_to_give(sim: RunningSim) -> None:
    refused(
        sim, "or, if it has the mode although 6502h does not name it, a `profile`", profile="none"
    )
    homing = {"method": 37, "position": 0.1}
    keys = {"modes": ("pp",), "counts_per_turn": 2000.0, "effort": 0.0, "homing": homing}
    refused(sim, "the drive has no 607Ch:00 home offset", profile="none", **keys)


def test_another_hardware_is_known_by_its_name(sim: RunningSim) -> None:
    """1008h begins with EPOS4: the rated torque of a maxon DCF, 4760 mA by 107746 µN·m/A, is in µN·m."""
    sim.control.inject("wrong_identity", product=0x61500000)
    sim.control.call("object", node=1, index=0x6076, value=512_871)
    joints = {"a": joint(1, gear=26.0)}
    with arm_of(patient_arm_on(sim, 0, joints=joints)) as arm:
        facts = device_of(arm).link.axes[0].facts
        assert facts.drive.rated_torque == pytest.approx(4.760 * 0.107746, rel=1e-5)
        arm.enable(LONG)

        def is_sent() -> bool:
            arm.servo_jf([2.0])
            return int(sim.control.call("object", node=1, index=0x6071)) in (149, 150)

        eventually(is_sent, "2 N·m are 150 thousandths")
        assert abs(float(arm.measured_js().effort[0])) < 20.0
    sim.control.clear()


@pytest.fixture(scope="module")
def kin(tmp_path_factory: pytest.TempPathFactory, shared: RunningSim) -> Iterator[RunningSim]:
    """A drive of the same maker that is no EPOS4 by name or product."""
    folder = tmp_path_factory.mktemp("kin")
    sheet = Path(shared.paths["eds"]).read_text().replace("EPOS4 Module 24/1.5", "Other 5")
    sheet = sheet.replace("0x60500000", "0x61500000").replace("0x000003ED", "0x00000225")
    (folder / "other.eds").write_text(sheet)
    (folder / "drives.yaml").write_text("1: {from_eds: other.eds}\n")
    with drives(1, drives=str(folder / "drives.yaml")) as sim:
        yield sim


def test_another_product_of_the_maker_is_noted_and_can_be_named(kin: RunningSim) -> None:
    plain = {"a": joint(1, modes=("cst",), counts_per_turn=2000.0)}
    with arm_of(patient_arm_on(kin, 0, joints=plain)) as robot:
        notes = " ".join(note.text for note in robot.health().notes)
        assert "give `profile: epos4` if it is one of these" in notes
        facts = device_of(robot).link.axes[0].facts
        assert facts.drive.rated_torque == pytest.approx(1.0)  # by current and torque constant
    named = {"a": joint(1, modes=("cst",), profile="epos4")}
    with arm_of(patient_arm_on(kin, 0, joints=named)) as robot:
        assert device_of(robot).link.axes[0].facts.drive.rated_torque == pytest.approx(1.0)
        robot.enable(LONG)


def test_a_rated_torque_in_another_unit_is_refused(sim: RunningSim) -> None:
    """1 N·m read as 1000: no joint of 20 N·m has such a motor."""
    keys = {"modes": ("cst",), "counts_per_turn": 2000.0}
    for words in ("6076h", "5e+04 N·m", "20 N·m", "`rated_torque`"):
        refused(sim, words, profile="none", **keys)


def test_the_library_as_master_finds_the_same_odd_points(sim: RunningSim) -> None:
    with library(sim) as node:
        assert node.sdo[0x6502].raw == 0x225
        assert node.sdo[0x60A9].raw == 0x00B44700
        assert node.sdo[0x1018][1].raw == 0xFB
        for index, sub in ((0x607C, 0), (0x605D, 0), (0x6091, 1), (0x608F, 1), (0x1029, 1)):
            with pytest.raises(canopen.SdoAbortedError) as refusal:
                node.sdo.upload(index, sub)
            assert refusal.value.code == 0x06020000
        with pytest.raises(canopen.SdoAbortedError):
            node.sdo[0x6098].raw = 0
        node.tpdo.read()
        node.rpdo.read()
        assert [node.tpdo[n].enabled for n in (1, 2, 3, 4)] == [True, False, False, False]
        assert all(node.rpdo[n].enabled for n in (1, 2, 3, 4))
        assert [each.index for each in node.rpdo[3]] == [0x6040, 0x607A]
        with pytest.raises(canopen.SdoAbortedError):
            node.sdo[0x1800][1].raw = 0x181  # without bit 30


def test_units_are_read_from_the_library_as_node(sim: RunningSim) -> None:
    """The library's node by the EDS, as a foreign drive: what it answers is the file's."""
    network = canopen.Network()
    network.connect(interface="crtk", channel=sim.paths["crtk"])
    link = CanLink(BusAddress("crtk", sim.paths["crtk"], 1_000_000, {}))
    try:
        network.create_node(9, sim.paths["eds"])
        link.open()
        profile = of_identity(Identity(vendor=0xFB, product=0x60500000))
        sdo = Sdo(Master(link).sdo(9))
        told = read_unit_objects(sdo, profile)
        assert (told.encoder, told.velocity_unit) == (2000, 0x00B44700)
        assert told.rated_torque == pytest.approx(1.0)
        assert sdo.find(OBJECTS["home_offset"]) is None
        sdo.ensure(profile.home_entry, -1234)
    finally:
        link.close()
        network.disconnect()

"""The CANopen arm on drives that CiA 402 permits: objects that are missing or can only be written."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from crtk_driver_canopen import PLUGIN
from crtk_drivers.front import LocalDevice
from crtk_drivers.session import Session
from crtk_sim_backends.canopen.eds import PUBLISHED
from crtk_sim_backends.process import RunningSim
from rigs.canopen_arm import arm_of, drives, patient_arm_on, stream
from rigs.waiting import LONG, eventually

TURN = 2.0 * np.pi
GEAR = 50.0


def sheet(
    folder: Path, lacks: tuple[str, ...] = (), changes: dict[str, dict[str, str]] | None = None
) -> str:
    """Write the EDS of the simulated drive without some objects, and with other keys in some sections."""
    kept = []
    for part in PUBLISHED.read_text().split("\n\n"):
        name = part[1 : part.index("]")] if part.startswith("[") else ""
        if any(name == index or name.startswith(f"{index}sub") for index in lacks):
            continue
        for key, value in (changes or {}).get(name, {}).items():
            lines = [line for line in part.splitlines() if not line.startswith(f"{key}=")]
            part = "\n".join([*lines, f"{key}={value}"])
        kept.append(part)
    path = folder / "drive.eds"
    path.write_text("\n\n".join(kept))
    return str(path)


@contextmanager
def legal(
    folder: Path, lacks: tuple[str, ...] = (), changes: dict[str, dict[str, str]] | None = None
) -> Iterator[RunningSim]:
    with drives(1, from_eds=sheet(folder, lacks, changes)) as sim:
        yield sim


def config(sim: RunningSim, mode: str, **keys: Any) -> Any:
    joint = {
        "node": 1,
        "gear": GEAR,
        "lower": -3.0,
        "upper": 3.0,
        "velocity": 1.0,
        "acceleration": 10.0,
        "effort": 20.0,
        "following_error": 1.0,
        "modes": (mode,),
        **keys.pop("joint", {}),
    }
    return patient_arm_on(sim, 0, joints={"a": joint}, **keys)


def turned(sim: RunningSim) -> float:
    """How far the motor has turned, rad of the joint: the simulator's own truth."""
    drive = sim.control.status()["drives"]["1"]
    return float(drive["axes"][0]["revolutions"]) * TURN / GEAR


def notes(arm: LocalDevice) -> str:
    return "\n".join(note.text for note in arm.health().notes)


def refusal(sim: RunningSim, config: Any) -> str:
    """What the arm says that does not connect."""
    arm = LocalDevice(Session(PLUGIN, config))
    try:
        arm._session.start()
        eventually(lambda: "failed" in (d := arm.operating_state().detail) or "no " in d, "refused")
        assert not arm.engine.connected
        return arm.operating_state().detail
    finally:
        arm.close()


def moves(sim: RunningSim, arm: LocalDevice, mode: str) -> None:
    """The joint goes where, or in the direction that, it is told, as the motor itself shows."""
    arm.enable(LONG)
    if mode in ("pp", "csp", "ip"):
        arm.move_jp([0.2]).wait(LONG)
        eventually(lambda: abs(turned(sim) - 0.2) < 2e-3, "it is there")
    elif mode in ("pv", "csv"):
        stream(arm, "servo_jv", [0.5], 0.5)
        assert turned(sim) == pytest.approx(0.25, rel=0.5)
    else:
        stream(arm, "servo_jf", [2.0], 0.3)
        assert turned(sim) > 0.0


def test_profile_position_needs_no_deceleration(tmp_path: Path) -> None:
    with legal(tmp_path, ("6084",)) as sim, arm_of(config(sim, "pp")) as arm:
        told = notes(arm)
        assert told.count("6084h") == 1
        assert "slows down as it speeds up" in told
        moves(sim, arm, "pp")
        assert sim.control.call("object", node=1, index=0x6083) == pytest.approx(
            10.0 * GEAR * 65536 / TURN, rel=1e-3
        )


@pytest.mark.parametrize("mode", ["csp", "pp", "csv", "pv", "cst", "tq", "ip"])
def test_a_mode_may_be_write_only(tmp_path: Path, mode: str) -> None:
    """DSP 402 V2.0 has 6060h so; 6061h tells the mode."""
    changes = {"6060": {"AccessType": "wo"}}
    with legal(tmp_path, changes=changes) as sim, arm_of(config(sim, mode)) as arm:
        moves(sim, arm, mode)


def test_modes_change_although_6060h_is_write_only(tmp_path: Path) -> None:
    joint = {"modes": ("csp", "csv")}
    changes = {"6060": {"AccessType": "wo"}}
    with legal(tmp_path, changes=changes) as sim, arm_of(config(sim, "csp", joint=joint)) as arm:
        moves(sim, arm, "csp")
        stream(arm, "servo_jv", [-0.5], 0.5)
        assert turned(sim) < 0.1


def test_a_write_only_mode_that_is_not_shown_is_refused(tmp_path: Path) -> None:
    with legal(tmp_path, changes={"6060": {"AccessType": "wo"}}) as sim:
        sim.control.inject("ignored_writes", node=1, index=0x6060)
        assert "6061h" in refusal(sim, config(sim, "csv"))


@pytest.mark.parametrize("lacks", [("606C",), ("6077",), ("606C", "6077")])
def test_feedback_that_a_drive_lacks_is_done_without(
    tmp_path: Path, lacks: tuple[str, ...]
) -> None:
    with legal(tmp_path, lacks) as sim, arm_of(config(sim, "csp")) as arm:
        state = arm.measured_js()
        assert (len(state.velocity) == 0) is ("606C" in lacks)
        assert (len(state.effort) == 0) is ("6077" in lacks)
        for index in lacks:
            assert notes(arm).count(f"no {index}h") == 1
        moves(sim, arm, "csp")


@pytest.mark.parametrize("index", ["606C", "6077"])
def test_feedback_that_cannot_be_mapped_is_done_without(tmp_path: Path, index: str) -> None:
    changes = {index: {"PDOMapping": "0"}}
    with legal(tmp_path, changes=changes) as sim, arm_of(config(sim, "csp")) as arm:
        assert notes(arm).count(f"{index}h") == 1
        moves(sim, arm, "csp")


def test_optional_objects_may_all_be_missing(tmp_path: Path) -> None:
    lacks = ("605A", "605B", "605C", "605D", "605E", "6065", "6067", "6068", "607C", "607D", "607F")
    lacks += (
        "6080",
        "6084",
        "6085",
        "60C2",
        "6502",
        "1029",
        "1019",
        "6085",
        "60C5",
        "60C6",
        "603F",
    )
    joint = {"modes": ("csp", "pp", "csv")}
    with legal(tmp_path, lacks) as sim, arm_of(config(sim, "csp", joint=joint)) as arm:
        moves(sim, arm, "csp")
        for index in ("605A", "605D", "605E", "6065", "607D", "6084", "60C2"):
            assert notes(arm).count(f"no {index}h") == 1, index


def test_a_drive_without_a_heartbeat_is_heard_by_its_pdos(tmp_path: Path) -> None:
    """A node has a heartbeat or node guarding (CiA 301)."""
    with legal(tmp_path, ("1017",)) as sim, arm_of(config(sim, "csp")) as arm:
        assert "only its PDOs tell that it is there" in notes(arm)
        moves(sim, arm, "csp")
        sim.control.inject("reset")
        eventually(lambda: "started anew" in arm.operating_state().detail, "its start is seen")
        eventually(lambda: not arm.engine.connected, "nothing is heard of it")
        eventually(lambda: arm.engine.connected and arm.engine.has_sample, "it is back")
        arm.enable(LONG)


@pytest.mark.parametrize(
    ("lacks", "mode", "says"),
    [
        (("1016",), "csp", "1016h:01 consumer heartbeat time: the node has no such object"),
        (("6007",), "csp", "6007h:00 abort connection option: the drive has no such object"),
    ],
)
def test_a_drive_that_nothing_stops_is_refused(
    tmp_path: Path, lacks: tuple[str, ...], mode: str, says: str
) -> None:
    with legal(tmp_path, lacks) as sim:
        assert says in refusal(sim, config(sim, mode))


@pytest.mark.parametrize(
    ("index", "mode", "kind"),
    [
        ("607A", "csp", "cyclic synchronous position (mandatory)"),
        ("6081", "pp", "profile position (mandatory)"),
        ("60FF", "csv", "cyclic synchronous velocity (mandatory)"),
        ("6071", "cst", "cyclic synchronous torque (mandatory)"),
    ],
)
def test_what_nothing_stands_in_for_is_refused(
    tmp_path: Path, index: str, mode: str, kind: str
) -> None:
    with legal(tmp_path, (index,), {"6502": {"DefaultValue": "0"}}) as sim:
        sim.control.call("object", node=1, index=0x6502, value=0x3FF)
        told = refusal(sim, config(sim, mode))
        assert f"the drive has no {index}h" in told
        assert kind in told


def test_one_mode_needs_no_6060h(tmp_path: Path) -> None:
    changes = {"6502": {"DefaultValue": "128"}}
    with legal(tmp_path, ("6060",), changes) as sim:
        with arm_of(config(sim, "csp")) as arm:
            assert notes(arm).count("no 6060h") == 1
            moves(sim, arm, "csp")
        joint = {"modes": ("csp", "csv")}
        assert "does not have" in refusal(sim, config(sim, "csp", joint=joint))


def test_a_fixed_exponent_takes_the_period(tmp_path: Path) -> None:
    """10 ms are 10 times 10^-3 s where a drive counts milliseconds only."""
    changes = {"60C2sub2": {"AccessType": "const", "DefaultValue": "-3"}}
    with legal(tmp_path, changes=changes) as sim, arm_of(config(sim, "csp")) as arm:
        assert sim.control.call("object", node=1, index=0x60C2, sub=1) == 10
        moves(sim, arm, "csp")


def test_what_can_only_be_written_is_written_as_a_parameter(tmp_path: Path) -> None:
    changes = {"6066": {"AccessType": "wo"}}
    joint = {"parameters": {"6066": 77}}
    with legal(tmp_path, changes=changes) as sim, arm_of(config(sim, "csp", joint=joint)) as arm:
        assert sim.control.call("object", node=1, index=0x6066) == 77
        assert "not read back" in notes(arm)


@pytest.mark.parametrize("index", ["6081", "6083", "6085", "607F", "6080", "60C5", "607Dsub1"])
def test_rates_and_limits_may_be_write_only(tmp_path: Path, index: str) -> None:
    with (
        legal(tmp_path, changes={index: {"AccessType": "wo"}}) as sim,
        arm_of(config(sim, "pp")) as arm,
    ):
        moves(sim, arm, "pp")


def test_a_mode_that_is_not_shown_is_noted(tmp_path: Path) -> None:
    changes = {"6502": {"DefaultValue": "128"}}
    with legal(tmp_path, ("6061",), changes) as sim, arm_of(config(sim, "csp")) as arm:
        assert notes(arm).count("no 6061h") == 1
        moves(sim, arm, "csp")


def test_homing_needs_no_acceleration_of_its_own(tmp_path: Path) -> None:
    homing = {"method": 37, "acceleration": 1.0, "required": True}
    joint = {"homing": homing}
    with legal(tmp_path, ("609A",)) as sim, arm_of(config(sim, "csp", joint=joint)) as arm:
        assert notes(arm).count("no 609Ah") == 1
        arm.enable(LONG)
        arm.home(LONG)
        eventually(lambda: arm.is_homed(), "it is homed")


def test_a_dcf_connects_to_its_own_simulator(tmp_path: Path) -> None:
    """Maxon's has 60C2h:1 = 0; the driver writes what it says, and then the period of the cycle."""
    said = {"60C2sub1": {"DefaultValue": "0", "ParameterValue": "0"}}
    said |= {"605A": {"ParameterValue": "-1"}, "6085": {"ParameterValue": "0"}}
    said |= {"6066": {"ParameterValue": "77"}}
    for name in ("60C2sub1", "6085"):
        said[name]["LowLimit"] = "0"
    said["605A"]["LowLimit"] = "-32768"
    path = sheet(tmp_path, changes=said)
    with drives(1, from_eds=path) as sim, arm_of(config(sim, "csp", joint={"eds": path})) as arm:
        assert sim.control.call("object", node=1, index=0x60C2, sub=1) == 10
        assert sim.control.call("object", node=1, index=0x605A) == -1
        assert sim.control.call("object", node=1, index=0x6066) == 77
        moves(sim, arm, "csp")

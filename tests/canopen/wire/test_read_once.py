"""What a connect costs on the bus, counted by the simulator's own log of its frames."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pytest

from crtk_driver_canopen.bus import CanLink
from crtk_driver_canopen.master import Master
from crtk_driver_canopen.objects import OBJECTS, Entry, ObjectType
from crtk_driver_canopen.read_once import Readings
from crtk_driver_canopen.tools import bus_address
from crtk_driver_canopen.units import TURN
from crtk_sim_backends.process import RunningSim
from rigs.canopen_arm import JOINT, arm_of, drives, patient_arm_on
from rigs.waiting import LONG

CHANGES: dict[int, str] = {
    0x6041: "looked at twice to see whether it has power, and asked for by the table of objects",
    0x6064: "looked at twice to see whether it moves, asked for by the table, and read before the start",
}
"""Objects that may be read again although nobody has written them, and why."""

JOINTS: dict[str, dict[str, Any]] = {
    "default": {"modes": ("csp",)},
    "modes": {},
    "homing": {
        "modes": ("csp", "pp", "pv"),
        "homing": {
            "method": 37,
            "speed_switch": 0.5,
            "speed_zero": 0.1,
            "acceleration": 1.0,
            "position": 0.0,
        },
    },
}
WRITTEN = {0x6040, 0x607F, 0x6080}
"""Objects that are written into a drive that is set up already: it had its limits of speed back."""
REQUESTS = {"default": (150, 85), "modes": (175, 95), "homing": (195, 105)}
"""Most SDO requests of a connect: to a drive from the factory, and to one that is set up already."""


def connects(log: Path) -> Iterator[list[bytes]]:
    """The requests to node 1 of each connect, from NMT pre-operational for all nodes to NMT start."""
    part: list[bytes] | None = None
    for line in log.read_text().splitlines():
        identifier, data = line.split()[2].split("#")
        if (identifier, data) == ("000", "8000"):
            part = []
        elif identifier == "000" and part is not None:
            yield part
            part = None
        elif identifier == "601" and part is not None:
            part.append(bytes.fromhex(data))


def read_again(requests: list[bytes]) -> Counter[str]:
    """Objects that were read again, and not written since: an object has its sub-indices together."""
    seen: set[tuple[int, int]] = set()
    again: Counter[str] = Counter()
    for data in requests:
        command, index, sub = data[0], int.from_bytes(data[1:3], "little"), data[3]
        if command == 0x40:
            if (index, sub) in seen and index not in CHANGES:
                again[f"{index:04X}h:{sub:02X}"] += 1
            seen.add((index, sub))
        elif command >> 5 == 1:
            seen = {key for key in seen if key[0] != index}
    return again


@pytest.mark.parametrize("name", JOINTS)
def test_a_connect_reads_each_object_once(tmp_path: Path, name: str) -> None:
    log = tmp_path / "frames.log"
    with drives(1, log=str(log)) as sim:
        config = patient_arm_on(sim, 1, JOINTS[name], moves="drives")
        for _ in range(2):
            with arm_of(config):
                pass
    first, second = connects(log)
    for requests in (first, second):
        assert not read_again(requests)
    assert len(first) < REQUESTS[name][0]
    assert len(second) < REQUESTS[name][1]
    written = {int.from_bytes(data[1:3], "little") for data in second if data[0] >> 5 == 1}
    assert written <= WRITTEN


def test_units_that_a_parameter_changes_count() -> None:
    """The feed constant is read before the parameters are written, to see whether the drive moves."""
    with drives(1) as sim:
        joint = {"modes": ("csp",), "parameters": {"6092:1": 8192}}
        with arm_of(patient_arm_on(sim, 1, joint)) as arm:
            arm.enable(LONG)
            arm.move_jp([0.2]).wait(LONG)
            motor = sim.control.status()["drives"]["1"]["axes"][0]["revolutions"]
            assert motor * TURN / JOINT["gear"] == pytest.approx(0.2, abs=0.01)  # type: ignore[operator]


@contextmanager
def readings(sim: RunningSim) -> Iterator[tuple[Master, Readings]]:
    with closing(CanLink(bus_address(patient_arm_on(sim, 1)))) as link:
        link.open()
        master = Master(link, sdo_timeout=LONG)
        yield master, Readings(master)


WINDOW = OBJECTS["following_error_window"]


def set_window(sim: RunningSim, value: int) -> None:
    """Change it past the bus."""
    sim.control.call("object", node=1, index=WINDOW.index, value=value)


@pytest.mark.parametrize(
    ("written", "found"),
    [
        (OBJECTS["following_error_time"], 5),
        (OBJECTS["feed"], 6),
        (Entry(0x2010, 1, ObjectType.U16, "of the maker"), 6),
        (OBJECTS["motor_rated_current"], 6),
    ],
)
def test_what_may_change_others_makes_them_read_anew(written: Entry, found: int) -> None:
    with drives(1) as sim, readings(sim) as (_, known):
        set_window(sim, 5)
        sdo = known.sdo(1)
        assert sdo.read(WINDOW) == 5
        set_window(sim, 6)
        sdo.write(written, 1000)
        assert sdo.read(WINDOW) == found


def test_what_was_read_before_a_restart_is_forgotten() -> None:
    with drives(1) as sim, readings(sim) as (master, known):
        factory = sim.control.call("object", node=1, index=WINDOW.index)
        set_window(sim, 5)
        assert known.sdo(1).read(WINDOW) == 5
        sim.control.inject("reset")
        assert master.poll(time.monotonic() + LONG, lambda: bool(master.take_events()))
        assert known.sdo(1).read(WINDOW) == factory

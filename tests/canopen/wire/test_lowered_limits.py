"""Limits of speed that the driver lowers in a drive, and gives back at the end."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import pytest

from crtk_driver_canopen.bus import CanLink
from crtk_driver_canopen.config import CanopenConfig
from crtk_driver_canopen.device import CanopenDevice
from crtk_driver_canopen.heartbeat import NmtCommand
from crtk_driver_canopen.lowered_limits import LoweredLimits
from crtk_driver_canopen.master import Master
from crtk_driver_canopen.objects import OBJECTS
from crtk_driver_canopen.sdo import Sdo
from crtk_driver_canopen.statemachine import Control
from crtk_driver_canopen.tools import bus_address
from crtk_driver_canopen.transfers import SdoChannel
from crtk_drivers.errors import ConnectionFailed, StopUnconfirmed
from crtk_drivers.front import LocalDevice
from crtk_sim_backends.process import RunningSim
from rigs.canopen_arm import arm_of, device_of, drives, patient_arm_on, start_anew
from rigs.waiting import LONG, eventually

LIMITS = (0x607F, 0x6080)
SLOW = 1 / 30


@pytest.fixture(scope="module")
def spawned() -> Iterator[RunningSim]:
    with drives(1) as sim:
        yield sim


@pytest.fixture
def sim(spawned: RunningSim) -> RunningSim:
    """A drive as from the factory."""
    spawned.control.clear()
    start_anew(spawned)
    return spawned


def limits(sim: RunningSim, node: int = 1) -> list[int]:
    return [int(sim.control.call("object", node=node, index=index)) for index in LIMITS]


def arm(sim: RunningSim, velocity: float, **keys: object) -> CanopenConfig:
    return patient_arm_on(sim, 1, {"velocity": velocity, "modes": ("csp",)}, **keys)


def used(sim: RunningSim, arm: LocalDevice) -> None:
    arm.enable(LONG)


def restarted(sim: RunningSim, arm: LocalDevice) -> None:
    sim.control.inject("reset")
    eventually(lambda: "started anew" in arm.operating_state().detail, "its start is seen")
    arm.enable(LONG)


def lost(sim: RunningSim, arm: LocalDevice) -> None:
    sim.control.inject("silent", node=1)
    eventually(lambda: not arm.engine.connected, "it is lost")
    sim.control.clear("silent")
    eventually(lambda: arm.engine.connected and arm.engine.has_sample, "it is back")


@pytest.mark.parametrize("happens", [None, used, restarted, lost])
def test_a_limit_may_be_raised_30_times_at_once(
    sim: RunningSim, happens: Callable[[RunningSim, LocalDevice], None] | None
) -> None:
    factory = limits(sim)
    with arm_of(arm(sim, SLOW)) as slow:
        if happens is not None:
            happens(sim, slow)
        assert all(now < was / 20 for now, was in zip(limits(sim), factory, strict=True))
    assert limits(sim) == factory
    with arm_of(arm(sim, 30 * SLOW)) as fast:
        fast.enable(LONG)


def test_a_drive_left_holding_keeps_its_limit(sim: RunningSim) -> None:
    with arm_of(arm(sim, SLOW, on_close="hold")) as slow:
        slow.enable(LONG)
        lowered = limits(sim)
    axis = sim.control.status()["drives"]["1"]["axes"][0]
    assert axis["powered"]
    assert limits(sim) == lowered


def test_a_limit_that_another_wrote_is_left(sim: RunningSim) -> None:
    with arm_of(arm(sim, SLOW)):
        sim.control.call("object", node=1, index=0x607F, value=12_345)
    assert limits(sim)[0] == 12_345


def test_a_drive_without_answers_does_not_delay_the_end(sim: RunningSim) -> None:
    with arm_of(arm(sim, SLOW, sdo_timeout=10.0)) as slow:
        lowered = limits(sim)
        sim.control.inject("no_sdo", node=1)
        began = time.monotonic()
        slow.close()
        assert time.monotonic() - began < 5.0
    assert limits(sim) == lowered


TWO = 2


@pytest.fixture
def pair() -> Iterator[RunningSim]:
    with drives(TWO) as sim:
        yield sim


def both(sim: RunningSim) -> list[list[int]]:
    return [limits(sim, node) for node in (1, TWO)]


@pytest.mark.parametrize("fault", ["no_sdo", "sdo_abort"])
def test_one_drive_does_not_keep_others_from_theirs(pair: RunningSim, fault: str) -> None:
    factory = both(pair)
    with arm_of(patient_arm_on(pair, TWO, {"velocity": SLOW, "modes": ("csp",)})):
        keys = {"index": 0x607F, "sub": 0} if fault == "sdo_abort" else {}
        pair.control.inject(fault, node=1, **keys)
    assert limits(pair, 1)[0] < factory[0][0]
    assert limits(pair, TWO) == factory[1]


def test_a_connect_that_fails_gives_limits_back(pair: RunningSim) -> None:
    factory = both(pair)
    pair.control.inject("sdo_abort", node=TWO, index=0x6065, sub=0)
    device = CanopenDevice(patient_arm_on(pair, TWO, {"velocity": SLOW, "modes": ("csp",)}))
    with pytest.raises(ConnectionFailed):
        device.open(time.monotonic() + LONG)
    assert both(pair) == factory


def test_a_drive_that_got_power_keeps_its_limit(sim: RunningSim) -> None:
    """By another master, after it was heard for the last time."""
    config = arm(sim, SLOW)
    entry, lowered = OBJECTS["max_profile_velocity"], LoweredLimits()
    with closing(CanLink(bus_address(config))) as link:
        link.open()
        master = Master(link, sdo_timeout=LONG)
        sdo = Sdo(master.sdo(1))
        found = sdo.read(entry)
        lowered.note(1, 0, entry, found, 1000)
        sdo.ensure(entry, 1000)
        for word in (Control.SHUTDOWN, Control.SWITCH_ON, Control.ENABLE):
            sdo.write(OBJECTS["controlword"], word)
        eventually(
            lambda: sim.control.status()["drives"]["1"]["axes"][0]["powered"], "it has power"
        )
        lowered.give_back(master, {1})
        assert limits(sim)[0] == 1000
        again = Sdo(SdoChannel(link, 1, LONG, master.poll))
        again.write(OBJECTS["controlword"], Control.DISABLE_VOLTAGE)
        lowered.give_back(master, {1})
        assert limits(sim)[0] == found


def test_a_node_that_another_master_stopped_gets_its_limit(sim: RunningSim) -> None:
    factory = limits(sim)
    with arm_of(arm(sim, SLOW)) as slow:
        link = device_of(slow).link
        link.master.command(NmtCommand.PRE_OPERATIONAL, 1)
        eventually(lambda: link.left, "it is seen to be pre-operational")
    assert limits(sim) == factory


def test_limits_of_a_set_up_that_goes_on_are_given_back(sim: RunningSim) -> None:
    factory = limits(sim)
    with arm_of(arm(sim, SLOW)) as slow:
        sim.control.inject("reset")
        eventually(lambda: "started anew" in slow.operating_state().detail, "its start is seen")
        slow.state_command("enable", 0.0)
        eventually(lambda: limits(sim)[0] < factory[0], "it is being set up")
    assert limits(sim) == factory


def test_slow_answers_do_not_delay_the_end(pair: RunningSim) -> None:
    with arm_of(patient_arm_on(pair, TWO, {"velocity": SLOW, "modes": ("csp",)})) as slow:
        for node in (1, TWO):
            pair.control.inject("slow_sdo", node=node, delay=0.2)
        slow.close()  # it is refused where it takes longer than the device declares


def test_our_heartbeat_ends_at_once_where_joints_may_move(tmp_path: Path) -> None:
    """Questions about limits would keep the drives from stopping by themselves."""
    log = tmp_path / "frames.log"
    with (
        drives(TWO, log=str(log)) as sim,
        arm_of(patient_arm_on(sim, TWO, {"velocity": 0.2})) as slow,
    ):
        slow.enable(LONG)
        eventually(lambda: _turns(sim, slow), "it moves")
        sim.control.inject("silent", node=TWO)
        with pytest.raises(StopUnconfirmed):
            slow.close()
    frames = [line.split()[2] for line in log.read_text().splitlines()]
    started = max(at for at, frame in enumerate(frames) if frame.startswith("000#01"))
    asked = [frame for frame in frames[started:] if frame.startswith(("601#40", "602#40"))]
    assert not [frame for frame in asked if frame[6:10] == "4160"]


def _turns(sim: RunningSim, arm: LocalDevice) -> bool:
    arm.servo_jv([0.1] * TWO)
    axes = [drive["axes"][0] for drive in sim.control.status()["drives"].values()]
    return all(abs(axis["velocity"]) > 0.0 for axis in axes)

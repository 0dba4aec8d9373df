"""Limits of speed that the driver lowers in a drive, and gives back at the end."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import pytest

from crtk_driver_canopen.config import CanopenConfig
from crtk_drivers.front import LocalDevice
from crtk_sim_backends.process import RunningSim
from rigs.canopen_arm import arm_of, drives, patient_arm_on, start_anew
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


def limits(sim: RunningSim) -> list[int]:
    return [int(sim.control.call("object", node=1, index=index)) for index in LIMITS]


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

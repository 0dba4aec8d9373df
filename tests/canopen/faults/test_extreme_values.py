"""Whatever drives say in TPDOs and SDO answers: no thread dies of it, and nothing moves."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from crtk_driver_canopen import PLUGIN
from crtk_drivers.errors import CrtkError, StopUnconfirmed
from crtk_drivers.front import LocalDevice
from crtk_sim_backends.process import RunningSim
from rigs.canopen_arm import PERIOD, arm_of, arm_on, device_of, drives
from rigs.claimed_values import no_surprise, numbers
from rigs.examples import examples
from rigs.extreme_values import IN_REAL_TIME
from rigs.waiting import LONG, eventually

CHEAP = {
    **IN_REAL_TIME,
    "suppress_health_check": [HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
}

IN_CYCLES = ((0x6041, 0, 2), (0x6061, 0, 1), (0x6064, 0, 4), (0x606C, 0, 4), (0x6077, 0, 2))
"""What TPDOs carry: statusword, mode, position, velocity, torque."""

AT_SET_UP = (
    *IN_CYCLES,
    *((0x1000, 0, 4), (0x1001, 0, 1), (0x1003, 0, 1), (0x1003, 1, 4), (0x1005, 0, 4)),
    *((0x1016, 0, 1), (0x1016, 1, 4), (0x1017, 0, 2), (0x1019, 0, 1), (0x1029, 1, 1)),
    *((0x1018, 0, 1), (0x1018, 1, 4), (0x1018, 2, 4), (0x1400, 1, 4), (0x1400, 2, 1)),
    *((0x1600, 0, 1), (0x1600, 1, 4), (0x1800, 1, 4), (0x1800, 2, 1), (0x1A00, 0, 1)),
    *((0x1A00, 1, 4), (0x603F, 0, 2), (0x6040, 0, 2), (0x605A, 0, 2), (0x605E, 0, 2)),
    *((0x6007, 0, 2), (0x6060, 0, 1), (0x6065, 0, 4), (0x6076, 0, 4), (0x607C, 0, 4)),
    *((0x607D, 1, 4), (0x607D, 2, 4), (0x607F, 0, 4), (0x6080, 0, 4), (0x608F, 1, 4)),
    *((0x608F, 2, 4), (0x6091, 1, 4), (0x6091, 2, 4), (0x6092, 1, 4), (0x60A8, 0, 4)),
    *((0x60A9, 0, 4), (0x60C2, 1, 1), (0x60C2, 2, 1), (0x60FF, 0, 4), (0x6502, 0, 4)),
)

Claim = tuple[int, int, str]


@st.composite
def claims(draw: st.DrawFn, objects: tuple[tuple[int, int, int], ...], sizes: bool) -> Claim:
    """Index, sub-index and what it reads as; with `sizes` also with another length than it has."""
    index, sub, size = draw(st.sampled_from(objects))
    if sizes and draw(st.integers(0, 5)) == 0:
        return index, sub, draw(st.binary(max_size=8)).hex()
    return index, sub, draw(numbers(size)).to_bytes(size, "little").hex()


@pytest.fixture(scope="module")
def sim() -> Iterator[RunningSim]:
    with drives(2) as sim:
        yield sim


@pytest.fixture
def arm(sim: RunningSim) -> Iterator[LocalDevice]:
    sim.control.clear()
    with arm_of(arm_on(sim, 2)) as arm:
        yield arm


def positions(sim: RunningSim) -> list[float]:
    """Where the motors are, in revolutions."""
    found = sim.control.status()["drives"]
    return [float(found[node]["axes"][0]["revolutions"]) for node in sorted(found)]


STEPS = 65536
"""Counts of a revolution."""

BELIEVED = 100 * STEPS
"""Counts: further away no joint of its range stands, nor has it come to; that has tests of its own."""


LOOKS = 10
"""At 5 ms each, all of which see a motor where it was: then it stands."""


def may_go(claim: Claim, here: float) -> float:
    """Return how far a motor may go that is `here`, in revolutions, of which a drive says this.

    A position that may be true is where the joint is held, and the motor goes there: who lies within what is
    possible cannot be told from who was pushed. It swings past that by up to a tenth of its way.
    """
    index, _, data = claim
    counts = int.from_bytes(bytes.fromhex(data), "little", signed=True)
    is_believed = index == 0x6064 and abs(counts) < BELIEVED
    return 0.01 + 1.1 * abs(counts / STEPS - here) if is_believed else 0.01


def at_rest(sim: RunningSim) -> list[float]:
    """Return where the motors are, once they stand: what was believed before may have sent one off."""
    found: deque[list[float]] = deque(maxlen=LOOKS)

    def stand() -> bool:
        found.append(positions(sim))
        return len(found) == LOOKS and all(one == pytest.approx(found[0]) for one in found)

    eventually(stand, "the motors stand")
    return found[-1]


@settings(max_examples=examples(20), **CHEAP)
@given(claim=claims(IN_CYCLES, sizes=False), node=st.integers(1, 2))
def test_what_a_drive_claims_while_it_holds_moves_nothing(
    sim: RunningSim, arm: LocalDevice, claim: Claim, node: int
) -> None:
    index, sub, data = claim
    eventually(lambda: _enables(arm), "it can be enabled")
    before = at_rest(sim)
    counters = device_of(arm).link.counters
    with no_surprise():
        sim.control.inject("claim", node=node, index=index, sub=sub, data=data)
        _after(counters.cycles + 4, arm)
        with suppress(CrtkError):
            arm.hold()
        _after(counters.cycles + 4, arm)
        told = arm.engine.feedback("measured_js")
        assert told is not None
        assert all(np.isfinite(value).all() for value in (told[0].position, told[0].velocity))
        sim.control.clear("claim")
        eventually(lambda: _enables(arm), "it can be enabled again")
    assert positions(sim) == pytest.approx(before, abs=may_go(claim, before[node - 1]))


@pytest.mark.parametrize("counts", [-(2**31), 2**31 - 1, 5_000_000])
def test_a_position_that_a_joint_cannot_have_come_to_is_a_fault_and_moves_nothing(
    sim: RunningSim, arm: LocalDevice, counts: int
) -> None:
    eventually(lambda: _enables(arm), "it can be enabled")
    before = positions(sim)
    data = counts.to_bytes(4, "little", signed=True).hex()
    sim.control.inject("claim", node=2, index=0x6064, data=data)
    eventually(lambda: arm.operating_state().state == "FAULT", "it is in FAULT")
    assert f"tells that it is at {counts} counts, where it cannot" in arm.operating_state().detail
    sim.control.clear("claim")
    _after(device_of(arm).link.counters.cycles + 4, arm)
    eventually(lambda: _enables(arm), "it can be enabled again")
    assert positions(sim) == pytest.approx(before, abs=0.01)


@pytest.mark.parametrize("counts", [-(2**31), 5_000_000])
def test_a_position_that_comes_without_power_is_no_target_when_it_is_enabled(
    sim: RunningSim, arm: LocalDevice, counts: int
) -> None:
    before = positions(sim)
    counters = device_of(arm).link.counters
    data = counts.to_bytes(4, "little", signed=True).hex()
    sim.control.inject("claim", node=2, index=0x6064, data=data)
    _after(counters.cycles + 4, arm)
    with pytest.raises(CrtkError, match=f"tells that it is at {counts} counts"):
        arm.enable(LONG)
    _after(counters.cycles + 4, arm)
    assert positions(sim) == pytest.approx(before, abs=0.01)
    sim.control.inject("reset", node=2)  # its position counts anew, whatever it is
    eventually(lambda: "started anew" in arm.operating_state().detail, "it has booted")
    sim.control.clear("claim")
    eventually(lambda: _enables(arm), "it can be enabled again")
    assert positions(sim) == pytest.approx(before, abs=0.01)


def test_a_drive_that_shows_no_state_stops_and_follows_no_position_that_it_tells(
    sim: RunningSim, arm: LocalDevice
) -> None:
    eventually(lambda: _enables(arm), "it can be enabled")
    before = positions(sim)
    sim.control.inject("claim", node=2, index=0x6041, data="ffff")
    eventually(lambda: arm.operating_state().state == "FAULT", "it is in FAULT")
    assert "it shows no state (statusword 0xffff" in arm.operating_state().detail
    sim.control.inject("claim", node=2, index=0x6064, data=(5_000_000).to_bytes(4, "little").hex())
    _after(device_of(arm).link.counters.cycles + 10, arm)
    assert positions(sim) == pytest.approx(before, abs=0.01)
    sim.control.clear("claim")
    eventually(lambda: _enables(arm), "it can be enabled again")
    assert positions(sim) == pytest.approx(before, abs=0.01)


def test_an_arm_whose_joint_stands_where_it_cannot_is_not_enabled(sim: RunningSim) -> None:
    sim.control.clear()
    before = positions(sim)
    sim.control.inject("claim", node=2, index=0x6064, data=(2**31 - 1).to_bytes(4, "little").hex())
    with arm_of(arm_on(sim, 2)) as arm:
        with pytest.raises(CrtkError, match="where no joint of its range can stand"):
            arm.enable(LONG)
        _after(device_of(arm).link.counters.cycles + 4, arm)
        assert positions(sim) == pytest.approx(before, abs=0.01)
        sim.control.clear("claim")


def _after(cycles: int, arm: LocalDevice) -> None:
    eventually(lambda: device_of(arm).link.counters.cycles >= cycles, "the driver has seen it")


def _enables(arm: LocalDevice) -> bool:
    if arm.is_enabled():
        return True
    try:
        arm.enable(LONG)
    except CrtkError:
        return False
    return True


@settings(max_examples=examples(15), **CHEAP)
@given(claim=claims(AT_SET_UP, sizes=True), node=st.integers(1, 2))
def test_what_a_drive_claims_when_it_is_set_up_is_refused_or_moves_nothing(
    sim: RunningSim, claim: Claim, node: int
) -> None:
    index, sub, data = claim
    before = at_rest(sim)
    sim.control.inject("claim", node=node, index=index, sub=sub, data=data)
    device = PLUGIN.create(arm_on(sim, 2, open_timeout=2.0, sdo_timeout=0.1))
    try:
        device.open(time.monotonic() + 1.0)
        given_up = time.monotonic() + 3.0
        for _ in device.enable():
            device.read(time.monotonic() + PERIOD)
            if time.monotonic() > given_up:
                break
    except CrtkError:
        pass  # it was refused
    finally:
        sim.control.clear("claim")
        with suppress(StopUnconfirmed):
            device.close()
    assert positions(sim) == pytest.approx(before, abs=may_go(claim, before[node - 1]))

"""A vacuum gripper: what is held, what is lost, and that nothing but a command releases it."""

from __future__ import annotations

import math
from collections.abc import Iterator

import pytest

from crtk_driver_onrobot import vacuum as vacuum_hand
from crtk_drivers.errors import CommandRefused, DeviceError
from crtk_drivers.state import OperatingState
from crtk_sim_backends.onrobot import SIM, RunningSim
from rigs.onrobot_bench import FREE_PORTS, OnRobotBench, configuration
from rigs.waiting import LONG, eventually

DISABLED, FAULT = OperatingState.DISABLED, OperatingState.FAULT
HELD = 55_000.0
"""Pa."""


@pytest.fixture(scope="module")
def shared() -> Iterator[RunningSim]:
    with SIM.spawn(**FREE_PORTS, model="vg10") as sim:
        yield sim


@pytest.fixture
def sim(shared: RunningSim) -> Iterator[RunningSim]:
    """A simulated VG10 with things at its cups and no vacuum."""
    shared.control.clear()
    shared.control.inject("unpowered")
    shared.control.clear()
    yield shared
    shared.control.clear()


@pytest.fixture
def vacuum(sim: RunningSim) -> Iterator[OnRobotBench]:
    """A driver at it."""
    with OnRobotBench(sim, configuration(sim, model="vg10")) as bench:
        yield bench


def held(bench: OnRobotBench) -> None:
    bench.front.enable()
    assert bench.front.grip() == "grip: channel a, b"
    for tell in (bench.front.state.vacuum_a, bench.front.state.vacuum_b):
        eventually(lambda tell=tell: tell() > HELD, "held")
    assert bench.front.state.holds_a()
    assert bench.front.state.grip_b() == "holds an object"


def test_channels_grip_and_release_each_by_itself(vacuum: OnRobotBench) -> None:
    held(vacuum)
    vacuum.front.release_b()
    eventually(lambda: vacuum.front.state.grip_b() == "holds nothing", "released")
    assert vacuum.front.state.holds_a()
    vacuum.front.release()
    eventually(lambda: vacuum.front.state.vacuum_a() < 1000.0, "released")
    assert vacuum.front.health().notes == ()


@pytest.mark.parametrize(("kind", "rate"), [("no_object", None), ("leak", 40.0)])
def test_a_thing_that_is_lost_is_told(vacuum: OnRobotBench, kind: str, rate: float | None) -> None:
    held(vacuum)
    more = {} if rate is None else {"rate": rate}
    vacuum.sim.control.inject(kind, channel="a", **more)
    eventually(lambda: vacuum.front.state.grip_a() == "object lost", "told")
    assert {note.key for note in vacuum.front.health().notes} == {"channel a"}
    assert vacuum.front.state.holds_b()


def test_nothing_at_the_cups_is_not_held(vacuum: OnRobotBench) -> None:
    vacuum.sim.control.inject("no_object")
    vacuum.front.enable()
    vacuum.front.grip()
    eventually(lambda: vacuum.front.state.vacuum_a() > 2000.0, "as much as comes")
    assert vacuum.front.state.grip_a() == "builds up vacuum"
    assert not vacuum.front.state.holds_a()


def test_what_another_program_grips_is_told(vacuum: OnRobotBench) -> None:
    vacuum.front.enable()
    vacuum.sim.control.inject("other_master", channel="b", word=0x0100 + 60)
    eventually(vacuum.front.state.holds_b, "held")
    vacuum.sim.control.inject("other_master", channel="b", word=0)
    eventually(lambda: vacuum.front.state.grip_b() == "object lost", "not by us")


def test_a_vacuum_is_in_pascals(vacuum: OnRobotBench) -> None:
    vacuum.front.enable()
    vacuum.front.vacuum(30_397.5)
    vacuum.front.grip_a()
    assert vacuum.simulated("written")[0] == 0x0100 + 30
    for wrong in (60.0, 0.6, -30_000.0, 90_000.0, math.nan):
        with pytest.raises(CommandRefused, match="vacuum"):
            vacuum.front.vacuum(wrong)


def test_it_is_not_moved_while_it_is_not_enabled(vacuum: OnRobotBench) -> None:
    before = vacuum.simulated("writes")
    for service in (vacuum.front.grip, vacuum.front.release):
        with pytest.raises(CommandRefused, match="not enabled"):
            service()
    assert vacuum.simulated("writes") == before


def test_a_lost_link_and_a_disable_release_nothing(vacuum: OnRobotBench) -> None:
    held(vacuum)
    before = vacuum.simulated("writes")
    vacuum.front.disable()
    vacuum.sim.control.inject("disconnect")
    vacuum.state(FAULT)
    vacuum.sim.control.clear()
    vacuum.connected()
    assert "holds an object" in vacuum.state(DISABLED)
    assert vacuum.simulated("writes") == before
    assert vacuum.front.state.holds_a()


def test_a_release_that_is_not_acknowledged_is_told_and_not_sent_later(
    vacuum: OnRobotBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    held(vacuum)
    monkeypatch.setattr(vacuum_hand, "TOLD", 0.3)  # in vain, however long
    vacuum.sim.control.inject("exception", code=6)
    with pytest.raises(DeviceError, match="not acknowledged"):
        vacuum.front.release()
    vacuum.sim.control.clear()
    vacuum.samples(10)
    assert vacuum.front.state.holds_a()


def test_a_release_that_is_broken_off_is_not_sent_later(vacuum: OnRobotBench) -> None:
    held(vacuum)
    vacuum.sim.control.inject("exception", code=6)
    steps = vacuum.device.services["release"].run()
    next(steps)
    steps.close()
    vacuum.sim.control.clear()
    vacuum.samples(10)
    assert vacuum.front.state.holds_a()


def test_a_release_that_waits_does_not_follow_a_stop(vacuum: OnRobotBench) -> None:
    held(vacuum)
    vacuum.sim.control.inject("exception", code=6)
    release = vacuum.session.engine.request("release")
    exceptions = vacuum.counter("exceptions")
    eventually(lambda: vacuum.counter("exceptions") > exceptions, "it waits")
    vacuum.front.disable()
    vacuum.sim.control.clear("exception")
    with pytest.raises(DeviceError):
        release.wait(LONG)
    vacuum.samples(10)
    assert vacuum.front.state.holds_a()


@pytest.mark.parametrize("on_close", ["hold", "release", "nothing"])
def test_how_it_is_left(sim: RunningSim, on_close: str) -> None:
    with OnRobotBench(sim, configuration(sim, model="vg10", on_close=on_close)) as bench:
        held(bench)
    released = sim.control.call("status")["written"][:2] == [0, 0]
    assert released is (on_close == "release")

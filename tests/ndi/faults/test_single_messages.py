"""One command or reply is lost, doubled or late: no pose is old, or another tool's, and it opens again.

The simulated tools go around in circles beside each other: a pose shows when it was, and whose it is.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator

import pytest

from crtk_drivers.state import OperatingState, StateCommand
from crtk_sim_backends.process import RunningSim
from rigs.ndi_bench import NdiBench, configuration, ndi_bench, simulated
from rigs.waiting import LONG, eventually

TURN = 4.0
"""Seconds in which the simulated tools go around once."""
RADIUS, APART = 60.0, 40.0
"""mm."""
YOUNGER = 1.0 / 60.0 + 0.04
"""Seconds by which a stamp may be too young: a period, and what a busy machine takes."""

EFFECTS = ("lost", "doubled", "late")
OF_THE_CONNECTION = 24
"""Commands with which a tracker of two tools is connected, and some more."""


@pytest.fixture(scope="module")
def sim() -> Iterator[RunningSim]:
    with simulated(motion="circle") as running:
        yield running


@pytest.fixture(autouse=True)
def cleared(sim: RunningSim) -> Iterator[None]:
    yield
    sim.control.clear()


def judged(bench: NdiBench) -> None:
    """Every pose is that of its tool, and no older than its stamp."""
    told = bench.sim.control.status()
    for place, tool in enumerate(bench.session.children.values()):
        found = tool.feedback("measured_cp")
        if found is None or not found[1].wall_ns or told["mode"] != "tracking":
            continue
        x, y, _ = 1e3 * found[0].position
        x -= APART * place
        assert math.hypot(x, y) == pytest.approx(RADIUS, abs=1.0), "it is another tool's"
        turned = (found[1].monotonic - told["origin"]) / TURN - math.atan2(y, x) / (2.0 * math.pi)
        younger = TURN * ((turned + 0.5) % 1.0 - 0.5)
        assert younger < YOUNGER, f"it is stamped {younger:.3f} s too young"


def watched(bench: NdiBench, test: Callable[[], bool], what: str) -> None:
    """Wait until something holds, and judge what is told meanwhile."""

    def holds() -> bool:
        judged(bench)
        return test()

    eventually(holds, what, timeout=2.0 * LONG)


def tracks(bench: NdiBench) -> None:
    """Connected, it is enabled as often as it takes, and all tools have valid poses."""
    engine = bench.session.engine

    def enabled() -> bool:
        if engine.connected and engine.transition_ended and engine.status.state != "ENABLED":
            engine.state_command(StateCommand.ENABLE)
        return bool(engine.status.state == OperatingState.ENABLED)

    watched(bench, enabled, "it is enabled")
    names = tuple(bench.session.children)
    watched(bench, lambda: all(map(bench.is_valid, names)), "poses of all tools")
    until = time.monotonic() + 0.2
    watched(bench, lambda: time.monotonic() > until, "some frames")


def connects(sim: RunningSim, effect: str, what: str, number: int) -> None:
    """Whatever becomes of that message, the tracker is connected, and all its tools are tracked."""
    bench = NdiBench(sim, configuration(sim))
    sim.control.inject("message", what=what, effect=effect, number=number)
    bench.session.start()
    try:
        bench.connected()
        tracks(bench)
    finally:
        bench.session.close()


@pytest.mark.sweep(6)
@pytest.mark.parametrize("number", range(1, OF_THE_CONNECTION + 1))
@pytest.mark.parametrize("what", ["command", "reply"])
@pytest.mark.parametrize("effect", EFFECTS)
def test_a_connection_survives_one_message(
    sim: RunningSim, effect: str, what: str, number: int
) -> None:
    connects(sim, effect, what, number)


def test_a_doubled_list_of_tools_hides_none(sim: RunningSim) -> None:
    """An empty list that came twice was taken for the list of those that are not enabled yet."""
    for number in range(10, 17):
        connects(sim, "doubled", "command", number)
        sim.control.clear()


@pytest.mark.sweep(4)
@pytest.mark.parametrize("command", ["TSTART", "TSTOP", "BX2", "PHSR", ""])
@pytest.mark.parametrize("what", ["command", "reply"])
@pytest.mark.parametrize("effect", EFFECTS)
@pytest.mark.parametrize("action", [StateCommand.ENABLE, StateCommand.DISABLE])
def test_a_transition_survives_one_message(
    sim: RunningSim, action: StateCommand, effect: str, what: str, command: str
) -> None:
    with ndi_bench(sim) as bench:
        if action is StateCommand.DISABLE:
            bench.tracking()
        sim.control.inject("message", what=what, effect=effect, command=command)
        engine = bench.session.engine
        engine.state_command(action)
        watched(bench, lambda: engine.transition_ended, f"{action} ends")
        reached = {StateCommand.ENABLE: "ENABLED", StateCommand.DISABLE: "DISABLED"}[action]
        assert engine.status.state == reached or engine.status.detail
        sim.control.clear()
        tracks(bench)


@pytest.mark.sweep(4)
@pytest.mark.parametrize("effect", EFFECTS)
@pytest.mark.parametrize("what", ["command", "reply"])
@pytest.mark.parametrize("number", [1, 2, 3])
def test_a_tool_that_appears_survives_one_message(
    sim: RunningSim, number: int, what: str, effect: str
) -> None:
    sim.control.inject("unplug", tool=1)
    with ndi_bench(sim) as bench:
        sim.control.clear()
        sim.control.inject("message", what=what, effect=effect, number=number)
        names = tuple(bench.session.children)

        def all_there() -> bool:
            return not any("is not plugged in" in note.text for note in bench.front.health().notes)

        watched(bench, all_there, f"{names} are plugged in")
        bench.connected()
        tracks(bench)


@pytest.mark.parametrize("command", ["TSTOP", ""])
@pytest.mark.parametrize("effect", EFFECTS)
@pytest.mark.parametrize("what", ["command", "reply"])
def test_nothing_tracks_after_a_close_with_one_message(
    sim: RunningSim, what: str, effect: str, command: str
) -> None:
    with ndi_bench(sim) as bench:
        bench.tracking()
        sim.control.inject("message", what=what, effect=effect, command=command)
    eventually(lambda: sim.control.status()["mode"] != "tracking", "it does not track")
    sim.control.clear()
    with ndi_bench(sim) as bench:
        tracks(bench)

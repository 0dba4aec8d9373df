"""What every gripper must do: grip, hold, tell, stop, and never let go by itself; the first on each way
to it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import ExitStack, suppress

import pytest

from crtk_drivers.errors import CommandRefused, MotionAborted, TransitionFailed
from crtk_drivers.state import OperatingState
from crtk_sim_backends.process import RunningSim
from rigs.gripper_bench import GripperBench
from rigs.gripper_cases import CASES, FINGERS, ONE_WAY, SWEEPING, WIDTH, Case
from rigs.waiting import LONG, eventually

ENABLED, DISABLED = OperatingState.ENABLED, OperatingState.DISABLED
FAULT, PAUSED = OperatingState.FAULT, OperatingState.PAUSED
CLOSED = 0.003
"""Opening in m below which fingers are closed."""

WAYS = (
    ("hold", "enabled"),
    ("nothing", "enabled"),
    ("release", "enabled"),
    ("release", "disabled"),
    ("release", "paused"),
    ("release", "lost"),
    ("release", "alarmed"),
)
"""How it is to be left, and in which state the program ends."""

pytestmark = pytest.mark.sweep(3)
every_way = pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
each = pytest.mark.parametrize("case", ONE_WAY, ids=lambda case: case.name)
fingers = pytest.mark.parametrize("case", FINGERS, ids=lambda case: case.name)


class Started:
    """Simulators, each started when it is first asked for."""

    def __init__(self, stack: ExitStack) -> None:
        self._stack = stack
        self._found: dict[str, RunningSim] = {}

    def of(self, case: Case) -> RunningSim:
        """Return that of a gripper."""
        name = case.simulator.name
        if name not in self._found:
            self._found[name] = self._stack.enter_context(case.simulator.spawn(**case.options))
        return self._found[name]


@pytest.fixture(scope="module")
def started() -> Iterator[Started]:
    with ExitStack() as stack:
        yield Started(stack)


@pytest.fixture
def sim(case: Case, started: Started) -> Iterator[RunningSim]:
    """A simulated gripper as nobody has used it."""
    found = started.of(case)
    found.control.clear()
    found.control.inject("object_lost")
    case.ready(found)
    yield found
    found.control.clear()


@pytest.fixture
def enabled(case: Case, sim: RunningSim) -> Iterator[GripperBench]:
    """A driver at it, enabled."""
    with case.bench(sim, link=case.link) as bench:
        case.enable(bench)
        yield bench


def stop(bench: GripperBench, command: str) -> None:
    """Ask for a stop, whether the state lets it be called so or not."""
    if command == "alarm":
        bench.session.engine.alarm("a fault of ours")
        return
    with suppress(CommandRefused):
        getattr(bench.front, command)()


# ------------------------------------------------------------------------------------------ the grip


@every_way
def test_it_grips_holds_lets_go_and_tells_what_is_lost(case: Case, enabled: GripperBench) -> None:
    case.grip(enabled)
    assert enabled.front.state.holds()
    if not case.is_suction:
        assert enabled.front.measured_js().position[0] == pytest.approx(WIDTH, abs=0.003)
    assert enabled.front.move_jp([case.opened]).wait(LONG)
    eventually(lambda: not enabled.front.state.holds(), "let go")
    assert enabled.front.state.grip() != "object lost"
    case.grip(enabled)
    enabled.sim.control.inject("object_lost")
    enabled.grip("object lost")
    assert not enabled.front.state.holds()
    notes = {note.key: note.text for note in enabled.front.health().notes}
    assert notes["object"] == "what it held is gone"
    enabled.state(ENABLED)


@each
@pytest.mark.parametrize("command", ["disable", "pause", "hold", "alarm"])
def test_what_stops_it_keeps_the_grip(case: Case, enabled: GripperBench, command: str) -> None:
    case.grip(enabled)
    before, force = enabled.simulated(case.writes), enabled.sim.control.status().get("force")
    stop(enabled, command)
    enabled.samples(10)
    assert enabled.simulated(case.writes) == before
    assert enabled.sim.control.status().get("force") == force
    assert case.keeps(enabled.sim)
    assert enabled.front.state.holds()


@fingers
def test_a_move_replaces_another_and_a_stop_is_read_back(case: Case, enabled: GripperBench) -> None:
    assert enabled.front.move_jp([case.opened]).wait(LONG)
    enabled.front.trajectory_j.set_ratio(case.ratio)
    first = enabled.front.move_jp([case.closed])
    eventually(lambda: enabled.simulated("moves"), "it moves")
    second = enabled.front.move_jp([0.01])
    with pytest.raises(MotionAborted):
        first.wait(LONG)
    eventually(lambda: enabled.simulated("moves"), "it moves")
    enabled.front.hold()
    with pytest.raises(MotionAborted):
        second.wait(LONG)
    eventually(lambda: enabled.device.has_stopped, "read back")
    assert not enabled.simulated("moves")
    assert enabled.simulated("opening") > 0.011
    enabled.grip("stopped")


@each
def test_what_cannot_be_is_refused_and_changes_nothing(case: Case, enabled: GripperBench) -> None:
    before = enabled.simulated(case.writes)
    most = enabled.device.capabilities.limits[0].upper
    for values in ([math.nan], [math.inf], [1.01 * most], [-0.01 * most], [0.0, 0.0], []):
        with pytest.raises(CommandRefused):
            enabled.front.move_jp(values)
    for values in ([math.nan], [math.inf], []):
        with pytest.raises(CommandRefused):
            enabled.front.servo_jp(values)
    for name, value in case.refused:
        with pytest.raises(CommandRefused, match=name):
            getattr(enabled.front, name)(value)
    enabled.samples(5)
    assert enabled.simulated(case.writes) == before


@pytest.mark.sweep(8)
@pytest.mark.parametrize("case", SWEEPING, ids=lambda case: case.name)
@pytest.mark.parametrize("begun_by", ["service", "enable"])
@pytest.mark.parametrize("command", ["hold", "disable", "pause", "alarm"])
def test_a_stop_ends_a_sweep_and_nothing_goes_on_by_itself(
    case: Case, sim: RunningSim, begun_by: str, command: str
) -> None:
    with case.bench(sim, link=case.link, **case.sweeping) as bench:
        bench.samples(2)
        start = bench.simulated("opening")
        if begun_by == "service":
            asked = bench.session.engine.request(case.sweep)
        else:
            bench.session.engine.state_command("enable")
        eventually(lambda: abs(bench.simulated("opening") - start) > 0.005, "it moves")
        stop(bench, command)
        eventually(lambda: not bench.simulated("moves"), "it rests")
        eventually(lambda: bench.device.has_stopped, "read back")
        here = bench.simulated("opening")
        bench.samples(20)
        assert bench.simulated("opening") == here != pytest.approx(case.opened, abs=1e-4)
        assert not bench.simulated("moves")
        bench.state(FAULT if command == "alarm" else DISABLED)
        if begun_by == "service":
            with pytest.raises(TransitionFailed, match="broken off"):
                asked.wait(LONG)
        bench.front.enable()
        assert bench.front.move_jp([case.start]).wait(LONG)


@each
@pytest.mark.parametrize("how", ["disable", "alarm"])
def test_nothing_but_enable_and_a_stop_is_for_a_gripper_that_is_not_enabled(
    case: Case, enabled: GripperBench, how: str
) -> None:
    ready = [name for name in ("activate", "reference") if name in enabled.device.services]
    for name in ready:
        with pytest.raises(CommandRefused, match="Disable it first"):
            getattr(enabled.front, name)()
    case.grip(enabled)
    if how == "disable":
        enabled.front.disable()
    else:
        enabled.session.engine.alarm("a fault of ours")
        enabled.samples(10)
    before = enabled.simulated(case.writes)
    for name in case.moving:
        with pytest.raises(CommandRefused, match="not enabled"):
            getattr(enabled.front, name)()
    assert enabled.simulated(case.writes) == before
    assert case.keeps(enabled.sim)


# -------------------------------------------------------------------------------- how it is left


@pytest.mark.parametrize(
    ("case", "on_close", "ends"),
    [
        pytest.param(case, *way, id="-".join((case.name, *way)))
        for case in ONE_WAY
        for way in WAYS
        if way[0] in case.on_close
    ],
)
def test_how_it_is_left(case: Case, sim: RunningSim, on_close: str, ends: str) -> None:
    """It is let go where that is asked for, by a program that ends while it is ENABLED, and by no other."""
    with case.bench(sim, link=case.link, on_close=on_close) as bench:
        case.enable(bench)
        case.grip(bench)
        if ends == "disabled":
            bench.front.disable()
        elif ends == "paused":
            bench.front.pause()
        elif ends == "alarmed":
            bench.session.engine.alarm("a fault of ours")
            bench.state(FAULT)
        elif ends == "lost":
            sim.control.inject("disconnect")
            bench.state(FAULT)
            sim.control.clear("disconnect")
            bench.connected()
        bench.samples(5)
        before = bench.simulated(case.writes)
    if (on_close, ends) == ("release", "enabled"):
        eventually(lambda: not case.keeps(sim), "let go")
    else:
        assert sim.control.call("status")[case.writes] == before
        assert case.keeps(sim)


# ------------------------------------------------------------------- what somebody else has taken


def taken(case: Case, bench: GripperBench) -> None:
    """Have another program close an open gripper of ours."""
    case.enable(bench)
    assert bench.front.move_jp([case.start]).wait(LONG)
    kind, parameters = case.other
    bench.sim.control.inject(kind, **parameters)


def closes(sim: RunningSim) -> None:
    """Wait until the other program has closed it."""
    eventually(lambda: sim.control.status()["opening"] < CLOSED, "closed by the other program")


@fingers
@pytest.mark.parametrize("command", ["", "hold", "disable", "alarm"])
def test_what_another_program_moves_goes_on(
    case: Case, enabled: GripperBench, command: str
) -> None:
    taken(case, enabled)
    enabled.state(PAUSED, "another program")
    if command:
        stop(enabled, command)
    closes(enabled.sim)
    if command != "alarm":
        assert enabled.session.engine.status.state in (PAUSED, DISABLED)


@fingers
@pytest.mark.parametrize("is_seen", [True, False], ids=["seen", "just-now"])
@pytest.mark.parametrize("on_close", ["hold", "release"])
def test_closing_leaves_what_another_program_moves(
    case: Case, sim: RunningSim, on_close: str, is_seen: bool
) -> None:
    with case.bench(sim, link=case.link, on_close=on_close) as bench:
        taken(case, bench)
        if is_seen:
            bench.state(PAUSED, "another program")
    closes(sim)


@fingers
def test_another_program_is_seen_before_our_first_command(case: Case, sim: RunningSim) -> None:
    with case.bench(sim, link=case.link, on_close="release") as bench:
        case.enable(bench)
        assert bench.front.move_jp([case.start]).wait(LONG)
        bench.front.disable()
        bench.front.enable()
        bench.samples(5)
        kind, parameters = case.other
        bench.sim.control.inject(kind, **parameters)
        bench.state(PAUSED, "another program")
    closes(sim)


# ----------------------------------------------------------------------- what would let go of it


def _stops_itself(case: Case) -> bool:
    """Whether what is between writes a stop (rGTO) when a connection ends: then gOBJ says nothing more."""
    return case.link == "controller"


@every_way
def test_connecting_writes_nothing_and_finds_what_is_held(
    case: Case, enabled: GripperBench
) -> None:
    case.grip(enabled)
    enabled.front.close()
    before = enabled.simulated(case.writes)
    with case.bench(enabled.sim, link=case.link) as again:
        told = again.state(DISABLED)
        if not _stops_itself(case):
            assert "holds an object" in told
            assert again.front.state.holds()
        again.front.enable()
        again.samples(5)
        assert again.simulated(case.writes) - before <= _stops_itself(case)
        assert _stops_itself(case) or case.keeps(again.sim)


@every_way
def test_a_lost_link_lets_nothing_go_and_replays_nothing(case: Case, enabled: GripperBench) -> None:
    case.grip(enabled)
    before = enabled.simulated(case.writes)
    enabled.sim.control.inject("disconnect")
    enabled.state(FAULT)
    enabled.sim.control.clear("disconnect")
    enabled.connected()
    enabled.state(DISABLED)
    enabled.front.enable()
    enabled.samples(5)
    assert enabled.simulated(case.writes) - before == _stops_itself(case)
    assert _stops_itself(case) or case.keeps(enabled.sim)


@each
def test_a_fault_lets_nothing_go(case: Case, enabled: GripperBench) -> None:
    case.grip(enabled)
    before = enabled.simulated(case.writes)
    kind, parameters = case.fault
    enabled.sim.control.inject(kind, **parameters)
    enabled.state(FAULT)
    enabled.samples(5)
    assert enabled.front.state.fault()
    assert enabled.simulated(case.writes) == before
    assert case.is_suction or case.keeps(enabled.sim)

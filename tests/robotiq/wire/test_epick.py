"""The vacuum gripper at its simulator: grips, losses, leaks, and that nothing is dropped by itself."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from crtk_drivers.errors import MotionAborted, TransitionFailed
from crtk_drivers.state import OperatingState
from crtk_sim_backends.robotiq.epick import SIM, RunningSim
from rigs.epick_bench import FREE_PORTS, EpickBench, bench, configuration
from rigs.waiting import LONG, eventually

ENABLED, DISABLED = OperatingState.ENABLED, OperatingState.DISABLED
PAUSED, FAULT = OperatingState.PAUSED, OperatingState.FAULT
HOLDS = "holds an object"


@pytest.fixture(scope="module")
def shared() -> Iterator[RunningSim]:
    with SIM.spawn(**FREE_PORTS) as sim:
        yield sim


@pytest.fixture
def sim(shared: RunningSim) -> Iterator[RunningSim]:
    """A simulated gripper, activated, with something under its cups, as nobody has used it."""
    shared.control.clear()
    shared.control.inject("deactivated")
    shared.control.inject("activated")
    shared.control.inject("object")
    eventually(lambda: shared.control.status()["vacuum"] < 1000.0, "open")
    yield shared
    shared.control.clear()


@pytest.fixture
def running(sim: RunningSim) -> Iterator[EpickBench]:
    """A driver at it, enabled."""
    with EpickBench(sim, configuration(sim, link="tool")) as bench:
        bench.front.enable()
        yield bench


def gripped(bench: EpickBench) -> None:
    """Let it hold what is there."""
    assert bench.front.move_jp([60_000.0]).wait(LONG)
    assert bench.front.state.holds()
    bench.grip(HOLDS)


def kept(bench: EpickBench) -> None:
    """It has let nothing go."""
    assert bench.simulated("releases") == 0
    assert bench.simulated("vacuum") > 40_000.0


@pytest.fixture
def fresh(shared: RunningSim) -> Iterator[EpickBench]:
    with bench("tool") as running:
        running.front.enable()
        yield running


def test_it_grips_holds_and_lets_go(running: EpickBench) -> None:
    gripped(running)
    eventually(lambda: running.front.measured_js().position[0] > 58_000.0, "60 kPa")
    assert running.front.state.pressure() < 42_000.0
    assert running.simulated("written") == "0b 00 00 28 05 32"
    assert running.front.move_jp([0.0]).wait(LONG)
    assert running.front.state.grip() == "holds nothing"
    eventually(lambda: running.front.measured_js().position[0] == 0.0, "no vacuum")


def test_by_its_own_judgement_it_is_asked_for_no_pressure(sim: RunningSim) -> None:
    with EpickBench(sim, configuration(sim, link="modbus", mode="automatic")) as running:
        running.front.enable()
        assert running.front.move_jp([60_000.0]).wait(LONG)
        assert running.simulated("written").startswith("09 00 00 00 05")


def test_where_nothing_is_the_move_fails_and_that_is_told(running: EpickBench) -> None:
    running.sim.control.inject("object_lost")
    with pytest.raises(MotionAborted):
        running.front.move_jp([60_000.0]).wait(LONG)
    running.grip("nothing gripped")
    assert "nothing was gripped in time" in running.front.state.fault()
    assert running.front.is_enabled()
    running.sim.control.inject("object")
    gripped(running)


def test_a_leak_keeps_the_pump_busy_and_is_told(sim: RunningSim) -> None:
    with EpickBench(sim, configuration(sim, link="tool", hysteresis=30_000.0)) as running:
        running.front.enable()
        running.sim.control.inject("object", leak=0.9)
        assert running.front.move_jp([60_000.0]).wait(LONG)
        running.grip("holds an object, at the least vacuum")
        eventually(lambda: "porous" in running.front.state.fault(), "told")
        assert running.front.is_enabled()


def test_a_stream_asks_once_for_each_vacuum(sim: RunningSim) -> None:
    config = configuration(sim, link="tool", reply_timeout=1.0)  # else what is late is asked again
    with EpickBench(sim, config) as running:
        running.front.enable()
        before = running.simulated("writes")
        for _ in range(20):
            running.front.servo_jp([50_000.0])
        running.grip(HOLDS)
        assert running.simulated("writes") == before + 1


def test_without_power_it_may_hold_and_enable_drops_nothing(sim: RunningSim) -> None:
    with EpickBench(sim, configuration(sim, link="tool", sample_timeout=1.0)) as running:
        running.front.enable()
        gripped(running)
        sim.control.inject("unpowered")
        running.state(FAULT)
        sim.control.clear("unpowered")
        running.state(DISABLED)
        with pytest.raises(TransitionFailed, match="may still hold something"):
            running.front.enable()
        assert running.simulated("ready") is False
        assert running.front.activate() == "activated"
        running.front.enable()


def test_a_major_fault_is_cleared_by_a_reset_in_enable(running: EpickBench) -> None:
    running.sim.control.inject("gripper_fault", code=0xC)
    running.state(FAULT, "internal")
    running.sim.control.clear("gripper_fault")
    running.front.enable()
    gripped(running)


def test_a_hot_gripper_is_not_enabled(running: EpickBench) -> None:
    running.sim.control.inject("gripper_fault", code=8)
    running.state(FAULT, "too hot")
    with pytest.raises(TransitionFailed, match="too hot"):
        running.front.enable()


def test_one_that_is_not_activated_is_activated_by_enable_if_it_may(sim: RunningSim) -> None:
    sim.control.inject("deactivated")
    with (
        EpickBench(sim, configuration(sim, link="serial", activate="never")) as running,
        pytest.raises(TransitionFailed, match="not activated"),
    ):
        running.front.enable()
    with EpickBench(sim, configuration(sim, link="serial")) as running:
        running.front.enable()
        gripped(running)


def test_a_reset_just_before_our_next_command_is_no_activation(running: EpickBench) -> None:
    gripped(running)
    running.sim.control.inject("deactivated_meanwhile")
    running.front.move_jp([70_000.0])
    running.state(DISABLED, "not activated")
    assert running.simulated("ready") is False


def test_another_master_pauses_it(running: EpickBench) -> None:
    gripped(running)
    running.sim.control.inject("other_master", pressure=70)
    running.state(PAUSED, "another program")
    running.front.resume()
    running.front.move_jp([0.0]).wait(LONG)


@pytest.mark.parametrize(
    ("kind", "parameters"),
    [
        ("bad_crc", {"every": 3}),
        ("cut", {"every": 4}),
        ("doubled", {}),
        ("late", {"seconds": 0.03}),
    ],
)
def test_a_bad_line_costs_time_and_nothing_else(
    running: EpickBench, kind: str, parameters: dict[str, float]
) -> None:
    running.sim.control.inject(kind, **parameters)
    gripped(running)
    assert running.front.move_jp([0.0]).wait(LONG)

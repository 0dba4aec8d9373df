"""What goes wrong at the service, the device, the grip and the wire: no force, and a reason."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from crtk_driver_haply import PLUGIN
from crtk_drivers.errors import CrtkError
from crtk_drivers.session import Session
from crtk_drivers.state import OperatingState
from crtk_sim_backends.haply import RunningSim
from rigs.haply_bench import HaplyBench, configuration, haply, simulated
from rigs.waiting import eventually

X = (1.0, 0.0, 0.0)
FAULT, PAUSED, DISABLED = OperatingState.FAULT, OperatingState.PAUSED, OperatingState.DISABLED


@pytest.fixture(scope="module")
def sim() -> Iterator[RunningSim]:
    with simulated() as running:
        yield running


@pytest.fixture
def bench(sim: RunningSim) -> Iterator[HaplyBench]:
    """ENABLED, with a force that is streamed again and again by `pushes_until`."""
    with haply(sim, ramp=0.0, stream_timeout=0.5, sample_timeout=1.2) as running:
        running.front.enable()
        running.push(X)
        yield running


@pytest.mark.sweep(3)
@pytest.mark.parametrize(
    ("kind", "state", "words"),
    [
        ("vanish", FAULT, "no Inverse3 049D any more"),
        ("disconnect", FAULT, "onnection"),
        ("mute", FAULT, "s old"),
        ("uncalibrated", DISABLED, "rest position"),
        ("asleep", PAUSED, "asleep: press its button"),
        ("no_grip", PAUSED, "no VerseGrip 61548"),
        ("malformed", FAULT, "s old"),
        ("half", FAULT, "s old"),
        ("nan", FAULT, "s old"),
        ("huge", FAULT, "s old"),
        ("foreign", FAULT, "s old"),
        ("corrupt", FAULT, ""),
    ],
)
def test_no_force_is_exerted_and_it_comes_back(
    bench: HaplyBench, kind: str, state: OperatingState, words: str
) -> None:
    parameters = {"every": 1, "direction": "out"} if kind == "corrupt" else {}
    bench.sim.control.inject(kind, **parameters)
    bench.pushes_until(state, words)
    bench.limp()
    bench.sim.control.clear(kind)
    bench.connected()

    def is_back() -> bool:
        is_paused = bench.front.operating_state().state is PAUSED
        try:
            (bench.front.resume if is_paused else bench.front.enable)()
        except CrtkError:
            return False
        return bool(bench.front.is_enabled())

    eventually(is_back, "ENABLED again")
    assert not bench.exerted().any(), "nothing goes on by itself"
    bench.push(X)


@pytest.mark.parametrize("kind", ["fragments", "more", "split"])
def test_what_is_allowed_is_read(bench: HaplyBench, kind: str) -> None:
    parameters = {"size": 7, "direction": "out"} if kind == "split" else {}
    bench.sim.control.inject(kind, **parameters)
    before = bench.front.health().samples
    eventually(lambda: bench.front.health().samples > before + 20, "it goes on")
    bench.push(X)


def test_a_message_that_cannot_be_read_is_dropped_and_told(sim: RunningSim) -> None:
    with haply(sim) as bench:
        sim.control.inject("nan")
        eventually(lambda: bench.front.health().device["malformed"] > 3, "they are counted")
        assert "NaN is no number" in bench.notes()["messages"]
        assert bench.front.operating_state().state is DISABLED


def test_poses_do_not_count_while_it_is_not_calibrated_or_its_grip_sleeps(sim: RunningSim) -> None:
    with haply(sim) as bench:
        engine = bench.session.engine
        for kind in ("uncalibrated", "asleep"):
            sim.control.inject(kind)
            eventually(lambda: engine.feedback("measured_cp")[1].wall_ns == 0, "not valid")
            sim.control.clear(kind)
            eventually(lambda: engine.feedback("measured_cp")[1].wall_ns, "valid")


@pytest.mark.parametrize("kind", ["uncalibrated", "asleep", "no_grip"])
def test_it_is_not_enabled_without(sim: RunningSim, kind: str) -> None:
    with haply(sim) as bench:
        sim.control.inject(kind)
        eventually(lambda: bench.session.engine.device.condition.reason, "it is told")
        with pytest.raises(CrtkError):
            bench.front.enable()
        bench.state(FAULT)
        sim.control.clear(kind)
        eventually(lambda: not bench.session.engine.device.condition.reason, "it is well")
        bench.front.enable()


def test_buttons_of_a_grip_that_sleeps_are_released_and_not_valid(sim: RunningSim) -> None:
    with haply(sim) as bench:
        sim.control.inject("press", button="a")
        eventually(lambda: bench.front.button_a().buttons == (1,), "pressed")
        sim.control.inject("asleep")
        eventually(lambda: not bench.front.button_a().is_valid, "not known")
        assert bench.front.button_a().buttons == (0,)


def test_a_low_battery_is_told(sim: RunningSim) -> None:
    with haply(sim) as bench:
        assert "battery" not in bench.notes()
        sim.control.inject("battery", level=0.07)
        eventually(lambda: "7 %" in bench.notes().get("battery", ""), "7 %")


def test_forces_that_are_not_exerted_are_told(bench: HaplyBench) -> None:
    bench.sim.control.inject("deaf")

    def is_told() -> bool:
        bench.send(X)
        return "force_member" in bench.notes().get("force", "")

    eventually(is_told, "it is told")


def test_a_stop_that_is_not_carried_out_is_told(bench: HaplyBench) -> None:
    bench.sim.control.inject("stuck")
    bench.front.hold()
    bench.state(FAULT, "a stop has not been carried out")
    assert bench.exerted().any()
    bench.sim.control.clear("stuck")
    bench.limp()
    eventually(lambda: bench.session.engine.device.has_stopped, "it is read back")


def test_a_force_that_goes_on_after_the_link_was_lost_is_told(bench: HaplyBench) -> None:
    """A stop that nobody saw carried out is not believed because there is a new connection."""
    bench.sim.control.inject("stuck")
    bench.sim.control.inject("disconnect")
    bench.pushes_until(FAULT)
    bench.sim.control.clear("disconnect")
    bench.connected()
    bench.state(FAULT, "a stop has not been carried out")
    assert bench.exerted().any()
    bench.sim.control.clear("stuck")
    bench.limp()
    eventually(lambda: bench.session.engine.device.has_stopped, "it is read back")


def test_two_clients(bench: HaplyBench) -> None:
    with haply(bench.sim, ramp=0.0) as other:
        other.front.enable()
        before = bench.front.health().samples
        eventually(lambda: bench.front.health().samples > before + 20, "the first goes on")
    assert bench.front.is_enabled()


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("vanish", "it has no Inverse3"),
        ("foreign", "another service, or a version"),
        ("malformed", "cannot be read"),
        ("no_answer", "does not answer the handshake"),
        ("disconnect", ""),
    ],
)
def test_it_says_why_it_does_not_connect(sim: RunningSim, kind: str, words: str) -> None:
    sim.control.inject(kind)
    session = Session(PLUGIN, configuration(sim, open_timeout=0.5))
    engine = session.engine
    try:
        session.start()
        eventually(lambda: engine.status.state is FAULT and words in engine.status.detail, words)
        assert f"{session.config.port}" in engine.device.address
        sim.control.clear()
        eventually(lambda: engine.connected and engine.has_sample, "connected")
        assert engine.status.state is DISABLED
    finally:
        session.close()
        sim.control.clear()


def test_the_service_dies_and_comes_back_at_its_port() -> None:
    with simulated() as first:
        host, port = first.host, first.ports["service"]
        bench = HaplyBench(first, configuration(first, ramp=0.0))
        try:
            bench.session.start()
            bench.connected()
            bench.front.enable()
            bench.push(X)
            first.kill()
            bench.pushes_until(FAULT)
            with simulated(host=host, port=port) as bench.sim:
                bench.connected()
                bench.state(DISABLED)
                assert not bench.exerted().any()
        finally:
            bench.front.close()

"""The driver at the simulated service: poses, buttons, forces, and when they are zero."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from crtk_drivers.errors import CommandRefused
from crtk_drivers.samples import Wrench, vector
from crtk_drivers.state import OperatingState
from crtk_sim_backends.haply import RunningSim
from rigs.haply_bench import HaplyBench, haply, simulated
from rigs.waiting import eventually

HERE = [0.02, -0.1, 0.17]
X, Z = (1.0, 0.0, 0.0), (0.0, 0.0, 1.5)


@pytest.fixture(scope="module")
def sim() -> Iterator[RunningSim]:
    with simulated() as running:
        yield running


@pytest.fixture
def bench(sim: RunningSim) -> Iterator[HaplyBench]:
    sim.control.call("put", position=HERE)
    with haply(sim, ramp=0.0, stream_timeout=0.3) as running:
        yield running


@pytest.fixture
def enabled(bench: HaplyBench) -> HaplyBench:
    bench.front.enable()
    return bench


def test_pose_and_twist(bench: HaplyBench) -> None:
    pose = bench.front.measured_cp()
    assert pose.position == pytest.approx(HERE)
    assert pose.orientation.tolist() == [0.0, 0.0, 0.0, 1.0]
    assert pose.frame_id == "haply_base"
    bench.sim.control.inject("turn")
    eventually(lambda: 0.8 < bench.front.measured_cv().angular[2] < 1.2, "it turns at 1 rad/s")
    bench.sim.control.inject("push", y=0.4)
    eventually(lambda: bench.front.measured_cv().linear[1] > 0.2, "it moves along y")


def test_buttons_and_charge(bench: HaplyBench) -> None:
    front = bench.front
    eventually(lambda: front.button_b().is_valid, "the buttons are known")
    assert front.button_b().buttons == (0,)
    bench.sim.control.inject("press", button="b")
    eventually(lambda: front.button_b().buttons == (1,), "b is pressed")
    assert front.button_a().buttons == (0,)
    bench.sim.control.clear("press")
    eventually(lambda: front.button_b().buttons == (0,), "b is released")
    assert front.state.battery() == pytest.approx(0.9)
    assert front.state.awake()
    assert front.state.calibrated()


def test_nothing_is_told_of_one_that_is_not_connected_any_more(sim: RunningSim) -> None:
    with haply(sim) as bench:
        readings = bench.front.engine.readings
        told = [readings[name].tell for name in ("battery", "awake", "calibrated")]
        eventually(lambda: all(tell() is not None for tell in told), "all is known")
    assert [tell() for tell in told] == [None] * 3


def test_a_button_is_called_as_it_is_configured(sim: RunningSim) -> None:
    with haply(sim, buttons={"clutch": "home"}) as bench:
        bench.sim.control.inject("press", button="home")
        eventually(lambda: bench.front.clutch().buttons == (1,), "home is pressed")


def test_a_force_pushes_and_ends_with_its_stream(enabled: HaplyBench) -> None:
    enabled.push(Z)

    def is_told() -> bool:
        enabled.send(Z)
        return bool(enabled.front.setpoint_cf(age=0).force.tolist() == list(Z))

    eventually(is_told, "the setpoint is told")
    enabled.limp()
    assert enabled.front.is_enabled()
    assert enabled.front.measured_cp().position[2] > HERE[2]


def test_a_force_in_the_axes_of_the_grip(enabled: HaplyBench) -> None:
    enabled.sim.control.inject("turn")
    eventually(lambda: enabled.front.measured_cp().orientation[2] > 0.6, "it has turned")

    def is_felt() -> bool:
        enabled.front.body.servo_cf([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
        x, y, _ = enabled.exerted()
        return bool(y > 0.5 and np.hypot(x, y) == pytest.approx(1.0))

    eventually(is_felt, "the force turns with the grip")


def test_a_force_that_is_too_great_is_refused(enabled: HaplyBench) -> None:
    with pytest.raises(CommandRefused, match=r"exceeds 3\.0"):
        enabled.send((2.0, 0.0, 2.5))
    assert not enabled.exerted().any()
    assert enabled.front.is_enabled()


def test_torques_are_left_out_and_that_is_told(enabled: HaplyBench) -> None:
    def is_felt() -> bool:
        enabled.front.servo_cf([1.0, 0.0, 2.0, 50.0, 0.0, 0.0])
        return bool(np.abs(enabled.exerted() - [1.0, 0.0, 2.0]).max() < 1e-9)

    eventually(is_felt, "its force")
    assert "left out" in enabled.notes()["torque"]


@pytest.mark.parametrize("ends", ["hold", "disable", "pause", "free"])
def test_a_force_is_zero_after(enabled: HaplyBench, ends: str) -> None:
    enabled.push(X)
    getattr(enabled.front, ends)()
    enabled.limp()
    if ends in ("disable", "pause"):
        with pytest.raises(CommandRefused):
            enabled.send(X)


def test_a_force_is_zero_at_the_end(sim: RunningSim) -> None:
    with haply(sim, ramp=0.0) as bench:
        bench.front.enable()
        bench.push(X)
    bench.limp()
    status = sim.control.status()
    assert status["connections"]["service"] == 0


def test_a_force_that_begins_grows(sim: RunningSim) -> None:
    with haply(sim, ramp=5.0) as bench:
        bench.front.enable()

        def grows() -> bool:
            bench.send(X)
            return bool(0.0 < bench.exerted()[0] < 1.0)

        eventually(grows, "less than asked for")


def test_what_is_no_force_is_refused(enabled: HaplyBench) -> None:
    for bad in ([float("nan")] * 6, [1.0, 2.0], [float("inf"), *[0.0] * 5]):
        with pytest.raises((CommandRefused, ValueError, TypeError)):
            enabled.front.servo_cf(bad)
    with pytest.raises(CommandRefused, match="frame"):
        enabled.front.servo_cf(Wrench(vector(X), vector((0.0, 0.0, 0.0)), "elsewhere"))
    assert enabled.front.is_enabled()


def test_nothing_is_exerted_before_it_is_enabled(bench: HaplyBench) -> None:
    with pytest.raises(CommandRefused):
        bench.send(X)
    assert bench.front.operating_state().state is OperatingState.DISABLED
    assert not bench.exerted().any()


@pytest.mark.parametrize("member", ["values", "vector"])
def test_both_names_of_a_force(sim: RunningSim, member: str) -> None:
    with haply(sim, ramp=0.0, force_member=member) as bench:
        bench.front.enable()
        bench.push(X)


@pytest.mark.slow
@pytest.mark.parametrize("grip", ["wired", "custom"])
def test_each_kind_of_grip(grip: str) -> None:
    with simulated(grip=grip) as other, haply(other) as bench:
        other.control.inject("press", button="a")
        eventually(lambda: bench.front.button_a().buttons == (1,), "a is pressed")


@pytest.mark.slow
def test_what_somebody_chose_is_looked_for(sim: RunningSim) -> None:
    from crtk_driver_haply import PLUGIN
    from crtk_drivers.session import Session
    from rigs.haply_bench import configuration

    session = Session(PLUGIN, configuration(sim, device_id="0001"))
    try:
        session.start()
        told = "it has no Inverse3 0001, but 049D"
        eventually(lambda: told in session.engine.status.detail, told)
    finally:
        session.close()

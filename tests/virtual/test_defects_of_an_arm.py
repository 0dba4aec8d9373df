"""Each defect of the virtual arm does what it says, through the engine, on a clock that the test turns."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from crtk_driver_virtual import PLUGIN
from crtk_driver_virtual.config import VirtualConfig
from crtk_driver_virtual.defective_device import DefectiveDevice
from crtk_driver_virtual.defects_config import DefectsConfig
from crtk_driver_virtual.device import VirtualDevice
from crtk_drivers.errors import CommandRefused, ConnectionLost
from crtk_drivers.samples import Pose, Sample, Twist, Vector, Wrench, vector
from crtk_drivers.state import OperatingState
from rigs.virtual_arm import (
    AMPLITUDE,
    FREQUENCY,
    JOINT,
    PERIOD,
    RATE,
    Bench,
    at_sine,
    column,
    joint_states,
    phasor,
    rest,
    sine,
    times,
    tool_points,
)

# ----------------------------------------------------------------------- one figure for each defect


def noise(bench: Bench) -> float:
    return float(column(bench.run(1.0)).std())


def line(bench: Bench) -> float:
    samples = bench.run(1.0)
    return abs(phasor(times(samples), column(samples), 50.0))


def drift(bench: Bench) -> float:
    samples = bench.run(1.0)
    return float(np.polyfit(times(samples), column(samples), 1)[0])


def largest_step(bench: Bench) -> float:
    return float(np.abs(np.diff(column(bench.enabled().stream(lambda t: 0.2 * t, 0.5)))).max())


def both_sides(bench: Bench) -> float:
    """How far apart a joint rests at one place that it came to from below and from above."""
    bench.enabled().go(0.1)
    bench.go(0.1)
    bench.go(-0.1)
    above = rest(bench)
    bench.go(-0.1)
    bench.go(0.1)
    return above - rest(bench)


def velocity_delay(bench: Bench) -> float:
    samples = sine(bench)
    t, q = times(samples), column(samples)
    told = at_sine(t, column(samples, "velocity"))
    true = at_sine(t, q) * 2j * math.pi * FREQUENCY
    return -float(np.angle(told / true)) / (2.0 * math.pi * FREQUENCY)


def velocity_slope(bench: Bench) -> float:
    samples = sine(bench)
    t, q = times(samples), column(samples)
    told = at_sine(t, column(samples, "velocity"))
    return float((told / (at_sine(t, q) * 2j * math.pi * FREQUENCY)).real)


def effort_ratio(bench: Bench) -> float:
    """Measured effort at rest, as share of the weight."""
    found = column(bench.enabled().run(0.1), "effort").mean()
    return float(found / bench.plant.dynamics.weight(bench.plant.position)[JOINT])


def spread_of_zero(bench: Bench) -> float:
    bench.enabled()
    found = []
    for _ in range(30):
        bench.command("unhome")
        bench.command("home")
        found.append(rest(bench))
    return float(np.std(found))


def pose_error(bench: Bench) -> float:
    sample = bench.run(0.01)[-1]
    told, (state,) = tool_points([sample])[0], joint_states([sample])
    return float(np.abs(bench.device.kinematics.forward(state.position).position - told).max())


def pose_ratio(bench: Bench) -> float:
    sample = bench.run(0.01)[-1]
    told, (state,) = tool_points([sample])[0], joint_states([sample])
    here = bench.device.kinematics.forward(state.position).position
    return float(np.linalg.norm(told) / np.linalg.norm(here))


def twist_ratio(bench: Bench) -> float:
    sample = bench.enabled().stream(lambda t: 0.2 * t, 0.5)[-1]
    told, (state,) = sample.values["measured_cv"], joint_states([sample])
    assert isinstance(told, Twist)
    moved = bench.device.kinematics.jacobian(state.position) @ state.velocity
    return float(np.linalg.norm(told.linear) / np.linalg.norm(moved[:3]))


def share_that_stands(bench: Bench) -> float:
    samples = bench.enabled().stream(lambda t: 0.2 * t, 1.0)[50:]
    return float(np.mean(np.diff(column(samples)) == 0.0))


def share_that_comes(bench: Bench) -> float:
    return len(bench.run(2.0)) / (2.0 * RATE)


def period_spread(bench: Bench) -> float:
    return float(np.diff(times(bench.run(1.0))).std())


def delivery_delay(bench: Bench) -> float:
    bench.run(0.2)
    return float(np.mean(np.array(bench.came[-50:]) - times(bench.samples[-50:])))


def tracking_delay(bench: Bench) -> float:
    samples = sine(bench)
    t = times(samples) - bench.stream_began
    return -float(np.angle(at_sine(t, column(samples)) * 1j)) / (2.0 * math.pi * FREQUENCY)


def tracking_gain(bench: Bench) -> float:
    samples = sine(bench)
    return abs(at_sine(times(samples), column(samples))) / AMPLITUDE


def stamp_spread(bench: Bench) -> float:
    samples = bench.run(1.0)
    return float((np.array(bench.came[-len(samples) :]) - times(samples)).std())


def clock_error(bench: Bench) -> float:
    samples = bench.run(1.0)
    return float(np.polyfit(bench.came[-len(samples) :], times(samples), 1)[0]) - 1.0


def fresh_without_link(bench: Bench) -> float:
    bench.device.reachable = False
    try:
        return len(bench.run(0.1))
    except ConnectionLost:
        return 0


def drop_at_disable(bench: Bench) -> float:
    before = rest(bench.enabled())
    bench.command("disable")
    return abs(rest(bench) - before)


def jump_at_enable(bench: Bench) -> float:
    before = rest(bench)
    bench.enabled().run(0.5)
    assert bench.state is OperatingState.ENABLED
    return rest(bench) - before


def jump_at_reconnect(bench: Bench) -> float:
    before = rest(bench)
    bench.engine.lose("tested")
    bench.device.close()
    bench.engine.connect(bench.clock() + 1.0)
    return rest(bench) - before


def missing_at_rest(bench: Bench) -> float:
    bench.enabled().go(0.1)
    return rest(bench) - bench.setpoint[JOINT]


def spread_of_rest(bench: Bench) -> float:
    bench.enabled()
    found = []
    for _ in range(8):
        bench.go(-0.02, wait=0.0)
        bench.go(0.02, wait=0.05)
        found.append(rest(bench) - bench.setpoint[JOINT])
    return float(np.std(found))


def overshoot(bench: Bench) -> float:
    start = rest(bench.enabled())
    samples = bench.go(0.05)
    return (float(column(samples).max()) - start) / 0.05 - 1.0


def limit_cycle(bench: Bench) -> float:
    assert column(bench.run(0.5)).std() < 1e-9, "brakes hold"
    samples = bench.enabled().run(1.0)
    return abs(phasor(times(samples), column(samples), 8.0))


def bow(bench: Bench) -> float:
    """How far the tool was from the straight line to where it went."""
    here = bench.enabled().samples[-1].values["measured_cp"]
    assert isinstance(here, Pose)
    goal = Pose(vector(here.position + np.array((0.0, 0.1, 0.0))), here.orientation, here.frame_id)
    begin = len(bench.samples)
    move = bench.engine.submit("move_cp", goal)
    assert move is not None
    while move.is_busy():
        bench.run(0.01)
    way = tool_points(bench.samples[begin:]) - here.position
    return float(np.linalg.norm(way[:, [0, 2]], axis=1).max())


def ripple(bench: Bench) -> float:
    samples = bench.enabled().stream(lambda t: 0.2 * t, 1.5)[-round(RATE) :]
    v = column(samples, "velocity")
    return abs(phasor(times(samples), v, 10.0)) / float(v.mean())


def fastest(bench: Bench) -> float:
    limit = bench.engine.capabilities.limits[JOINT]

    def way(t: float) -> float:
        slow = 0.5 * limit.acceleration * min(t, limit.velocity / limit.acceleration) ** 2
        return slow + limit.velocity * max(0.0, t - limit.velocity / limit.acceleration)

    samples = bench.enabled().stream(way, limit.velocity / limit.acceleration + 0.2)
    return float(column(samples, "velocity").max()) / limit.velocity


def past_the_end(bench: Bench) -> float:
    limit = bench.engine.capabilities.limits[JOINT]
    samples = bench.enabled().stream(lambda t: min(0.5 * t, 0.3), 0.7)
    return float(column(samples).max()) - limit.upper


def dry_friction(bench: Bench) -> float:
    """Half of the difference of the efforts there and back, without what grows with speed."""

    def both(speed: float) -> float:
        there = bench.stream(lambda t: speed * t, 0.5)[-100:]
        bench.run(0.3)
        back = bench.stream(lambda t: -speed * t, 0.5)[-100:]
        bench.run(0.3)
        return 0.5 * float(
            column(there, "effort").mean()
            - column(back, "effort").mean()
            - weight_between(bench, there, back)
        )

    bench.enabled()
    return 2.0 * both(0.2) - both(0.4)


def weight_between(bench: Bench, one: list[Sample], other: list[Sample]) -> float:
    def mean(samples: list[Sample]) -> float:
        weights = [bench.plant.dynamics.weight(state.position) for state in joint_states(samples)]
        return float(np.mean(weights, axis=0)[JOINT])

    return mean(one) - mean(other)


def time_to_stop(bench: Bench) -> float:
    bench.enabled().stream(lambda t: 0.5 * min(t, 0.2) ** 2 / 0.4 + 0.5 * max(0.0, t - 0.2), 0.4)
    bench.engine.submit("hold")
    samples = bench.run(1.5)
    moving = np.flatnonzero(np.abs(column(samples, "velocity")) > 1e-3)
    return float(times(samples)[moving[-1]] - times(samples)[0])


def way_back(bench: Bench) -> float:
    """How far the joint comes back after it was stopped in motion."""
    bench.enabled().stream(lambda t: 0.4 * t, 0.3)
    bench.engine.submit("hold")
    positions = column(bench.run(1.0))
    return float(positions.max() - positions[-1])


def forces(bench: Bench) -> tuple[Vector, Vector]:
    """When measured_cf was measured, and its z, with 10 N in it."""
    push = Wrench(vector((0.0, 0.0, 10.0)), vector((0.0, 0.0, 0.0)), "base")
    bench.device.apply_wrench(push)
    bench.run(0.01)
    samples = bench.run(1.0)
    felt = [sample.values["measured_cf"] for sample in samples]
    return times(samples), np.array([each.force[2] for each in felt if isinstance(each, Wrench)])


def force_noise(bench: Bench) -> float:
    return float(forces(bench)[1].std())


def force_line(bench: Bench) -> float:
    return abs(phasor(*forces(bench), 50.0))


def force_drift(bench: Bench) -> float:
    return float(np.polyfit(*forces(bench), 1)[0])


def force_felt(bench: Bench) -> float:
    return float(forces(bench)[1].mean())


def way_after_silence(bench: Bench) -> float:
    """How far the joint goes within a second and a half after a stream has ended."""
    samples = bench.enabled().stream(lambda t: 0.15 * t, 0.3)
    here = float(column(samples)[-1])
    bench.run(1.5)
    return rest(bench) - here


def way_while_frozen(bench: Bench) -> float:
    """How far the joint goes while the driver does nothing for a second."""
    here = float(column(bench.enabled().stream(lambda t: 0.15 * t, 0.3))[-1])
    bench.clock.advance(1.0)
    return float(column(bench.run(PERIOD))[-1]) - here


# ------------------------------------------------------------------------------------------ the table


@dataclass(frozen=True)
class Case:
    """A figure that a defect changes: what it is without, and with it."""

    measure: Callable[[Bench], float]
    defects: dict[str, Any]
    without: float
    with_it: float
    within: float
    keys: dict[str, Any] = field(default_factory=dict)


NEAR_THE_END = {"start": (0.0, 1.95, 1.4, 0.0, 1.3416, 0.0)}

CASES = {
    "position_noise": Case(noise, {"position_noise": 1e-3}, 0.0, 1e-3, 1e-4),
    "position_line": Case(line, {"position_line": 1e-3}, 0.0, 1e-3, 1e-5),
    "position_drift": Case(drift, {"position_drift": 0.01}, 0.0, 0.01, 1e-5),
    "position_jump": Case(largest_step, {"position_jump": 0.1, "jump_at": 0.45}, 0.0, 0.1, 5e-3),
    "backlash": Case(both_sides, {"backlash": 0.01}, 0.0, 0.01, 2e-4),
    "velocity_lag": Case(velocity_delay, {"velocity_lag": 0.02}, 0.0, 0.02, 1.5e-3),
    "velocity_scale": Case(velocity_slope, {"velocity_scale": 1.1}, 1.0, 1.1, 0.01),
    "effort_sign": Case(effort_ratio, {"effort_sign": -1}, 1.0, -1.0, 0.01),
    "effort_scale": Case(effort_ratio, {"effort_scale": 1.5}, 1.0, 1.5, 0.01),
    "homing_noise": Case(
        spread_of_zero, {"homing_noise": 0.01}, 0.0, 0.01, 4e-3, {"needs_homing": True}
    ),
    "calibration": Case(pose_error, {"calibration": 0.01}, 0.0, 9e-3, 1e-3),
    "pose_scale": Case(pose_ratio, {"pose_scale": 1000.0}, 1.0, 1000.0, 1e-6),
    "twist_scale": Case(twist_ratio, {"twist_scale": 1.5}, 1.0, 1.5, 0.01),
    "frozen_share": Case(share_that_stands, {"frozen_share": 0.1}, 0.0, 0.1, 0.03),
    "lost_samples": Case(share_that_comes, {"lost_samples": 0.1}, 1.0, 0.9, 0.03),
    "slow": Case(share_that_comes, {"slow": 0.8}, 1.0, 0.8, 1e-3),
    "jitter": Case(period_spread, {"jitter": 1e-3}, 0.0, 6e-4, 1e-4),
    "age": Case(delivery_delay, {"age": 0.01}, 0.0, 0.01, 1e-6),
    "arrival_stamps": Case(
        tracking_delay, {"age": 0.05, "arrival_stamps": True}, 0.002, 0.052, 1e-3
    ),
    "stamp_jitter": Case(stamp_spread, {"stamp_jitter": 1e-3}, 0.0, 1e-3, 1e-4),
    "clock_drift": Case(clock_error, {"clock_drift": 1000.0}, 0.0, 1e-3, 1e-6),
    "stale_stamps": Case(fresh_without_link, {"stale_stamps": True}, 0, 50, 0.5),
    "sag_on_disable": Case(drop_at_disable, {"sag_on_disable": 0.02}, 0.0, 0.02, 1e-6),
    "jump_on_enable": Case(jump_at_enable, {"jump_on_enable": 0.02}, 0.0, 0.02, 1e-4),
    "jump_on_reconnect": Case(jump_at_reconnect, {"jump_on_reconnect": 0.02}, 0.0, 0.02, 1e-6),
    "tracking_lag": Case(tracking_delay, {"tracking_lag": 0.05}, 0.002, 0.052, 1e-3),
    "gain": Case(tracking_gain, {"gain": 0.9}, 1.0, 0.9, 0.01),
    "following_offset": Case(missing_at_rest, {"following_offset": 5e-3}, 0.0, 5e-3, 1e-4),
    "repeatability": Case(spread_of_rest, {"repeatability": 2e-3}, 0.0, 1.5e-3, 7e-4),
    "resonance": Case(overshoot, {"resonance": 3.0}, 0.0, 0.44, 0.05),
    "hunting": Case(limit_cycle, {"hunting": 2e-3}, 0.0, 2e-3, 2e-4),
    "line_bow": Case(bow, {"line_bow": 5e-3}, 0.0, 5e-3, 5e-4),
    "speed_ripple": Case(ripple, {"speed_ripple": 0.2}, 0.0, 0.2, 0.02),
    "overspeed": Case(fastest, {"overspeed": 1.2}, 1.0, 1.2, 0.03),
    "overtravel": Case(past_the_end, {"overtravel": 0.05}, 0.0, 0.05, 1e-3, NEAR_THE_END),
    "coulomb_friction": Case(dry_friction, {"coulomb_friction": 3.0}, 0.0, 3.0, 0.2),
    "slow_stop": Case(time_to_stop, {"slow_stop": 20.0}, 0.05, 0.6, 0.1),
    "rebound": Case(way_back, {"rebound": 0.02}, 0.0, 0.02, 2e-3),
    "force_noise": Case(force_noise, {"force_noise": 0.5}, 0.0, 0.5, 0.05),
    "force_line": Case(force_line, {"force_line": 0.5}, 0.0, 0.5, 0.01),
    "force_drift": Case(force_drift, {"force_drift": 0.5}, 0.0, 0.5, 1e-3),
    "force_scale": Case(force_felt, {"force_scale": 1.2}, 10.0, 12.0, 1e-6),
    "ignores_stop": Case(way_after_silence, {"ignores_stop": True}, 0.0, 0.23, 0.01),
    "ignores_watchdog": Case(way_while_frozen, {"ignores_watchdog": True}, 0.0, 0.15, 0.01),
}

COMPANIONS = {"joints", "seed", "line_frequency", "jump_at", "damping", "hunting_frequency"}
"""Keys that are no defect by themselves."""


def test_the_table_has_every_defect() -> None:
    assert set(CASES) == set(DefectsConfig.model_fields) - COMPANIONS


@pytest.mark.sweep(8)
@pytest.mark.parametrize("name", CASES)
def test_a_defect_is_seen_and_is_not_seen_without_it(name: str) -> None:
    case = CASES[name]
    assert abs(case.with_it - case.without) > 2.0 * case.within, "the two could not be told apart"
    healthy = case.measure(Bench({}, **case.keys))
    defective = case.measure(Bench(case.defects, **case.keys))
    assert healthy == pytest.approx(case.without, abs=case.within)
    assert defective == pytest.approx(case.with_it, abs=case.within)


def test_defects_can_be_those_of_one_joint() -> None:
    other = Bench({"position_noise": 1e-3, "gain": 0.9, "joints": [JOINT + 1]})
    assert noise(other) == 0.0
    assert tracking_gain(other) == pytest.approx(1.0, abs=0.01)


def test_an_arm_without_defects_has_nothing_of_them() -> None:
    assert type(PLUGIN.create(VirtualConfig())) is VirtualDevice
    assert type(PLUGIN.create(VirtualConfig(defects={"gain": 0.9}))) is DefectiveDevice  # type: ignore[arg-type]


def test_an_arm_whose_defects_do_nothing_moves_as_one_without() -> None:
    """The plant of the defects is the plant, where no defect is in its way."""
    one, other = Bench({}), Bench({"effort_scale": 1.1})
    for bench in (one, other):
        bench.enabled().go(0.3)
    assert len(one.samples) == len(other.samples)
    assert column(other.samples) == pytest.approx(column(one.samples), abs=1e-9)


def test_a_jump_past_what_may_be_is_a_fault() -> None:
    bench = Bench({"position_jump": 6.283, "jump_at": 0.45}).enabled()
    with pytest.raises(CommandRefused, match="FAULT"):
        bench.stream(lambda t: 0.2 * t, 0.5)
    assert "joint_2 does not follow" in bench.engine.status.detail


@pytest.mark.parametrize(
    ("command", "why"),
    [("hold", "a stop has not been carried out"), ("", "does not follow")],
)
def test_a_stop_that_is_ignored_is_a_fault_and_no_stop_either(command: str, why: str) -> None:
    bench = Bench({"ignores_stop": True}).enabled()
    bench.stream(lambda t: 0.3 * t, 0.3)
    if command:
        bench.engine.submit(command)
    bench.run(2.3)
    assert bench.state is OperatingState.FAULT
    assert why in bench.engine.status.detail
    here = rest(bench)
    assert rest(bench) - here == pytest.approx(0.05 * 0.3, rel=0.1)
    bench.command("disable")
    here = rest(bench)
    assert rest(bench) == here

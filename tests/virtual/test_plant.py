"""The plant of the virtual arm: what physics and servos promise, without a clock."""

from typing import Any

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from crtk_driver_virtual.config import VirtualConfig
from crtk_driver_virtual.models import BUILT_IN, load_arm
from crtk_driver_virtual.plant import FREE, HOLD, OVERSPEED, SUBSTEP, Command, Drive, Plant, Wall
from crtk_driver_virtual.servo import FOLLOWING
from crtk_drivers.config import PoseConfig
from crtk_drivers.kinematics.serial import SerialChain

MODELS = tuple(BUILT_IN)
HANGING = (0.0, 0.0, 9.81)
"""Gravity of an arm at the ceiling: straight up, where it stands at zero, is then straight down."""


def plant_of(model: str = "six_axis", **changes: Any) -> Plant:
    keys = {"friction", "start", "rotor_inertia", "acceleration"}
    config = {key: changes.pop(key) for key in keys & changes.keys()}
    plant = Plant(load_arm(VirtualConfig(model=model, **config)), **changes)
    plant.braked = False
    return plant


def limits_of(model: str, name: str) -> np.ndarray:
    arm = load_arm(VirtualConfig(model=model))
    return np.array([getattr(limit, name) for limit in arm.limits])


def run(plant: Plant, seconds: float, command: Command | None = None) -> None:
    if command is not None:
        plant.command = command
    for _ in range(round(seconds / SUBSTEP)):
        plant.step()


def wall_below(plant: Plant, depth: float, stiffness: float, damping: float = 50.0) -> Wall:
    point, _ = plant.dynamics.tool(plant.position)
    return Wall(point - (0.0, 0.0, depth), np.array((0.0, 0.0, 1.0)), stiffness, damping)


# ------------------------------------------------------------------------------------------- physics


@pytest.mark.parametrize("model", MODELS)
def test_energy_is_kept_without_friction_and_compensation(model: str) -> None:
    count = load_arm(VirtualConfig(model=model)).start.size
    start = (0.3, 0.5, 0.3, 0.2, 0.3, 0.1, 0.1)[:count]
    plant = plant_of(model, friction=0.0, start=start, gravity=HANGING)
    plant.gravity_compensation = False
    plant.command = Command(Drive.EFFORT, np.zeros(count))
    energy = plant.dynamics.energy
    before = energy(plant.position, plant.velocity)
    changes, kinetic = [], []
    for _ in range(2000):
        plant.step()
        q, v = plant.position, plant.velocity
        changes.append(abs(energy(q, v) - before))
        kinetic.append(energy(q, v) - energy(q, 0.0 * v))
    assert max(kinetic) > 0.01 * abs(before), "it hardly moved"
    assert max(changes) < 5e-3 * max(kinetic)


def test_friction_only_takes_energy() -> None:
    plant = plant_of(gravity=(0.0, 0.0, 0.0), start=(0.3, 0.5, 0.3, 0.2, 0.3, 0.1))
    plant.velocity = np.full(6, 1.0)
    plant.command = FREE
    energies = []
    for _ in range(300):
        energies.append(plant.dynamics.energy(plant.position, plant.velocity))
        plant.step()
    assert (np.diff(energies) < 0.0).all()
    assert energies[-1] < 0.8 * energies[0]


def test_friction_of_any_size_stops_a_light_joint_without_swinging() -> None:
    plant = plant_of(friction=100.0, rotor_inertia=1e-4, gravity=(0.0, 0.0, 0.0))
    plant.velocity = np.array((0.0, 0.0, 0.0, 0.0, 0.0, 3.0))
    plant.command = FREE
    for _ in range(20):
        plant.step()
        assert 0.0 <= plant.velocity[5] < 0.1


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("drive", [Drive.FREE, Drive.EFFORT, Drive.WRENCH])
def test_gravity_compensation_holds_still(model: str, drive: Drive) -> None:
    plant = plant_of(model)
    start = plant.position
    size = 6 if drive is Drive.WRENCH else start.size
    run(plant, 1.0, Command(drive, np.zeros(size)))
    assert np.abs(plant.position - start).max() < 1e-9
    assert plant.effort == pytest.approx(plant.dynamics.weight(start), abs=1e-6)


def test_without_compensation_it_falls_but_not_when_free() -> None:
    plant = plant_of()
    height = plant.dynamics.tool(plant.position)[0][2]
    plant.gravity_compensation = False
    run(plant, 0.3, FREE)
    assert plant.dynamics.tool(plant.position)[0][2] == pytest.approx(height)
    run(plant, 0.3, Command(Drive.EFFORT, np.zeros(6)))
    assert plant.dynamics.tool(plant.position)[0][2] < height - 0.05


@pytest.mark.parametrize("model", MODELS)
def test_forward_and_inverse_dynamics_agree(model: str) -> None:
    plant, random = plant_of(model), np.random.default_rng(1)
    q = plant.position
    v, a = random.uniform(-1.0, 1.0, (2, q.size))
    effort = plant.dynamics.effort(q, v, a)
    assert plant.dynamics.acceleration(q, v, effort) == pytest.approx(a)
    rest = plant.dynamics.effort(q, 0.0 * v, 0.0 * a)
    assert plant.dynamics.mobility(q) @ (plant.dynamics.effort(q, 0.0 * v, a) - rest) == (
        pytest.approx(a)
    )
    assert plant.dynamics.weight(q) == pytest.approx(rest)


@pytest.mark.parametrize("model", MODELS)
def test_tool_and_jacobian_are_those_of_the_kinematics(model: str) -> None:
    arm = load_arm(VirtualConfig(model=model))
    tool = PoseConfig(position=(0.03, -0.02, 0.1), rpy=(0.3, 0.2, 0.1)).pose
    plant, chain = Plant(arm, tool=tool), SerialChain(arm.chain, tool=tool)
    point, jacobian = plant.dynamics.tool(plant.position)
    assert point == pytest.approx(chain.forward(arm.start).position, abs=1e-12)
    assert jacobian == pytest.approx(chain.jacobian(arm.start), abs=1e-12)


# ------------------------------------------------------------------------------------------ contacts


@pytest.mark.sweep(4)
@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(("stiffness", "damping"), [(500.0, 0.0), (5e3, 50.0), (1e6, 1e4)])
def test_at_rest_on_a_wall_force_is_stiffness_times_depth(
    model: str, stiffness: float, damping: float
) -> None:
    plant = plant_of(model, friction=5.0)
    force = 0.5 * load_arm(VirtualConfig(model=model)).tool.force
    wall = wall_below(plant, 1e-3, stiffness, damping)
    plant = plant_of(model, friction=5.0, walls=[wall])
    wrench = np.array((0.0, 0.0, -force, 0.0, 0.0, 0.0))
    deepest = 0.0
    plant.command = Command(Drive.WRENCH, wrench)
    for _ in range(6000):
        plant.step()
        assert plant.wrench[2] >= 0.0, "the wall pulls"
        deepest = max(deepest, wall.point[2] - plant.dynamics.tool(plant.position)[0][2])
    depth = wall.point[2] - plant.dynamics.tool(plant.position)[0][2]
    assert plant.wrench[2] == pytest.approx(stiffness * depth, rel=0.02)
    assert plant.wrench[2] == pytest.approx(force, rel=0.02)
    assert not plant.wrench[3:].any()
    assert deepest < 3.0 * force / stiffness + 2e-3


def test_a_wall_lets_go_of_a_tool_that_is_pulled_out() -> None:
    wall = wall_below(plant_of(), -2e-3, 100.0, damping=1e4)
    plant = plant_of(walls=[wall])
    pull = Command(Drive.WRENCH, np.array((0.0, 0.0, 100.0, 0.0, 0.0, 0.0)))
    plant.command = pull
    for _ in range(100):
        plant.step()
        assert plant.wrench[2] >= 0.0
    assert plant.dynamics.tool(plant.position)[0][2] > wall.point[2]
    assert plant.wrench[2] == 0.0


def test_in_a_corner_each_wall_carries_its_share() -> None:
    free = plant_of()
    point, _ = free.dynamics.tool(free.position)
    walls = [
        Wall(point - 1e-3 * normal, normal, 5e3, 50.0)
        for normal in (np.array((0.0, 0.0, 1.0)), np.array((0.6, 0.8, 0.0)))
    ]
    plant = plant_of(friction=5.0, walls=walls)
    wrench = np.array((-12.0, -16.0, -30.0, 0.0, 0.0, 0.0))
    run(plant, 4.0, Command(Drive.WRENCH, wrench))
    assert plant.wrench == pytest.approx(-wrench, abs=0.5)


def test_a_wall_is_felt_with_closed_brakes_and_while_a_position_is_followed() -> None:
    free = plant_of()
    wall = wall_below(free, -1e-3, 5e3)
    plant = plant_of(walls=[wall])
    plant.braked = True
    plant.step()
    assert plant.wrench[:3] == pytest.approx((0.0, 0.0, 5.0))
    plant.braked = False
    run(plant, 1.0, Command(Drive.POSITION, plant.position))
    depth = wall.point[2] - plant.dynamics.tool(plant.position)[0][2]
    assert 0.0 < depth < 1e-3
    assert plant.wrench[2] == pytest.approx(5e3 * depth)
    weight = plant.dynamics.weight(plant.position)
    assert plant.effort == pytest.approx(weight - plant.jacobian.T @ plant.wrench, abs=1e-3)


@pytest.mark.sweep(6)
@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_stops_hold_against_the_strongest_efforts(model: str, sign: float) -> None:
    lower, upper, strongest = (limits_of(model, name) for name in ("lower", "upper", "effort"))
    plant = plant_of(model)
    plant.command = Command(Drive.EFFORT, sign * strongest)
    for _ in range(4000):
        plant.step()
        assert (plant.position >= lower).all()
        assert (plant.position <= upper).all()
    at = upper if sign > 0.0 else lower
    assert np.abs(plant.position - at).min() < 1e-6
    assert np.abs(plant.velocity).max() < 1e-6


def test_a_stop_takes_no_more_momentum_than_it_must() -> None:
    plant = plant_of(gravity=(0.0, 0.0, 0.0), friction=0.0)
    plant.position = plant.position.copy()
    plant.position[3] = limits_of("six_axis", "upper")[3] - 1e-3
    plant.velocity = np.array((1.0, 0.0, 0.0, 2.0, 0.0, 0.0))
    before = plant.dynamics.energy(plant.position, plant.velocity)
    run(plant, 2e-3, FREE)
    assert plant.velocity[3] == pytest.approx(0.0, abs=1e-6)
    assert plant.velocity[0] == pytest.approx(1.0, abs=0.1)
    assert plant.dynamics.energy(plant.position, plant.velocity) < before


def test_a_velocity_ends_at_the_stop_and_comes_back_at_once() -> None:
    plant = plant_of()
    upper = limits_of("six_axis", "upper")
    run(plant, 3.0, Command(Drive.VELOCITY, np.array((0.0, 0.0, 0.0, 0.0, 2.0, 0.0))))
    assert plant.position[4] == pytest.approx(upper[4], abs=1e-6)
    run(plant, 0.1, Command(Drive.VELOCITY, np.array((0.0, 0.0, 0.0, 0.0, -1.0, 0.0))))
    assert plant.position[4] < upper[4] - 0.05


# ------------------------------------------------------------------------------------ limits and hand


@pytest.mark.parametrize("drive", [Drive.POSITION, Drive.VELOCITY, Drive.EFFORT])
def test_motors_are_no_stronger_than_their_limits(drive: Drive) -> None:
    strongest = limits_of("six_axis", "effort")
    fastest = limits_of("six_axis", "velocity")
    random, plant = np.random.default_rng(2), plant_of()
    plant.hand = np.array((0.0, 0.0, -400.0, 0.0, 0.0, 0.0))
    largest = np.zeros(6)
    for _ in range(40):
        plant.command = Command(drive, random.uniform(-2.0, 2.0, 6) * strongest)
        for _ in range(20):
            plant.step()
            largest = np.maximum(largest, np.abs(plant.effort))
            assert (np.abs(plant.effort) <= strongest).all()
            assert (np.abs(plant.velocity) <= OVERSPEED * fastest).all()
    assert (largest == strongest).any(), "no motor was at its limit"


def test_a_hand_bends_a_held_arm_by_force_over_stiffness_and_back() -> None:
    plant = plant_of(bandwidth=20.0)
    start = plant.position
    plant.hand = np.array((10.0, 0.0, -20.0, 0.0, 1.0, 0.0))
    run(plant, 1.0, HOLD)
    load = plant.jacobian.T @ plant.hand
    stiffness = (2.0 * np.pi * 20.0) ** 2
    bent = plant.dynamics.mobility(plant.position) @ load / stiffness
    assert plant.position - start == pytest.approx(bent, rel=1e-3, abs=1e-8)
    assert plant.effort == pytest.approx(plant.dynamics.weight(plant.position) - load, abs=1e-3)
    assert plant.wrench.tolist() == plant.hand.tolist()
    plant.hand = np.zeros(6)
    run(plant, 1.0)
    assert plant.position == pytest.approx(start, abs=1e-9)


def test_a_hand_moves_what_is_free_and_nothing_with_closed_brakes() -> None:
    plant = plant_of("haptic")
    height = plant.dynamics.tool(plant.position)[0][2]
    plant.hand = np.array((0.0, 0.0, 0.2, 0.0, 0.0, 0.0))
    plant.braked = True
    start = plant.position
    run(plant, 0.2, FREE)
    assert plant.position.tolist() == start.tolist()
    assert plant.wrench.tolist() == plant.hand.tolist()
    assert not plant.effort.any()
    plant.braked = False
    run(plant, 0.1)
    assert plant.dynamics.tool(plant.position)[0][2] > height + 1e-3


# -------------------------------------------------------------------------------------------- servos


@pytest.mark.sweep(4)
@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("substeps", [2, 10, 20])
def test_a_stream_of_positions_is_followed_one_interval_late(model: str, substeps: int) -> None:
    plant = plant_of(model)
    start, speed = plant.position, 0.3 * limits_of(model, "acceleration") * 0.1
    late = []
    for i in range(800 // substeps):
        time = i * substeps * SUBSTEP
        # begins gently and then goes on at one speed
        goal = start + speed * max(0.5 * min(time, 0.2) ** 2 / 0.2, time - 0.1)
        if i * substeps > 400:
            late.append((goal - plant.position) / speed)
        plant.command = Command(Drive.POSITION, goal)
        run(plant, substeps * SUBSTEP)
    assert np.abs(late).max() < (substeps + 1) * SUBSTEP


@pytest.mark.parametrize("model", MODELS)
def test_a_position_is_reached_exactly(model: str) -> None:
    plant = plant_of(model)
    goal = plant.position + 0.02
    run(plant, 1.0, Command(Drive.POSITION, goal))
    assert plant.position == pytest.approx(goal, abs=1e-9)
    assert np.abs(plant.velocity).max() < 1e-9


@pytest.mark.sweep(4)
@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("jump", [0.05, 0.3, -0.6])
def test_a_jump_of_all_joints_is_not_passed_by_more_than_a_hundredth(
    model: str, jump: float
) -> None:
    plant = plant_of(model)
    goal = plant.position + jump
    beyond = 0.0
    plant.command = Command(Drive.POSITION, goal)
    for _ in range(2000):
        plant.step()
        beyond = max(beyond, float((np.sign(jump) * (plant.position - goal)).max()))
    assert beyond < 0.01 * abs(jump)
    assert plant.position == pytest.approx(goal, abs=1e-9)


def test_a_velocity_is_reached_without_overshoot_and_hold_stays_where_it_stops() -> None:
    plant = plant_of()
    wanted = np.array((0.5, -0.4, 0.3, 0.5, 0.2, 0.5))
    plant.command = Command(Drive.VELOCITY, wanted)
    for _ in range(300):
        plant.step()
        assert (np.abs(plant.velocity) <= np.abs(wanted) + 1e-9).all()
    assert plant.velocity == pytest.approx(wanted, rel=1e-3)
    plant.command = HOLD
    assert not plant.is_held
    run(plant, 0.3)
    assert plant.is_held
    stopped = plant.position
    run(plant, 1.0)
    assert plant.position == pytest.approx(stopped, abs=1e-5)


@pytest.mark.parametrize("drive", [Drive.VELOCITY, Drive.POSITION])
def test_what_a_wall_stops_does_not_shoot_off_when_the_wall_is_gone(drive: Drive) -> None:
    wall = wall_below(plant_of(), 5e-3, 1e6, 1e4)
    plant = plant_of(walls=[wall])
    away = np.array((0.0, 0.4, 0.0, 0.0, 0.0, 0.0))
    run(plant, 2.0, Command(drive, away + (plant.position if drive is Drive.POSITION else 0.0)))
    assert plant.wrench[2] > 10.0
    blocked = plant.position
    plant._walls = ()
    run(plant, 1.0, HOLD)
    assert np.abs(plant.position - blocked).max() < 1.5 * FOLLOWING


def test_hold_after_positions_does_not_creep_under_a_load() -> None:
    plant = plant_of()
    plant.hand = np.array((0.0, 0.0, -50.0, 0.0, 0.0, 0.0))
    goal = plant.position
    run(plant, 1.0, Command(Drive.POSITION, goal))
    bent = plant.position
    for _ in range(20):
        run(plant, 0.05, HOLD)
        run(plant, 0.05, Command(Drive.POSITION, goal))
    run(plant, 1.0, HOLD)
    assert plant.position == pytest.approx(bent, abs=1e-6)


def test_efforts_take_over_and_hold_begins_where_they_end() -> None:
    plant = plant_of()
    run(plant, 0.3, Command(Drive.EFFORT, np.array((20.0, 0.0, 0.0, 0.0, 0.0, 0.0))))
    speed, here = plant.velocity[0], plant.position[0]
    assert speed > 0.5
    run(plant, 1.0, HOLD)
    assert plant.is_held
    assert here < plant.position[0] < here + speed * 0.5


# ---------------------------------------------------------------------------------------------- time


def test_time_goes_on_in_whole_substeps_and_loses_none() -> None:
    plant = plant_of()
    plant.advance(0.4 * SUBSTEP)
    assert plant.time == 0.0
    plant.advance(0.7 * SUBSTEP)
    assert plant.time == SUBSTEP
    for _ in range(100):
        plant.advance(1.37 * SUBSTEP)
    assert plant.time == pytest.approx(138 * SUBSTEP)

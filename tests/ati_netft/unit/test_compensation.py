"""Weight of the tool, point and axes, and the fit that finds tool and bias."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_ati_netft.compensation import (
    GRAVITY,
    Compensation,
    Tool,
    fit_tool,
    spread,
    transfer,
)
from crtk_drivers.geometry.quaternions import matrix_from_quaternion
from crtk_drivers.samples import vector

small = st.floats(-0.2, 0.2)
points = st.tuples(small, small, small).map(vector)
seeds = st.integers(0, 2**32 - 1)


def random_rotations(count, seed=0):
    quaternions = np.random.default_rng(seed).normal(size=(count, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    return np.array([matrix_from_quaternion(vector(q)) for q in quaternions])


def test_a_tool_pulls_downwards_at_its_centre() -> None:
    tool = Tool(2.0, vector([0.1, 0.0, 0.05]))
    assert tool.weight(np.eye(3)) == pytest.approx([0, 0, -19.6133, 0, 1.96133, 0])
    on_its_side = np.array(
        [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    )  # z of the sensor along -y of the world
    assert tool.weight(on_its_side.astype(float)) == pytest.approx(
        [0, -19.6133, 0, 0.980665, 0, -1.96133]
    )


def test_a_force_has_a_moment_about_another_point() -> None:
    matrix = transfer(vector([0.0, 0.0, 0.1]), np.eye(3))
    assert matrix @ [5.0, 0, 0, 0, 0, 0] == pytest.approx([5, 0, 0, 0, -0.5, 0])
    turned = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # its x is our y
    matrix = transfer(vector([0.0, 0.0, 0.0]), turned)
    assert matrix @ [0, 3.0, 0, 0, 0, 1.0] == pytest.approx([3, 0, 0, 0, 0, 1])


@given(points, seeds)
def test_there_and_back_changes_nothing(point, seed) -> None:
    rotation = random_rotations(1, seed)[0]
    there = transfer(point, rotation)
    back = transfer(vector(-rotation.T @ point), rotation.T)
    assert back @ there == pytest.approx(np.eye(6), abs=1e-12)


@given(points, seeds)
def test_a_force_through_the_point_has_no_moment_there(point, seed) -> None:
    random = np.random.default_rng(seed)
    force, rotation = random.normal(size=3), random_rotations(1, seed)[0]
    measured = np.concatenate((force, np.cross(point, force)))
    result = Compensation(matrix=transfer(point, rotation)).apply(measured)
    assert result[:3] == pytest.approx(rotation.T @ force)
    assert result[3:] == pytest.approx(np.zeros(3), abs=1e-12)


@given(seeds)
def test_what_is_left_is_the_load(seed) -> None:
    random = np.random.default_rng(seed)
    tool = Tool(1.3, vector(random.normal(size=3) * 0.1))
    rotation = random_rotations(1, seed)[0]
    bias, load = vector(random.normal(size=6)), random.normal(size=(20, 6))
    compensation = Compensation(bias, tool.weight(rotation))
    measured = load + bias + tool.weight(rotation)
    assert compensation.apply(measured) == pytest.approx(load)
    assert compensation.apply(measured[0]) == pytest.approx(load[0])


@given(
    mass=st.floats(0.05, 10.0),
    center=points,
    bias=st.lists(st.floats(-50.0, 50.0), min_size=6, max_size=6),
    count=st.integers(4, 12),
    seed=seeds,
)
def test_the_fit_finds_tool_and_bias(mass, center, bias, count, seed) -> None:
    rotations = random_rotations(count, seed)
    if spread(rotations) < 0.3:
        return
    tool = Tool(mass, center)
    measured = np.array([tool.weight(rotation) for rotation in rotations]) + bias
    found = fit_tool(measured, rotations)
    assert found.tool.mass == pytest.approx(mass, rel=1e-6)
    assert found.tool.center == pytest.approx(center, abs=1e-6)
    assert found.bias == pytest.approx(bias, abs=1e-6)
    assert found.force_residual < 1e-6
    assert found.torque_residual < 1e-6


def test_the_fit_says_how_sure_it_is() -> None:
    random = np.random.default_rng(4)
    tool, bias = Tool(0.8, vector([0.01, -0.02, 0.06])), np.arange(6.0)
    errors, claimed, distances, claimed_distances = [], [], [], []
    for seed in range(60):
        rotations = random_rotations(8, seed)
        noise = random.normal(size=(8, 6)) * np.repeat((0.05, 0.002), 3)
        measured = np.array([tool.weight(r) for r in rotations]) + bias + noise
        found = fit_tool(measured, rotations)
        errors.append(found.tool.mass - 0.8)
        claimed.append(found.mass_error)
        distances.append(found.tool.center - tool.center)
        claimed_distances.append(found.center_error)
        assert 0.02 < found.force_residual < 0.2
    assert np.std(errors) == pytest.approx(np.sqrt(np.mean(np.square(claimed))), rel=0.35)
    assert np.std(distances) == pytest.approx(
        np.sqrt(np.mean(np.square(claimed_distances))), rel=0.35
    )


def test_another_gravity_is_taken_into_account() -> None:
    moon = vector([0.0, 0.0, -1.62])
    tool, rotations = Tool(3.0, vector([0.0, 0.05, 0.1])), random_rotations(6)
    measured = np.array([tool.weight(r, moon) for r in rotations])
    assert fit_tool(measured, rotations, moon).tool.mass == pytest.approx(3.0)
    assert GRAVITY[2] == -9.80665


def test_poses_that_do_not_tell_are_refused() -> None:
    rotations = random_rotations(6)
    tool = Tool(1.0, vector([0, 0, 0.1]))

    def measured(some):
        return np.array([tool.weight(rotation) for rotation in some])

    with pytest.raises(ValueError, match="too few"):
        fit_tool(measured(rotations[:2]), rotations[:2])
    about_z = np.array([matrix_from_quaternion(vector([0, 0, s, c])) for s, c in
                        [(0, 1), (0.6, 0.8), (1, 0), (0.8, -0.6)]])  # fmt: skip
    with pytest.raises(ValueError, match="too much alike"):
        fit_tool(measured(about_z), about_z)
    two = np.array([rotations[0], rotations[1], rotations[0], rotations[1]])
    with pytest.raises(ValueError, match="too much alike"):
        fit_tool(measured(two), two)
    with pytest.raises(ValueError, match="mass"):
        fit_tool(-measured(rotations), rotations)
    with pytest.raises(ValueError, match="not finite"):
        fit_tool(measured(rotations) * np.nan, rotations)
    with pytest.raises(ValueError, match="wrenches for"):
        fit_tool(measured(rotations), rotations[:5])


@pytest.mark.parametrize(
    ("mass", "center"), [(-1.0, [0, 0, 0]), (np.nan, [0, 0, 0]), (np.inf, [0, 0, 0]), (1.0, [0, 0])]
)
def test_no_tool(mass, center) -> None:
    with pytest.raises(ValueError, match="no tool"):
        Tool(mass, vector(center))

"""Kinematics and dynamics of the simulated UR arms."""

from __future__ import annotations

from math import pi

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from crtk_sim_backends.ur.models import MODELS
from crtk_sim_backends.ur.motion import kinematics as k
from crtk_sim_backends.ur.motion.dynamics import Dynamics
from crtk_sim_backends.ur.motion.kinematics import Kinematics
from rigs.ur_controller import apart

ANGLE = st.floats(-3.1, 3.1)
JOINTS = st.lists(ANGLE, min_size=6, max_size=6)
POSE = st.tuples(*(st.floats(-1, 1),) * 3, *(st.floats(-1.7, 1.7),) * 3)
NAMES = sorted(MODELS)
TOOL = k.to_transform((0.01, -0.02, 0.15, 0.3, -0.2, 0.5))


def shifted(q: list[float], index: int, step: float) -> list[float]:
    moved = list(q)
    moved[index] += step
    return moved


@pytest.mark.parametrize(
    ("name", "position"),
    [
        ("ur5e", (0.0, -0.2329, 1.0794)),  # upright: y = -(d4 + d6), z = d1 - a2 - a3 + d5
        ("ur3", (0.0, -0.19425, 0.69415)),
        ("ur20", (0.0, -0.3553, 1.9863)),
    ],
)
def test_upright_arm_is_where_the_data_sheet_says(name: str, position: tuple[float, ...]) -> None:
    pose = Kinematics(MODELS[name]).forward([0.0, -pi / 2, 0.0, -pi / 2, 0.0, 0.0])
    assert apart(pose[:3], position) < 1e-9


@pytest.mark.sweep(3)
@pytest.mark.parametrize("name", NAMES)
def test_inverse_finds_the_joints_again(name: str) -> None:
    kinematics = Kinematics(MODELS[name])

    @given(JOINTS)
    def round_trip(q: list[float]) -> None:
        target = k.compose(kinematics.flange(q), TOOL)
        found = kinematics.inverse(target, q, TOOL)
        assert found is not None
        assert apart(k.compose(kinematics.flange(found), TOOL), target) < 1e-6
        if abs(q[4]) > 0.01 and abs(abs(q[4]) - pi) > 0.01 and abs(q[2]) > 0.01:
            branches = kinematics.inverse_all(kinematics.flange(q), q[5])
            nearest = min(
                max(abs((a - b + pi) % (2 * pi) - pi) for a, b in zip(q, x, strict=True))
                for x in branches
            )
            assert nearest < 1e-4

    round_trip()


@pytest.mark.parametrize("name", NAMES)
def test_all_solutions_reach_the_same_pose(name: str) -> None:
    kinematics = Kinematics(MODELS[name])
    target = kinematics.flange([0.4, -1.4, 1.5, -0.7, -1.3, 0.5])
    solutions = kinematics.inverse_all(target)
    assert len(solutions) == 8
    for q in solutions:
        assert apart(kinematics.flange(q), target) < 1e-9


@given(JOINTS, st.lists(st.floats(-0.04, 0.04), min_size=6, max_size=6))
def test_following_a_pose_stays_in_the_branch_and_reaches_it(
    q: list[float], step: list[float]
) -> None:
    kinematics = Kinematics(MODELS["ur5e"])
    target = k.compose(kinematics.flange([a + b for a, b in zip(q, step, strict=True)]), TOOL)
    found = kinematics.follow(target, q, TOOL)
    nearest = kinematics.inverse(target, q, TOOL)
    assume(nearest is not None)  # as where the elbow is stretched to the limit of its reach
    assert found is not None
    assert apart(k.compose(kinematics.flange(found), TOOL), target) < 1e-6
    assert apart(found, q) < max(0.1, apart(nearest, q) + 1e-9)


def test_inverse_out_of_reach_is_none() -> None:
    kinematics = Kinematics(MODELS["ur5e"])
    far = k.to_transform((1.5, 0.0, 0.5, 0.0, 0.0, 0.0))
    assert kinematics.inverse(far, [0.0] * 6) is None
    assert kinematics.follow(far, [0.0] * 6) is None


def test_inverse_stays_within_joint_limits() -> None:
    kinematics = Kinematics(MODELS["ur5e"])
    q = [6.2, -1.2, 1.1, -0.7, -1.3, -6.2]
    target = kinematics.flange(q)
    turned = kinematics.inverse(target, [v + 1.0 for v in q])
    assert turned is not None
    assert max(map(abs, turned)) <= 2 * pi


@given(JOINTS)
def test_jacobian_is_the_derivative(q: list[float]) -> None:
    kinematics = Kinematics(MODELS["ur10e"])
    matrix = kinematics.jacobian(q, TOOL)
    h = 1e-6
    for i in range(6):
        before = k.compose(kinematics.flange(shifted(q, i, -h)), TOOL)
        after = k.compose(kinematics.flange(shifted(q, i, h)), TOOL)
        linear = [(b - a) / (2 * h) for a, b in zip(before[9:], after[9:], strict=True)]
        turn = k.rotation_vector(k.compose((*after[:9], 0, 0, 0), k.invert((*before[:9], 0, 0, 0))))
        angular = [x / (2 * h) for x in turn]
        assert apart([row[i] for row in matrix], [*linear, *angular]) < 1e-5


@given(POSE, POSE)
def test_pose_trans_and_inverse_cancel(a: tuple[float, ...], b: tuple[float, ...]) -> None:
    assert apart(k.pose_trans(k.pose_inv(a), k.pose_trans(a, b)), b) < 1e-7
    assert apart(k.pose_add(b, k.pose_sub(a, b))[:3], a[:3]) < 1e-9


@given(POSE, POSE)
def test_interpolation_starts_and_ends_at_its_poses(
    a: tuple[float, ...], b: tuple[float, ...]
) -> None:
    ends = [k.to_transform(k.interpolate_pose(a, b, fraction)) for fraction in (0.0, 1.0)]
    assert apart(ends[0], k.to_transform(a)) < 1e-7
    assert apart(ends[1], k.to_transform(b)) < 1e-7


@pytest.mark.parametrize(
    "axis", [(pi, 0, 0), (0, pi, 0), (0, 0, pi), (2.2214414690791831, 2.2214414690791831, 0)]
)
def test_half_turns_survive(axis: tuple[float, ...]) -> None:
    matrix = k.rotation_matrix(*axis)
    assert apart(k.rotation_matrix(*k.rotation_vector(matrix)), matrix) < 1e-9


@pytest.mark.parametrize("name", NAMES)
def test_gravity_torque_is_the_slope_of_potential_energy(name: str) -> None:
    kinematics = Kinematics(MODELS[name])
    dynamics = Dynamics(kinematics)
    q = [0.3, -1.1, 1.2, -0.9, -1.4, 0.6]
    gravity = (0.0, 0.0, 9.82)
    payload, cog = 2.0, (0.01, 0.02, 0.1)

    def energy(joints: list[float]) -> float:
        _, _, links = dynamics._geometry(joints, payload, cog, kinematics.flange(joints))
        return sum(mass * 9.82 * centre[2] for mass, centre in links)

    torques = dynamics.torques(q, [0.0] * 6, payload, cog, gravity)
    h = 1e-6
    slopes = [(energy(shifted(q, i, h)) - energy(shifted(q, i, -h))) / (2 * h) for i in range(6)]
    assert apart(torques, slopes) < 1e-4
    assert abs(torques[1]) > 1.0
    assert all(abs(t) <= limit for t, limit in zip(torques, MODELS[name].torque, strict=True))


def test_mass_matrix_is_symmetric_and_agrees_with_the_torques() -> None:
    dynamics = Dynamics(Kinematics(MODELS["ur5e"]))
    q = [0.3, -1.1, 1.2, -0.9, -1.4, 0.6]
    matrix = dynamics.mass_matrix(q, 1.0, (0.0, 0.0, 0.1))
    for i in range(6):
        assert matrix[i][i] > 0.0
        assert apart(matrix[i], [row[i] for row in matrix]) < 1e-12
        qdd = [float(j == i) for j in range(6)]
        torques = dynamics.torques(q, qdd, 1.0, (0.0, 0.0, 0.1), (0.0, 0.0, 0.0))
        assert torques[i] == pytest.approx(matrix[i][i])


def test_coriolis_vanishes_at_rest_and_grows_with_the_square_of_speed() -> None:
    dynamics = Dynamics(Kinematics(MODELS["ur5e"]))
    q = [0.3, -1.1, 1.2, -0.9, -1.4, 0.6]
    qd = [0.5, -0.4, 0.3, 0.2, 0.1, -0.6]
    single = dynamics.coriolis(q, qd, 0.0, (0.0,) * 3)
    double = dynamics.coriolis(q, [2 * v for v in qd], 0.0, (0.0,) * 3)
    assert apart([4 * t for t in single], double) < 1e-9
    assert max(map(abs, single)) > 1e-3
    assert dynamics.coriolis(q, [0.0] * 6, 0.0, (0.0,) * 3) == [0.0] * 6


@given(JOINTS, st.lists(st.floats(-1, 1), min_size=6, max_size=6))
def test_joint_rates_move_the_tool_as_asked(q: list[float], twist: list[float]) -> None:
    matrix = Kinematics(MODELS["ur10e"]).jacobian(q, TOOL)
    rates = k.joint_rates(matrix, twist, 1e-3)
    assume(rates is not None)
    assert apart(k.multiply(matrix, rates), twist) < 1e-9


@pytest.mark.parametrize(
    "q",
    [
        [0.3, -1.1, 0.0, -0.9, -1.4, 0.6],  # elbow stretched
        [0.3, -1.1, 1.2, -0.9, 0.0, 0.6],  # wrist axes 4 and 6 parallel
    ],
)
def test_in_a_singularity_there_are_no_joint_rates(q: list[float]) -> None:
    assert k.joint_rates(Kinematics(MODELS["ur5e"]).jacobian(q), [0.1] * 6) is None

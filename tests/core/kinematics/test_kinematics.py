"""Generic kinematics: against DH tables, the UR closed form, pinocchio's own URDF reader, and itself."""

import math
import subprocess
import sys
import threading

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crtk_driver_ur.frames import transform_of
from crtk_driver_ur.kinematics import ArmKinematics
from crtk_driver_ur.models import JOINT_NAMES, MODELS, RobotModel
from crtk_drivers.errors import ConfigError, CrtkError, KinematicsError
from crtk_drivers.geometry.quaternions import (
    matrix_from_quaternion,
    pose_from_rotvec,
    quaternion_product,
    rotvec_from_quaternion,
)
from crtk_drivers.kinematics.chain import Chain, DHConvention, DHJoint, JointKind, chain_from_dh
from crtk_drivers.kinematics.serial import EDGE, IkFailure, InverseKinematicsError, SerialChain
from crtk_drivers.samples import Pose, vector
from rigs.examples import examples

pytest.importorskip("pinocchio", reason="the kinematics extra is not installed")

ACCURACY = 1e-9
HALF = math.pi / 2
TOOL = pose_from_rotvec(vector((0.01, -0.02, 0.15, 0.3, -0.2, 0.5)))
BASE = pose_from_rotvec(vector((1.0, 2.0, 0.5, 0.0, 0.4, -1.5)))


def ur_chain(model: RobotModel) -> Chain:
    twist = (HALF, 0.0, 0.0, HALF, -HALF, 0.0)
    a = (0.0, model.a2, model.a3, 0.0, 0.0, 0.0)
    d = (model.d1, 0.0, 0.0, model.d4, model.d5, model.d6)
    limits = model.position_limits
    return chain_from_dh(
        DHJoint(name, a[i], twist[i], d[i], lower=limits.lower[i], upper=limits.upper[i])
        for i, name in enumerate(JOINT_NAMES)
    )


# The manufacturer's table (Craig's convention) and limits of the Franka Emika Panda.
PANDA = chain_from_dh(
    [
        DHJoint("1", 0.0, 0.0, 0.333, lower=-2.8973, upper=2.8973),
        DHJoint("2", 0.0, -HALF, 0.0, lower=-1.7628, upper=1.7628),
        DHJoint("3", 0.0, HALF, 0.316, lower=-2.8973, upper=2.8973),
        DHJoint("4", 0.0825, HALF, 0.0, lower=-3.0718, upper=-0.0698),
        DHJoint("5", -0.0825, -HALF, 0.384, lower=-2.8973, upper=2.8973),
        DHJoint("6", 0.0, HALF, 0.0, lower=-0.0175, upper=3.7525),
        DHJoint("7", 0.088, HALF, 0.0, lower=-2.8973, upper=2.8973),
    ],
    DHConvention.MODIFIED,
)
UR = {name: SerialChain(ur_chain(model), name=name) for name, model in MODELS.items()}
UR5E = UR["ur5e"]
PANDA_ARM = SerialChain(PANDA)
SLIDE = SerialChain(
    chain_from_dh(
        [
            DHJoint("turn", 0.1, 0.3, 0.2, 0.4, lower=-3.0, upper=3.0),
            DHJoint("slide", 0.2, -0.7, 0.1, 1.1, JointKind.PRISMATIC, lower=-0.1, upper=0.5),
            DHJoint("bend", 0.3, 1.2, 0.0, lower=-1.5, upper=2.0),
        ]
    )
)
ARMS = [UR5E, PANDA_ARM, SLIDE, SerialChain(PANDA, base=BASE, tool=TOOL)]

names = st.sampled_from(sorted(MODELS))
angles = st.lists(st.floats(-2 * math.pi, 2 * math.pi), min_size=6, max_size=6).map(vector)
arms = st.sampled_from(ARMS)
seeds = st.integers(0, 2**32 - 1)


def within(arm: SerialChain, seed: int) -> np.ndarray:
    """A joint position within the limits, and within half a turn of zero."""
    random = np.random.default_rng(seed)
    return random.uniform(np.maximum(arm.lower, -math.pi), np.minimum(arm.upper, math.pi))


def distance(a: Pose, b: Pose) -> float:
    """The larger of m and rad between two poses."""
    inverse = vector(b.orientation * (-1, -1, -1, 1))
    turned = rotvec_from_quaternion(quaternion_product(a.orientation, inverse))
    return max(np.linalg.norm(a.position - b.position), np.linalg.norm(turned))


def homogeneous(pose: Pose) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = matrix_from_quaternion(pose.orientation)
    matrix[:3, 3] = pose.position
    return matrix


def refused(arm: SerialChain, pose: Pose, reference=None, **options) -> InverseKinematicsError:
    reference = np.zeros(len(arm.joints)) if reference is None else reference
    with pytest.raises(InverseKinematicsError) as caught:
        arm.inverse(pose, reference, **options)
    return caught.value


# Forward


@given(names, angles)
def test_forward_is_that_of_the_closed_form_for_every_ur(name, q):
    expected = ArmKinematics(MODELS[name]).forward(q)
    assert distance(UR[name].forward(q), expected) < ACCURACY


def test_forward_known_answer_of_a_ur5e():
    # The zero position follows from the published DH table by hand: stretched along -x, flange to -y.
    pose = UR5E.forward(np.zeros(6))
    assert pose.position == pytest.approx((-0.425 - 0.3922, -0.1333 - 0.0996, 0.1625 - 0.0997))
    assert homogeneous(pose)[:3, :3] == pytest.approx(
        np.array(((1, 0, 0), (0, 0, -1), (0, 1, 0))), abs=1e-12
    )


def test_forward_known_answer_of_a_panda_in_modified_dh():
    # Its zero position by hand: straight up, the flange frame 88 mm ahead and upside down.
    pose = PANDA_ARM.forward(np.zeros(7))
    assert pose.position == pytest.approx((0.088, 0.0, 0.333 + 0.316 + 0.384), abs=1e-12)
    assert homogeneous(pose)[:3, :3] == pytest.approx(np.diag((1, -1, -1)), abs=1e-12)


@given(st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3))
def test_a_dh_table_with_offsets_and_a_slide_is_the_textbook_product(q):
    rows = [(0.1, 0.3, 0.2, 0.4 + q[0]), (0.2, -0.7, 0.1 + q[1], 1.1), (0.3, 1.2, 0.0, q[2])]
    expected = np.eye(4)
    for a, alpha, d, theta in rows:
        c, s, ca, sa = math.cos(theta), math.sin(theta), math.cos(alpha), math.sin(alpha)
        expected = expected @ np.array(
            [
                [c, -s * ca, s * sa, a * c],
                [s, c * ca, -c * sa, a * s],
                [0, sa, ca, d],
                [0, 0, 0, 1],
            ]
        )
    assert np.abs(homogeneous(SLIDE.forward(vector(q))) - expected).max() < 1e-12


@given(seeds)
def test_base_and_tool_are_placed_before_and_after_the_arm(seed):
    q = within(PANDA_ARM, seed)
    expected = homogeneous(BASE) @ homogeneous(PANDA_ARM.forward(q)) @ homogeneous(TOOL)
    assert np.abs(homogeneous(ARMS[3].forward(q)) - expected).max() < 1e-12


def test_what_is_returned_is_nobody_elses_memory():
    pose = UR5E.forward(np.zeros(6))
    position, columns = pose.position.copy(), UR5E.jacobian(np.zeros(6))
    first = columns.copy()
    UR5E.forward(np.ones(6))
    UR5E.jacobian(np.ones(6))
    assert (pose.position == position).all()
    assert (columns == first).all()
    assert not pose.position.flags.writeable


def test_threads_do_not_share_buffers():
    positions = [within(UR5E, seed) for seed in range(8)]
    expected = [UR5E.forward(q).position for q in positions]
    wrong = []

    def ask(i):
        for _ in range(200):
            UR5E.jacobian(positions[i])
            if not np.array_equal(UR5E.forward(positions[i]).position, expected[i]):
                wrong.append(i)

    threads = [threading.Thread(target=ask, args=(i,)) for i in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(30.0)
    assert not wrong
    assert not any(thread.is_alive() for thread in threads)


def test_every_thread_has_a_workspace_of_its_own():
    found = [UR5E._workspace.data]
    thread = threading.Thread(target=lambda: found.append(UR5E._workspace.data))
    thread.start()
    thread.join(30.0)
    assert found[0] is not found[1]
    assert found[0] is UR5E._workspace.data


# Jacobian


@given(arms, seeds)
def test_jacobian_is_the_derivative_of_forward(arm, seed):
    q, h = within(arm, seed), 1e-6
    numeric = np.empty((6, q.size))
    for i, step in enumerate(np.eye(q.size) * h):
        ahead, behind = arm.forward(q + step), arm.forward(q - step)
        inverse = vector(behind.orientation * (-1, -1, -1, 1))
        turned = rotvec_from_quaternion(quaternion_product(ahead.orientation, inverse))
        numeric[:, i] = (*(ahead.position - behind.position), *turned)
    assert np.abs(arm.jacobian(q) - numeric / (2 * h)).max() < 1e-7


@given(names, angles)
def test_jacobian_is_that_of_the_closed_form(name, q):
    expected = ArmKinematics(MODELS[name]).jacobian(q)
    assert np.abs(UR[name].jacobian(q) - expected).max() < ACCURACY


# Inverse


@settings(max_examples=examples(60))
@given(arms, seeds)
def test_a_reachable_pose_is_reached_within_the_limits(arm, seed):
    pose = arm.forward(within(arm, seed))
    q = arm.inverse(pose, within(arm, seed + 1))
    assert distance(arm.forward(q), pose) < ACCURACY
    assert (q >= arm.lower).all()
    assert (q <= arm.upper).all()


@settings(max_examples=examples(30))
@given(names, seeds)
def test_a_solution_is_one_of_the_closed_form(name, seed):
    closed = ArmKinematics(MODELS[name])
    expected = within(UR[name], seed)
    pose = UR[name].forward(expected)
    q = UR[name].inverse(pose, within(UR[name], seed + 1))
    near = closed.inverse(pose, q)
    # not the joints: close to a singularity those differ by the root of the error in the pose
    assert distance(closed.forward(near), UR[name].forward(q)) < 2 * ACCURACY
    if min(abs(math.sin(expected[4])), abs(math.sin(expected[2]))) > 0.1:
        assert np.abs(near - q).max() < 1e-6


@given(arms, seeds)
def test_a_pose_near_the_reference_is_solved_nearby_without_restarts(arm, seed):
    random = np.random.default_rng(seed)
    middle = (np.maximum(arm.lower, -3.0) + np.minimum(arm.upper, 3.0)) / 2
    reference = middle + random.uniform(-0.02, 0.02, middle.size) + 0.4
    reference = np.clip(reference, arm.lower + 0.1, arm.upper - 0.1)
    goal = reference + random.uniform(-0.01, 0.01, middle.size)
    q = arm.inverse(arm.forward(goal), reference, restarts=0)
    assert np.abs(q - reference).max() < 0.1


def test_the_reference_itself_comes_back_unchanged():
    for arm in ARMS:
        q = within(arm, 3)
        assert np.abs(arm.inverse(arm.forward(q), q) - q).max() < ACCURACY


@pytest.mark.parametrize("turn", [-2 * math.pi, 2 * math.pi])
def test_whole_turns_are_those_of_the_reference(turn):
    q = np.array((0.3, -1.2, 1.1, -0.5, 0.9, math.copysign(0.2, -turn)))
    reference = q + np.array((0, 0, 0, 0, 0, 0.9 * turn))
    found = UR5E.inverse(UR5E.forward(q), reference)
    assert np.abs(found - q)[:5].max() < 1e-6
    assert found[5] == pytest.approx(q[5] + turn)


@given(st.floats(-30.0, 30.0), st.floats(-30.0, 30.0), st.floats(-9.0, 8.0), st.floats(0.1, 20.0))
def test_the_whole_turn_is_the_nearest_that_the_limits_allow(angle, reference, lower, width):
    arm = SerialChain(chain_from_dh([DHJoint("a", 1.0, lower=lower, upper=lower + width)]))
    (found,) = arm._nearest_turns(np.array((angle,)), np.array((reference,)))
    turns = [angle + 2 * math.pi * i for i in range(-20, 21)]
    allowed = [turned for turned in turns if lower - EDGE <= turned <= lower + width + EDGE]
    nearest = min(abs(turned - reference) for turned in allowed or turns)
    assert abs(found - reference) == pytest.approx(nearest, abs=1e-9)


def test_rounding_beyond_a_limit_is_cut_off():
    for limit, sign in ((PANDA_ARM.lower, -1.0), (PANDA_ARM.upper, 1.0)):
        beyond = limit + sign * 5e-11
        target = PANDA_ARM._place(PANDA_ARM._workspace.data, beyond).copy()
        assert PANDA_ARM._is_within(beyond)
        found = PANDA_ARM._checked(PANDA_ARM._workspace.data, target, beyond)
        assert (found == limit).all()


def test_a_joint_without_limits_goes_on_turning():
    wrist = np.array((0.3, -1.2, 1.1, -0.5, 0.9, 50.0))
    goal = wrist + 0.001
    assert UR["ur3e"].inverse(UR["ur3e"].forward(goal), wrist) == pytest.approx(goal, abs=1e-7)
    # That of a UR5e ends at one turn, and takes the nearest whole turn that it has.
    assert abs(UR5E.inverse(UR5E.forward(goal), wrist)[5]) <= 2 * math.pi


def test_the_same_question_has_the_same_answer():
    # One that the descent from the reference does not solve, so that restarts are part of it.
    arm = SerialChain(PANDA)
    for seed in range(50):
        pose, reference = arm.forward(within(arm, seed)), within(arm, seed + 1000)
        try:
            arm.inverse(pose, reference, restarts=0)
        except InverseKinematicsError:
            break
    else:
        pytest.fail("no pose needed a restart")
    first = arm.inverse(pose, reference)
    assert (first == arm.inverse(pose, reference)).all()
    assert (first == SerialChain(PANDA).inverse(pose, reference)).all()


@pytest.mark.parametrize("wrist", [0.0, 1e-12, 1e-7, 1e-4, math.pi])
@pytest.mark.parametrize("offset", [0.0, 0.02, 0.7])
def test_wrist_singularity(wrist, offset):
    q = np.array((0.3, -1.2, 1.1, -0.5, wrist, 0.2))
    pose = UR5E.forward(q)
    found = UR5E.inverse(pose, q + offset)
    assert distance(UR5E.forward(found), pose) < ACCURACY


def test_a_stretched_arm():
    q = np.array((0.3, -1.2, 0.0, -0.5, 0.9, 0.2))
    pose = UR5E.forward(q)
    found = UR5E.inverse(pose, q + 0.05)
    assert distance(UR5E.forward(found), pose) < ACCURACY


def test_solutions_on_a_limit_are_within_it():
    for joint in range(7):
        for limit in (PANDA_ARM.lower, PANDA_ARM.upper):
            q = np.array((0.1, 0.2, -0.3, -1.5, 0.4, 1.2, 0.5))
            q[joint] = limit[joint]
            pose = PANDA_ARM.forward(q)
            found = PANDA_ARM.inverse(pose, q)
            assert distance(PANDA_ARM.forward(found), pose) < ACCURACY
            assert (found >= PANDA_ARM.lower).all()
            assert (found <= PANDA_ARM.upper).all()


@pytest.mark.parametrize("size", [0.02, 50.0])
def test_arms_of_other_sizes(size):
    model = MODELS["ur5e"]
    rows = [(0, HALF, model.d1), (model.a2, 0, 0), (model.a3, 0, 0)]
    rows += [(0, HALF, model.d4), (0, -HALF, model.d5), (0, 0, model.d6)]
    arm = SerialChain(
        chain_from_dh(
            DHJoint(str(i), a * size, alpha, d * size) for i, (a, alpha, d) in enumerate(rows)
        )
    )
    for seed in range(10):
        q = within(arm, seed)
        found = arm.inverse(arm.forward(q), within(arm, seed + 100))
        assert distance(arm.forward(found), arm.forward(q)) < ACCURACY


def test_position_only_takes_any_orientation():
    arm = SerialChain(ur_chain(MODELS["ur5e"]), position_only=True, tool=TOOL)
    pose = pose_from_rotvec(vector((0.4, 0.2, 0.3, 0.1, 0.2, 0.3)))
    found = arm.forward(arm.inverse(pose, np.full(6, 0.5)))
    assert np.linalg.norm(found.position - pose.position) < ACCURACY
    assert distance(found, pose) > 0.01


# Inverse: refusals


def test_a_pose_beyond_the_links_is_refused_before_anything_is_tried():
    error = refused(UR5E, Pose(vector((0, 0, 1.5)), vector((0, 0, 0, 1))))
    assert error.reason is IkFailure.OUT_OF_REACH
    # by hand: 1.5 - d1 = 1.3375, and a2 + hypot(a3, d4) + d5 + d6
    reach = 0.425 + math.hypot(0.3922, 0.1333) + 0.0997 + 0.0996
    expected = f"ur5e: the pose is 1.3375 m from the first joint; the links reach {reach:.4f} m. "
    assert str(error).startswith(expected)


def test_reach_is_no_less_than_the_arm_has():
    for arm in ARMS:
        for seed in range(100):
            pose = arm.forward(within(arm, seed))
            assert np.linalg.norm(pose.position - arm._shoulder) <= arm._reach + 1e-12


@pytest.mark.parametrize("position", [(0.75, 0.0, 0.85), (0.0, 0.05, 0.5)])
def test_a_pose_that_no_joints_take_is_out_of_reach(position):
    pose = Pose(vector(position), vector((0, 0, 0, 1)))
    closed = ArmKinematics(MODELS["ur5e"])
    assert not closed.inverse_all(transform_of(pose))
    arm = SerialChain(ur_chain(MODELS["ur5e"]), time_limit=20.0)
    error = refused(arm, pose)
    assert error.reason is IkFailure.OUT_OF_REACH
    assert isinstance(error, KinematicsError)
    assert isinstance(error, CrtkError)


def test_a_pose_beyond_the_limits_names_the_joint():
    narrow = chain_from_dh(
        [DHJoint("first", 0.5, lower=-1.0, upper=1.0), DHJoint("second", 0.5, lower=0.2, upper=0.8)]
    )
    arm = SerialChain(narrow, time_limit=20.0)
    error = refused(arm, arm.forward(np.array((1.5, 0.5))))
    assert error.reason is IkFailure.JOINT_LIMITS
    assert "first 1.5000 (-1.0000 to 1.0000)" in str(error)
    assert "second" not in str(error)


def test_few_attempts_do_not_prove_that_a_pose_is_out_of_reach():
    pose = Pose(vector((0.0, 0.05, 0.5)), vector((0, 0, 0, 1)))
    assert refused(UR5E, pose, restarts=0).reason is IkFailure.NOT_CONVERGED


def test_time_is_bounded():
    arm = SerialChain(ur_chain(MODELS["ur5e"]), restarts=10**9, time_limit=0.02)
    error = refused(arm, Pose(vector((0.0, 0.05, 0.5)), vector((0, 0, 0, 1))))
    assert error.reason is IkFailure.NOT_CONVERGED
    assert "0.02 s" in str(error)


NAN = math.nan
BAD_POSES = [
    ((NAN, 0, 0), (0, 0, 0, 1)),
    ((0, math.inf, 0), (0, 0, 0, 1)),
    ((0, 0, 0), (0, 0, 0, 0)),
    ((0, 0, 0), (0, 0, 0, NAN)),
    ((0, 0, 0), (0, 0, 0.5, 1)),
    ((0, 0), (0, 0, 0, 1)),
    ((0, 0, 0), (0, 0, 1)),
]


@pytest.mark.parametrize(("position", "orientation"), BAD_POSES)
def test_what_is_no_pose_is_refused(position, orientation):
    pose = Pose(vector(position), vector(orientation))
    with pytest.raises(ValueError, match=r"must be finite|a pose has"):
        UR5E.inverse(pose, np.zeros(6))
    with pytest.raises(ConfigError, match="tool: "):
        SerialChain(PANDA, tool=pose)
    with pytest.raises(ConfigError, match="base: "):
        SerialChain(PANDA, base=pose)


@pytest.mark.parametrize("joints", [[0.0] * 5, [0.0] * 7, [[0.0] * 6], [0.0] * 5 + [NAN], []])
def test_what_is_no_joint_position_is_refused(joints):
    joints = np.array(joints)
    for ask in (UR5E.forward, UR5E.jacobian, lambda q: UR5E.inverse(UR5E.forward(np.zeros(6)), q)):
        with pytest.raises(ValueError, match="6 finite joint positions are needed"):
            ask(joints)


# Tables and configuration


@pytest.mark.parametrize(
    "rows",
    [
        [],
        [DHJoint("a"), DHJoint("a")],
        [DHJoint("")],
        [DHJoint("a", d=NAN)],
        [DHJoint("a", a=math.inf)],
        [DHJoint("a", alpha=NAN)],
        [DHJoint("a", theta=math.inf)],
        [DHJoint("a", lower=1.0, upper=1.0)],
        [DHJoint("a", lower=NAN)],
        [DHJoint(str(i)) for i in range(33)],
    ],
)
@pytest.mark.parametrize("convention", DHConvention)
def test_a_table_that_is_no_arm_is_refused(rows, convention):
    with pytest.raises(ConfigError):
        chain_from_dh(rows, convention)


def test_kind_and_convention_may_be_words_as_a_file_has_them():
    slide = chain_from_dh([DHJoint("a", kind="prismatic", upper=0.5, lower=0.0)], "modified")
    assert slide.joints[0].kind is JointKind.PRISMATIC
    assert slide.reach == 0.5
    with pytest.raises(ValueError, match="spherical"):
        chain_from_dh([DHJoint("a", kind="spherical")])
    with pytest.raises(ValueError, match="french"):
        chain_from_dh([DHJoint("a")], "french")


@pytest.mark.parametrize("options", [{"restarts": -1}, {"time_limit": 0.0}, {"time_limit": NAN}])
def test_bounds_that_are_none_are_refused(options):
    with pytest.raises(ConfigError):
        SerialChain(PANDA, **options)


def run(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=50)


def test_pinocchio_is_imported_when_it_is_needed_and_missed_with_the_command_that_brings_it():
    done = run(
        "import sys, crtk_drivers, crtk_drivers.kinematics.serial as k\n"
        "from crtk_drivers.kinematics.chain import DHJoint, chain_from_dh\n"
        "from crtk_drivers.errors import MissingExtra\n"
        "assert 'pinocchio' not in sys.modules\n"
        "sys.modules['pinocchio'] = None\n"
        "try:\n    k.SerialChain(chain_from_dh([DHJoint('a')]))\n"
        "except MissingExtra as error:\n    print(error.remedy)\n"
    )
    assert done.returncode == 0, done.stderr
    assert "pip install 'crtk-drivers[kinematics]'" in done.stdout


def test_limits_may_be_whole_numbers():
    links = [(0.0, 0.1, HALF), (0.13, 0.0, 0.0), (0.12, 0.0, 0.0), (0.12, 0.0, 0.0)]
    arm = SerialChain(
        chain_from_dh(
            DHJoint(str(index), a, twist, d, lower=-3, upper=3)
            for index, (a, d, twist) in enumerate(links)
        ),
        position_only=True,
    )
    goal = arm.forward(vector((0.2, 0.4, -0.9, 0.5)))
    found = arm.inverse(goal, vector((0.1, 0.5, -0.8, 0.4)))
    assert arm.forward(found).position == pytest.approx(goal.position, abs=ACCURACY)
    assert arm.lower.dtype == np.float64

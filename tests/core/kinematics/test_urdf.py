"""URDF: against pinocchio's own reader, and what a hostile or wrong document meets (FAULTS I19)."""

import math
import os
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crtk_drivers.errors import ConfigError
from crtk_drivers.geometry.quaternions import matrix_from_quaternion
from crtk_drivers.kinematics.chain import Chain, JointKind
from crtk_drivers.kinematics.serial import IkFailure, InverseKinematicsError, SerialChain
from crtk_drivers.kinematics.urdf import (
    MAX_SIZE,
    ends_of_joints,
    joint_rates,
    parse_urdf,
)
from crtk_drivers.wrappers.urdf_file import read_urdf
from rigs.examples import examples

pin = pytest.importorskip("pinocchio", reason="the kinematics extra is not installed")

DATA = Path(__file__).parents[2] / "data"
SEVEN = (DATA / "seven_axis.urdf").read_text()
A1_TO_A7 = tuple(f"a{i}" for i in range(1, 8))
CHAINS = {
    "seven_axis": ("world", "flange"),
    "planar": ("base", "tip"),
    "scara": ("base", "tool"),
}


def chain(name: str) -> Chain:
    base, tip = CHAINS[name]
    return read_urdf(DATA / f"{name}.urdf", base=base, tip=tip)


def forward_of_pinocchio(urdf: str, base: str, tip: str, joints: dict[str, float]) -> np.ndarray:
    """The placement of link `tip` in link `base` by pinocchio's own URDF reader."""
    model = pin.buildModelFromXML(urdf)
    q = pin.neutral(model)
    for name, value in joints.items():
        joint = model.joints[model.getJointId(name)]
        continuous = joint.nq == 2
        q[joint.idx_q : joint.idx_q + joint.nq] = (
            (math.cos(value), math.sin(value)) if continuous else value
        )
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    at = [data.oMf[model.getFrameId(link)] for link in (base, tip)]
    return at[0].actInv(at[1]).homogeneous


def forward(arm: SerialChain, q: np.ndarray) -> np.ndarray:
    pose, matrix = arm.forward(q), np.eye(4)
    matrix[:3, :3] = matrix_from_quaternion(pose.orientation)
    matrix[:3, 3] = pose.position
    return matrix


@pytest.mark.parametrize("name", CHAINS)
def test_forward_is_that_of_pinocchios_own_reader(name):
    base, tip = CHAINS[name]
    arm = SerialChain(chain(name))
    text = (DATA / f"{name}.urdf").read_text()
    for seed in range(5):
        q = np.random.default_rng(seed).uniform(-2.0, 2.0, len(arm.joints))
        joints = dict(zip(arm.joints, q, strict=True))
        expected = forward_of_pinocchio(text, base, tip, joints)
        assert np.abs(forward(arm, q) - expected).max() < 1e-12


@pytest.mark.parametrize(
    ("base", "tip", "joints"),
    [("pedestal", "l4", 4), ("l2", "flange", 5), ("l1", "l2", 1), ("world", "finger_left", 8)],
)
def test_any_part_of_a_urdf_is_a_chain(base, tip, joints):
    arm = SerialChain(parse_urdf(SEVEN, base=base, tip=tip))
    q = np.linspace(0.1, 0.4, joints)
    expected = forward_of_pinocchio(SEVEN, base, tip, dict(zip(arm.joints, q, strict=True)))
    assert np.abs(forward(arm, q) - expected).max() < 1e-12


numbers = st.floats(-3.0, 3.0).map(lambda x: round(x, 3))
triples = st.tuples(numbers, numbers, numbers)
axes = triples.filter(lambda axis: math.hypot(*axis) > 0.1)
kinds = st.sampled_from(["revolute", "continuous", "prismatic", "fixed"])


@settings(max_examples=examples(40))
@given(st.lists(st.tuples(kinds, triples, triples, axes, numbers), min_size=1, max_size=8))
def test_any_urdf_is_read_as_pinocchio_reads_it(rows):
    links = "".join(f'<link name="l{i}"/>' for i in range(len(rows) + 1))
    joints = "".join(
        f'<joint name="j{i}" type="{kind}"><parent link="l{i}"/><child link="l{i + 1}"/>'
        f'<origin xyz="{" ".join(map(str, xyz))}" rpy="{" ".join(map(str, rpy))}"/>'
        f'<axis xyz="{" ".join(map(str, axis))}"/>'
        '<limit lower="-4" upper="4" velocity="1" effort="1"/></joint>'
        for i, (kind, xyz, rpy, axis, _) in enumerate(rows)
    )
    text = f'<robot name="r">{links}{joints}</robot>'
    moving = [i for i, row in enumerate(rows) if row[0] != "fixed"]
    tip = f"l{len(rows)}"
    if not moving:
        with pytest.raises(ConfigError, match="0 moving joints"):
            parse_urdf(text, base="l0", tip=tip)
        return
    arm = SerialChain(parse_urdf(text, base="l0", tip=tip))
    q = np.array([rows[i][4] for i in moving])
    expected = forward_of_pinocchio(text, "l0", tip, dict(zip(arm.joints, q, strict=True)))
    assert np.abs(forward(arm, q) - expected).max() < 1e-11


def test_limits_and_kinds():
    seven, scara = SerialChain(chain("seven_axis")), chain("scara")
    assert seven.joints == A1_TO_A7
    assert seven.lower.tolist() == [-math.inf, -2.0, -2.9, -2.2, -2.9, -2.0, -3.0]
    assert seven.upper.tolist() == [math.inf, 2.0, 2.9, 2.2, 2.9, 2.0, 3.0]
    assert [joint.kind for joint in scara.joints] == [
        JointKind.REVOLUTE,
        JointKind.REVOLUTE,
        JointKind.PRISMATIC,
        JointKind.REVOLUTE,
    ]


def test_joint_vectors_have_the_order_that_was_asked_for():
    order = ("a3", "a1", "a7", "a2", "a6", "a4", "a5")
    ordered = SerialChain(parse_urdf(SEVEN, base="world", tip="flange", joints=order))
    plain = SerialChain(parse_urdf(SEVEN, base="world", tip="flange"))
    place = [A1_TO_A7.index(name) for name in order]
    q = np.array((0.3, 0.5, -0.2, 0.8, 0.1, -0.7, 0.4))
    pose = plain.forward(q)
    assert ordered.joints == order
    assert (ordered.forward(q[place]).position == pose.position).all()
    assert (ordered.jacobian(q[place]) == plain.jacobian(q)[:, place]).all()
    assert (ordered.lower == plain.lower[place]).all()
    found = ordered.inverse(pose, q[place] + 0.01)
    assert np.abs(found - q[place]).max() < 0.1
    assert (found == plain.inverse(pose, q + 0.01)[place]).all()


@pytest.mark.parametrize("name", CHAINS)
def test_reachable_poses_are_reached_within_the_limits(name):
    arm = SerialChain(chain(name), time_limit=20.0)
    random = np.random.default_rng(4)
    lower, upper = np.maximum(arm.lower, -math.pi), np.minimum(arm.upper, math.pi)
    for _ in range(20):
        goal, reference = random.uniform(lower, upper), random.uniform(lower, upper)
        found = arm.inverse(arm.forward(goal), reference)
        assert np.abs(forward(arm, found) - forward(arm, goal)).max() < 1e-9
        assert (found >= arm.lower).all()
        assert (found <= arm.upper).all()


def test_a_slide_beyond_its_limit_is_named():
    arm = SerialChain(chain("scara"), time_limit=20.0)
    with pytest.raises(InverseKinematicsError) as caught:
        arm.inverse(arm.forward(np.array((0.3, 0.4, 0.3, 0.5))), np.array((0.3, 0.4, 0.1, 0.5)))
    assert caught.value.reason is IkFailure.JOINT_LIMITS
    assert "beyond the limits: quill_joint 0.3000 (-0.0500 to 0.2500)" in str(caught.value)


def test_a_planar_arm_reaches_nothing_out_of_its_plane():
    arm = SerialChain(chain("planar"), time_limit=20.0)
    pose = arm.forward(np.array((0.3, 0.4, 0.5)))
    raised = type(pose)(pose.position + np.array((0.0, 0.0, 0.01)), pose.orientation)
    with pytest.raises(InverseKinematicsError) as caught:
        arm.inverse(raised, np.zeros(3))
    assert caught.value.reason is IkFailure.OUT_OF_REACH


# Wrong and hostile documents

JOINT = '<joint name="j" type="revolute"><parent link="a"/><child link="b"/>{}</joint>'
LIMIT = '<limit lower="-1" upper="1"/>'
LINKS = '<link name="a"/><link name="b"/>'


def document(joint: str = JOINT.format(LIMIT), more: str = "") -> str:
    return f'<robot name="r">{LINKS}{joint}{more}</robot>'


LAUGHS = (
    '<!DOCTYPE robot [<!ENTITY l0 "lol">'
    + "".join(f'<!ENTITY l{i} "{f"&l{i - 1};" * 10}">' for i in range(1, 10))
    + "]>"
)
LOOP = (
    '<robot name="r"><link name="a"/><link name="b"/><link name="c"/>'
    '<joint name="1" type="fixed"><parent link="b"/><child link="c"/></joint>'
    '<joint name="2" type="fixed"><parent link="c"/><child link="b"/></joint></robot>'
)
WRONG = {
    "entity bomb": (f'{LAUGHS}<robot name="&l9;"/>', "DOCTYPE"),
    "external entity": (
        '<!DOCTYPE robot [<!ENTITY x SYSTEM "file:///etc/passwd">]><robot>&x;</robot>',
        "DOCTYPE",
    ),
    "external subset": ('<!DOCTYPE robot SYSTEM "http://127.0.0.1/x.dtd"><robot/>', "DOCTYPE"),
    "undefined entity": ("<robot>&x;</robot>", "not well-formed"),
    "empty": ("", "not well-formed"),
    "NUL": ("<robot>\0</robot>", "not well-formed"),
    "cut off": (document()[:-9], "not well-formed"),
    "two roots": (document() + document(), "not well-formed"),
    "deep": ("<robot>" + "<a>" * 100_000, "nests elements deeper than 32"),
    "large": (document(more=" " * MAX_SIZE), f"at most {MAX_SIZE}"),
    "not a URDF": ("<sdf/>", "is XML of <'sdf'>"),
    "no links": ("<robot/>", "It has no links"),
    "no child": (document('<joint name="j" type="fixed"><parent link="a"/></joint>'), "no child"),
    "no parent": (document('<joint name="j" type="fixed"><child link="b"/></joint>'), "no parent"),
    "unconnected": (document(""), "'b' does not hang from link 'a'"),
    "loop": (LOOP, "'b' does not hang from link 'a'"),
    "two parents": (document(more=JOINT.format(LIMIT)), "child of two joints"),
    "floating": (document(JOINT.replace("revolute", "floating").format("")), "type 'floating'"),
    "no type": (document(JOINT.replace(' type="revolute"', "").format(LIMIT)), "type ''"),
    "no name": (document(JOINT.replace('name="j" ', "").format(LIMIT)), "no name"),
    "mimic": (document(JOINT.format(LIMIT + '<mimic joint="k"/>')), "mimics another"),
    "no limit": (document(JOINT.format("")), "has no limit"),
    "empty range": (document(JOINT.format('<limit lower="1" upper="1"/>')), "not below upper"),
    "no bounds": (document(JOINT.format('<limit velocity="1"/>')), "not below upper"),
    "NaN limit": (document(JOINT.format('<limit lower="nan" upper="1"/>')), "lower is 'nan'"),
    "NaN origin": (document(JOINT.format(LIMIT + '<origin xyz="0 nan 0"/>')), "xyz is '0 nan 0'"),
    "infinite rpy": (document(JOINT.format(LIMIT + '<origin rpy="inf 0 0"/>')), "rpy is 'inf 0 0'"),
    "two numbers": (document(JOINT.format(LIMIT + '<origin xyz="0 0"/>')), "3 finite numbers"),
    "words": (document(JOINT.format(LIMIT + '<axis xyz="up"/>')), "axis xyz is 'up'"),
    "zero axis": (document(JOINT.format(LIMIT + '<axis xyz="0 0 0"/>')), "axis is [0.0, 0.0, 0.0]"),
    "huge axis": (document(JOINT.format(LIMIT + '<axis xyz="1e300 0 0"/>')), "3 finite numbers"),
    "long name": (document(JOINT.replace('"revolute"', f'"{"x" * 9999}"').format("")), "xxx..."),
}


@pytest.mark.parametrize(("text", "said"), WRONG.values(), ids=list(WRONG))
def test_a_wrong_document_is_refused_and_named(text, said, tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        read_urdf(path, base="a", tip="b")
    assert said in str(caught.value)
    assert str(caught.value).startswith(f"{path}: ")
    assert len(str(caught.value)) < 400 + len(str(path))
    with pytest.raises(ConfigError):
        parse_urdf(text, base="a", tip="b")


def test_an_entity_bomb_in_another_encoding_is_refused():
    text = f'<?xml version="1.0" encoding="utf-16"?>{LAUGHS}<robot name="&l9;"/>'
    with pytest.raises(ConfigError, match="DOCTYPE"):
        parse_urdf(text.encode("utf-16"), base="a", tip="b")
    with pytest.raises(ConfigError, match="not well-formed"):
        parse_urdf(b'<?xml version="1.0" encoding="klingon"?><robot/>', base="a", tip="b")


def test_more_joints_than_any_arm_has_are_refused():
    links = "".join(f'<link name="l{i}"/>' for i in range(5001))
    joints = "".join(
        f'<joint name="{i}" type="continuous"><parent link="l{i}"/><child link="l{i + 1}"/></joint>'
        for i in range(5000)
    )
    with pytest.raises(ConfigError, match="5000 moving joints"):
        parse_urdf(f"<robot>{links}{joints}</robot>", base="l0", tip="l5000")


@pytest.mark.parametrize("joints", [("k",), ("j", "j"), ("j", "k")])
def test_joint_names_that_are_not_the_chains_are_refused(joints):
    with pytest.raises(ConfigError, match=r"my\.urdf: joint names"):
        parse_urdf(document(), base="a", tip="b", joints=joints, where="my.urdf")


def test_a_link_that_is_misspelt_is_suggested():
    with pytest.raises(ConfigError, match=r"there is no link 'flnage'. Did you mean 'flange'\?"):
        parse_urdf(SEVEN, base="world", tip="flnage")


def test_files_that_are_none_are_refused(tmp_path):
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    large = tmp_path / "large.urdf"
    with large.open("wb") as file:
        file.truncate(MAX_SIZE * 1000)  # sparse
    for path, said in [
        (tmp_path / "missing.urdf", "No such file"),
        (tmp_path, "is a directory"),
        (fifo, "is not a regular file"),
        (Path("/dev/zero"), "is not a regular file"),
        (large, "a URDF file has at most"),
        (Path("a\0b"), "cannot be read"),
    ]:
        with pytest.raises(ConfigError, match=said) as caught:
            read_urdf(path, base="a", tip="b")
        assert str(caught.value).startswith(f"{path}: ")


@settings(max_examples=examples(200))
@given(st.data())
def test_a_damaged_document_is_read_or_refused(data):
    original = SEVEN.encode()
    start = data.draw(st.integers(0, len(original)))
    end = data.draw(st.integers(start, min(len(original), start + 60)))
    damaged = original[:start] + data.draw(st.binary(max_size=20)) + original[end:]
    with suppress(ConfigError):
        assert parse_urdf(damaged, base="world", tip="flange").joints


def test_rates_of_joints_are_those_of_their_limits() -> None:
    model = pin.buildModelFromXML(SEVEN)
    found = joint_rates(SEVEN, [*A1_TO_A7, "nobody"])
    assert set(found) <= set(A1_TO_A7)
    for name, rate in found.items():
        place = model.idx_vs[model.getJointId(name)]
        assert rate.velocity == model.upperVelocityLimit[place]
        assert rate.effort == model.upperEffortLimit[place]


def test_a_rate_that_is_no_number_is_refused() -> None:
    wrong = SEVEN.replace('velocity="', 'velocity="x', 1)
    with pytest.raises(ConfigError, match="velocity"):
        joint_rates(wrong, A1_TO_A7)


def test_the_ends_of_joints_are_links_between_which_they_are_a_chain() -> None:
    base, tip = ends_of_joints(SEVEN, A1_TO_A7)
    assert parse_urdf(SEVEN, base=base, tip=tip).names == A1_TO_A7

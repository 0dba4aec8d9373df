"""The arms of this package: their configurations hold, and their URDFs say the same."""

from __future__ import annotations

import math
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from crtk_driver_dynamixel import arms
from crtk_driver_dynamixel.config import DynamixelConfig
from crtk_driver_dynamixel.joints import Chain
from crtk_drivers.config import from_values, load
from crtk_drivers.errors import ConfigError
from crtk_drivers.kinematics.serial import SerialChain
from crtk_drivers.samples import Pose, vector
from crtk_drivers.wrappers.urdf_file import read_urdf
from crtk_sim_backends.dynamixel.config import SimConfig

NAMES = arms.names()


def config(arm: str) -> DynamixelConfig:
    return load(DynamixelConfig, from_values({"arm": arm, "port": "/dev/ttyUSB0"}))


MODELLED = [name for name in NAMES if config(name).kinematics is not None]


def urdf_of(arm: str) -> str:
    kinematics = config(arm).kinematics
    assert kinematics is not None
    assert kinematics.urdf is not None
    return kinematics.urdf


def model(arm: str) -> SerialChain:
    kinematics = config(arm).kinematics
    assert kinematics is not None
    chain = read_urdf(
        urdf_of(arm),
        base=kinematics.base_link,
        tip=kinematics.tip_link,
        joints=tuple(config(arm).joints),
    )
    return SerialChain(chain, position_only=kinematics.position_only)


def test_which_there_are() -> None:
    assert NAMES == ("arm6", "koch_follower", "koch_leader", "open_manipulator_x", "vx300s")
    assert list(NAMES) == MODELLED
    described = DynamixelConfig.model_fields["arm"].description or ""
    assert all(name in described for name in NAMES)


@pytest.mark.parametrize("arm", NAMES)
def test_the_configuration_makes_a_chain(arm: str) -> None:
    chain = Chain.of(config(arm))
    assert chain.gripper is not None
    middle = np.array([0.5 * (limit.lower + limit.upper) for limit in chain.limits])
    servos = chain.to_servos(
        np.append(middle, chain.gripper.finger.finger.angle(chain.gripper.open))
    )
    counts = chain.scaling.position.to_counts(servos)
    np.testing.assert_allclose(chain.scaling.position.to_si(counts), servos, atol=1e-3)


@pytest.mark.parametrize("arm", MODELLED)
def test_limits_of_configuration_and_urdf_agree(arm: str) -> None:
    joints = config(arm).joints
    chain = Chain.of(config(arm))
    elements = {
        joint.get("name"): joint.find("limit")
        for joint in ElementTree.parse(urdf_of(arm)).getroot().iterfind("joint")
    }
    for name, limits in zip(joints, chain.limits, strict=True):
        element = elements[name]
        assert element is not None
        for key in ("lower", "upper", "velocity", "effort"):
            assert float(element.attrib[key]) == getattr(limits, key), (name, key)


@pytest.mark.parametrize("arm", MODELLED)
def test_pinocchio_loads_the_urdf_itself(arm: str) -> None:
    pinocchio = pytest.importorskip("pinocchio")
    loaded = pinocchio.buildModelFromUrdf(urdf_of(arm))
    assert list(loaded.names)[1:] == list(config(arm).joints)
    assert loaded.existFrame("tool")


def test_leader_and_follower_are_at_the_same_place_with_the_same_joints() -> None:
    leader, follower = model("koch_leader"), model("koch_follower")
    for joints in ([0.0] * 5, [0.3, 0.5, -0.7, 0.2, 1.0]):
        here, there = (arm.forward(vector(joints)) for arm in (leader, follower))
        np.testing.assert_allclose(here.position, there.position, atol=1e-12)
        np.testing.assert_allclose(here.orientation, there.orientation, atol=1e-12)


@pytest.mark.parametrize("arm", MODELLED)
def test_urdf_has_primitives_and_inertias_that_can_be(arm: str) -> None:
    root = ElementTree.parse(urdf_of(arm)).getroot()
    assert not list(root.iter("mesh"))
    links = [link for link in root.iterfind("link") if link.find("inertial") is not None]
    assert len(links) == len(config(arm).joints) + 1
    for inertia in root.iter("inertia"):
        x, y, z = (float(inertia.attrib[key]) for key in ("ixx", "iyy", "izz"))
        assert min(x, y, z) > 0.0
        assert x + y > z
        assert y + z > x
        assert z + x > y


# Tool positions at given joints; the zeros are sums of the published lengths, the rest by hand from them.
POSES: list[tuple[str, list[float], list[float]]] = [
    ("arm6", [0, 0, 0, 0, 0, 0], [0.5, 0.0, 0.42]),
    ("arm6", [math.pi / 2, 0, 0, 0, 0, 0], [0.0, 0.5, 0.42]),
    (
        "arm6",
        [0, 0.5, -0.5, 0, 0, 0],
        [0.5 + 0.25 * math.sin(0.5), 0.0, 0.17 + 0.25 * math.cos(0.5)],
    ),
    ("arm6", [0, 0, -math.pi / 2, 0, 0, 0], [0.0, 0.0, 0.92]),
    ("arm6", [0, 0, 0, 0, math.pi / 2, 0], [0.3, 0.0, 0.22]),
    ("arm6", [0, 0, 0, math.pi / 2, math.pi / 2, 0], [0.3, 0.2, 0.42]),
    ("vx300s", [0, 0, 0, 0, 0, 0], [0.536494, 0.0, 0.42705]),
    ("vx300s", [0, 0, -math.pi / 2, 0, 0, 0], [0.05955, 0.0, 0.42705 + 0.476944]),
    ("open_manipulator_x", [0, 0, 0, 0], [0.286, 0.0, 0.2045]),
    ("open_manipulator_x", [0, 0, 0, math.pi / 2], [0.16, 0.0, 0.0785]),
    ("open_manipulator_x", [math.pi / 2, 0, 0, 0], [0.012, 0.274, 0.2045]),
    ("koch_follower", [0, 0, 0, 0, 0], [0.22728, 0.0, 0.1673]),
    ("koch_follower", [0, 0, 0, math.pi / 2, 0], [0.11528, 0.0, 0.0553]),
]


@pytest.mark.parametrize(("arm", "joints", "position"), POSES)
def test_known_poses(arm: str, joints: list[float], position: list[float]) -> None:
    np.testing.assert_allclose(model(arm).forward(vector(joints)).position, position, atol=1e-9)


@pytest.mark.parametrize("arm", MODELLED)
def test_poses_within_the_limits_are_found_again(arm: str) -> None:
    chain = model(arm)
    random = np.random.default_rng(7)
    for _ in range(5):
        joints = chain.lower + random.uniform(0.2, 0.8, chain.lower.size) * (
            chain.upper - chain.lower
        )
        pose = chain.forward(vector(joints))
        found = chain.forward(chain.inverse(pose, vector(joints + 0.05)))
        np.testing.assert_allclose(found.position, pose.position, atol=1e-8)


def test_the_tool_points_ahead_at_zero() -> None:
    for arm in MODELLED:
        pose: Pose = model(arm).forward(vector(np.zeros(len(config(arm).joints))))
        np.testing.assert_allclose(pose.orientation, [0.0, 0.0, 0.0, 1.0], atol=1e-12)


def test_vx300s_shadows_follow_as_delivered() -> None:
    chain = Chain.of(config("vx300s"))
    assert [s.id for s in chain.servos] == [1, 2, 3, 4, 5, 6, 7, 8, 9]
    assert [s.id for s in chain.servos if s.follow == "secondary_id"] == [3, 5]
    assert [s.id for s in chain.servos if s.reverse] == [2, 4, 7]
    counts = chain.scaling.position.to_counts(chain.to_servos(np.full(7, 0.3)))
    assert counts[1] == counts[2]


@pytest.mark.parametrize("arm", NAMES)
def test_the_simulator_has_the_same_servos(arm: str) -> None:
    (simulated,) = SimConfig(servos=arm).buses
    chain = Chain.of(config(arm))
    assert {s.id: s.units.model.name for s in chain.servos} == {
        servo.number: servo.model.name for servo in simulated
    }
    partners = {servo.number: servo.partner for servo in simulated if servo.partner is not None}
    first = {s.joint: s.id for s in chain.servos if s.is_first}
    assert {s.id: first[s.joint] for s in chain.servos if not s.is_first} == partners


def test_files_of_ones_own(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('joints.a = {id = 1, model = "xm430-w350"}\n')
    assert arms.arm_file(str(path)) == path
    assert list(config(str(path)).joints) == ["a"]
    with pytest.raises(ConfigError, match="there is no arm 'mine'"):
        arms.arm_file("mine")


def test_a_users_values_come_first() -> None:
    values = {
        "arm": "arm6",
        "joints": {"waist": {"lower": -1.0}, "rail": {"id": 20, "model": "xm430-w350"}},
        "gripper": None,
        "kinematics": None,
    }
    mine = load(DynamixelConfig, from_values(values))
    assert mine.joints["waist"].range == (-1.0, 3.14)
    assert list(mine.joints)[-1] == "rail"
    assert mine.gripper is None
    assert mine.kinematics is None

"""The URDF that is made of a device: our reader gets the same kinematics from it as the device has."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_drivers import plugins
from crtk_drivers.config import from_values, load
from crtk_drivers.device import Capabilities, Device, JointLimits, Kinematics
from crtk_drivers.geometry.quaternions import matrix_from_quaternion, quaternion_from_rpy
from crtk_drivers.kinematics.chain import Chain, ChainJoint, JointKind, placed
from crtk_drivers.kinematics.found_chain import found_chain, tool_of
from crtk_drivers.kinematics.joint_axes import matrix_of
from crtk_drivers.kinematics.serial import SerialChain
from crtk_drivers.kinematics.urdf import parse_urdf
from crtk_drivers.kinematics.urdf_text import urdf_of
from crtk_drivers.samples import Array, Pose, Vector, vector
from crtk_drivers.wrappers.forwarding import WrappedDevice

CLOSE = 1e-6
LIMITS = JointLimits(-2.0, 2.0, 1.0, 1.0, 1.0, 5.0)
PLACE = {"frame_id": "world", "position": [1.0, -2.0, 0.5], "rpy": [3.0, 0.2, 0.4]}
TOOL = {"position": [0.0, 0.02, 0.1], "rpy": [0.3, 0.2, 0.1]}
ARMS = {
    "ur3e": ("ur", {"host": "h", "model": "ur3e"}),
    "ur5e placed": ("ur", {"host": "h", "model": "ur5e", "base": PLACE}),
    "ur10": ("ur", {"host": "h", "model": "ur10"}),
    "gantry": ("loopback", {}),
    "six_axis": ("virtual", {"model": "six_axis"}),
    "seven_axis": ("virtual", {"model": "seven_axis"}),
    "haptic": ("virtual", {"model": "haptic", "tool": TOOL}),
}


def made(name: str, **values: Any) -> Device:
    plugin = plugins.device(name)
    config: Any = load(plugin.config, from_values(values))
    return plugin.make(config)


def read_back(device: Device, chain: Chain) -> tuple[str, Chain]:
    text = urdf_of(
        chain, device.capabilities.limits, name="arm", base="base", tip="tip", frame="a/{}".format
    )
    return text, parse_urdf(text, base="a/base", tip="a/tip", joints=device.capabilities.joints)


def random_positions(device: Device) -> list[Any]:
    random = np.random.default_rng(7)
    return [vector(random.uniform(-2.0, 2.0, len(device.capabilities.joints))) for _ in range(20)]


@pytest.mark.parametrize("name", ARMS)
def test_what_is_read_back_leads_where_the_device_does(name: str) -> None:
    plugin, values = ARMS[name]
    device = made(plugin, **values)
    kinematics = device.kinematics
    chain = found_chain(device)
    assert chain is not None
    assert kinematics is not None
    text, again = read_back(device, chain)
    for q in random_positions(device):
        assert tool_of(again, q) == pytest.approx(matrix_of(kinematics.forward(q)), abs=CLOSE)
    ours = SerialChain(again)
    q = random_positions(device)[0]
    assert matrix_of(ours.forward(q)) == pytest.approx(tool_of(again, q), abs=CLOSE)
    for joint, limit in zip(again.joints, device.capabilities.limits, strict=True):
        assert (joint.lower, joint.upper) == (limit.lower, limit.upper)
    assert text.count("<visual>") == text.count("<cylinder")
    assert text.count("<visual>") >= (3 if plugin != "loopback" else 0)
    for element in ElementTree.fromstring(text).iterfind("joint[@type='revolute']/limit"):
        assert float(element.get("velocity", "")) > 0.0
        assert float(element.get("effort", "")) >= 0.0


class Other(WrappedDevice):
    """A device with other kinematics, whose tool is `bend` off as no chain's is."""

    def __init__(self, inner: Device, chain: Chain, bend: float = 0.0) -> None:
        super().__init__(inner)
        limits = tuple(LIMITS for _ in chain.names)
        self._own = replace(inner.capabilities, joints=chain.names, limits=limits)
        self._kinematics = Bent(SerialChain(chain), bend)

    @property
    def capabilities(self) -> Capabilities:
        return self._own

    @property
    def kinematics(self) -> Kinematics:
        return self._kinematics


class Bent(Kinematics):
    def __init__(self, chain: SerialChain, bend: float) -> None:
        self._chain = chain
        self._bend = bend

    def forward(self, joints: Vector) -> Pose:
        pose = self._chain.forward(joints)
        return replace(pose, position=pose.position + self._bend * math.sin(joints[1]))

    def inverse(self, pose: Pose, reference: Vector) -> Vector:
        raise AssertionError("nobody asks")

    def jacobian(self, joints: Vector) -> Array:
        return self._chain.jacobian(joints)


def sliding() -> Chain:
    """Turn about z, slide along x, turn about y and z; joint vectors are in another order."""
    step = placed(np.eye(3), (0.1, 0.2, 0.3))
    turns, slides = JointKind.REVOLUTE, JointKind.PRISMATIC
    axes = {"a": (turns, 2), "b": (slides, 0), "c": (turns, 1), "d": (turns, 2)}
    joints = tuple(
        ChainJoint(name, kind, step, np.eye(3)[axis], -2.0, 2.0)
        for name, (kind, axis) in axes.items()
    )
    return Chain(joints, placed(np.eye(3), (0.0, 0.4, 0.5)), ("d", "b", "a", "c"))


def test_joints_that_slide_and_joint_vectors_of_another_order() -> None:
    device = Other(made("loopback"), sliding())
    chain = found_chain(device)
    assert chain is not None
    assert [joint.name for joint in chain.joints] == ["a", "b", "c", "d"]
    _, again = read_back(device, chain)
    assert again.names == ("d", "b", "a", "c")
    for q in random_positions(device):
        assert tool_of(again, q) == pytest.approx(tool_of(sliding(), q), abs=CLOSE)


def test_what_is_no_chain_has_none() -> None:
    assert found_chain(Other(made("loopback"), sliding(), bend=1e-3)) is None
    assert found_chain(made("ati-netft", host="h")) is None


ANGLES = st.floats(-math.pi, math.pi) | st.sampled_from([0.0, math.pi / 2, -math.pi / 2, math.pi])


@given(ANGLES, ANGLES, ANGLES)
def test_any_orientation_comes_back(roll: float, pitch: float, yaw: float) -> None:
    turned = matrix_from_quaternion(quaternion_from_rpy(roll, pitch, yaw))
    joint = ChainJoint("j", JointKind.REVOLUTE, placed(turned, (1.0, 2.0, 3.0)), np.eye(3)[0])
    chain = Chain((joint,), placed(turned.T, (0.0, 0.0, 1.0)))
    text = urdf_of(chain, (LIMITS,), name="a", base="b", tip="t")
    again = parse_urdf(text, base="b", tip="t")
    for before, after in ((joint.placement, again.joints[0].placement), (chain.tip, again.tip)):
        assert after == pytest.approx(before, abs=CLOSE)
    assert "continuous" in text


def test_names_are_escaped_and_numbers_are_finite() -> None:
    limits = JointLimits(-math.inf, math.inf, math.inf, 1.0, 1.0, math.inf)
    joint = ChainJoint('a "<&>', JointKind.PRISMATIC, np.eye(4), np.eye(3)[0])
    text = urdf_of(Chain((joint,), np.eye(4)), (limits,), name="x&y", base="b<", tip="t")
    assert parse_urdf(text, base="b<", tip="t").names == ('a "<&>',)
    assert "inf" not in text.lower()

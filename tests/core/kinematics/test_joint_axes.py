"""The chain that is drawn of a device: found from its own kinematics, and exactly as they are."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from crtk_drivers import plugins
from crtk_drivers.config import from_values, load
from crtk_drivers.device import Device, Kinematics
from crtk_drivers.geometry.quaternions import matrix_from_quaternion
from crtk_drivers.kinematics.chain import JointKind
from crtk_drivers.kinematics.joint_axes import chain_of, joint_kinds, joint_units
from crtk_drivers.samples import Array, Pose, Vector, vector
from crtk_drivers.wrappers.forwarding import WrappedDevice

PLACE = {"frame_id": "world", "position": [1.0, -2.0, 0.5], "rpy": [3.0, 0.2, 0.4]}


def made(name: str, **values: Any) -> Device:
    plugin = plugins.device(name)
    config: Any = load(plugin.config, from_values(values))
    return plugin.make(config)


def matrix(pose: Pose) -> Array:
    transform = np.eye(4)
    transform[:3, :3] = matrix_from_quaternion(pose.orientation)
    transform[:3, 3] = pose.position
    return transform


ARMS = {
    "ur3e": ("ur", {"host": "h", "model": "ur3e"}),
    "ur10": ("ur", {"host": "h", "model": "ur10"}),
    "six_axis": ("virtual", {"model": "six_axis"}),
    "seven_axis": ("virtual", {"model": "seven_axis"}),
    "haptic": ("virtual", {"model": "haptic", "tool": {"position": [0.0, 0.02, 0.1]}}),
}


@pytest.mark.parametrize("name", ARMS)
def test_the_chain_leads_where_the_devices_own_kinematics_do(name: str) -> None:
    plugin, values = ARMS[name]
    device = made(plugin, **values)
    chain = chain_of(device)
    assert chain is not None
    random = np.random.default_rng(4)
    for _ in range(10):
        q = vector(random.uniform(-2.0, 2.0, len(device.capabilities.joints)))
        assert chain.tool(q) == pytest.approx(matrix(device.kinematics.forward(q)), abs=1e-9)


def test_the_axes_stand_where_links_meet() -> None:
    chain = chain_of(made("virtual", model="seven_axis"))
    assert chain is not None
    heights = np.cumsum([np.linalg.norm(each[:3, 3]) for each in chain.joints])
    assert heights == pytest.approx([0.0, 0.34, 0.34, 0.74, 0.74, 1.1, 1.1])


def test_a_device_that_stands_elsewhere_is_drawn_in_its_own_base() -> None:
    own = chain_of(made("virtual"))
    elsewhere = chain_of(made("virtual", base=PLACE))
    assert own is not None
    assert elsewhere is not None
    for before, after in zip(
        (*own.joints, own.tip), (*elsewhere.joints, elsewhere.tip), strict=True
    ):
        assert after == pytest.approx(before, abs=1e-9)


def test_joints_that_slide_have_a_kind_and_make_no_chain() -> None:
    device = made("loopback")
    slides, turns = JointKind.PRISMATIC, JointKind.REVOLUTE
    assert joint_kinds(device) == (slides, slides, slides, turns)
    assert chain_of(device) is None


def test_without_kinematics_nothing_is_known() -> None:
    class Bare(WrappedDevice):
        @property
        def capabilities(self) -> Any:
            return replace(
                self.inner.capabilities,
                cartesian_limits=None,
                modes=frozenset(),
            )

        @property
        def kinematics(self) -> None:
            return None

    device = Bare(made("loopback"))
    assert joint_kinds(device) == (None,) * 4
    assert chain_of(device) is None


def test_a_chain_that_would_lead_elsewhere_is_not_shown() -> None:
    class Coupled(Kinematics):
        """The elbow turns with the shoulder."""

        def __init__(self, inner: Kinematics) -> None:
            self.inner = inner

        def forward(self, joints: Vector) -> Pose:
            return self.inner.forward(self._coupled(joints))

        def inverse(self, pose: Pose, reference: Vector) -> Vector:
            raise AssertionError("nobody asks")

        def jacobian(self, joints: Vector) -> Array:
            return self.inner.jacobian(self._coupled(joints))

        @staticmethod
        def _coupled(joints: Vector) -> Vector:
            bent = np.array(joints)
            bent[2] -= bent[1]
            return vector(bent)

    class Arm(WrappedDevice):
        @property
        def kinematics(self) -> Kinematics:
            return Coupled(self.inner.kinematics)

    assert chain_of(Arm(made("virtual"))) is None


def _raises(q: Vector) -> Array:
    raise ZeroDivisionError("at the singularity")


@pytest.mark.parametrize(
    "jacobian",
    [_raises, lambda q: np.eye(6)[:, :3], lambda q: np.eye(6), lambda q: None, lambda q: 1.0],
    ids=["raises", "too few", "too many", "nothing", "number"],
)
def test_kinematics_that_fail_leave_the_units_unknown(
    jacobian: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    device = made("loopback")
    monkeypatch.setattr(type(device.kinematics), "jacobian", lambda self, q: jacobian(q))
    assert joint_kinds(device) == (None,) * 4
    assert joint_units(device) == ("",) * 4
    assert chain_of(device) is None

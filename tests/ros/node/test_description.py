"""``robot_description``: the device as URDF, latched, of the kinematics in force."""

from __future__ import annotations

from typing import Any

import numpy as np
from std_msgs.msg import String

from crtk_drivers import plugins
from crtk_drivers.config import from_values, load
from crtk_drivers.device import Device, Kinematics
from crtk_drivers.kinematics.found_chain import tool_of
from crtk_drivers.kinematics.joint_axes import matrix_of
from crtk_drivers.kinematics.urdf import parse_urdf
from crtk_drivers.plugins import DevicePlugin
from crtk_drivers.ros import qos
from crtk_drivers.ros.policy import interface
from crtk_drivers.samples import Array, Pose, Vector, vector
from crtk_drivers.testing.loopback import LoopbackConfig, LoopbackDevice
from rigs.loopback_node import rig_of
from rigs.ros_client import RosClient
from rigs.ur_node import ur_on_ros
from rigs.waiting import eventually


def heard(client: RosClient, topic: str) -> list[str]:
    """Subscribe as one who comes late, and return what arrives."""
    texts: list[str] = []
    client.node.create_subscription(String, topic, lambda m: texts.append(m.data), qos.LATCHED)
    return texts


def agree(text: str, device: Device, base: str, tip: str) -> bool:
    chain = parse_urdf(text, base=base, tip=tip, joints=device.capabilities.joints)
    random = np.random.default_rng(3)
    kinematics = device.kinematics
    assert kinematics is not None
    probes = [vector(random.uniform(-2.0, 2.0, len(chain.names))) for _ in range(10)]
    differences = [tool_of(chain, q) - matrix_of(kinematics.forward(q)) for q in probes]
    return bool(np.abs(differences).max() < 1e-6)


def test_a_ur_is_told_as_it_computes() -> None:
    with ur_on_ros("/described_ur") as rig:
        texts = heard(rig.client, "/described_ur/robot_description")
        device = rig.session.engine.device
        base, tip = "described_ur/base", f"described_ur/{device.capabilities.tool_frame}_by_joints"
        eventually(lambda: bool(texts) and agree(texts[-1], device, base, tip), "it agrees")
        assert '<robot name="described_ur">' in texts[-1]
        assert '<link name="described_ur/shoulder_pan_joint_link"' in texts[-1]


class Raised(Kinematics):
    """The gantry on a table."""

    def __init__(self, inner: Kinematics, height: float) -> None:
        self.inner = inner
        self.height = height

    def forward(self, joints: Vector) -> Pose:
        pose = self.inner.forward(joints)
        return Pose(
            pose.position + np.array((0.0, 0.0, self.height)), pose.orientation, pose.frame_id
        )

    def inverse(self, pose: Pose, reference: Vector) -> Vector:
        raise AssertionError("nobody asks")

    def jacobian(self, joints: Vector) -> Array:
        return self.inner.jacobian(joints)


class OnTable(LoopbackDevice):
    table: Kinematics | None = None

    @property
    def kinematics(self) -> Any:
        return self.table or super().kinematics


def test_it_is_told_again_when_the_kinematics_are_others() -> None:
    plugin = DevicePlugin("on-table", "A gantry on a table.", LoopbackConfig, OnTable)
    with rig_of("/on_table", plugin=plugin) as rig:
        texts = heard(rig.client, "/on_table/robot_description")
        eventually(lambda: bool(texts), "it is told")
        device = rig.device
        assert isinstance(device, OnTable)
        base, tip = "on_table/base", "on_table/tool_by_joints"
        assert agree(texts[-1], device, base, tip)
        device.table = Raised(device.kinematics, 0.7)
        eventually(lambda: len(texts) == 2, "it is told again")
        assert agree(texts[-1], device, base, tip)
        assert 'xyz="0.0 0.0 0.7"' in texts[-1]


def test_a_device_without_kinematics_has_no_such_topic() -> None:
    plugin = plugins.device("ati-netft")
    config: Any = load(plugin.config, from_values({"host": "192.0.2.1"}))
    published = interface(plugin.make(config), "/ft").publishes
    assert "/ft/refusals" in published
    assert "/ft/robot_description" not in published

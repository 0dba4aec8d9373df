"""``robot_description``: the device as URDF, latched, for programs that show it or plan for it.

It is made of the kinematics in force, and told again when these change: a robot's own calibration is known
once it is connected, and a tool may be mounted later.
"""

from __future__ import annotations

import logging

from rclpy.node import Node
from std_msgs.msg import String

from crtk_drivers.device import Kinematics
from crtk_drivers.engine import Engine
from crtk_drivers.kinematics.found_chain import found_chain
from crtk_drivers.kinematics.urdf_text import urdf_of
from crtk_drivers.ros import qos
from crtk_drivers.ros.joint_names import JointNames
from crtk_drivers.ros.names import DESCRIPTION, Frames
from crtk_drivers.ros.publishing import Job, PublishingThread

LOOK_RATE = 1.0
"""Looks a second whether the kinematics are others."""

TIP = "_by_joints"
"""After the name of the tool frame: /tf has that frame itself already, by `measured_cp`."""

logger = logging.getLogger(__name__)


class DescriptionTopic:
    """Exists for a device with kinematics; silent as long as these are no chain's."""

    def __init__(
        self,
        node: Node,
        thread: PublishingThread,
        engine: Engine,
        frames: Frames,
        joints: JointNames,
    ) -> None:
        self._engine = engine
        self._joints = joints
        self._frames = frames
        self._name = node.get_namespace().strip("/").replace("/", "_") or engine.name
        self._publisher = None
        self._seen: Kinematics | None = None
        self._told = ""
        if engine.device.kinematics is not None:
            self._publisher = qos.publisher(node, String, DESCRIPTION, qos.LATCHED)
        self.job: Job = thread.job("description", self._publish)
        if self._publisher is not None:
            self.job.set_rate(LOOK_RATE)

    def _publish(self) -> None:
        device = self._engine.device
        kinematics = device.kinematics
        if self._publisher is None or kinematics is self._seen:
            return
        self._seen = kinematics
        chain, capabilities = found_chain(device), device.capabilities
        if chain is None:
            logger.debug(
                "%s: its kinematics are no chain's: no %s", self._engine.where, DESCRIPTION
            )
            return
        text = urdf_of(
            chain,
            capabilities.limits,
            name=self._name,
            base=capabilities.base_frame,
            tip=f"{capabilities.tool_frame}{TIP}",
            frame=self._frames.outgoing,
            joint=lambda name: self._joints.outgoing([name])[0],
        )
        if text != self._told:
            self._told = self._engine.standing[DESCRIPTION] = text
            self._publisher.publish(String(data=text))

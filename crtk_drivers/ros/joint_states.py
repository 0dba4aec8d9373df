"""``joint_states``: `measured_js` once more, for programs that know all joints by their names."""

from __future__ import annotations

from dataclasses import replace

from sensor_msgs.msg import JointState as JointStateMessage

from crtk_drivers.engine import Engine
from crtk_drivers.recording import cdr
from crtk_drivers.ros import qos
from crtk_drivers.ros.joint_names import JointNames
from crtk_drivers.ros.names import JOINT_STATES
from crtk_drivers.ros.publishing import Job, PublishingThread
from crtk_drivers.ros.unlocked import UnlockedNode
from crtk_drivers.samples import JointState


class JointStatesTopic:
    """Told while somebody listens, as long as joints are measured: what is not valid is left out."""

    def __init__(
        self, node: UnlockedNode, thread: PublishingThread, engine: Engine, names: JointNames
    ) -> None:
        self._engine = engine
        self._names = names.outgoing(engine.capabilities.joints)
        self._sent_ns = 0
        self.publisher = qos.publisher(node, JointStateMessage, JOINT_STATES, qos.DATA)
        self.job: Job = thread.job(JOINT_STATES, self._publish)

    def _publish(self) -> None:
        if self.publisher.get_subscription_count() == 0:
            return
        found = self._engine.feedback("measured_js")
        if found is None or found[1].wall_ns in (0, self._sent_ns):
            return
        state, stamp = found
        assert isinstance(state, JointState)
        self._sent_ns = stamp.wall_ns
        self.publisher.publish(cdr.encode(replace(state, name=self._names), stamp.wall_ns))

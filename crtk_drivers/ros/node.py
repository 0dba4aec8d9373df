"""The ROS 2 node of one device: wires the parts of this package together."""

from __future__ import annotations

import json
import logging
import time
from functools import partial

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context
from std_msgs.msg import String
from typing_extensions import override

from crtk_drivers.commands import ROS_TYPES
from crtk_drivers.config import NodeConfig
from crtk_drivers.engine import Engine, Observer
from crtk_drivers.errors import CommandRefused
from crtk_drivers.ros import qos
from crtk_drivers.ros.command_threads import CommandThreads
from crtk_drivers.ros.controller_topics import ControllerTopics
from crtk_drivers.ros.diagnostics import Diagnostics
from crtk_drivers.ros.joint_names import JointNames
from crtk_drivers.ros.joint_states import JointStatesTopic
from crtk_drivers.ros.manifest import MANIFEST, manifest
from crtk_drivers.ros.mismatches import TypeConflicts
from crtk_drivers.ros.moveit import Actions
from crtk_drivers.ros.names import AMONG_DRIVERS, NODE_NAME, Frames
from crtk_drivers.ros.operating_state import StatusTopic
from crtk_drivers.ros.parameters import declare_fixed, declare_frame_prefix, declare_rates
from crtk_drivers.ros.presence import Presence
from crtk_drivers.ros.publishing import PublishingThread
from crtk_drivers.ros.readings import ReadingTopics
from crtk_drivers.ros.refusals import RefusalTopic
from crtk_drivers.ros.robot_description import DescriptionTopic
from crtk_drivers.ros.rosout import RosoutHandler
from crtk_drivers.ros.senders import LOOK_RATE
from crtk_drivers.ros.servers import DeviceServices, Services
from crtk_drivers.ros.subscriptions import CommandTopics
from crtk_drivers.ros.topics import FeedbackTopics, LatchedTopics, Transforms
from crtk_drivers.ros.unlocked import UnlockedNode
from crtk_drivers.samples import Stamp
from crtk_drivers.state import Status

logger = logging.getLogger(__name__)

PUBLISHER_TIMEOUT = 0.4
GRAPH_RATE = 1.0
STANDING_BY = frozenset({AMONG_DRIVERS, "diagnostics", "rosout", "refusals", "senders", "graph"})
"""Jobs of the publishing thread that go on while another driver serves the namespace."""


class _Listener(Observer):
    """Hands what the engine tells over to the publishing thread."""

    def __init__(
        self, engine: Engine, status: StatusTopic, refusals: RefusalTopic, latched: LatchedTopics
    ) -> None:
        self._where = engine.where
        self._afterwards = engine.after_telling
        self._status = status
        self._refusals = refusals
        self._latched = latched

    @override
    def status_changed(self, status: Status, stamp: Stamp) -> None:
        self._status.announce(status, stamp)

    @override
    def command_refused(self, refusal: CommandRefused) -> None:
        self._refusals.add(refusal)

    @override
    def latched(self, name: str) -> None:
        self._latched.job.ask()

    @override
    def warned(self, text: str) -> None:
        self._afterwards(partial(logger.warning, "%s: %s", self._where, text))


class DriverNode:
    """Serves one engine on ROS 2. Publishes nothing before `start`.

    The rclpy node is its attribute `node`, not its base: the names of the two would collide.

    Args:
        engine: of the device.
        namespace: of the node, for example ``/ur5``; ``-r __ns:=`` overrides it.
        context: initialised.
        config: initial values of the parameters.
        tells_log: pass what the process logs on to ``/rosout``.
    """

    def __init__(
        self,
        engine: Engine,
        namespace: str,
        context: Context,
        config: NodeConfig | None = None,
        tells_log: bool = True,
    ) -> None:
        self.node = node = UnlockedNode(
            NODE_NAME, namespace=namespace, context=context, enable_rosout=False
        )
        self._engine = engine
        self._thread = PublishingThread(f"publishing {engine.name}")
        config = config or NodeConfig()
        prefix = declare_frame_prefix(node, config)
        self._frames = frames = Frames(prefix, engine.capabilities.base_frame)
        self._rosout = RosoutHandler(node, self._thread) if tells_log else logging.NullHandler()
        self._refusals = RefusalTopic(node, self._thread)
        self._status = StatusTopic(
            node,
            self._thread,
            engine.status,
            is_told=engine.has_state,
            before=self._refusals.publish,
        )
        self._feedback = FeedbackTopics(node, self._thread, engine)
        self._latched = LatchedTopics(node, self._thread, engine)
        self._readings = ReadingTopics(node, self._thread, engine, frames)
        self._transforms = Transforms(node, self._thread, engine, frames)
        joints = JointNames(declare_fixed(node, config, "joint_prefix"))
        self._description = DescriptionTopic(node, self._thread, engine, frames, joints)
        shares = declare_fixed(node, config, "share_namespace")
        self._presence = Presence(node, self._thread, engine, shares, self._serve_or_stand_by)
        admit = self._presence.admit
        self._command_threads = CommandThreads(engine.name)
        self._commands = CommandTopics(node, engine, frames, admit, self._command_threads)
        self._thread.job("senders", self._commands.senders.look, LOOK_RATE)
        self._services = Services(node, engine, self._status.next_stamp)
        self._device_services = DeviceServices(context, node.get_namespace(), engine, admit)
        tells_joints = declare_fixed(node, config, "joint_states")
        serves_moveit = declare_fixed(node, config, "moveit")
        self._joint_states: JointStatesTopic | None = None
        if (tells_joints or serves_moveit) and "measured_js" in engine.commands:
            self._joint_states = JointStatesTopic(node, self._thread, engine, joints)
        self._actions: Actions | None = None
        if serves_moveit:
            ControllerTopics(engine, self._commands, joints, admit)
            where = context, node.get_namespace()
            self._actions = Actions(*where, self._thread, engine, joints, admit)
        self._ros_names = self._names_on_ros()
        self._set_up_diagnostics()
        self._set_up_manifest()
        self._listener = _Listener(engine, self._status, self._refusals, self._latched)
        set_rate = {
            "publish_rate": self._set_publish_rate,
            "tf_rate": self._transforms.job.set_rate,
            "heartbeat_rate": self._status.job.set_rate,
            "diagnostics_rate": self._diagnostics_job.set_rate,
        }

        def apply(name: str, rate: float) -> None:
            self._rates[name] = rate
            set_rate[name](rate)
            self._manifest_job.ask()

        declare_rates(node, config, apply)

    def start(self) -> None:
        """Begin to publish."""
        self._engine.add_observer(self._listener)
        self._status.announce(self._engine.status, Stamp.now())
        logging.getLogger("crtk_drivers").addHandler(self._rosout)
        self._thread.start()
        self._latched.job.ask()
        self._description.job.ask()
        self._command_threads.start()
        self._services.start()
        self._device_services.start()
        if self._actions is not None:
            self._actions.start()

    def stop(self, timeout: float = PUBLISHER_TIMEOUT) -> bool:
        """Publish what is still to be told and end; False if DDS still blocks after `timeout` s."""
        logging.getLogger("crtk_drivers").removeHandler(self._rosout)
        self._engine.remove_observer(self._listener)
        self._engine.on_sample = None
        self._presence.leave()
        read = self._command_threads.stop(timeout)
        self._services.stop(timeout)
        self._device_services.stop(timeout)
        if self._actions is not None:
            self._actions.stop(timeout)
        return self._thread.stop(timeout) and read

    def _set_publish_rate(self, rate: float) -> None:
        self._feedback.set_rate(rate)
        if self._joint_states is not None:
            self._joint_states.job.set_rate(rate)

    def _serve_or_stand_by(self, serves: bool) -> None:
        """While another driver serves, clients hear from that one alone."""
        self._thread.only = None if serves else STANDING_BY
        self._refusals.is_told = serves

    def _names_on_ros(self) -> dict[str, str]:
        endpoints = {
            **self._feedback.publishers,
            **self._latched.publishers,
            **self._commands.subscriptions,
            **self._readings.publishers,
        }
        if self._status.publisher is not None:
            endpoints["operating_state"] = self._status.publisher
        names = {name: endpoint.topic_name for name, endpoint in endpoints.items()}
        services = {**self._services.services, **self._device_services.services}
        names |= {name: srv.service_name for name, srv in services.items()}
        payloads = {name: command.payload for name, command in self._engine.commands.items()}
        payloads |= {name: taken.payload for name, taken in self._engine.inputs.items()}
        payloads |= {
            reading.told_as(name): reading.payload
            for name, reading in self._engine.readings.items()
        }
        expected = {
            endpoint.topic_name: ROS_TYPES[payloads[name]] for name, endpoint in endpoints.items()
        }
        self._thread.job("graph", TypeConflicts(self.node, expected).check, GRAPH_RATE)
        return names

    def _set_up_diagnostics(self) -> None:
        engine = self._engine
        diagnostics = Diagnostics(
            self.node.get_fully_qualified_name(), engine.where, engine.options.sample_timeout
        )
        publisher = qos.publisher(self.node, DiagnosticArray, "/diagnostics", qos.DATA)
        self._diagnostics_job = self._thread.job(
            "diagnostics",
            lambda: publisher.publish(
                diagnostics.report(
                    engine.status, engine.health(), time.time_ns(), self._commands.senders.floods
                )
            ),
        )

    def _set_up_manifest(self) -> None:
        publisher = qos.publisher(self.node, String, f"~/{MANIFEST}", qos.LATCHED)
        self._rates: dict[str, float] = {}

        def publish() -> None:
            content = manifest(self._engine, self._frames, self._rates, self._ros_names)
            text = json.dumps(content, allow_nan=False)
            self._engine.standing[f"{NODE_NAME}/{MANIFEST}"] = text
            publisher.publish(String(data=text))

        self._manifest_job = self._thread.job("manifest", publish)

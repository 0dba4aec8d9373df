"""Services: ``operating_state``, ``forward_kinematics``, ``inverse_kinematics``, ``crtk_version``.

A query that is refused answers with `result` False and the reason in `message`. What a device does beyond
CRTK (`crtk_drivers.device.Service`) is a std_srvs/Trigger of that name; these take their time, and so have a
node and a thread of their own.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import Any

from crtk_msgs.srv import TriggerOperatingState
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.service import Service
from std_srvs.srv import Trigger

from crtk_drivers.commands import Direction, Payload
from crtk_drivers.engine import Engine
from crtk_drivers.errors import CommandRefused, CrtkError, KinematicsError
from crtk_drivers.ros.manifest import CRTK_VERSION
from crtk_drivers.ros.messages import TYPES, fill_status, pose_of, set_pose
from crtk_drivers.ros.names import SERVICES_NODE_NAME
from crtk_drivers.ros.spinning import SPIN_PERIOD, make_executor
from crtk_drivers.ros.unlocked import UnlockedNode
from crtk_drivers.samples import vector

logger = logging.getLogger(__name__)


class Services:
    """The services of one device. `next_stamp` gives stamps that fit in with the topic's."""

    def __init__(self, node: Node, engine: Engine, next_stamp: Callable[[int], int]) -> None:
        self._engine = engine
        self._next_stamp = next_stamp
        answers: dict[Payload, Callable[[str, Any, Any], None]] = {
            Payload.FORWARD_KINEMATICS: self._forward_kinematics,
            Payload.INVERSE_KINEMATICS: self._inverse_kinematics,
        }
        self.services: dict[str, Service] = {
            name: node.create_service(
                TYPES[command.payload], name, self._query(name, answers[command.payload])
            )
            for name, command in engine.commands.items()
            if command.direction is Direction.SERVICE
        }
        node.create_service(TriggerOperatingState, "operating_state", self._operating_state)
        node.create_service(Trigger, "crtk_version", self._crtk_version)

    def _operating_state(self, request: Any, response: Any) -> Any:
        fill_status(response.operating_state, self._engine.status, self._next_stamp(time.time_ns()))
        return response

    def _crtk_version(self, request: Any, response: Any) -> Any:
        response.success = True
        response.message = CRTK_VERSION
        return response

    def _query(
        self, name: str, answer: Callable[[str, Any, Any], None]
    ) -> Callable[[Any, Any], Any]:
        def respond(request: Any, response: Any) -> Any:
            response.result = False
            try:
                answer(name, request, response)
            except CommandRefused as refusal:
                self._engine.report_refusal(refusal)
                response.message = str(refusal)
            except KinematicsError as error:
                response.message = str(error)
            except Exception as error:
                logger.exception("%s: %s failed", self._engine.where, name)
                response.message = f"{type(error).__name__}: {error}. Please report this."
            else:
                response.result = True
            return response

        return respond

    def _forward_kinematics(self, name: str, request: Any, response: Any) -> None:
        set_pose(response.cp, self._engine.forward_kinematics(vector(request.jp), name))

    def _inverse_kinematics(self, name: str, request: Any, response: Any) -> None:
        joints = self._engine.inverse_kinematics(pose_of(request.cp), vector(request.jp))
        response.jp = [float(value) for value in joints]


class DeviceServices:
    """A device's own services. Nothing is there if it has none.

    Args:
        context: of the driver's node.
        namespace: of the driver's node.
        engine: asked.
        admit: called with the name of each that is asked for; may refuse it.
    """

    def __init__(
        self, context: Context, namespace: str, engine: Engine, admit: Callable[[str], None]
    ) -> None:
        self._engine = engine
        self._admit = admit
        self._stop = threading.Event()
        self._node: Node | None = None
        self.services: dict[str, Service] = {}
        if not engine.services:
            return
        self._node = node = UnlockedNode(
            SERVICES_NODE_NAME, namespace=namespace, context=context, enable_rosout=False
        )
        self._executor = make_executor(context)
        self._executor.add_node(node)
        self.services = {
            name: node.create_service(Trigger, name, self._answer(name)) for name in engine.services
        }
        self._thread = threading.Thread(
            target=self._spin, name=f"services {engine.name}", daemon=True
        )

    def start(self) -> None:
        """Begin to serve."""
        if self._node is not None:
            self._thread.start()

    def stop(self, timeout: float) -> None:
        """Serve no more. One that is being carried out is waited for, for `timeout` s."""
        if self._node is None:
            return
        self._stop.set()
        if self._thread.ident is not None:
            self._thread.join(timeout)
        self._executor.shutdown(timeout_sec=0.0)
        self._node.destroy_node()

    def _spin(self) -> None:
        while not self._stop.is_set():
            try:
                self._executor.spin_once(timeout_sec=SPIN_PERIOD)
            except ExternalShutdownException:
                return

    def _answer(self, name: str) -> Callable[[Any, Any], Any]:
        def respond(request: Any, response: Any) -> Any:
            limit = self._engine.capabilities.transition_timeout + 1.0
            try:
                self._admit(name)
                response.message = self._engine.request(name).wait(limit)
                response.success = True
            except CrtkError as error:
                response.success, response.message = False, str(error)
            return response

        return respond

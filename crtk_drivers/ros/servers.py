"""Services: ``operating_state``, ``forward_kinematics``, ``inverse_kinematics``, ``crtk_version``.

A query that is refused answers with `result` False and the reason in `message`. What a device does beyond
CRTK (`crtk_drivers.device.Service`) is a std_srvs/Trigger of that name; these take their time, and so have a
node and a thread of their own. Those that are stops have another: they are not kept waiting by the rest.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from functools import partial
from queue import SimpleQueue
from typing import Any, Final

from crtk_msgs.srv import TriggerOperatingState
from rclpy.context import Context
from rclpy.service import Service
from std_srvs.srv import Trigger

from crtk_drivers.commands import Direction, Payload
from crtk_drivers.engine import Engine
from crtk_drivers.errors import CommandRefused, CrtkError, KinematicsError
from crtk_drivers.ros.arrival import Arrival
from crtk_drivers.ros.manifest import CRTK_VERSION
from crtk_drivers.ros.messages import TYPES, fill_status, pose_of, set_pose
from crtk_drivers.ros.names import SERVICES_NODE_NAME, STOPS_NODE_NAME
from crtk_drivers.ros.own_thread import SpunNode
from crtk_drivers.ros.unlocked import UnlockedNode
from crtk_drivers.ros.unlocked_service import UnlockedService
from crtk_drivers.samples import vector

logger = logging.getLogger(__name__)

MOST_QUESTIONS: Final = 64
"""For inverse kinematics that wait."""


class Services:
    """The services of one device. `next_stamp` gives stamps that fit in with the topic's.

    Inverse kinematics are asked in a thread of their own: a pose out of reach takes generic ones 0.2 s, and
    whoever asks for many must not hold up the commands of others, a stop among them.
    """

    def __init__(
        self, node: UnlockedNode, engine: Engine, next_stamp: Callable[[int], int]
    ) -> None:
        self._engine = engine
        self._next_stamp = next_stamp
        self._asked: SimpleQueue[Callable[[], None] | None] = SimpleQueue()
        self._thread = threading.Thread(
            target=self._answer, name=f"kinematics {engine.name}", daemon=True
        )
        self.services: dict[str, Service] = {}
        for name, command in engine.commands.items():
            if command.direction is not Direction.SERVICE:
                continue
            kind: Any = TYPES[command.payload]
            if command.payload is Payload.INVERSE_KINEMATICS:
                ask = partial(self._ask, self._query(name, self._inverse_kinematics), kind.Response)
                self.services[name] = UnlockedService(node, kind, name, ask).service
            else:
                answer = self._query(name, self._forward_kinematics)
                self.services[name] = node.create_service(kind, name, answer)
        if engine.has_state:
            node.create_service(TriggerOperatingState, "operating_state", self._operating_state)
        node.create_service(Trigger, "crtk_version", self._crtk_version)

    def start(self) -> None:
        """Begin to answer what takes long."""
        if "inverse_kinematics" in self.services:
            self._thread.start()

    def stop(self, timeout: float) -> None:
        """Answer no more of that; what is being answered is waited for, for `timeout` s."""
        self._asked.put(None)
        if self._thread.is_alive():
            self._thread.join(timeout)

    def _ask(
        self,
        respond: Callable[[Any, Any], Any],
        make: Callable[[], Any],
        request: Any,
        reply: Callable[[Any], None],
        arrival: Arrival,
    ) -> None:
        response = make()
        if self._asked.qsize() >= MOST_QUESTIONS:
            response.message = f"{MOST_QUESTIONS} questions wait. Ask again once they are answered."
            reply(response)
            return
        self._asked.put(lambda: reply(respond(request, response)))

    def _answer(self) -> None:
        while (ask := self._asked.get()) is not None:
            try:
                ask()
            except Exception:
                logger.exception("%s: a question was not answered", self._engine.where)

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
        self._spun: list[SpunNode] = []
        self.services: dict[str, Service] = {}
        for stops, node_name in ((False, SERVICES_NODE_NAME), (True, STOPS_NODE_NAME)):
            names = [name for name, each in engine.services.items() if each.stops is stops]
            if not names:
                continue
            spun = SpunNode(context, node_name, namespace, f"{node_name} {engine.name}")
            self._spun.append(spun)
            for name in names:
                served = UnlockedService(spun.node, Trigger, name, self._answer(name))
                self.services[name] = served.service

    def start(self) -> None:
        """Begin to serve."""
        for spun in self._spun:
            spun.start()

    def stop(self, timeout: float) -> None:
        """Serve no more. One that is being carried out is waited for, for `timeout` s."""
        for spun in self._spun:
            spun.stop(timeout)

    def _answer(self, name: str) -> Callable[[Any, Callable[[Any], None], Arrival], None]:
        def respond(request: Any, reply: Callable[[Any], None], arrival: Arrival) -> None:
            limit = self._engine.capabilities.transition_timeout + 1.0
            response = Trigger.Response()
            try:
                self._admit(name)
                response.message = self._engine.request(name, arrival.earliest_ns).wait(limit)
                response.success = True
            except CrtkError as error:
                response.success, response.message = False, str(error)
            reply(response)

        return respond

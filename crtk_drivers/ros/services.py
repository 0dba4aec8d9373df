"""Services: ``operating_state``, ``forward_kinematics``, ``inverse_kinematics``, ``crtk_version``.

A query that is refused answers with `result` False and the reason in `message`.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Any

from crtk_msgs.srv import TriggerOperatingState
from rclpy.node import Node
from rclpy.service import Service
from std_srvs.srv import Trigger

from crtk_drivers.commands import Direction, Payload
from crtk_drivers.engine import Engine
from crtk_drivers.errors import CommandRefused, KinematicsError
from crtk_drivers.ros.manifest import CRTK_VERSION
from crtk_drivers.ros.messages import TYPES, fill_status, pose_of, set_pose
from crtk_drivers.samples import vector

logger = logging.getLogger(__name__)


class Services:
    """The services of one device. `next_stamp` gives stamps that fit in with the topic's."""

    def __init__(self, node: Node, engine: Engine, next_stamp: Callable[[int], int]) -> None:
        self._engine = engine
        self._next_stamp = next_stamp
        answers: dict[Payload, Callable[[Any, Any], None]] = {
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

    def _query(self, name: str, answer: Callable[[Any, Any], None]) -> Callable[[Any, Any], Any]:
        def respond(request: Any, response: Any) -> Any:
            response.result = False
            try:
                answer(request, response)
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

    def _forward_kinematics(self, request: Any, response: Any) -> None:
        set_pose(response.cp, self._engine.forward_kinematics(vector(request.jp)))

    def _inverse_kinematics(self, request: Any, response: Any) -> None:
        joints = self._engine.inverse_kinematics(pose_of(request.cp), vector(request.jp))
        response.jp = [float(value) for value in joints]

"""What a robot has, asked once: controllers, hardware, description. For people; it waits."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import String

from crtk_driver_ros2_control.controllers import Controller
from crtk_driver_ros2_control.foreign import messages
from crtk_drivers.errors import ConnectionFailed
from crtk_drivers.ros import qos

T = TypeVar("T")

AGAIN = 0.5
"""Seconds after which it is asked again: the first answer to a client that was not found yet is lost."""
DESCRIPTION_WAIT = 2.0
"""Seconds in which a robot that publishes its description has done so."""


@dataclass(frozen=True)
class Survey:
    """What was found.

    Attributes:
        controllers: by name.
        orders: joints of each controller that tells them, by its name.
        description: URDF; empty if none is published.
    """

    controllers: Mapping[str, Controller]
    orders: Mapping[str, tuple[str, ...]]
    description: str


def survey(manager: str, domain: int | None, timeout: float) -> Survey:
    """Ask a controller manager, its controllers, and for the description beside it.

    Raises:
        ConnectionFailed: it does not answer within `timeout` s.
    """
    namespace = manager.rpartition("/")[0]
    with _asking(domain) as asking:
        listed = asking.ask(
            f"{manager}/list_controllers",
            messages.LIST_CONTROLLERS,
            {},
            messages.controllers,
            timeout,
        )
        orders = {}
        for name in listed:
            orders[name] = asking.ask(
                f"{namespace}/{name}/get_parameters",
                messages.PARAMETERS,
                {"names": ["joints"]},
                messages.texts,
                timeout,
            )
        return Survey(listed, orders, asking.description(f"{namespace}/robot_description"))


class _Asking:
    def __init__(self, node: Node, executor: SingleThreadedExecutor) -> None:
        self._node = node
        self._executor = executor

    def ask(
        self,
        service: str,
        kind: Any,
        fields: Mapping[str, Any],
        read: Callable[[Any], T],
        timeout: float,
    ) -> T:
        client = self._node.create_client(kind, service)
        deadline = time.monotonic() + timeout
        try:
            wait = AGAIN
            while (left := deadline - time.monotonic()) > 0.0 and client.wait_for_service(left):
                future = client.call_async(messages.request(kind, fields))
                left = max(0.0, deadline - time.monotonic())
                self._executor.spin_until_future_complete(future, min(wait, left))
                if future.done():
                    return read(future.result())
                client.remove_pending_request(future)
                wait *= 2.0  # the service may be slow, or the first answer was lost
        finally:
            self._node.destroy_client(client)
        raise ConnectionFailed(
            f"no answer in {timeout:g} s",
            where=service,
            remedy="Is ros2_control_node running, in this ROS domain and range?",
        )

    def description(self, topic: str) -> str:
        found: list[str] = []
        self._node.create_subscription(
            String, topic, lambda message: found.append(message.data), qos.LATCHED
        )
        deadline = time.monotonic() + DESCRIPTION_WAIT
        while not found and time.monotonic() < deadline:
            self._executor.spin_once(timeout_sec=0.1)
        return found[-1] if found else ""


@contextmanager
def _asking(domain: int | None) -> Iterator[_Asking]:
    context = Context()
    rclpy.init(context=context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("crtk_ros2_control_describe", context=context, enable_rosout=False)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    try:
        yield _Asking(node, executor)
    finally:
        executor.shutdown(timeout_sec=0.0)
        node.destroy_node()
        context.try_shutdown()

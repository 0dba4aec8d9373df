"""What a monitor sees last of a driver that was closed in order: DISABLED, of every driver on every way."""

from __future__ import annotations

import threading

import pytest

pytest.importorskip("rclpy")

import rclpy
from crtk_msgs.msg import OperatingState as OperatingStateMessage
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from crtk_drivers.session import Session
from crtk_drivers.state import OperatingState
from rigs.loopback_node import served
from rigs.ros_client import TRANSIENT
from rigs.waiting import eventually
from rigs.ways import WAYS, session_on


class Monitor:
    """Listens to operating states, latched, of nodes that may not be there yet."""

    def __init__(self, *namespaces: str) -> None:
        self.told: dict[str, list[str]] = {each: [] for each in namespaces}
        self._context = Context()
        rclpy.init(context=self._context)
        self._node = Node("monitor", context=self._context, enable_rosout=False)
        self._executor = SingleThreadedExecutor(context=self._context)
        for each in namespaces:
            self._listen(each)
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._executor.spin)

    def _listen(self, namespace: str) -> None:
        def take(message: OperatingStateMessage) -> None:
            self.told[namespace].append(message.state)

        self._node.create_subscription(
            OperatingStateMessage, f"{namespace}/operating_state", take, TRANSIENT
        )

    def __enter__(self) -> Monitor:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._executor.shutdown()
        self._thread.join()
        self._node.destroy_node()
        self._context.try_shutdown()


def _has_state(session: Session) -> list[str]:
    """Return the namespaces below the driver's that have an operating state of their own."""
    own = {"": session.engine, **session.children}
    return [name for name, engine in own.items() if engine.has_state]


@pytest.mark.ros
@pytest.mark.sweep(5)
@pytest.mark.parametrize(("name", "key", "way"), WAYS, ids=lambda part: part or "-")
def test_closing_in_order_ends_in_disabled(name: str, key: str, way: str) -> None:
    space = "/last_" + "_".join((name, way)).replace("-", "_").strip("_")
    session = session_on(name, key, way)
    spaces = ["/".join(filter(None, (space, each))) for each in _has_state(session)]
    with Monitor(*spaces) as monitor:
        with served(session, space):
            session.engine.state_command("enable")
            eventually(lambda: session.engine.transition_ended, "enable has ended")
            eventually(lambda: all(monitor.told.values()), "the monitor hears it")
        seen = {each: told[-1] for each, told in monitor.told.items()}
    assert seen == dict.fromkeys(spaces, OperatingState.DISABLED.value)

"""A loopback device on ROS 2, and a client that is connected to it over DDS."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from crtk_drivers.config import NodeConfig
from crtk_drivers.device import Condition
from crtk_drivers.plugins import DevicePlugin
from crtk_drivers.ros.serving import Serving
from crtk_drivers.session import Session
from crtk_drivers.testing.loopback import PLUGIN, LoopbackConfig, LoopbackDevice
from rigs.ros_client import TIMEOUT, RosClient


def until(condition: Callable[[], bool], what: str) -> None:
    """Wait for a condition."""
    end = time.monotonic() + TIMEOUT
    while not condition():
        assert time.monotonic() < end, f"not within {TIMEOUT} s: {what}"
        time.sleep(0.005)


@dataclass
class Rig:
    """A served device and its client."""

    session: Session
    serving: Serving
    client: RosClient

    @property
    def device(self) -> LoopbackDevice:
        device = self.session.engine.device
        assert isinstance(device, LoopbackDevice)
        return device

    def reset(self) -> None:
        self.device.reachable, self.device.silent = True, False
        self.device.reported = Condition()
        engine = self.session.engine
        until(lambda: engine.status.detail == "", "the device is back")
        engine.state_command("disable")
        until(lambda: engine.transition_ended, "disable is carried out, whatever the state was")
        until(lambda: engine.status.state == "DISABLED", "the device is disabled")
        told = self.client["operating_state"].messages
        until(lambda: bool(told) and told[-1].state == "DISABLED", "the client has heard that")
        self.device.go_to_zero()


@contextmanager
def serve(
    config: LoopbackConfig,
    namespace: str,
    ros_args: list[str],
    node: NodeConfig | None = None,
    plugin: DevicePlugin = PLUGIN,
) -> Iterator[tuple[Session, Serving]]:
    """Serve a loopback device from a thread of this process."""
    session = Session(plugin, config)
    with served(session, namespace, ros_args, node) as serving:
        yield session, serving


@contextmanager
def served(
    session: Session, namespace: str, ros_args: Sequence[str] = (), node: NodeConfig | None = None
) -> Iterator[Serving]:
    """Run a session, and serve it from a thread of this process."""
    stop = threading.Event()
    with (
        Serving(session.engine, namespace, ros_args, node, session.children) as serving,
        session,
    ):
        thread = threading.Thread(target=serving.spin, args=(stop,), name="test serving")
        thread.start()
        try:
            yield serving
        finally:
            stop.set()
            thread.join()


@contextmanager
def rig_of(
    namespace: str,
    ros_args: list[str] | None = None,
    node: NodeConfig | None = None,
    plugin: DevicePlugin = PLUGIN,
    **config: Any,
) -> Iterator[Rig]:
    """Serve a loopback device, and connect a client to it."""
    with (
        RosClient(namespace) as client,
        serve(LoopbackConfig(**config), namespace, ros_args or [], node, plugin) as (
            session,
            serving,
        ),
    ):
        client.check_connections()
        yield Rig(session, serving, client)

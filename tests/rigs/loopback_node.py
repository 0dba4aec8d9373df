"""A loopback device on ROS 2, and a client that is connected to it over DDS."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from crtk_drivers.config import NodeConfig
from crtk_drivers.device import Condition
from crtk_drivers.engine import Engine
from crtk_drivers.plugins import DevicePlugin
from crtk_drivers.ros.serving import Serving
from crtk_drivers.samples import Number
from crtk_drivers.session import Session
from crtk_drivers.testing.loopback import PLUGIN, LoopbackConfig, LoopbackDevice
from rigs.ros_client import RosClient, stamp_ns
from rigs.waiting import eventually

RATE = 40.0
"""Hz of the device and of what is published: the client hears twenty topics, each in each cycle."""


def put_at_zero(engine: Engine) -> None:
    """Put a loopback device that is not ENABLED to zero; the I/O thread may just be moving it on."""
    device = engine.device
    assert isinstance(device, LoopbackDevice)

    def is_there() -> bool:
        device.go_to_zero()
        found = engine.feedback("measured_js")
        return found is not None and not found[0].position.any()  # type: ignore[union-attr]

    eventually(is_there, "it is at zero")


SLOWLY = 0.02
"""Share of the speed of a move that is not to be over before it is stopped, whoever has to wait."""


@contextmanager
def slowly(engine: Engine) -> Iterator[None]:
    """Let moves that begin within take fifty times as long."""
    engine.submit("trajectory_j/set_ratio", Number(SLOWLY))
    try:
        yield
    finally:
        engine.submit("trajectory_j/set_ratio", Number(1.0))


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
        eventually(lambda: engine.connected, "the device is back")
        begun = time.time_ns()
        engine.state_command("disable")
        eventually(
            lambda: engine.transition_ended, "disable is carried out, whatever the state was"
        )
        eventually(lambda: engine.status.state == "DISABLED", "the device is disabled")
        told = self.client["operating_state"].messages

        def is_heard() -> bool:
            """Not what was told before: a state of the last test may be on its way still."""
            newest = told[-1] if told else None
            if newest is None or stamp_ns(newest) < begun:
                return False
            return newest.state == "DISABLED" and not newest.is_busy

        eventually(is_heard, "the client has heard that")
        put_at_zero(engine)


@contextmanager
def serve(
    config: LoopbackConfig,
    namespace: str,
    ros_args: list[str],
    node: NodeConfig | None = None,
    plugin: DevicePlugin = PLUGIN,
    *,
    connects: bool = True,
) -> Iterator[tuple[Session, Serving]]:
    """Serve a loopback device from a thread of this process; see `served`."""
    session = Session(plugin, config)
    with served(session, namespace, ros_args, node, connects=connects) as serving:
        yield session, serving


@contextmanager
def served(
    session: Session,
    namespace: str,
    ros_args: Sequence[str] = (),
    node: NodeConfig | None = None,
    *,
    connects: bool = True,
) -> Iterator[Serving]:
    """Run a session, and serve it from a thread of this process; wait until it is connected, if it is to."""
    stop = threading.Event()
    with (
        Serving(session.engine, namespace, ros_args, node, session.children) as serving,
        session,
    ):
        thread = threading.Thread(target=serving.spin, args=(stop,), name="test serving")
        thread.start()
        try:
            if connects:
                eventually(
                    lambda: all(each.has_sample for each in session.engines), "it is connected"
                )
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
    config = {"rate": RATE} | config
    node = node or NodeConfig(publish_rate=RATE)
    with (
        RosClient(namespace) as client,
        serve(LoopbackConfig(**config), namespace, ros_args or [], node, plugin) as (
            session,
            serving,
        ),
    ):
        client.check_connections()
        eventually(lambda: _hears(serving, client), "the device knows who hears it")
        yield Rig(session, serving, client)


def _hears(serving: Serving, client: RosClient) -> bool:
    """Whether all that is published goes to the client too: it may know the device before that knows it."""
    heard = {each.topic_name for each in client.node.subscriptions}
    publishers = [each for each in serving.driver.node.publishers if each.topic_name in heard]
    return all(each.get_subscription_count() for each in publishers)

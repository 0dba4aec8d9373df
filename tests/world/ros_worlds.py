"""Worlds in which programs talk by rclpy; imported in patched Python, so no pytest is imported here."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Int32
from std_srvs.srv import Trigger

from crtk_drivers.ros.unlocked import is_acknowledged
from crtk_drivers.testing.world import World

TOPIC = "/numbers"
LATCHED = QoSProfile(
    depth=3,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
    reliability=ReliabilityPolicy.RELIABLE,
)
BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
RELIABLE = QoSProfile(depth=10)
MANY = QoSProfile(depth=100)
FOUND = 0.5
"""s in which two programs have found each other."""


@contextmanager
def program(name: str, arguments: list[str] | None = None) -> Iterator[Node]:
    """Be a program with a node."""
    context = Context()
    rclpy.init(
        args=arguments or [], context=context, signal_handler_options=SignalHandlerOptions.NO
    )
    node = rclpy.create_node(name, context=context)
    try:
        yield node
    finally:
        node.destroy_node()
        context.try_shutdown()


def spin(node: Node, seconds: float, make: Callable[..., Any] = EventsExecutor) -> None:
    """Serve callbacks for so many s."""
    executor = make(context=node.context)
    executor.add_node(node)
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        executor.spin_once(timeout_sec=0.05)
    executor.shutdown()


def _hear(world: World, send: Callable[[Node, Any], None], profile: QoSProfile) -> list[int]:
    """Return the numbers that one program hears of those that another one sends."""
    heard: list[int] = []

    def speak() -> None:
        with program("speaks") as node:
            publisher = node.create_publisher(Int32, TOPIC, profile)
            time.sleep(FOUND)
            send(node, publisher)
            time.sleep(30.0)

    speaker = world.start("speaks", speak)
    with program("hears") as node:
        node.create_subscription(Int32, TOPIC, lambda message: heard.append(message.data), profile)
        spin(node, FOUND + 30.0)
    world.join(speaker)
    return heard


def _send_numbers(_: Node, publisher: Any) -> None:
    for number in range(50):
        publisher.publish(Int32(data=number))
        time.sleep(0.01)


def reliable(world: World) -> list[int]:
    """Lose a third of all datagrams, on a reliable topic."""
    world.network.weather.lost = 0.3  # type: ignore[attr-defined]
    return _hear(world, _send_numbers, MANY)


def best_effort(world: World) -> list[int]:
    """Lose a third of all datagrams, on a topic without repetitions."""
    world.network.weather.lost = 0.3  # type: ignore[attr-defined]
    return _hear(world, _send_numbers, BEST_EFFORT)


def repaired(world: World) -> list[float]:
    """Lose one message, and return how long another program waits for it."""
    waited: list[float] = []
    sent = 0.0

    def speak() -> None:
        nonlocal sent
        with program("speaks") as node:
            publisher = node.create_publisher(Int32, TOPIC, RELIABLE)
            time.sleep(FOUND)
            world.troubles.block(0.0, 0.1)
            time.sleep(0.01)
            sent = time.monotonic()
            publisher.publish(Int32(data=1))
            time.sleep(6.0)

    speaker = world.start("speaks", speak)
    with program("hears") as node:
        node.create_subscription(
            Int32, TOPIC, lambda _: waited.append(time.monotonic() - sent), RELIABLE
        )
        spin(node, FOUND + 5.0)
    world.join(speaker)
    return waited


def latched(world: World, executor: str) -> list[int]:
    """Hear what was said before, from a program that keeps three messages."""
    make = {"EventsExecutor": EventsExecutor, "SingleThreadedExecutor": SingleThreadedExecutor}
    heard: list[int] = []

    def speak() -> None:
        with program("speaks") as node:
            publisher = node.create_publisher(Int32, TOPIC, LATCHED)
            for number in range(5):
                publisher.publish(Int32(data=number))
            time.sleep(4.0)

    speaker = world.start("speaks", speak)
    time.sleep(1.0)
    with program("hears") as node:
        node.create_subscription(Int32, TOPIC, lambda message: heard.append(message.data), LATCHED)
        spin(node, 2.0, make[executor])
    world.join(speaker)
    return heard


def missed(world: World, dies: bool) -> float:
    """Return the s after which a publisher is missed whose process dies, or leaves."""

    def speak() -> None:
        with program("speaks") as node:
            node.create_publisher(Int32, TOPIC, RELIABLE)
            time.sleep(1.0)
            if dies:
                world.kernel.end_process(world.kernel.process, -9)

    world.start("speaks", speak)
    with program("hears") as node:
        while not node.count_publishers(TOPIC):
            time.sleep(0.01)
        while node.count_publishers(TOPIC):
            time.sleep(0.01)
    return world.kernel.seconds


def unmatched(world: World) -> list[int]:
    """Ask for what was said before, of a publisher that does not keep it; count who is told of that."""
    told: list[int] = []

    def speak() -> None:
        with program("speaks") as node:
            node.create_publisher(Int32, TOPIC, RELIABLE)
            time.sleep(3.0)

    from rclpy.event_handler import SubscriptionEventCallbacks

    speaker = world.start("speaks", speak)
    with program("hears") as node:
        subscription = node.create_subscription(
            Int32,
            TOPIC,
            lambda _: None,
            LATCHED,
            event_callbacks=SubscriptionEventCallbacks(
                incompatible_qos=lambda event: told.append(event.last_policy_kind)
            ),
        )
        spin(node, 2.0)
        told.append(subscription.get_publisher_count())
    world.join(speaker)
    return told


def confirmed(world: World, stands: bool) -> bool:
    """Return whether a message is acknowledged within 2 s by a program that stands still, or not."""

    def hear() -> None:
        with program("hears") as node:
            node.create_subscription(Int32, TOPIC, lambda _: None, QoSProfile(depth=1))
            time.sleep(10.0)

    hearer = world.start("hears", hear)
    with program("speaks") as node:
        publisher = node.create_publisher(Int32, TOPIC, QoSProfile(depth=1))
        while not publisher.get_subscription_count():
            time.sleep(0.01)
        if stands:
            world.kernel.freeze(hearer, 5.0)
        publisher.publish(Int32(data=1))
        return is_acknowledged(publisher, 2.0)


def asked(world: World) -> str:
    """Ask a service of another program."""

    def answer(_: Any, response: Any) -> Any:
        response.message = "here"
        return response

    def serve() -> None:
        with program("serves") as node:
            node.create_service(Trigger, "/where", answer)
            spin(node, 5.0)

    server = world.start("serves", serve)
    with program("asks") as node:
        client = node.create_client(Trigger, "/where")
        assert client.wait_for_service(2.0)
        time.sleep(FOUND)
        future = client.call_async(Trigger.Request())
        spin(node, 1.0)
        found = str(future.result().message)
    world.join(server)
    return found


def refused(_: World, what: str) -> str:
    """Ask for something that worlds do not have, and return what they say."""
    ask: dict[str, Callable[[Node], object]] = {
        "KEEP_ALL": lambda node: node.create_publisher(
            Int32, TOPIC, QoSProfile(history=HistoryPolicy.KEEP_ALL)
        ),
        "deadline": lambda node: node.create_publisher(
            Int32, TOPIC, QoSProfile(depth=1, deadline=rclpy.duration.Duration(seconds=1))
        ),
        "use_sim_time": lambda node: node.set_parameters(
            [rclpy.parameter.Parameter("use_sim_time", value=True)]
        ),
    }
    arguments = ["--ros-args", "--params-file", "a.yaml"] if what == "--params-file" else []
    try:
        with program("asks", arguments) as node:
            ask[what](node)
    except Exception as error:
        return str(error)
    return ""

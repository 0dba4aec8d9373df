"""A served loopback device and `crtk_drivers.client` on the far side of it."""

from __future__ import annotations

import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, Self

import rclpy
from rclpy.context import Context
from rclpy.exceptions import InvalidHandle
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

from crtk_drivers.client import RemoteDevice, connect
from crtk_drivers.device import Condition
from crtk_drivers.engine import Engine
from crtk_drivers.state import Status
from crtk_drivers.testing.loopback import LoopbackConfig, LoopbackDevice
from rigs.loopback_node import put_at_zero, serve
from rigs.programs import Program, Start
from rigs.waiting import LONG, eventually


@dataclass
class Far:
    """A device in this process, and a client that reaches it over DDS only."""

    namespace: str
    engine: Engine
    arm: RemoteDevice

    @property
    def device(self) -> LoopbackDevice:
        device = self.engine.device
        assert isinstance(device, LoopbackDevice)
        return device

    def reset(self) -> None:
        self.device.reachable, self.device.silent = True, False
        self.device.reported = Condition()
        eventually(lambda: self.engine.connected and self.engine.transition_ended, "it is back")
        begun = time.time_ns()
        self.engine.state_command("disable")
        eventually(lambda: self.engine.transition_ended, "disable has ended")
        eventually(lambda: self.engine.status == Status(is_homed=True), "it is disabled, and well")
        eventually(lambda: self.engine.health().stream == "", "no stream is left")
        heard = self.arm._space.status()

        def is_heard() -> bool:
            """Not what was told before: a state of the last test may be on its way still."""
            return heard._stamp_ns >= begun and heard.latest == Status(is_homed=True)

        eventually(is_heard, "the client has heard that")
        put_at_zero(self.engine)


@contextmanager
def far_device(namespace: str, **config: Any) -> Iterator[Far]:
    with (
        serve(LoopbackConfig(**config), namespace, []) as (session, _),
        connect(namespace, timeout=LONG) as arm,
    ):
        yield Far(namespace, session.engine, arm)


class Node:
    """A bare node of another maker: spun in a thread, with nothing but what the test gives it."""

    def __init__(self, name: str) -> None:
        self._context = Context()
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node(name, context=self._context)
        self.executor = SingleThreadedExecutor(context=self._context)
        self.executor.add_node(self.node)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._spin, name=name)

    def _spin(self) -> None:
        while not self._stop.is_set():
            with suppress(InvalidHandle):  # a test destroys an endpoint that it is just looking at
                self.executor.spin_once(timeout_sec=0.02)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *details: object) -> None:
        self._stop.set()
        self._thread.join()
        self.executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()


@contextmanager
def driver_process(start: Start, namespace: str) -> Iterator[Callable[[], Program]]:
    """Give what starts a driver in a process of its own; the last one is ended."""
    running: list[Program] = []

    def again() -> Program:
        running.append(start("rigs.serve_loopback", namespace, stdout=subprocess.PIPE))
        return running[-1]

    try:
        yield again
    finally:
        for process in running:
            process.terminate()
            process.communicate(timeout=LONG)

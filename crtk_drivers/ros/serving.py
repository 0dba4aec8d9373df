"""Running the node: ROS context, executor, signals, and the way out."""

from __future__ import annotations

import gc
import logging
import math
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from types import FrameType, MappingProxyType
from typing import Self

import rclpy
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException
from rclpy.signals import SignalHandlerOptions

from crtk_drivers.config import NodeConfig
from crtk_drivers.engine import Engine
from crtk_drivers.errors import ConfigError, DeviceError
from crtk_drivers.ros import environment
from crtk_drivers.ros.node import PUBLISHER_TIMEOUT, DriverNode
from crtk_drivers.ros.spinning import SPIN_PERIOD, make_executor
from crtk_drivers.session import Session
from crtk_drivers.status.stop_request import StopRequest, end_signals

logger = logging.getLogger(__name__)

SAME_SIGNAL = 1.0
"""Seconds in which a second SIGINT is taken for the first."""
CLOSE_TIMEOUT = 1.2


class Serving:
    """A node for each engine, their ROS context and executor. A context manager; `spin` in between.

    Args:
        engine, namespace, config: see `DriverNode`.
        ros_args: what follows on the command line from ``--ros-args`` on, that word included.
        children: engines of the devices behind it, by the name of their sub-namespace.

    Raises:
        ConfigError: the ROS arguments cannot be used.
    """

    def __init__(
        self,
        engine: Engine,
        namespace: str,
        ros_args: Sequence[str] = (),
        config: NodeConfig | None = None,
        children: Mapping[str, Engine] = MappingProxyType({}),
    ) -> None:
        self._context = Context()
        try:
            rclpy.init(
                args=list(ros_args),
                context=self._context,
                signal_handler_options=SignalHandlerOptions.NO,
            )
        except Exception as error:
            raise environment.not_started(error, ros_args) from error
        try:
            self.driver = DriverNode(engine, namespace, self._context, config)
            self._drivers = [self.driver, *self._behind(engine, children, config)]
        except BaseException:
            self._context.try_shutdown()
            raise
        self._executor = make_executor(self._context)
        for driver in self._drivers:
            self._executor.add_node(driver.node)

    def _behind(
        self, front: Engine, children: Mapping[str, Engine], config: NodeConfig | None
    ) -> Iterator[DriverNode]:
        parent = self.driver.node.get_namespace().rstrip("/")
        own = front.capabilities.tool_frame
        prefix = self.driver.node.get_parameter("frame_prefix").value
        shared = (config or NodeConfig()).model_copy(update={"frame_prefix": prefix})
        for name, engine in children.items():
            namespace = f"{parent}/{name}"
            # One with a tool frame of another name has its frames among those of the device in front.
            its = config if engine.capabilities.tool_frame == own else shared
            driver = DriverNode(engine, namespace, self._context, its, tells_log=False)
            if driver.node.get_namespace() != namespace:
                raise ConfigError(
                    f"the ROS arguments put {name} into {driver.node.get_namespace()}, where "
                    "another device is",
                    remedy="Give the namespace with --ns instead of __ns:=.",
                )
            yield driver

    def start(self) -> None:
        """Begin to publish."""
        for driver in self._drivers:
            driver.start()

    def spin(self, stop: StopRequest, idle: Callable[[], None] | None = None) -> None:
        """Serve callbacks until `stop` is set or the context is shut down. One that fails is logged.

        Args:
            idle: called about ten times a second, from this thread.
        """
        called = 0.0
        while not stop.is_set() and self._context.ok():
            try:
                self._executor.spin_once(timeout_sec=SPIN_PERIOD)
            except ExternalShutdownException:
                return
            except Exception:  # what somebody sends ends no driver
                if not stop.is_set():
                    logger.exception("a ROS callback failed")
            if idle is not None and time.monotonic() - called >= SPIN_PERIOD:
                called = time.monotonic()
                idle()

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> bool:
        """End everything; return False if a DDS writer still blocks, then nothing more can be done."""
        stopped = [driver.stop() for driver in self._drivers]
        if not all(stopped):
            return False
        self._executor.shutdown(timeout_sec=PUBLISHER_TIMEOUT)
        for driver in self._drivers:
            driver.node.destroy_node()
        self._context.try_shutdown()
        return True


def run(
    session: Session,
    namespace: str,
    ros_args: Sequence[str] = (),
    *,
    config: NodeConfig | None = None,
    served: Callable[[str], None] | None = None,
    idle: Callable[[], None] | None = None,
) -> int:
    """Serve a session on ROS 2 until SIGINT or SIGTERM; return the exit code.

    The device is stopped and left as it is configured; everything is closed within two seconds and the time
    that it declares for stopping. The exit code is 1 if it was not seen to stop. From the main thread only.

    Args:
        session: not started; it is closed at the end.
        namespace: checked by `crtk_drivers.ros.names.checked_namespace`.
        ros_args: see `Serving`.
        config: initial values of the node's parameters.
        served: called once with the namespace in which the device is, after remapping, before it is opened.
        idle: called about ten times a second, for a status line.

    Raises:
        ConfigError: the ROS arguments cannot be used.
    """
    stop = StopRequest()
    with _signals(stop):
        try:
            serving = Serving(session.engine, namespace, ros_args, config, session.children)
        except BaseException:
            session.close()
            raise
        serving.start()
        code = 0
        try:
            namespace = serving.driver.node.get_namespace()
            session.place(namespace)
            if served is not None:
                served(namespace)
            _leave_out_of_collections()
            session.start()
            serving.spin(stop, idle)
        finally:
            # The device first: what comes after may take its time.
            try:
                session.close(CLOSE_TIMEOUT)
            except DeviceError as error:
                logger.error("%s", error)
                code = 1
            if not serving.close():
                _leave(code)
    return code


def _leave_out_of_collections() -> None:
    """Let Python's collector never look again at what exists by now: that stopped all threads for 80 ms."""
    gc.collect()
    gc.freeze()


@contextmanager
def _signals(stop: StopRequest) -> Iterator[None]:
    """Set `stop` at SIGINT, SIGTERM and SIGHUP.

    A later SIGINT has its usual effect; one that follows at once is the same one, sent to the process
    and passed on by its launcher.
    """
    first = math.inf

    def ask(number: int, frame: FrameType | None) -> None:
        nonlocal first
        stop.set()
        first = min(first, time.monotonic())
        if number == signal.SIGINT and time.monotonic() - first > SAME_SIGNAL:
            signal.default_int_handler(number, frame)

    with end_signals(ask):
        yield


def _leave(code: int) -> None:
    """End the process while a DDS writer blocks: its thread cannot be ended, nor DDS be closed."""
    logger.warning("a DDS writer still blocks; leaving without closing ROS")
    logging.shutdown()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)

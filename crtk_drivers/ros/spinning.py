"""The executor that this package spins with.

rclpy's EventsExecutor, whose cost does not grow with the number of topics. Its `spin` hangs in some
builds: call ``spin_once(timeout_sec=SPIN_PERIOD)`` in a loop instead.
"""

from __future__ import annotations

import logging
import threading

from rclpy.context import Context
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor

logger = logging.getLogger(__name__)

SPIN_PERIOD = 0.1
"""Longest time in s that a request to stop waits for the executor."""


def make_executor(context: Context) -> Executor:
    """Return an executor to be driven by ``spin_once``."""
    try:
        from rclpy.experimental import EventsExecutor
    except ImportError:
        return SingleThreadedExecutor(context=context)
    return EventsExecutor(context=context)


def spin(executor: Executor, stopped: threading.Event) -> None:
    """Serve callbacks until `stopped`, or until ROS is left; a callback that fails is logged."""
    while not stopped.is_set() and executor.context.ok():
        try:
            executor.spin_once(timeout_sec=SPIN_PERIOD)
        except ExternalShutdownException:
            return
        except Exception:
            if not stopped.is_set():
                logger.exception("a ROS callback failed")

"""The executor that this package spins with.

rclpy's EventsExecutor, whose cost does not grow with the number of topics. Its `spin` hangs in some
builds: call ``spin_once(timeout_sec=SPIN_PERIOD)`` in a loop instead.
"""

from __future__ import annotations

from rclpy.context import Context
from rclpy.executors import Executor, SingleThreadedExecutor

SPIN_PERIOD = 0.1
"""Longest time in s that a request to stop waits for the executor."""


def make_executor(context: Context) -> Executor:
    """Return an executor to be driven by ``spin_once``."""
    try:
        from rclpy.experimental import EventsExecutor
    except ImportError:
        return SingleThreadedExecutor(context=context)
    return EventsExecutor(context=context)

"""Warnings and errors of this package on /rosout, where ROS users look for them."""

from __future__ import annotations

import logging
from collections import deque

from rcl_interfaces.msg import Log
from rclpy.node import Node
from typing_extensions import override

from crtk_drivers.ros import qos
from crtk_drivers.ros.messages import set_stamp
from crtk_drivers.ros.publishing import PublishingThread

CAPACITY = 100
"""Records that wait at most; the oldest are dropped."""

_LEVELS = (
    (logging.CRITICAL, Log.FATAL),
    (logging.ERROR, Log.ERROR),
    (logging.WARNING, Log.WARN),
    (logging.NOTSET, Log.INFO),
)


class RosoutHandler(logging.Handler):
    """A handler that queues records for the publishing thread. Attach it to a logger."""

    def __init__(self, node: Node, thread: PublishingThread) -> None:
        super().__init__(logging.WARNING)
        self._publisher = qos.publisher(node, Log, "/rosout", qos.ROSOUT)
        self._name = node.get_fully_qualified_name().strip("/").replace("/", ".")
        self._records: deque[logging.LogRecord] = deque(maxlen=CAPACITY)
        self._job = thread.job("rosout", self._publish)

    @override
    def emit(self, record: logging.LogRecord) -> None:
        """Queue a record; returns at once."""
        self._records.append(record)
        self._job.ask()

    def _publish(self) -> None:
        while self._records:
            self._publisher.publish(self._message(self._records.popleft()))

    def _message(self, record: logging.LogRecord) -> Log:
        message = Log(
            level=next(level for least, level in _LEVELS if record.levelno >= least),
            name=self._name,
            msg=record.getMessage(),
            file=record.pathname,
            function=record.funcName or "",
            line=record.lineno,
        )
        set_stamp(message.stamp, int(record.created * 1e9))
        return message

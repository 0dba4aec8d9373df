"""A node with an executor and a thread of its own, for what takes its time."""

from __future__ import annotations

import threading

from rclpy.context import Context

from crtk_drivers.ros.spinning import make_executor, spin
from crtk_drivers.ros.unlocked import UnlockedNode


class SpunNode:
    """Not spun before `start`.

    Args:
        context: of the driver's node.
        name, namespace: of the node.
        thread_name: of its thread.

    Attributes:
        node: to be given its endpoints before `start`.
    """

    def __init__(self, context: Context, name: str, namespace: str, thread_name: str) -> None:
        self.node = UnlockedNode(name, namespace=namespace, context=context, enable_rosout=False)
        self._executor = make_executor(context)
        self._executor.add_node(self.node)
        self._stop = threading.Event()
        self._thread = threading.Thread(
            target=spin, args=(self._executor, self._stop), name=thread_name, daemon=True
        )

    def start(self) -> None:
        """Begin to serve callbacks."""
        self._thread.start()

    def stop(self, timeout: float) -> None:
        """End; a callback that runs is waited for, for `timeout` s."""
        self._stop.set()
        if self._thread.ident is not None:
            self._thread.join(timeout)
        self._executor.shutdown(timeout_sec=0.0)
        self.node.destroy_node()

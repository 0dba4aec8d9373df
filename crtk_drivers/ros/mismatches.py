"""Finds topics of our names that carry another type: in ROS 2 these two simply never meet.

Old CRTK clients send geometry_msgs/TransformStamped where PoseStamped is the payload since 2022.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping

from rclpy.node import Node

logger = logging.getLogger(__name__)


class TypeConflicts:
    """Compares the ROS graph with what this node uses.

    Args:
        expected: type, as ``geometry_msgs/msg/PoseStamped``, by full topic name.
    """

    def __init__(self, node: Node, expected: Mapping[str, str]) -> None:
        self._node = node
        self._expected = expected
        self._told: set[tuple[str, str]] = set()

    def check(self) -> None:
        """Log each conflict, once."""
        for topic, types in self._node.get_topic_names_and_types():
            wanted = self._expected.get(topic)
            for other in types:
                if wanted in (None, other) or (topic, other) in self._told:
                    continue
                self._told.add((topic, other))
                logger.warning(
                    "somebody uses %s with the type %s; it is %s here, and the two never meet. "
                    "Update that program.",
                    topic,
                    other,
                    wanted,
                )

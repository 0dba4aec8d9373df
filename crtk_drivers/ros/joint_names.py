"""The names of a device's joints on ROS, for programs that know several arms: with a prefix. No ROS here."""

from __future__ import annotations

from collections.abc import Sequence


class JointNames:
    """Joint names and the same with a prefix.

    Args:
        prefix: put before each on its way out, taken off on its way in; may be empty.
    """

    def __init__(self, prefix: str) -> None:
        self._prefix = prefix

    def outgoing(self, names: Sequence[str]) -> tuple[str, ...]:
        """Return the names on ROS."""
        return tuple(self._prefix + name for name in names)

    def incoming(self, names: Sequence[str]) -> tuple[str, ...]:
        """Return the device's names; one without the prefix is passed on as it is."""
        return tuple(name.removeprefix(self._prefix) for name in names)

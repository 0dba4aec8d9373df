"""Namespaces and frame names. No rclpy here: the command line checks `--ns` before it loads ROS."""

from __future__ import annotations

import re

from crtk_drivers.errors import ConfigError

NODE_NAME = "crtk_driver"
SERVICES_NODE_NAME = "crtk_driver_services"
"""Of what a device does beyond CRTK; a node of its own."""
STOPS_NODE_NAME = "crtk_driver_stops"
"""Of those services of a device that are stops: they wait for no other one."""

AMONG_DRIVERS = "drivers"
"""Topic on which the drivers of a namespace tell each other that they are there."""
DESCRIPTION = "robot_description"
"""Topic on which a device is told as URDF."""
JOINT_STATES = "joint_states"
"""Topic on which all joints are told by name."""
ACTIONS_NODE_NAME = "crtk_driver_actions"
"""Of the actions for MoveIt; a node of its own."""
ANOTHER_DRIVER = "another driver"
"""Key of the note that tells of one."""

MAX_LENGTH = 180
"""Characters of a namespace. DDS names end at 255; the rest is for node name, topic and ROS's prefixes."""

_TOKEN = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_UNUSABLE = re.compile(r"[^A-Za-z0-9_]+")


def checked_namespace(text: str, option: str = "--ns ") -> str:
    """Return `text` if it can be the namespace of a device, for example ``/ur5`` or ``/lab/left``.

    It is never rewritten: a device that listens where nobody expects it is worse than none.

    Args:
        text: to check.
        option: what stands before it where it is given, for messages.

    Raises:
        ConfigError: it cannot; the remedy gives the nearest namespace that can.
    """
    problem = _problem(text)
    if problem:
        raise ConfigError(
            f"{option}{text[:MAX_LENGTH]!r} is not a namespace: {problem}",
            remedy=f"Try: {option}{suggestion(text)}",
        )
    return text


def _problem(text: str) -> str:
    if not text.startswith("/"):
        return "it does not begin with '/'"
    if len(text) > MAX_LENGTH:
        return f"it has {len(text)} characters, {MAX_LENGTH} are possible"
    if text == "/":
        return ""
    if text.endswith("/"):
        return "it ends with '/'"
    for token in text[1:].split("/"):
        if token in ("", ".", ".."):
            return f"it holds {token!r} between two '/'"
        if "__" in token:
            return f"{token!r} holds two '_' in a row"
        if not _TOKEN.fullmatch(token):
            return f"{token!r} is not letters, digits and '_', or begins with a digit"
    return ""


def suggestion(text: str) -> str:
    """Return the valid namespace nearest to `text`."""
    tokens = []
    for token in text.split("/"):
        clean = re.sub("__+", "_", _UNUSABLE.sub("_", token.strip(" .")))
        if clean.strip("_"):
            tokens.append(f"r{clean}" if clean[0].isdigit() else clean)
    return ("/" + "/".join(tokens))[:MAX_LENGTH].rstrip("/_") or "/robot"


def default_frame_prefix(namespace: str) -> str:
    """Return what keeps the frames of two devices apart on /tf: ``ur5/`` in the namespace ``/ur5``."""
    return namespace.strip("/") + "/" if namespace.strip("/") else ""


class Frames:
    """The device's frame names and the same names on ROS, which carry a prefix.

    Args:
        prefix: put before each frame on its way out, taken off on its way in; may be empty.
        base: the frame of what has none.
    """

    def __init__(self, prefix: str, base: str) -> None:
        self._prefix = prefix
        self._outgoing = {"": prefix + base}

    def outgoing(self, frame_id: str) -> str:
        """Return the name on ROS of a frame of the device; empty means the base frame."""
        name = self._outgoing.get(frame_id)
        if name is None:
            name = self._outgoing[frame_id] = self._prefix + frame_id
        return name

    def incoming(self, frame_id: str) -> str:
        """Return the device's name of a frame; one without the prefix is passed on as it is."""
        return frame_id.removeprefix(self._prefix)

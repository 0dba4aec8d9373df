"""What the values of a device are as ROS messages, in bytes: for who publishes them, and who records them."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Final

from crtk_drivers.commands import Command, Payload
from crtk_drivers.device import Capabilities
from crtk_drivers.recording import cdr
from crtk_drivers.samples import JointState, Stamp, Value

IN_A_FRAME: Final = (
    Payload.JOINT_STATE,
    Payload.POSE,
    Payload.POSES,
    Payload.TWIST,
    Payload.WRENCH,
)
"""What names a frame. Of joints it is the one of `measured_cp`, as CRTK asks: the base frame."""

KEPT: Final = 1024
"""Messages that are kept for who wants the same: half a second of four topics at 500 Hz."""


class Messages:
    """The messages of one device. From any thread.

    Args:
        capabilities: of the device.

    Attributes:
        outgoing: what a frame of the device is called outside; empty means the base frame.
        are_shared: of a sample, a message that was made is kept: two want it.
    """

    def __init__(self, capabilities: Capabilities) -> None:
        base = capabilities.base_frame
        self.outgoing: Callable[[str], str] = lambda frame: frame or base
        self.are_shared = False
        self._joints = capabilities.joints
        self._own_frames = {"body": capabilities.tool_frame}
        if capabilities.base_pose is not None:
            self._own_frames["local"] = "local"
        self._base = base
        self._made: dict[tuple[str, int, float], bytes] = {}
        self._order: deque[tuple[str, int, float]] = deque()

    def of(self, name: str, command: Command, value: Value, stamp: Stamp) -> bytes:
        """Return the message of a value that is told.

        Args:
            name: of the command, with its sub-namespace.
            command: its row.
            value: of its type.
            stamp: `wall_ns` 0 marks data that is not valid.
        """
        if not (self.are_shared and "measured_" in name):  # a setpoint may change within a sample
            return self.encoded(name, command, value, stamp.wall_ns)
        key = name, stamp.wall_ns, stamp.monotonic
        data = self._made.get(key)
        if data is None:
            data = self._made[key] = self.encoded(name, command, value, stamp.wall_ns)
            self._order.append(key)
            if len(self._order) > KEPT:
                self._made.pop(self._order.popleft(), None)
        return data

    def encoded(self, name: str, command: Command, value: Value, stamp_ns: int) -> bytes:
        """As `of`, made anew."""
        if isinstance(value, JointState) and not value.name and "/" not in name:
            value = replace(value, name=self._joints)
        frame_id = ""
        if command.payload in IN_A_FRAME:
            own = getattr(value, "frame_id", "") or self._own_frames.get(command.frame, self._base)
            frame_id = self.outgoing(own)
        return cdr.encode(value, stamp_ns, frame_id)

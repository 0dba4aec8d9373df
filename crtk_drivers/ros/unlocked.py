"""A node whose publishers let go of Python's global lock while they are inside DDS.

rclpy's own `publish` keeps the lock. A DDS writer can block for a third of a second, and then every thread
of the process stands still, the I/O threads first. Here a message is bytes already, or is serialised with the
lock held, which touches no writer, and is handed to rcl by ctypes, which releases the lock for the time of
the call.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.serialization import serialize_message
from rclpy.subscription import Subscription
from rclpy.waitable import Waitable


class _SerializedMessage(ctypes.Structure):
    """``rcutils_uint8_array_t`` (rcutils/types/uint8_array.h); rcl only reads it."""

    _fields_ = (
        ("buffer", ctypes.c_char_p),
        ("length", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", ctypes.c_void_p * 5),
    )


class _ErrorText(ctypes.Structure):
    """``rcutils_error_string_t`` (rcutils/error_handling.h)."""

    _fields_ = (("text", ctypes.c_char * 1024),)


# Both are in this process already: rclpy is linked with them.
_rcutils = ctypes.CDLL("librcutils.so")
_rcutils.rcutils_get_error_string.restype = _ErrorText
_publish = ctypes.CDLL("librcl.so").rcl_publish_serialized_message
_publish.argtypes = (ctypes.c_void_p, ctypes.POINTER(_SerializedMessage), ctypes.c_void_p)
_publish.restype = ctypes.c_int


def rcl_error() -> str:
    """Return the reason of rcl's last failure in this thread, and forget it there."""
    text: bytes = _rcutils.rcutils_get_error_string().text
    _rcutils.rcutils_reset_error()
    return text.decode(errors="replace")


class UnlockedPublisher(Publisher):  # type: ignore[misc]  # rclpy has no types
    """A publisher that does not stop other threads. Made by `UnlockedNode`."""

    def publish(self, msg: Any) -> None:
        """Send a message, or what is one already, as bytes of CDR.

        Raises:
            RuntimeError: DDS refused it, with its reason.
        """
        data = msg if isinstance(msg, bytes) else serialize_message(msg)
        wire = _SerializedMessage(data, len(data), len(data))
        handle = self.handle
        with handle:
            failed = _publish(handle.pointer, wire, None)
        if failed:
            raise RuntimeError(f"DDS did not take a message: {rcl_error()}")


class UnlockedNode(Node):  # type: ignore[misc]  # rclpy has no types
    """A node that makes such publishers, those of rclpy's own topics included."""

    def __init__(self, *args: Any, **options: Any) -> None:
        self._read_otherwise: list[Subscription] = []
        super().__init__(*args, **options)

    def create_publisher(self, *args: Any, **options: Any) -> Publisher:
        """See rclpy."""
        return super().create_publisher(*args, **options, publisher_class=UnlockedPublisher)

    def has_overrides(self, prefix: str) -> bool:
        """Say whether a parameter whose name begins with `prefix` was given at the start."""
        return any(name.startswith(prefix) for name in self._parameter_overrides)

    def read_by(self, subscription: Subscription, reader: Waitable) -> None:
        """Let `reader` take the messages of a subscription of this node, which no executor has yet."""
        self._read_otherwise.append(subscription)
        self.add_waitable(reader)

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """Those that the executor reads."""
        return (one for one in super().subscriptions if one not in self._read_otherwise)

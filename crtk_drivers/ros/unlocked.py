"""A node whose publishers let go of Python's global lock while they are inside DDS.

rclpy's own `publish` keeps the lock. A DDS writer can block for a third of a second, and then every thread
of the process stands still, the I/O threads first. Here a message is bytes already, or is serialised with the
lock held, which touches no writer, and is handed to rcl by ctypes, which releases the lock for the time of
the call.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from typing import Any, Final

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.serialization import serialize_message
from rclpy.service import Service
from rclpy.subscription import Subscription
from rclpy.waitable import Waitable

_FIRST_SIZE = 1024


class _SentMessage(ctypes.Structure):
    """``rcutils_uint8_array_t`` (rcutils/types/uint8_array.h); rcl only reads it."""

    _fields_ = (
        ("buffer", ctypes.c_char_p),
        ("length", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", ctypes.c_void_p * 5),
    )


class _Allocator(ctypes.Structure):
    """``rcutils_allocator_t`` (rcutils/allocator.h)."""

    _fields_ = (("functions", ctypes.c_void_p * 4), ("state", ctypes.c_void_p))


class SerializedMessage(ctypes.Structure):
    """``rcutils_uint8_array_t`` that rcl writes into, and makes larger where it must; see `new_message`."""

    _fields_ = (
        ("buffer", ctypes.c_void_p),
        ("length", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", _Allocator),
    )

    def release(self) -> None:
        """Give its memory back."""
        _rcutils.rcutils_uint8_array_fini(ctypes.byref(self))


class _ErrorText(ctypes.Structure):
    """``rcutils_error_string_t`` (rcutils/error_handling.h)."""

    _fields_ = (("text", ctypes.c_char * 1024),)


# Both are in this process already: rclpy is linked with them.
_rcutils = ctypes.CDLL("librcutils.so")
_rcutils.rcutils_get_error_string.restype = _ErrorText
_rcutils.rcutils_get_default_allocator.restype = _Allocator
_rcutils.rcutils_uint8_array_init.argtypes = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p)
_rcutils.rcutils_uint8_array_fini.argtypes = (ctypes.c_void_p,)
_publish = ctypes.CDLL("librcl.so").rcl_publish_serialized_message
_publish.argtypes = (ctypes.c_void_p, ctypes.POINTER(_SentMessage), ctypes.c_void_p)
_publish.restype = ctypes.c_int
_wait_for_all_acked = ctypes.CDLL("librcl.so").rcl_publisher_wait_for_all_acked
_wait_for_all_acked.argtypes = (ctypes.c_void_p, ctypes.c_int64)
_wait_for_all_acked.restype = ctypes.c_int
_TIMEOUT: Final = 2  # RCL_RET_TIMEOUT (rcl/types.h)


def new_message() -> SerializedMessage:
    """Return memory for a message of any size."""
    message = SerializedMessage()
    allocator = _rcutils.rcutils_get_default_allocator()
    if _rcutils.rcutils_uint8_array_init(
        ctypes.byref(message), _FIRST_SIZE, ctypes.byref(allocator)
    ):
        raise MemoryError("no memory for a message")
    return message


def rcl_error() -> str:
    """Return the reason of rcl's last failure in this thread, and forget it there."""
    text: bytes = _rcutils.rcutils_get_error_string().text
    _rcutils.rcutils_reset_error()
    return text.decode(errors="replace")


def is_acknowledged(publisher: Publisher, timeout: float) -> bool:
    """Return whether all who listen reliably have acknowledged within `timeout` s what was published.

    rclpy's own `wait_for_all_acked` keeps Python's lock: no other thread would run meanwhile.

    Raises:
        InvalidHandle: the publisher was destroyed.
        RuntimeError: the middleware cannot tell, with its reason.
    """
    handle = publisher.handle
    with handle:
        failed = _wait_for_all_acked(handle.pointer, int(timeout * 1e9))
    if not failed:
        return True
    reason = rcl_error()
    if failed == _TIMEOUT:
        return False
    raise RuntimeError(f"DDS does not say whether a message arrived: {reason}")


class UnlockedPublisher(Publisher):  # type: ignore[misc]  # rclpy has no types
    """A publisher that does not stop other threads. Made by `UnlockedNode`."""

    def publish(self, msg: Any) -> None:
        """Send a message, or what is one already, as bytes of CDR.

        Raises:
            RuntimeError: DDS refused it, with its reason.
        """
        data = msg if isinstance(msg, bytes) else serialize_message(msg)
        wire = _SentMessage(data, len(data), len(data))
        handle = self.handle
        with handle:
            failed = _publish(handle.pointer, wire, None)
        if failed:
            raise RuntimeError(f"DDS did not take a message: {rcl_error()}")


class UnlockedNode(Node):  # type: ignore[misc]  # rclpy has no types
    """A node that makes such publishers, those of rclpy's own topics included."""

    def __init__(self, *args: Any, **options: Any) -> None:
        self._read_otherwise: list[Subscription] = []
        self._served_otherwise: list[Service] = []
        super().__init__(*args, **options)

    def create_publisher(self, *args: Any, **options: Any) -> Publisher:
        """See rclpy."""
        return super().create_publisher(*args, **options, publisher_class=UnlockedPublisher)

    def has_overrides(self, prefix: str) -> bool:
        """Say whether a parameter whose name begins with `prefix` was given at the start."""
        return any(name.startswith(prefix) for name in self._parameter_overrides)

    def read_by(self, subscription: Subscription, reader: Waitable) -> None:
        """Let `reader` take the messages of a subscription of this node, which no executor has yet."""
        self.leave_to_others(subscription)
        self.add_waitable(reader)

    def leave_to_others(self, subscription: Subscription) -> None:
        """Let no executor read a subscription of this node, which none has yet."""
        self._read_otherwise.append(subscription)

    def serve_by(self, service: Service, server: Waitable) -> None:
        """Let `server` take the requests of a service of this node, which no executor has yet."""
        self._served_otherwise.append(service)
        self.add_waitable(server)

    @property
    def services(self) -> Iterator[Service]:
        """Those that the executor reads."""
        return (one for one in super().services if one not in self._served_otherwise)

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """Those that the executor reads."""
        return (one for one in super().subscriptions if one not in self._read_otherwise)

"""Services that leave Python's global lock alone, and answer when they like.

rclpy takes a request, makes Python objects of all that is in it, and sends the response, all with the lock
held: of a trajectory of a hundred thousand points for six seconds, in which no I/O thread runs. Here rcl and
the type support are called by ctypes, which lets go of the lock; only a message that is wanted as a Python
object becomes one.
"""

from __future__ import annotations

import ctypes
import logging
from collections.abc import Callable
from typing import Any

from rclpy.service import Service
from rclpy.waitable import NumberOfEntities, Waitable

from crtk_drivers.ros.arrival import Arrival, Requests
from crtk_drivers.ros.message_types import MessageType
from crtk_drivers.ros.unlocked import UnlockedNode, new_message, rcl_error

logger = logging.getLogger(__name__)

_NOTHING_THERE = 601  # RCL_RET_SERVICE_TAKE_FAILED (rcl/types.h)


class _RequestId(ctypes.Structure):
    """``rmw_request_id_t`` (rmw/types.h)."""

    _fields_ = (("writer_guid", ctypes.c_int8 * 16), ("sequence_number", ctypes.c_int64))


class _ServiceInfo(ctypes.Structure):
    """``rmw_service_info_t`` (rmw/types.h)."""

    _fields_ = (
        ("source_timestamp", ctypes.c_int64),
        ("received_timestamp", ctypes.c_int64),
        ("request_id", _RequestId),
    )


# It is in this process already, and rmw among the libraries that it is linked with.
_rcl = ctypes.CDLL("librcl.so")
_take = _rcl.rcl_take_request_with_info
_take.argtypes = (ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p)
_send = _rcl.rcl_send_response
_send.argtypes = (ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p)
_serialize = _rcl.rmw_serialize
_serialize.argtypes = (ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p)


class _Messages(MessageType):
    """A type of requests or responses."""

    def as_bytes(self, message: int) -> bytes:
        """Return a message as CDR."""
        wire = new_message()
        try:
            if _serialize(message, self.support, ctypes.byref(wire)):
                raise RuntimeError(f"a request could not be read: {rcl_error()}")
            return ctypes.string_at(wire.buffer, wire.length)
        finally:
            wire.release()


class UnlockedService(Waitable):  # type: ignore[misc]  # rclpy has no types
    """Reads a service in the executor's stead.

    Args:
        node: not given to an executor yet.
        kind: of the service.
        name: of the service.
        receive: called by the executor's thread with each request, what sends its response: once, now
            or later, from any thread; and when it came.
        takes_bytes: requests are handed over as CDR.

    Attributes:
        service: of rclpy.
    """

    def __init__(
        self,
        node: UnlockedNode,
        kind: Any,
        name: str,
        receive: Callable[[Any, Callable[[Any], None], Arrival], None],
        takes_bytes: bool = False,
    ) -> None:
        self.service: Service = node.create_service(kind, name, _unread)
        super().__init__(self.service.callback_group)
        self._name = name
        self._handle = self.service.handle
        self._receive = receive
        self._takes_bytes = takes_bytes
        self._requests, self._responses = _Messages(kind.Request), _Messages(kind.Response)
        self._arrivals = Requests()
        self._index = -1
        node.serve_by(self.service, self)

    def __enter__(self) -> None:
        self._handle.__enter__()

    def __exit__(self, *error: object) -> None:
        self._handle.__exit__(*error)

    def get_num_entities(self) -> NumberOfEntities:
        """See rclpy."""
        return NumberOfEntities(num_services=1)

    def add_to_wait_set(self, wait_set: Any) -> None:
        """See rclpy."""
        self._index = wait_set.add_service(self._handle)

    def is_ready(self, wait_set: Any) -> bool:
        """See rclpy."""
        return bool(wait_set.is_ready("service", self._index))

    def take_data(self) -> None:
        """Hand over the next request. What anybody can send must not end the executor."""
        try:
            taken = self._taken()
            if taken is not None:
                self._receive(*taken)
        except Exception:
            logger.exception("a request to %s failed", self._name)

    async def execute(self, nothing: None) -> None:
        """See rclpy. `take_data` has done it."""

    def _taken(self) -> tuple[Any, Callable[[Any], None], Arrival] | None:
        info = _ServiceInfo()
        messages = self._requests
        message = messages.create()
        try:
            with self._handle:
                failed = _take(self._handle.pointer, ctypes.byref(info), message)
            if failed:
                text = rcl_error()
                if failed == _NOTHING_THERE:
                    return None
                raise RuntimeError(f"DDS did not hand over a request: {text}")
            read = messages.as_bytes if self._takes_bytes else messages.to_python
            request = read(message)
        finally:
            messages.destroy(message)
        requester = info.request_id
        return (
            request,
            lambda response: self._reply(response, requester),
            self._arrivals.arrival(
                bytes(requester.writer_guid), info.received_timestamp, info.source_timestamp
            ),
        )

    def _reply(self, response: Any, requester: _RequestId) -> None:
        messages = self._responses
        message = messages.create()
        try:
            if not messages.from_python(response, message):
                raise ValueError(f"this is no response of {self._name}: {response}")
            with self._handle:
                failed = _send(self._handle.pointer, ctypes.byref(requester), message)
            if failed:
                logger.warning("a response of %s was not sent: %s", self._name, rcl_error())
        finally:
            messages.destroy(message)


def _unread(request: Any, response: Any) -> Any:
    """The callback of a service that an `UnlockedService` reads."""
    return response

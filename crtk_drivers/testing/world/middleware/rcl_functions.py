"""Functions of rcl that are called by ctypes, in a world. What is not here is refused by its name."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from crtk_drivers.testing.world.machine import files
from crtk_drivers.testing.world.machine.kernel import NotSimulated
from crtk_drivers.testing.world.middleware.message_bytes import (
    ByteArray,
    message_type,
    rmw_serialize,
)
from crtk_drivers.testing.world.middleware.rclpy_endpoints import Publisher, Service, Subscription
from crtk_drivers.testing.world.middleware.rclpy_handles import handle_of

_OK, _TIMEOUT, _PUBLISHER_INVALID = 0, 2, 300  # rcl/types.h
_NO_MESSAGE, _NO_REQUEST = 401, 601
_ONE: Final = (1).to_bytes(8, "little")


def _publish(pointer: int, message: Any, _: None) -> int:
    found = ByteArray.from_buffer(message)
    publisher: Publisher = handle_of(pointer)
    if not publisher.is_valid:
        return _PUBLISHER_INVALID
    publisher.publish_raw(ctypes.string_at(found.buffer, found.length))
    return _OK


def _await_acknowledgement(pointer: int, timeout: int) -> int:
    publisher: Publisher = handle_of(pointer)
    return _OK if publisher.is_acknowledged(timeout) else _TIMEOUT


def _take_message(pointer: int, message: Any, info: Any, _: None) -> int:
    subscription: Subscription = handle_of(pointer)
    taken = subscription.take()
    if taken is None:
        return _NO_MESSAGE
    ByteArray.from_buffer(_given(message)).put(taken.sample.data)
    told = _given(info)
    told.source_timestamp = taken.sample.sent_ns
    told.received_timestamp = taken.received_ns
    told.publication_sequence_number = taken.sample.number
    told.gid[:] = taken.gid
    return _OK


def _count_messages(pointer: int, function: Any, descriptor: int) -> int:
    """Let each message write into an eventfd: no other function is called here."""
    subscription: Subscription = handle_of(pointer)
    subscription.tell = None
    if function is not None:
        file = files.find(descriptor)
        subscription.tell = lambda: file.write(_ONE) if file.is_open else None
        subscription.changed()
    return _OK


def _take_request(pointer: int, info: Any, message: int) -> int:
    service: Service = handle_of(pointer)
    taken = service.take()
    if taken is None or taken.sample.related is None:
        return _NO_REQUEST
    told = _given(info)
    told.source_timestamp = told.received_timestamp = taken.sample.sent_ns
    client, told.request_id.sequence_number = taken.sample.related
    ctypes.memmove(told.request_id.writer_guid, client, len(client))
    return message_type(service.kind.Request).decode_into(taken.sample.data, message)


def _respond(pointer: int, requester: Any, message: int) -> int:
    service: Service = handle_of(pointer)
    response = message_type(service.kind.Response)
    identity = _given(requester)
    related = bytes(identity.writer_guid), identity.sequence_number
    sent = service.respond(response.encode(response.to_python(message)), related)
    return _OK if sent else _TIMEOUT


def _given(reference: Any) -> Any:
    """Return what was given to `ctypes.byref`."""
    return reference._obj  # noqa: SLF001


_FUNCTIONS: Final[dict[str, Callable[..., int]]] = {
    "rcl_publish_serialized_message": _publish,
    "rcl_publisher_wait_for_all_acked": _await_acknowledgement,
    "rcl_send_response": _respond,
    "rcl_subscription_set_on_new_message_callback": _count_messages,
    "rcl_take_request_with_info": _take_request,
    "rcl_take_serialized_message": _take_message,
    "rmw_serialize": rmw_serialize,
}


class _Function:
    """A function of a library, which may be given types that it does not need."""

    def __init__(self, function: Callable[..., int]) -> None:
        self._function = function
        self.argtypes: Any = ()
        self.restype: Any = None

    def __call__(self, *given: Any) -> int:
        return self._function(*given)


class Rcl:
    """The library, as `ctypes.CDLL` has it."""

    def __getattr__(self, name: str) -> _Function:
        if name.startswith("__"):
            raise AttributeError(name)

        def refuse(*_: object) -> int:
            raise NotSimulated(f"{name} of librcl")

        return _Function(_FUNCTIONS.get(name, refuse))


class Library(ctypes.CDLL):
    """As `ctypes.CDLL`; rcl is that of the world."""

    def __new__(cls, name: Any = None, *_: Any, **__: Any) -> Any:
        """Return the library, or the world's own."""
        if name is not None and Path(str(name)).name.startswith("librcl.so"):
            return Rcl()
        return super().__new__(cls)

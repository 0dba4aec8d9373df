"""Messages as bytes of CDR. Equal messages are equal bytes: rmw leaves between fields what was in memory."""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any, Final

from crtk_drivers.ros.message_types import MessageType

REAL_LIBRARY: Final = ctypes.CDLL
_AT_FIRST: Final = 4096


class _Allocator(ctypes.Structure):
    """``rcutils_allocator_t`` (rcutils/allocator.h)."""

    _fields_ = (("functions_and_state", ctypes.c_void_p * 5),)


class ByteArray(ctypes.Structure):
    """``rcutils_uint8_array_t`` (rcutils/types/uint8_array.h)."""

    _fields_ = (
        ("buffer", ctypes.c_void_p),
        ("length", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", _Allocator),
    )

    def make_room(self, size: int) -> None:
        """Have a capacity of so many bytes at least."""
        if self.capacity < size:
            resize = _rcutils().rcutils_uint8_array_resize
            resize(ctypes.byref(self), ctypes.c_size_t(size))

    def put(self, data: bytes) -> None:
        """Hold these bytes."""
        self.make_room(len(data))
        ctypes.memmove(self.buffer, data, len(data))
        self.length = len(data)


@cache
def _rcutils() -> Any:
    library = REAL_LIBRARY("librcutils.so")
    library.rcutils_get_default_allocator.restype = _Allocator
    return library


@cache
def _rmw() -> Any:
    return REAL_LIBRARY("librcl.so")  # is linked with it


def new_bytes() -> ByteArray:
    """Return an array that holds nothing."""
    made = ByteArray()
    allocator = _rcutils().rcutils_get_default_allocator()
    _rcutils().rcutils_uint8_array_init(
        ctypes.byref(made), ctypes.c_size_t(_AT_FIRST), ctypes.byref(allocator)
    )
    return made


def rmw_serialize(message: Any, support: Any, wire: Any) -> int:
    """As rmw, with zeros between the fields; `wire` is what `ctypes.byref` returns of an array."""
    found = ByteArray.from_buffer(wire._obj)  # noqa: SLF001
    while True:
        before = found.capacity
        ctypes.memset(found.buffer, 0, before)
        failed = _rmw().rmw_serialize(ctypes.c_void_p(message), ctypes.c_void_p(support), wire)
        if failed or found.capacity == before:
            return int(failed)


class _EncodedType(MessageType):
    """A type of messages that are written and read here."""

    def encode(self, message: Any) -> bytes:
        """Return a message as CDR.

        Raises:
            ValueError: rmw cannot write it.
        """
        made = self.create()
        try:
            self.from_python(message, made)
            wire = new_bytes()
            try:
                if rmw_serialize(made, self.support, ctypes.byref(wire)):
                    raise ValueError(f"{message} cannot be serialized")
                return ctypes.string_at(wire.buffer, wire.length)
            finally:
                _rcutils().rcutils_uint8_array_fini(ctypes.byref(wire))
        finally:
            self.destroy(made)

    def decode_into(self, data: bytes, message: int) -> int:
        """Write what CDR says into a message in C; return rmw's answer, 0 if that went well."""
        held = ctypes.create_string_buffer(data, len(data))
        wire = ByteArray(ctypes.addressof(held), len(data), len(data))
        return int(
            _rmw().rmw_deserialize(
                ctypes.byref(wire), ctypes.c_void_p(self.support), ctypes.c_void_p(message)
            )
        )


@cache
def message_type(kind: Any) -> _EncodedType:
    """Return the C side of a type."""
    return _EncodedType(kind)


def serialize(message: Any, kind: Any) -> bytes:
    """As rclpy's ``rclpy_serialize``."""
    return message_type(kind).encode(message)

"""Messages as bytes of CDR. Equal messages are equal bytes: rmw leaves between fields what was in memory."""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any, Final

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


_python = ctypes.PyDLL(None)
_python.PyCapsule_GetPointer.restype = ctypes.c_void_p
_python.PyCapsule_GetPointer.argtypes = (ctypes.py_object, ctypes.c_char_p)
_python.PyCapsule_GetName.restype = ctypes.c_char_p
_python.PyCapsule_GetName.argtypes = (ctypes.py_object,)

_Create = ctypes.CFUNCTYPE(ctypes.c_void_p)
_Destroy = ctypes.CFUNCTYPE(None, ctypes.c_void_p)
_ToPython = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.c_void_p)
_FromPython = ctypes.PYFUNCTYPE(ctypes.c_bool, ctypes.py_object, ctypes.c_void_p)


class MessageType:
    """The C side of a type of messages, which rosidl_generator_py keeps in capsules of its metaclass.

    Attributes:
        support: its ``rosidl_message_type_support_t``.
    """

    def __init__(self, kind: Any) -> None:
        kind.__class__.__import_type_support__()
        held = vars(kind.__class__)

        def pointer(name: str) -> Any:
            return _python.PyCapsule_GetPointer(held[name], _python.PyCapsule_GetName(held[name]))

        self._create = _Create(pointer("_CREATE_ROS_MESSAGE"))
        self._destroy = _Destroy(pointer("_DESTROY_ROS_MESSAGE"))
        self._from_python = _FromPython(pointer("_CONVERT_FROM_PY"))
        self.to_python = _ToPython(pointer("_CONVERT_TO_PY"))
        self.support = pointer("_TYPE_SUPPORT")

    def encode(self, message: Any) -> bytes:
        """Return a message as CDR.

        Raises:
            ValueError: rmw cannot write it.
        """
        made = self._create()
        try:
            self._from_python(message, made)
            wire = new_bytes()
            try:
                if rmw_serialize(made, self.support, ctypes.byref(wire)):
                    raise ValueError(f"{message} cannot be serialized")
                return ctypes.string_at(wire.buffer, wire.length)
            finally:
                _rcutils().rcutils_uint8_array_fini(ctypes.byref(wire))
        finally:
            self._destroy(made)

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
def message_type(kind: Any) -> MessageType:
    """Return the C side of a type."""
    return MessageType(kind)


def serialize(message: Any, kind: Any) -> bytes:
    """As rclpy's ``rclpy_serialize``."""
    return message_type(kind).encode(message)

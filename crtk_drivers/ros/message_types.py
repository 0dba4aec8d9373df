"""The C side of types of messages. No rclpy here."""

from __future__ import annotations

import ctypes
from typing import Any

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

    Args:
        kind: the class in Python.

    Attributes:
        create, destroy: make a message, and give its memory back.
        to_python, from_python: copy one.
        support: its ``rosidl_message_type_support_t``.
    """

    def __init__(self, kind: Any) -> None:
        kind.__class__.__import_type_support__()
        held = vars(kind.__class__)

        def pointer(name: str) -> Any:
            return _python.PyCapsule_GetPointer(held[name], _python.PyCapsule_GetName(held[name]))

        self.create = _Create(pointer("_CREATE_ROS_MESSAGE"))
        self.destroy = _Destroy(pointer("_DESTROY_ROS_MESSAGE"))
        self.to_python = _ToPython(pointer("_CONVERT_TO_PY"))
        self.from_python = _FromPython(pointer("_CONVERT_FROM_PY"))
        self.support = pointer("_TYPE_SUPPORT")

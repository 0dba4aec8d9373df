"""The vendor's library by ctypes: the functions of DHD and DRD that are called, as a table.

From the documentation of the Force Dimension SDK 3 (DHD and DRD API). A device is a ``char``; a function
returns a negative number when it fails, and dhdErrorGetLastStr says why. DHD_TIMEGUARD (1: nothing newer than
last time) and DHD_MOTOR_SATURATED (2) are no failures.
"""

from __future__ import annotations

import ctypes
import os
import platform
from collections.abc import Callable, Iterator, Mapping
from ctypes import POINTER, c_bool, c_byte, c_char_p, c_double, c_int, c_ubyte, c_uint, c_ushort
from pathlib import Path
from typing import Any, Final

from crtk_drivers.kit.haptics.servo import HandError

__all__ = ["SATURATED", "Library", "find"]

SATURATED: Final = 2
MAJOR: Final = 3
"""Major version of the SDK that is known."""

_MATRIX: Final = (c_double * 3) * 3
_OUT: Final = POINTER(c_double)
_ID: Final = c_byte

FUNCTIONS: Final[Mapping[str, tuple[Any, ...]]] = {
    # name: what it returns, what it takes
    "dhdGetSDKVersion": (None, *(POINTER(c_int),) * 4),
    "dhdErrorGetLastStr": (c_char_p,),
    "dhdEnableExpertMode": (c_int,),
    "dhdGetDeviceCount": (c_int,),
    "drdOpenID": (c_int, _ID),
    "drdClose": (c_int, _ID),
    "dhdGetSystemName": (c_char_p, _ID),
    "dhdGetSystemType": (c_int, _ID),
    "dhdGetSerialNumber": (c_int, POINTER(c_ushort), _ID),
    "dhdIsLeftHanded": (c_bool, _ID),
    "dhdHasWrist": (c_bool, _ID),
    "dhdHasActiveWrist": (c_bool, _ID),
    "dhdHasGripper": (c_bool, _ID),
    "dhdHasActiveGripper": (c_bool, _ID),
    "dhdGetStatus": (c_int, POINTER(c_int), _ID),
    "dhdEnableForce": (c_int, c_ubyte, _ID),
    "dhdSetGravityCompensation": (c_int, c_int, _ID),
    "dhdSetWatchdog": (c_int, c_ubyte, _ID),
    "dhdGetWatchdog": (c_int, POINTER(c_ubyte), _ID),
    "drdIsInitialized": (c_bool, _ID),
    "drdAutoInit": (c_int, _ID),
    "drdStop": (c_int, c_bool, _ID),
    "dhdGetPositionAndOrientationFrame": (c_int, _OUT, _OUT, _OUT, _MATRIX, _ID),
    "dhdGetLinearVelocity": (c_int, _OUT, _OUT, _OUT, _ID),
    "dhdGetAngularVelocityRad": (c_int, _OUT, _OUT, _OUT, _ID),
    "dhdGetGripperAngleRad": (c_int, _OUT, _ID),
    "dhdGetGripperAngularVelocityRad": (c_int, _OUT, _ID),
    "dhdGetButtonMask": (c_uint, _ID),
    "dhdGetForceAndTorqueAndGripperForce": (c_int, *(_OUT,) * 7, _ID),
    "dhdSetForceAndTorqueAndGripperForce": (c_int, *(c_double,) * 7, _ID),
}

INSTALL: Final = (
    "Install the Force Dimension SDK (forcedimension.com, it is free), and set FDSDK to its folder or "
    "`library` to its libdrd.so."
)


def find(path: str) -> Iterator[str]:
    """Yield where the library may be: at `path` alone if that is given."""
    if path:
        yield path
        return
    root = os.environ.get("FDSDK")
    if root:
        folder = Path(root) / "lib" / "release" / f"lin-{platform.machine()}-gcc"
        yield from map(str, sorted(folder.glob("libdrd.so*"), reverse=True))
    yield from ("libdrd.so.3", "libdrd.so")


class Library:
    """The library, loaded; only in a process of its own.

    Args:
        path: of it; looked for if empty.

    Raises:
        HandError: it is not there, another version, or another library.
    """

    def __init__(self, path: str) -> None:
        failures = []
        for place in find(path):
            try:
                self._library = ctypes.CDLL(place)
                break
            except OSError as error:
                failures.append(str(error))
        else:
            raise HandError(f"its library cannot be loaded: {'; '.join(failures)}", INSTALL)
        self._functions: dict[str, Callable[..., Any]] = {}
        for name, (returns, *takes) in FUNCTIONS.items():
            function = getattr(self._library, name, None)
            if function is None:
                raise HandError(
                    f"its library {place} has no {name}",
                    f"It must be libdrd of SDK {MAJOR}, not libdhd. {INSTALL}",
                )
            function.restype, function.argtypes = returns, takes
            self._functions[name] = function
        numbers = [c_int() for _ in range(4)]
        self._functions["dhdGetSDKVersion"](*map(ctypes.byref, numbers))
        self.version = ".".join(str(number.value) for number in numbers)
        if numbers[0].value != MAJOR:
            raise HandError(
                f"its library {place} is of SDK {self.version}, and this driver knows {MAJOR}",
                INSTALL,
            )

    def ask(self, name: str, *arguments: Any) -> Any:
        """Call a function, and return what it returns."""
        return self._functions[name](*arguments)

    def call(self, name: str, *arguments: Any) -> int:
        """Call a function that may fail, and return what it returns.

        Raises:
            HandError: it failed, with the library's words.
        """
        result = int(self._functions[name](*arguments))
        if result < 0:
            told = self._functions["dhdErrorGetLastStr"]() or b"no reason"
            raise HandError(
                f"{name}: {told.decode(errors='replace')}",
                "Look at its cable and its power; it is opened again by itself.",
            )
        return result

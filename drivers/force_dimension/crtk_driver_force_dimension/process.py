"""The process that owns the vendor's library: ``python -m crtk_driver_force_dimension.process FD``."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Mapping
from ctypes import c_double
from typing import Any, Final

from crtk_driver_force_dimension.library import SATURATED, Library
from crtk_drivers.kit.child_process import Parent
from crtk_drivers.kit.haptics.fixtures import Motion
from crtk_drivers.kit.haptics.servo import HandError, HandReading, HandState, Servo
from crtk_drivers.kit.haptics.triples import Triple, quaternion

__all__ = ["DhdHand"]

FORCE: Final = 5
GRAVITY: Final = 10
FORCE_OFF_CAUSE: Final = 14
"""Indices of dhdGetStatus."""
MOST_STATUS: Final = 32
"""ints that it may write: DHD_MAX_STATUS grows, and is 17 in SDK 3.14 (forcedimension-core)."""

WATCHDOG: Final = 3
CAUSES: Final[Mapping[int, tuple[str, bool]]] = {
    0: ("for no reason that it tells", True),
    1: ("by its force button", False),
    2: ("since it moved too fast", True),
    3: ("by its watchdog", True),
    4: ("by another program", True),
    5: ("since USB was unplugged", True),
    6: ("by its dead man's switch", False),
}
"""Why forces are off (DHD_FORCEOFF_*), and whether that is a fault: else somebody at the device did it."""


class DhdHand:
    """A device by libdrd."""

    def __init__(self) -> None:
        self._library: Library | None = None
        self._id = -1
        self._sign = 1.0
        self._has_gripper = False
        self._numbers = [c_double() for _ in range(7)]
        self._refs = [ctypes.byref(number) for number in self._numbers]
        self._matrix = ((c_double * 3) * 3)()
        self._status = (ctypes.c_int * MOST_STATUS)()

    def open(self, options: Mapping[str, Any]) -> Mapping[str, Any]:
        """See `Hand.open`."""
        self._library = library = Library(options["library"])
        library.call("dhdEnableExpertMode")
        index, count = options["index"], library.call("dhdGetDeviceCount")
        if index >= count:
            raise HandError(
                f"there are {count} devices, and it would be number {index}, from 0",
                "Look at its cable and its power, and whether you may use it (udev rules of the SDK).",
            )
        self._id = opened = library.call("drdOpenID", index)
        serial = self._check(library, options)
        library.call("dhdEnableForce", 0, opened)  # whatever was left on
        self._set_watchdog(library, options["watchdog"])
        library.call("dhdSetGravityCompensation", int(options["gravity_compensation"]), opened)
        is_left = bool(library.ask("dhdIsLeftHanded", opened))
        self._sign = -1.0 if is_left else 1.0
        self._has_gripper = bool(library.ask("dhdHasGripper", opened))
        name = library.ask("dhdGetSystemName", opened) or b""
        hand = "left" if is_left else "right"
        return {"name": name.decode(), "serial": serial, "hand": hand, "SDK": library.version}

    def _check(self, library: Library, options: Mapping[str, Any]) -> int:
        """Make sure that it is the device that was configured; return its serial number."""
        number = ctypes.c_ushort()
        library.call("dhdGetSerialNumber", ctypes.byref(number), self._id)
        wanted = options["serial"]
        if wanted is not None and wanted != number.value:
            raise HandError(
                f"its serial number is {number.value}, not {wanted}",
                "Give `index` of the other one, or its `serial`.",
            )
        kind = library.call("dhdGetSystemType", self._id)
        name = (library.ask("dhdGetSystemName", self._id) or b"").decode()
        has = (
            bool(library.ask("dhdHasActiveWrist", self._id)),
            bool(library.ask("dhdHasGripper", self._id)),
            bool(library.ask("dhdHasActiveGripper", self._id)),
        )
        if kind not in options["types"] or has != tuple(options["has"]):
            raise HandError(
                f"it is another device than {options['model']}: {name} (type {kind}; active wrist, gripper, "
                f"active gripper: {', '.join('yes' if each else 'no' for each in has)})",
                "Correct `model`.",
            )
        return number.value

    def _set_watchdog(self, library: Library, ticks: int) -> None:
        """Let the device end forces by itself, and believe it when it is read back."""
        library.call("dhdSetWatchdog", ticks, self._id)
        held = ctypes.c_ubyte()
        library.call("dhdGetWatchdog", ctypes.byref(held), self._id)
        if held.value != ticks:
            raise HandError(
                f"its watchdog was set to {ticks} and is {held.value}",
                "Without it nothing ends its forces when this computer hangs. Its firmware may be too old.",
            )

    @property
    def _open(self) -> Library:
        if self._library is None or self._id < 0:
            raise HandError("it is not open")
        return self._library

    def close(self) -> None:
        """See `Hand.close`."""
        library, index = self._library, self._id
        self._library, self._id = None, -1
        if library is None or index < 0:
            return
        # Each is tried though another fails.
        library.ask("dhdSetForceAndTorqueAndGripperForce", *(0.0,) * 7, index)
        library.ask("dhdEnableForce", 0, index)
        library.call("drdClose", index)

    def read(self) -> HandReading:
        """See `Hand.read`."""
        call, refs, index = self._open.call, self._refs, self._id
        call("dhdGetPositionAndOrientationFrame", *refs[:3], self._matrix, index)
        position, orientation = self._three(), quaternion([tuple(row) for row in self._matrix])
        call("dhdGetLinearVelocity", *refs[:3], index)
        velocity = self._three()
        call("dhdGetAngularVelocityRad", *refs[:3], index)
        turning = self._three()
        call("dhdGetForceAndTorqueAndGripperForce", *refs, index)
        force, torque = self._three(), self._three(3)
        grip = self._sign * self._numbers[6].value
        angle = speed = 0.0
        if self._has_gripper:
            call("dhdGetGripperAngleRad", refs[0], index)
            call("dhdGetGripperAngularVelocityRad", refs[1], index)
            angle, speed = (self._sign * number.value for number in self._numbers[:2])
        buttons = int(self._open.ask("dhdGetButtonMask", index))
        motion = Motion(position, orientation, velocity, turning)
        return HandReading(motion, force, torque, angle, speed, grip, buttons)

    def _three(self, first: int = 0) -> Triple:
        x, y, z = self._numbers[first : first + 3]
        return (x.value, y.value, z.value)

    def state(self) -> HandState:
        """See `Hand.state`."""
        library = self._open
        library.call("dhdGetStatus", self._status, self._id)
        cause = self._status[FORCE_OFF_CAUSE]
        words, is_fault = CAUSES.get(cause, (f"for an unknown reason ({cause})", True))
        return HandState(
            bool(library.ask("drdIsInitialized", self._id)),
            bool(self._status[FORCE]),
            f"its forces were switched off {words}",
            cause == WATCHDOG,
            is_fault,
            bool(self._status[GRAVITY]),
        )

    def push(self, force: Triple, torque: Triple, grip: float) -> bool:
        """See `Hand.push`."""
        result = self._open.call(
            "dhdSetForceAndTorqueAndGripperForce", *force, *torque, self._sign * grip, self._id
        )
        return result == SATURATED

    def enable(self, on: bool) -> None:
        """See `Hand.enable`."""
        self._open.call("dhdEnableForce", int(on), self._id)

    def use_gravity_compensation(self, on: bool) -> None:
        """See `Hand.use_gravity_compensation`."""
        self._open.call("dhdSetGravityCompensation", int(on), self._id)

    def home(self) -> None:
        """See `Hand.home`. Regulation that it may leave running is ended, however it ends; forces stay on."""
        try:
            self._open.call("drdAutoInit", self._id)
        finally:
            self._open.call("drdStop", True, self._id)

    def end_homing(self) -> None:
        """See `Hand.end_homing`."""
        self._open.call("drdStop", True, self._id)


if __name__ == "__main__":
    Servo(Parent(int(sys.argv[1])), DhdHand()).run()

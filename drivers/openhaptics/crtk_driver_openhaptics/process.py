"""The process that owns the vendor's library: ``python -m crtk_driver_openhaptics.process FD``.

The vendor's axes are x to the right, y up, z to the user; ours are x ahead, y left, z up. Both ends of a
rotation are turned, so that none stays none.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Mapping, Sequence
from typing import Any, Final

from crtk_driver_openhaptics.shim import INSTALL, Mailbox, Shim
from crtk_drivers.kit.child_process import Parent
from crtk_drivers.kit.haptics.fixtures import Motion
from crtk_drivers.kit.haptics.servo import HandError, HandReading, HandState, Servo
from crtk_drivers.kit.haptics.triples import Quadruple, Triple, quaternion, times

__all__ = ["HdHand"]

MM: Final = 0.001
CALIBRATED: Final = 0x5000
NEEDS_HAND: Final = 0x5002
INKWELL: Final = 4
WARM_MOTORS: Final = 0x0200
COMM_ERRORS: Final = frozenset({0x0302, 0x0303})
"""HD_COMM_ERROR, HD_COMM_CONFIG_ERROR: the device is gone."""
STANDS: Final = 0.3
"""s without a frame after which the scheduler stands."""
CALIBRATES: Final = 2.0
"""s in which a calibration that needs nobody is done."""
LETS_GO: Final = 0.05
"""s in which the callback has switched forces off."""


def ours(theirs: Sequence[float]) -> Triple:
    """Return a vector of the vendor's axes in ours."""
    return (-theirs[2], -theirs[0], theirs[1])


def theirs(vector: Triple) -> Triple:
    """Return a vector of our axes in the vendor's."""
    return (-vector[1], vector[2], -vector[0])


def pose(transform: Sequence[float]) -> tuple[Triple, Quadruple]:
    """Return position (m) and orientation of a transform (16, columns one after the other, mm)."""
    # Columns of ours are where our axes x, y, z go: those of the vendor's -z, -x, y.
    ahead, left, up = (
        tuple(-each for each in ours(transform[8:11])),
        tuple(-each for each in ours(transform[0:3])),
        ours(transform[4:7]),
    )
    rows = tuple(zip(ahead, left, up, strict=True))
    return times(ours(transform[12:15]), MM), quaternion(rows)


class HdHand:
    """A device by libHD."""

    def __init__(self) -> None:
        self._shim: Shim | None = None
        self._box = Mailbox()
        self._frames = 0
        self._seen = 0.0
        self._error = 0
        self._gives_up = threading.Event()

    def open(self, options: Mapping[str, Any]) -> Mapping[str, Any]:
        """See `Hand.open`."""
        shim = Shim(options["library"])
        if shim.call("open", options["device"].encode(), options["force_timeout"]) < 0:
            raise HandError(
                shim.text("error"),
                f"Look at its cable, its name in Touch Setup, and whether another program has it. {INSTALL}",
            )
        self._shim = shim
        deadline = time.monotonic() + 2.0
        while not self._box.frames:
            if time.monotonic() > deadline:
                raise HandError(
                    "its scheduler does not start", "Restart it, and look at its cable."
                )
            time.sleep(0.002)
            shim.read(self._box)
        self._seen = time.monotonic()
        return {"name": shim.text("model"), "serial": shim.text("serial")}

    @property
    def _open(self) -> Shim:
        if self._shim is None:
            raise HandError("it is not open")
        return self._shim

    def close(self) -> None:
        """See `Hand.close`."""
        shim, self._shim = self._shim, None
        if shim is not None:
            shim.call("enable", 0)
            deadline = time.monotonic() + LETS_GO
            shim.read(self._box)
            while self._box.forces_on and time.monotonic() < deadline:
                time.sleep(0.001)
                shim.read(self._box)
            shim.call("close")

    def read(self) -> HandReading:
        """See `Hand.read`."""
        self._look()
        box = self._box
        position, orientation = pose(box.transform)
        motion = Motion(position, orientation, times(ours(box.velocity), MM), ours(box.turning))
        return HandReading(motion, ours(box.force), buttons=box.buttons)

    def _look(self) -> None:
        """Take what the callback has read, and see that it goes on.

        Raises:
            HandError: it stands, or the device is gone.
        """
        shim, box, now = self._open, self._box, time.monotonic()
        shim.read(box)
        if box.error:
            self._error = box.error
        if box.error in COMM_ERRORS:
            raise HandError(
                f"it is gone: {shim.text('words', box.error)}",
                "Look at its cable and its power; it is opened again by itself.",
            )
        if box.frames != self._frames:
            self._frames, self._seen = box.frames, now
        elif now - self._seen > STANDS:
            raise HandError("its scheduler stands", "It is opened again by itself.")

    def state(self) -> HandState:
        """See `Hand.state`."""
        self._look()
        words = self._open.text("words", self._error) if self._error else "no reason"
        return HandState(
            self._box.calibration == CALIBRATED,
            bool(self._box.forces_on),
            f"its forces were switched off: {words} ({self._error:#06x})",
            is_fault=True,
        )

    def push(self, force: Triple, torque: Triple, grip: float) -> bool:
        """See `Hand.push`."""
        self._open.call("push", *theirs(force))
        return self._error == WARM_MOTORS

    def enable(self, on: bool) -> None:
        """See `Hand.enable`. It is switched by the callback, which is waited for."""
        self._error = 0
        self._open.call("enable", int(on))
        deadline = time.monotonic() + 0.1
        while bool(self._box.forces_on) is not on and time.monotonic() < deadline:
            time.sleep(0.001)
            self._look()

    def use_gravity_compensation(self, on: bool) -> None:
        """It has none."""
        raise HandError("it has no gravity compensation")

    def home(self) -> None:
        """See `Hand.home`. The library moves nothing: a person puts the arm where it can be calibrated."""
        if self._box.calibration == NEEDS_HAND:
            where = (
                "the stylus into the inkwell"
                if self._box.style & INKWELL
                else "the arm to its rest"
            )
            raise HandError("it has to be calibrated by hand", f"Put {where}, and send home again.")
        self._gives_up.clear()
        self._open.call("calibrate", self._box.style)
        deadline = time.monotonic() + CALIBRATES
        while self._box.calibration != CALIBRATED and time.monotonic() < deadline:
            if self._gives_up.wait(0.01):
                raise HandError("it was told to stop", "Send home again.")
            self._look()

    def end_homing(self) -> None:
        """See `Hand.end_homing`. It moves nothing."""
        self._gives_up.set()


if __name__ == "__main__":
    Servo(Parent(int(sys.argv[1])), HdHand()).run()

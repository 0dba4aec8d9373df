"""Which force is sent now: the one that was asked for last, unless nobody repeats it. No I/O."""

from __future__ import annotations

import math

from crtk_driver_haply.messages import NO_FORCE, Triple

__all__ = ["ForceInForce"]


class ForceInForce:
    """The force of one device. Each method replaces one reference, so that `drop` may come from any thread.

    Args:
        ramp: seconds in which a force that begins grows to what was asked for.
        lasts: seconds after which a force that nobody asked for again is zero.
    """

    def __init__(self, ramp: float, lasts: float) -> None:
        self._ramp = ramp
        self._lasts = lasts
        self._asked: tuple[Triple, float, float] = NO_FORCE, -math.inf, -math.inf

    def ask(self, force: Triple, now: float) -> None:
        """Exert a force (3,) in N from now on."""
        _, asked, began = self._asked
        self._asked = force, now, began if now - asked <= self._lasts else now

    def drop(self) -> None:
        """Exert none."""
        self._asked = NO_FORCE, -math.inf, -math.inf

    def at(self, now: float) -> Triple:
        """Return the force (3,) in N to be sent at monotonic seconds."""
        (x, y, z), asked, began = self._asked
        if now - asked > self._lasts:
            return NO_FORCE
        share = min(1.0, (now - began) / self._ramp) if self._ramp else 1.0
        return share * x, share * y, share * z

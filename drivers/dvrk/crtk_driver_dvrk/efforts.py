"""From efforts of joints to what the converters of motors take. Pure."""

from __future__ import annotations

from typing import Final

import numpy as np

from crtk_driver_dvrk.motor_file import Motor
from crtk_drivers.samples import Array, Vector

_ROUNDING: Final = 1e-9


class Efforts:
    """Makes currents of joint efforts, by the coupling with which joints are measured (virtual work).

    Args:
        motors: of the arm.
        coupling: (n, n): positions of actuators to those of joints.
        share: of the largest currents of the file that may be used, above 0 and at most 1.

    Attributes:
        most: (n,): the effort that each joint may have, in N·m (N), whatever the others have: no combination
            of them asks a motor for more than its share.
        zero: what no current is for each converter.
    """

    def __init__(self, motors: tuple[Motor, ...], coupling: Array, share: float) -> None:
        self._motors = motors
        self._to_actuators = coupling.T
        self._scale = np.array([motor.effort_to_current for motor in motors])
        self._amperes = share * np.array([motor.most for motor in motors])
        self.most = self._limits()
        self.zero = tuple(motor.zero for motor in motors)

    def _limits(self) -> Array:
        """Return the limits of joint efforts."""
        room = self._amperes / abs(self._scale)
        part = abs(self._to_actuators)
        takes = part > 0.0
        with np.errstate(divide="ignore"):
            alone = np.where(takes, room[:, None] / part, np.inf).min(axis=0)
        worst = part @ alone
        smaller = np.minimum(1.0, room / np.maximum(worst, np.finfo(float).tiny))
        limits: Array = alone * np.where(takes, smaller[:, None], 1.0).min(axis=0)
        return limits

    def amperes(self, efforts: Vector) -> Array:
        """Return the current (n,) of each motor for efforts (n,) of the joints, in A."""
        return self._scale * (self._to_actuators @ efforts)

    def bits(self, efforts: Vector) -> tuple[int, ...]:
        """Return what the converters take for efforts (n,) of the joints.

        Raises:
            ValueError: a motor would get more than its share, or what is no number.
        """
        if not np.isfinite(efforts).all():
            raise ValueError(f"efforts of {efforts.tolist()}: more than may be")
        amperes = self.amperes(efforts)
        if not (abs(amperes) <= self._amperes * (1.0 + _ROUNDING)).all():
            raise ValueError(f"currents of {np.round(amperes, 3).tolist()} A: more than may be")
        rows = zip(self._motors, amperes.tolist(), strict=True)
        return tuple(round(motor.to_bits.of(current)) for motor, current in rows)

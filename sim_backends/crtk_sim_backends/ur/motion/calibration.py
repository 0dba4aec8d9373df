"""An arm whose links are not quite as long, and not at quite the angles, as its model's."""

from __future__ import annotations

from dataclasses import replace
from math import cos, sin
from random import Random
from typing import Final

from typing_extensions import override

from crtk_sim_backends.ur.models import ALPHA, Calibration, RobotModel, Vector6
from crtk_sim_backends.ur.motion.kinematics import (
    IDENTITY,
    Floats,
    Kinematics,
    Transform,
    compose,
    invert,
    joint_rates,
    rotation_vector,
)

__all__ = ["CalibratedKinematics", "calibrated", "kinematics_of"]

_EXACT: Final = 1e-11  # m and rad
_STEPS: Final = 20
_NEAR: Final = 0.2  # rad by which the joints are corrected at most
_MILLI: Final = 1e-3


def calibrated(model: RobotModel, spread: float, seed: int) -> RobotModel:
    """Return the model of an arm of its own.

    Args:
        model: nominal lengths and angles.
        spread: up to which each of them is off, mm and mrad.
        seed: of the random numbers: the same arm each time.
    """
    random = Random(seed)

    def off(values: Vector6) -> Vector6:
        a, b, c, d, e, f = (value + random.uniform(-spread, spread) * _MILLI for value in values)
        return a, b, c, d, e, f

    own = Calibration(
        off((0.0,) * 6),
        off(model.a),
        off(model.d),
        off(ALPHA),
        tuple(random.getrandbits(32) for _ in range(6)),
    )
    return replace(model, calibration=own)


def kinematics_of(model: RobotModel) -> Kinematics:
    """Return the kinematics of an arm, whether it has a calibration or not."""
    own = model.calibration
    return Kinematics(model) if own is None else CalibratedKinematics(model, own)


class CalibratedKinematics(Kinematics):
    """Positions are those of the arm's own links; speeds (the Jacobian) and the elbow, of the model's.

    Args:
        model: the arm.
        own: its calibration.
    """

    def __init__(self, model: RobotModel, own: Calibration) -> None:
        super().__init__(model)
        self._rows = tuple(zip(own.theta, own.a, own.d, own.alpha, strict=True))

    @override
    def flange(self, q: Floats) -> Transform:
        found = IDENTITY
        for angle, (theta, a, d, alpha) in zip(q, self._rows, strict=True):
            c, s, ca, sa = cos(angle + theta), sin(angle + theta), cos(alpha), sin(alpha)
            found = compose(
                found, (c, -s * ca, s * sa, s, c * ca, -c * sa, 0.0, sa, ca, a * c, a * s, d)
            )
        return found

    @override
    def inverse(self, t: Transform, near: Floats, tool: Transform = IDENTITY) -> list[float] | None:
        flange = t if tool is IDENTITY else compose(t, invert(tool))
        nominal = super().inverse(flange, near)
        found = None if nominal is None else self._corrected(flange, nominal)
        return found or self._corrected(flange, near)

    @override
    def follow(self, t: Transform, near: Floats, tool: Transform = IDENTITY) -> list[float] | None:
        flange = t if tool is IDENTITY else compose(t, invert(tool))
        return self._corrected(flange, near) or self.inverse(flange, near)

    def _corrected(self, flange: Transform, start: Floats) -> list[float] | None:
        """Joint positions around `start` that bring the flange there, None if there are none."""
        q = list(start)
        for _ in range(_STEPS):
            here = self.flange(q)
            turn = rotation_vector(compose(flange, invert(here)))
            missed = (flange[9] - here[9], flange[10] - here[10], flange[11] - here[11], *turn)
            if max(map(abs, missed)) < _EXACT:
                limits = self.model.position
                fits = all(abs(x) <= limit for x, limit in zip(q, limits, strict=True))
                return q if fits else None
            step = joint_rates(self.jacobian(q, flange=here), missed)
            if step is None:
                return None
            q = [x + dx for x, dx in zip(q, step, strict=True)]
            if max(abs(x - x0) for x, x0 in zip(q, start, strict=True)) > _NEAR:
                return None
        return None

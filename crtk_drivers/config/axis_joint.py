"""A joint that is an axis of a motion controller or a drive, which counts and is told positions."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from crtk_drivers.config.settings import Settings
from crtk_drivers.device import JointLimits

__all__ = ["AxisJoint"]


class AxisJoint(Settings):
    """What such joints have in common; which axis it is, and what a count of it means, a driver adds."""

    kind: Literal["revolute", "prismatic"] = Field(default="revolute", description="Of the joint.")
    sign: Literal[1, -1] = Field(
        default=1, description="-1 if the joint moves against the counts of the axis."
    )
    offset: float = Field(
        default=0.0, description="Position of the joint where the axis counts 0, in rad (m)."
    )
    lower: float = Field(description="Least position, in rad (m).")
    upper: float = Field(description="Greatest position, in rad (m).")
    velocity: float = Field(gt=0.0, le=1000.0, description="Limit in rad/s (m/s).")
    acceleration: float = Field(
        default=10.0, gt=0.0, le=100_000.0, description="Limit in rad/s² (m/s²)."
    )
    following_error: float | None = Field(
        default=None,
        gt=0.0,
        description="The axis is switched off, and FAULT, when it is further than this from where it was "
        "told to be, in rad (m); a fifth of a second at its greatest velocity if null.",
    )
    arrival: float | None = Field(
        default=None,
        gt=0.0,
        description="A move has ended when the joint is nearer than this to its goal, in rad (m); a fiftieth "
        "of a second at its greatest velocity if null.",
    )

    @model_validator(mode="after")
    def _has_a_range(self) -> Self:
        if not self.lower < self.upper:
            raise ValueError(f"lower ({self.lower:g}) must be below upper ({self.upper:g})")
        return self

    @property
    def following(self) -> float:
        """How far it may be from where it was told to be, in rad (m)."""
        return 0.2 * self.velocity if self.following_error is None else self.following_error

    @property
    def arrives_within(self) -> float:
        """How near to its goal a move has ended, in rad (m)."""
        return 0.02 * self.velocity if self.arrival is None else self.arrival

    @property
    def limits(self) -> JointLimits:
        """Those of a device; efforts are not commanded."""
        return JointLimits(
            lower=self.lower,
            upper=self.upper,
            velocity=self.velocity,
            acceleration=self.acceleration,
            jerk=10.0 * self.acceleration,
            effort=0.0,
        )

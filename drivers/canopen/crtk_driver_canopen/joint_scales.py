"""Configuration of the units of a joint: keys for what its drive does not report.

Where the unit of each object comes from is a table, `crtk_driver_canopen.unit_table`.
"""

from __future__ import annotations

import math
from typing import Literal, Self

from pydantic import Field, model_validator

from crtk_driver_canopen.unit_codes import TURN
from crtk_driver_canopen.units import JointUnits
from crtk_drivers.config import Settings


class JointScales(Settings):
    """What the counts of a drive are, of one joint."""

    kind: Literal["revolute", "prismatic"] = Field(default="revolute", description="Of the joint.")
    scale: float | None = Field(
        default=None,
        gt=0.0,
        description="rad (m) for one position unit of the drive; from the keys below, or the drive's "
        "own unit objects, if null.",
    )
    counts_per_turn: float | None = Field(
        default=None,
        gt=0.0,
        description="Counts for one turn of the motor; 608Fh of the drive if null.",
    )
    gear: float | None = Field(
        default=None,
        gt=0.0,
        le=100_000.0,
        description="Turns of the motor for one of the joint; 6091h of the drive if null.",
    )
    feed: float | None = Field(
        default=None, gt=0.0, le=10.0, description="Way of a prismatic joint with one turn, in m."
    )
    sign: Literal[1, -1] = Field(
        default=1, description="-1 if the joint moves against the counts of the drive."
    )
    offset: float = Field(
        default=0.0, description="Position of the joint where the drive counts 0, in rad (m)."
    )
    velocity_scale: float | None = Field(
        default=None,
        gt=0.0,
        description="rad/s (m/s) for one velocity unit (60FFh, 6081h, 6099h); 60A9h of the drive, that of "
        "its make, or that of position per second, if null.",
    )
    measured_velocity_scale: float | None = Field(
        default=None,
        gt=0.0,
        description="rad/s (m/s) for one unit of the measured velocity (606Ch); that of its make, or that "
        "of commanded velocities, if null.",
    )
    acceleration_scale: float | None = Field(
        default=None,
        gt=0.0,
        description="rad/s² (m/s²) for one unit of accelerations (6083h, 6084h, 609Ah); 60AAh of the drive, "
        "that of its make, or that of velocity per second, if null. Needed beside `velocity_scale` where "
        "nobody else tells it.",
    )
    ramp_time_scale: float | None = Field(
        default=None,
        gt=0.0,
        le=1.0,
        description="s for one unit of 6083h, 6084h and 609Ah of a drive that takes the times of ramps "
        "there, in place of accelerations.",
    )
    rated_torque: float | None = Field(
        default=None,
        gt=0.0,
        le=10_000.0,
        description="Of the motor, in N·m: torques are counted in thousandths of it; 6076h if null.",
    )
    effort_scale: float | None = Field(
        default=None,
        gt=0.0,
        description="N·m (N) of the joint for one unit of torque (6071h), in place of `rated_torque`, for a "
        "drive that counts torques or currents otherwise.",
    )
    measured_effort_scale: float | None = Field(
        default=None,
        gt=0.0,
        description="N·m (N) of the joint for one unit of the measured torque (6077h); as 6071h if null.",
    )
    plausibility: Literal["refuse", "note"] = Field(
        default="refuse",
        description="What is done with a drive whose rated torque, speeds or accelerations are more than 20 "
        "times off the limits of the joint: it is refused, or that is noted in diagnostics.",
    )

    @model_validator(mode="after")
    def _told_once(self) -> Self:
        if self.feed is not None and self.kind == "revolute":
            raise ValueError("feed: is only for a prismatic joint")
        for one, other in (
            ("scale", "counts_per_turn"),
            ("acceleration_scale", "ramp_time_scale"),
            ("effort_scale", "rated_torque"),
        ):
            if getattr(self, one) is not None and getattr(self, other) is not None:
                raise ValueError(f"give {one} or {other}, not both")
        return self

    @property
    def known_units(self) -> JointUnits:
        """Its units as far as the configuration alone tells them; the others are NaN, or None."""
        position = velocity = effort = math.nan
        turn = TURN if self.kind == "revolute" else self.feed
        if self.scale is not None:
            position = self.scale
        elif self.counts_per_turn is not None and self.gear is not None and turn is not None:
            position = turn / (self.counts_per_turn * self.gear)
        if self.velocity_scale is not None:
            velocity = self.velocity_scale
        if self.effort_scale is not None:
            effort = self.effort_scale
        elif self.rated_torque is not None and self.gear is not None and turn is not None:
            effort = self.rated_torque / 1000.0 * self.gear * TURN / turn
        return JointUnits(
            self.sign * position,
            self.offset,
            self.sign * velocity,
            self.sign * effort,
            self.measured_velocity_scale,
        )

"""What is expected of a device beyond the clauses, and how far it may go: the file of ``--expect``."""

from __future__ import annotations

from pydantic import Field

from crtk_drivers.config import Seconds, Settings


class JointRange(Settings):
    """Where one joint may go."""

    lower: float = Field(description="Least position, in rad or m.")
    upper: float = Field(description="Greatest position, in rad or m.")
    velocity: float | None = Field(
        default=None, gt=0.0, description="Greatest velocity, in rad/s or m/s."
    )


class Expectations(Settings):
    """Tolerances, steps and times. A device's own manifest gives its ranges, unless they are given here."""

    still: float = Field(
        default=1e-3, gt=0.0, description="rad or m within which a joint has not moved."
    )
    step: float = Field(
        default=0.02, gt=0.0, le=0.2, description="rad or m that a joint is moved by."
    )
    stroke: float = Field(
        default=0.1,
        gt=0.0,
        le=0.5,
        description="rad or m of the moves that are interrupted; at most a tenth of the range.",
    )
    linear_step: float = Field(
        default=0.005, gt=0.0, le=0.05, description="m that the tool is moved by."
    )
    arrival: float = Field(
        default=5e-3, gt=0.0, description="rad or m within which a goal counts as reached."
    )
    wait: Seconds = Field(default=1.0, description="s in which what must do nothing is watched.")
    transition_time: Seconds = Field(
        default=30.0, description="s that enable, disable, pause and resume may take."
    )
    home_time: Seconds = Field(default=120.0, description="s that home may take.")
    move_time: Seconds = Field(default=10.0, description="s that a small move may take.")
    stop_time: Seconds = Field(
        default=1.0, description="s after which motion that was ended must be over."
    )
    stream_stop: Seconds | None = Field(
        default=None,
        description="s within which the joints stand after the last command of a stream.",
    )
    flood_time: Seconds = Field(
        default=5.0, description="s for which it is sent a thousand commands a second."
    )
    joint: int = Field(
        default=-1,
        description="Place of the joint that is moved; negative ones count from the end.",
    )
    ranges: tuple[JointRange, ...] = Field(
        default=(), description="Where the joints may go, in their order."
    )

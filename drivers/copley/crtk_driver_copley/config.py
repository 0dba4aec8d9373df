"""What a user may set: the keys of the file, and the options of ``crtk-driver copley``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Final, Literal, Self

from pydantic import Field, model_validator

from crtk_driver_copley.codec import address
from crtk_driver_copley.tables import ACCELERATION_UNIT, VELOCITY_UNIT
from crtk_drivers.config import AxisJoint, DeviceConfig, Settings

__all__ = ["CopleyConfig", "HomingConfig", "JointConfig"]

MOST: Final = 2_147_483_647
"""What a parameter of 32 bits takes."""

_EXCHANGES: Final = 5
"""Commands for one axis in a cycle: four questions, and most times a point; one more for its current."""
_EXCHANGE: Final = 25
"""Bytes of a command and its answer."""
_POINT: Final = 32
"""Bytes of a point and its answer."""
SHARE: Final = 0.8
"""Of the line that points may take: something is to be read, too."""
_ANSWER: Final = 0.002
"""Seconds that a drive and an adapter take for an answer."""


class HomingConfig(Settings):
    """How a joint is homed: its axis counts 0 there, and the joint is at its `offset`."""

    method: Literal[
        "drive",
        "here",
        "limit_negative",
        "limit_positive",
        "index_negative",
        "index_positive",
        "switch_negative",
        "switch_positive",
        "hard_stop_negative",
        "hard_stop_positive",
    ] = Field(
        description="To a limit switch, the next index, the home switch or a hard stop, in that direction of "
        "the counts; where it stands (here); or as the drive is set (drive, with its own speeds)."
    )
    speed: float = Field(
        default=0.1, gt=0.0, description="Towards what is looked for, rad/s (m/s)."
    )
    slow: float = Field(default=0.02, gt=0.0, description="When it is found, in rad/s (m/s).")
    timeout: float = Field(default=60.0, gt=0.0, le=3600.0, description="Longest time, in s.")


class JointConfig(AxisJoint):
    """One joint: an axis of a drive."""

    node: int = Field(
        default=0,
        ge=0,
        le=127,
        description="Node of the drive behind that at the serial line, which is 0.",
    )
    axis: Literal["A", "B", "C", "D"] | None = Field(
        default=None, description="Letter of the axis of a drive with several; null: it has one."
    )
    counts: float = Field(gt=0.0, description="Counts of the encoder for one rad (m) of the joint.")
    following_error: float | None = Field(
        default=None,
        gt=0.0,
        description="How far it may be from where it was told to be, in rad (m): FAULT, also of the drive, "
        "whose limit (0xba) is set to it; null: a fifth of a second at its greatest velocity, and that of "
        "the drive stays.",
    )
    torque_per_ampere: float | None = Field(
        default=None,
        gt=0.0,
        le=1e6,
        description="N·m (N) of the joint for one ampere of the motor, gear included; efforts are not "
        "measured if null, which saves one of six questions.",
    )
    homing: HomingConfig | None = Field(
        default=None, description="How it is homed; null: its counts are believed."
    )

    @model_validator(mode="after")
    def _possible(self) -> Self:
        told = {
            "lower": abs(self.raw(self.lower)),
            "upper": abs(self.raw(self.upper)),
            "velocity": self.velocity * self.counts / VELOCITY_UNIT,
            "acceleration": self.acceleration * self.counts / ACCELERATION_UNIT,
        }
        for key, number in told.items():
            if number > MOST:
                raise ValueError(
                    f"{key}: {getattr(self, key):g} would be {number:.4g} in the unit of the drive, which "
                    f"takes {MOST}: correct it, or counts"
                )
        homing = self.homing
        if homing is not None and max(homing.speed, homing.slow) > self.velocity:
            raise ValueError(
                f"homing: speed ({homing.speed:g}) or slow ({homing.slow:g}) is more than velocity "
                f"({self.velocity:g})"
            )
        return self

    @property
    def to(self) -> str:
        """What its commands begin with."""
        return address(self.node, self.axis)

    def raw(self, position: float) -> float:
        """Return what the axis counts at a position, in rad (m)."""
        return self.sign * (position - self.offset) * self.counts


class CopleyConfig(DeviceConfig):
    """An arm of axes of drives at one serial line."""

    HEADINGS: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "The line": ("port", "baud", "reply_timeout"),
        "Joints": ("joints",),
        "What it does": ("tracking", "pvt_period", "pvt_lead", "rate", "on_close"),
        **DeviceConfig.HEADINGS,
    }

    port: str = Field(
        default="",
        max_length=1000,
        description="Serial port, best as under /dev/serial/by-id; or socket://host:port of a server.",
    )
    baud: Literal[9600, 19200, 38400, 57600, 115200] = Field(
        default=115200,
        description="Rate in bit/s that the drive is raised to; through a server: that of both.",
    )
    reply_timeout: float = Field(
        default=0.1, ge=0.01, le=2.0, description="Longest time for the answer to a command, in s."
    )
    joints: dict[str, JointConfig] = Field(
        default={}, max_length=16, description="Joints by name, in the order of joint vectors."
    )
    tracking: Literal["pvt", "profile", "stop_go"] = Field(
        default="pvt",
        description="How positions are followed: pvt: points with velocity and time, streamed into the "
        "drive's buffer; profile: the newest is the goal of the drive's own ramp; stop_go: when it rests.",
    )
    pvt_period: float = Field(
        default=0.03, ge=0.01, le=0.2, description="Time from one point to the next with pvt, in s."
    )
    pvt_lead: int = Field(
        default=4,
        ge=2,
        le=20,
        description="Points that wait in the drive with pvt: so much later a joint is where it was sent, and "
        "so long this computer or the line may be held up before the axes stop.",
    )
    rate: float = Field(
        default=50.0,
        ge=1.0,
        le=500.0,
        description="Samples per second at most; as many as the line carries.",
    )
    on_close: Literal["hold", "power_off"] = Field(
        default="power_off",
        description="How the axes are left at the end, once the joints stand: without power, or holding, "
        "which nothing of ours watches any more.",
    )

    @property
    def carried(self) -> float:
        """Samples per second that the line carries, with drives that take some time for each answer."""
        exchange = _EXCHANGE * 10.0 / self.baud + _ANSWER
        joints = self.joints.values()
        exchanges = sum(_EXCHANGES + (joint.torque_per_ampere is not None) for joint in joints)
        return min(self.rate, 1.0 / (max(_EXCHANGES, exchanges) * exchange))

    @model_validator(mode="after")
    def _points_are_carried(self) -> Self:
        axes = len(self.joints)
        needed = axes * (_POINT * 10.0 / self.baud + _ANSWER) / SHARE
        if self.tracking == "pvt" and needed > self.pvt_period:
            raise ValueError(
                f"pvt_period: {self.pvt_period:g} s is too short for the points of {axes} axes at "
                f"{self.baud} bit/s: give {needed:.2g} or more, or tracking: profile"
            )
        return self

    @model_validator(mode="after")
    def _axes(self) -> Self:
        taken: dict[str, str] = {}
        for name, joint in self.joints.items():
            other = taken.setdefault(joint.to, name)
            if other != name:
                raise ValueError(
                    f"joints.{name}: node {joint.node}, axis {joint.axis or 'the only one'} is also that "
                    f"of {other}"
                )
        return self

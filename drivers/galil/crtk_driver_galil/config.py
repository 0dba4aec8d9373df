"""What a user may set: the keys of the file, and the options of ``crtk-driver galil``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Literal, Self

from pydantic import Field, model_validator

from crtk_drivers.config import AxisJoint, DeviceConfig, Settings

__all__ = ["GalilConfig", "HomingConfig", "JointConfig"]

AxisLetter = Literal["A", "B", "C", "D", "E", "F", "G", "H"]


class HomingConfig(Settings):
    """How a joint is homed."""

    method: Literal["home", "index", "here"] = Field(
        description="HM: the home switch and the index; FI: the next index; or where it stands (DP)."
    )
    speed: float = Field(
        default=0.1, gt=0.0, description="Towards switch or index, in rad/s (m/s)."
    )
    direction: Literal[1, -1] = Field(
        default=1,
        description="Of the search for the index; that for the home switch follows from its level (CN).",
    )
    position: float = Field(
        default=0.0, description="Position of the joint at the home point, in rad (m)."
    )
    timeout: float = Field(default=60.0, gt=0.0, le=3600.0, description="Longest time, in s.")


class JointConfig(AxisJoint):
    """One joint: an axis of the controller. Its `following_error` is ER, with OE on."""

    axis: AxisLetter = Field(description="Letter of the axis.")
    scale: float = Field(gt=0.0, description="rad (m) for one count of the encoder.")
    torque_per_volt: float | None = Field(
        default=None,
        gt=0.0,
        le=1e6,
        description="N·m (N) of the joint for one volt of the controller's output (TT): amplifier, motor "
        "and gear; efforts are not measured if null.",
    )
    homing: HomingConfig | None = Field(
        default=None, description="How it is homed; null: its counts are believed."
    )

    @model_validator(mode="after")
    def _possible(self) -> Self:
        for key in ("lower", "upper"):
            counts = self.counts(getattr(self, key))
            if abs(counts) > _MOST:
                raise ValueError(
                    f"{key}: {getattr(self, key):g} would be {counts:.4g} counts, more than PA takes "
                    f"({_MOST}): correct it, or scale"
                )
        for key, command, unit, most in (
            ("velocity", "SP", "counts/s", MOST_SPEED),
            ("acceleration", "AC", "counts/s²", MOST_ACCELERATION),
        ):
            rate = getattr(self, key)
            if rate / self.scale > most:
                raise ValueError(
                    f"{key}: {rate:g} would be {rate / self.scale:.4g} {unit}, more than "
                    f"{command} takes ({most}): correct it, or scale"
                )
        searches = self.homing is not None and self.homing.method != "here"
        if self.homing is not None and searches and self.homing.speed > self.velocity:
            raise ValueError(
                f"homing.speed: {self.homing.speed:g} is more than velocity ({self.velocity:g})"
            )
        return self

    def counts(self, position: float) -> float:
        """Return what the axis counts at a position, in rad (m)."""
        return self.sign * (position - self.offset) / self.scale


_MOST = 2_147_483_647

MOST_SPEED = 22_000_000
MOST_ACCELERATION = 1_073_740_800
"""What SP, AC and DC take, in counts/s and counts/s²."""


class GalilConfig(DeviceConfig):
    """An arm of axes of one controller."""

    HEADINGS: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "The controller": ("host", "tcp_port", "udp_port", "model"),
        "Joints": ("joints",),
        "What it does": (
            "tracking",
            "pvt_period",
            "pvt_lead",
            "record_period",
            "reply_timeout",
            "on_close",
        ),
        **DeviceConfig.HEADINGS,
    }

    host: str = Field(default="", max_length=255, description="Address of the controller.")
    tcp_port: int = Field(default=23, ge=1, le=65535, description="TCP port of the commands.")
    udp_port: int = Field(
        default=60007, ge=1, le=65535, description="UDP port from which data records are asked for."
    )
    model: Literal["auto", "4000", "52000", "30000", "2103", "1806", "1802"] = Field(
        default="auto",
        description="Family, which says what its data record is like; by its revision (^R^V) if auto.",
    )
    joints: dict[str, JointConfig] = Field(
        default={}, max_length=8, description="Joints by name, in the order of joint vectors."
    )
    tracking: Literal["pt", "pvt", "stop_go"] = Field(
        default="pt",
        description="How positions are followed: pt: position tracking, with the controller's own ramp to "
        "each; pvt: position, velocity and time of short pieces; stop_go: to the newest, when it rests.",
    )
    pvt_period: float = Field(
        default=0.016, ge=0.004, le=0.2, description="Length of a piece with pvt, in s."
    )
    pvt_lead: int = Field(
        default=3,
        ge=2,
        le=50,
        description="Pieces that wait in the controller's buffer with pvt: so much later a joint is where it "
        "was sent, and so long this computer may be held up before the axes stop.",
    )
    record_period: float = Field(
        default=0.004,
        ge=0.002,
        le=0.1,
        description="Time between two data records (DR), which is the cycle, in s.",
    )
    reply_timeout: float = Field(
        default=1.0, gt=0.0, le=10.0, description="Longest time for the answer to a command, in s."
    )
    on_close: Literal["hold", "power_off"] = Field(
        default="power_off",
        description="How the axes are left at the end, once the joints stand: without power (MO), or "
        "holding, which nothing of ours watches any more.",
    )

    @model_validator(mode="after")
    def _axes(self) -> Self:
        taken: dict[str, str] = {}
        for name, joint in self.joints.items():
            other = taken.setdefault(joint.axis, name)
            if other != name:
                raise ValueError(f"joints.{name}.axis: {joint.axis} is also that of {other}")
        return self

"""What the configurations of haptic devices have in common."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from pydantic import Field

from crtk_drivers.config.settings import DeviceConfig, Seconds, Settings
from crtk_drivers.kit.haptics import ForceLimits, TankLimits

__all__ = ["EnergyConfig", "FollowConfig", "HapticConfig"]


class FollowConfig(Settings):
    """The spring and the damper towards a pose of servo_cp."""

    stiffness: float = Field(default=300.0, ge=0.0, le=5000.0, description="N/m.")
    damping: float = Field(default=3.0, ge=0.0, le=50.0, description="N·s/m.")
    turn_stiffness: float = Field(default=0.5, ge=0.0, le=50.0, description="N·m/rad.")
    turn_damping: float = Field(default=0.01, ge=0.0, le=2.0, description="N·m·s/rad.")


class EnergyConfig(Settings):
    """How much energy fixtures may give a hand, see docs/haptics.md."""

    allowance: float = Field(
        default=0.01, gt=0.0, le=10.0, description="J beyond what the hand gave them."
    )
    power: float = Field(
        default=2.0, gt=0.0, le=100.0, description="W for fixtures that are moved, or followed."
    )
    acceleration: float = Field(
        default=150.0, gt=0.0, le=5000.0, description="Of the hand at most, in m/s²."
    )
    delay: int = Field(
        default=2,
        ge=0,
        le=100,
        description="Cycles from a position to the force that follows from it.",
    )


class HapticConfig(DeviceConfig):
    """A device that pushes a hand, with the local force loop (docs/haptics.md)."""

    HEADINGS: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "Local force loop": (
            "ramp",
            "command_timeout",
            "driver_timeout",
            "loop_rate",
            "rate",
            "frame_id",
            "follow",
            "energy",
        ),
        **DeviceConfig.HEADINGS,
    }

    frame_id: str = Field(
        default="base", min_length=1, max_length=100, description="Frame of its base."
    )
    ramp: float = Field(
        default=0.5, gt=0.0, le=10.0, description="Seconds in which forces rise after enable."
    )
    command_timeout: float = Field(
        default=0.05,
        ge=0.005,
        le=1.0,
        description="Seconds after which the process of the library takes a force or a pose for ended.",
    )
    driver_timeout: float = Field(
        default=0.1,
        ge=0.03,
        le=2.0,
        description="Seconds without a word of the driver after which that process makes no forces.",
    )
    loop_rate: float = Field(
        default=1000.0, ge=200.0, le=4000.0, description="Of the local force loop, in Hz."
    )
    rate: float = Field(default=200.0, ge=20.0, le=1000.0, description="Samples a second.")
    follow: FollowConfig = Field(default=FollowConfig(), description="Towards servo_cp.")
    energy: EnergyConfig = Field(default=EnergyConfig(), description="Of fixtures.")
    open_timeout: Seconds = Field(default=15.0, description="Longest time to connect, in s.")

    def force_limits(self, force: float, torque: float) -> ForceLimits:
        """Return the limits of the force loop, with N and N·m at most."""
        return ForceLimits(
            force=force, torque=torque, ramp=self.ramp, command_timeout=self.command_timeout
        )

    @property
    def tank(self) -> TankLimits:
        """How much energy fixtures may give."""
        return TankLimits(**self.energy.model_dump(), period=1.0 / self.loop_rate)

"""What a user may set: the keys of the file, and the options of ``crtk-driver force-dimension``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Literal, Self

from pydantic import Field, model_validator

from crtk_driver_force_dimension.models import MODELS, Model
from crtk_drivers.config.settings import Seconds
from crtk_drivers.kit.haptics.haptic_config import HapticConfig

__all__ = ["WATCHDOG_UNIT", "ForceDimensionConfig"]

WATCHDOG_UNIT = 0.000125
"""s of which dhdSetWatchdog takes up to 255."""


class ForceDimensionConfig(HapticConfig):
    """One device."""

    HEADINGS: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "The device": ("library", "index", "serial", "model", "home_timeout"),
        "Forces": (
            "max_force",
            "max_torque",
            "max_grip",
            "watchdog",
            "watchdog_trips",
            "gravity_compensation",
        ),
        **HapticConfig.HEADINGS,
    }

    library: str = Field(
        default="",
        max_length=1000,
        description="Path of the vendor's libdrd.so; looked for in $FDSDK and among the system's if empty.",
    )
    index: int = Field(
        default=0, ge=0, le=15, description="Which of the devices that the library counts."
    )
    serial: int | None = Field(
        default=None, ge=0, description="Its serial number, which is checked; any if null."
    )
    model: Literal[
        "omega.3", "omega.6", "omega.7", "delta.3", "delta.6", "sigma.7", "lambda.7", "falcon"
    ] = Field(default="omega.7", description="Which device it is, which is checked.")
    home_timeout: Seconds = Field(default=40.0, description="Longest time to home, in s.")
    max_force: float | None = Field(
        default=None,
        gt=0.0,
        description="N, the length of the force at most; what the model can keep up if null.",
    )
    max_torque: float | None = Field(
        default=None, gt=0.0, description="N·m; what the model can keep up if null."
    )
    max_grip: float | None = Field(
        default=None, gt=0.0, description="N of the gripper; what the model can keep up if null."
    )
    watchdog: float = Field(
        default=0.02,
        ge=0.001,
        le=255 * WATCHDOG_UNIT,
        description="Seconds without a force after which the device itself switches forces off.",
    )
    watchdog_trips: int = Field(
        default=1,
        ge=0,
        le=1000,
        description="Times in 10 s after which forces rise again by themselves when that happened since our "
        "process was late; once more is a FAULT.",
    )
    gravity_compensation: bool = Field(
        default=True, description="The device carries its own weight from the start."
    )

    @property
    def has(self) -> Model:
        """What the model has."""
        return MODELS[self.model]

    @model_validator(mode="after")
    def _possible(self) -> Self:
        model = self.has
        for key, most in (
            ("max_force", model.force),
            ("max_torque", model.torque),
            ("max_grip", model.grip),
        ):
            value = getattr(self, key)
            if value is not None and value > most:
                raise ValueError(f"{key}: {value:g} is more than {self.model} has ({most:g})")
        if self.watchdog * self.loop_rate < 2.0:
            raise ValueError(
                f"watchdog: {self.watchdog:g} s is less than two cycles at {self.loop_rate:g} Hz"
            )
        return self

    @property
    def force(self) -> float:
        """N at most."""
        return self.has.force if self.max_force is None else self.max_force

    @property
    def torque(self) -> float:
        """N·m at most."""
        return self.has.torque if self.max_torque is None else self.max_torque

    @property
    def grip(self) -> float:
        """N of the gripper at most."""
        return self.has.grip if self.max_grip is None else self.max_grip

"""What a user may set: the keys of the file, and the options of ``crtk-driver openhaptics``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from pydantic import Field

from crtk_drivers.kit.haptics.haptic_config import HapticConfig

__all__ = ["OpenHapticsConfig"]


class OpenHapticsConfig(HapticConfig):
    """One device."""

    HEADINGS: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "The device": ("library", "device", "buttons", "home_timeout"),
        "Forces": ("max_force", "force_timeout"),
        **HapticConfig.HEADINGS,
    }

    library: str = Field(
        default="",
        max_length=1000,
        description="Path of the vendor's libHD.so; looked for among the system's libraries if empty.",
    )
    device: str = Field(
        default="",
        max_length=200,
        description="Name of the device, as Touch Setup gave it; the default device if empty.",
    )
    buttons: tuple[str, ...] = Field(
        default=("front", "back"),
        max_length=4,
        description="Names of its buttons, the first bit first: topics below the namespace.",
    )
    home_timeout: float = Field(
        default=10.0, gt=0.0, le=300.0, description="Longest time to calibrate, in s."
    )
    max_force: float = Field(
        default=3.0,
        gt=0.0,
        le=40.0,
        description="N, the length of the force at most. A Touch has 3.4 N, and 0.9 N for long, from memory.",
    )
    force_timeout: float = Field(
        default=0.02,
        ge=0.002,
        le=0.5,
        description="Seconds without a new force after which the 1 kHz callback makes none.",
    )

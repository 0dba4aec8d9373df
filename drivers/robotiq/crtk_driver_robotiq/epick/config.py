"""What a user may set: the keys of the file, and the options of ``crtk-driver robotiq-epick``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Literal, Self

from pydantic import Field, model_validator

from crtk_driver_robotiq.epick.registers import LONGEST
from crtk_drivers.kit.modbus_settings import ModbusConfig

__all__ = ["EpickConfig"]


class EpickConfig(ModbusConfig):
    """A Robotiq ePick."""

    HEADINGS: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "The way to it": ModbusConfig.WAY,
        "What it does": (
            "mode",
            "most",
            "hysteresis",
            "timeout",
            "release_timeout",
            "activate",
            "on_close",
            "joint",
        ),
        **ModbusConfig.HEADINGS,
    }

    link: Literal["serial", "tool", "modbus"] = Field(
        default="serial",
        description="Modbus RTU at a serial port; the same through a robot's tool (TCP 54321); or Modbus "
        "TCP.",
    )
    baud: int = Field(default=115_200, ge=1200, le=4_000_000, description="Bits a second there.")
    address: int = Field(default=9, ge=1, le=247, description="Modbus address of the gripper.")
    mode: Literal["automatic", "advanced"] = Field(
        default="advanced",
        description="advanced: the pump keeps the vacuum between what is asked for and `hysteresis` less; "
        "automatic: it decides by itself, and any vacuum that is asked for means: grip.",
    )
    most: float = Field(
        default=80_000.0,
        ge=10_000.0,
        le=100_000.0,
        description="Greatest vacuum that may be asked for, in Pa below the surroundings.",
    )
    hysteresis: float = Field(
        default=10_000.0,
        ge=1000.0,
        le=90_000.0,
        description="By how much less the vacuum may be, in Pa: there the pump runs again, and an object "
        "counts as gripped.",
    )
    timeout: float = Field(
        default=3.0,
        ge=0.1,
        le=LONGEST,
        description="Seconds in which it must grip something, before it gives up.",
    )
    release_timeout: float = Field(
        default=1.0, ge=0.1, le=LONGEST, description="Seconds for which it blows to let go."
    )
    activate: Literal["if needed", "never"] = Field(
        default="if needed",
        description="Whether `enable` activates it, which lets go: when it is not activated or its fault "
        "asks for it, but not while it may hold something; or never.",
    )
    on_close: Literal["hold", "release"] = Field(
        default="hold",
        description="How it is left when the program ends while it is enabled: as it is, a grip kept; or "
        "released. A lost link or a fault releases nothing.",
    )
    joint: str = Field(default="vacuum", min_length=1, max_length=64, description="Of the joint.")

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.hysteresis >= self.most:
            raise ValueError(f"hysteresis ({self.hysteresis:g}) must be below most ({self.most:g})")
        return self

"""What a user may set: the keys of the file, and the options of ``crtk-driver onrobot``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Literal, Self

from pydantic import Field, model_validator

from crtk_driver_onrobot.models import MODELS, PER_MILLE, Fingers, Model, Vacuum
from crtk_drivers.kit.modbus_settings import ModbusConfig

__all__ = ["LEAST_VACUUM", "MOST_VACUUM", "OnRobotConfig"]

LEAST_VACUUM = 50 * PER_MILLE
MOST_VACUUM = 800 * PER_MILLE
"""Pa below the ambient pressure: 5 and 80 %; the pumps reach no more."""


class OnRobotConfig(ModbusConfig):
    """An OnRobot gripper."""

    HEADINGS: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "The gripper": ("model", "grip", "joint"),
        "The way to it": ModbusConfig.WAY,
        "What it does": ("on_close", "force", "speed", "vacuum", "held_from"),
        **ModbusConfig.HEADINGS,
    }
    PARITY: ClassVar[str] = "even"

    model: Literal["rg2", "rg6", "2fg7", "2fg14", "3fg15", "vg10", "vgc10"] = Field(
        default="rg2", description="Which gripper it is; another one is refused."
    )
    grip: Literal["outside", "inside"] = Field(
        default="outside",
        description="Whether it closes onto things or opens into them. An RG detects both by itself.",
    )
    joint: str = Field(default="opening", min_length=1, max_length=64, description="Of the joint.")
    link: Literal["modbus", "serial", "tool"] = Field(
        default="modbus",
        description="Modbus TCP to the Compute Box; Modbus RTU at a serial port; or the same through a "
        "robot's tool (TCP 54321).",
    )
    baud: int = Field(default=1_000_000, ge=1200, le=5_000_000, description="Bits a second there.")
    address: int = Field(
        default=65,
        ge=1,
        le=247,
        description="Modbus address; 66 is the second side of a dual quick changer.",
    )
    on_close: Literal["hold", "release", "nothing"] = Field(
        default="hold",
        description="How it is left when the program ends while it is enabled: stopped where it is, a grip "
        "kept; opened (closed where it grips from inside, a vacuum released); or with nothing sent. A lost "
        "link or a fault opens nothing.",
    )
    force: float | None = Field(
        default=None, gt=0.0, description="Of the grip, in N; its least if null."
    )
    speed: float = Field(
        default=1.0, ge=0.1, le=1.0, description="Share of the speed (2FG; others have one speed)."
    )
    vacuum: float = Field(
        default=600 * PER_MILLE,
        ge=LEAST_VACUUM,
        le=MOST_VACUUM,
        description="Of the grip, in Pa below the ambient pressure.",
    )
    held_from: float = Field(
        default=200 * PER_MILLE,
        ge=10 * PER_MILLE,
        le=MOST_VACUUM,
        description="Vacuum in Pa from which a channel holds something.",
    )

    @model_validator(mode="after")
    def _fits(self) -> Self:
        least, most = self.data.force
        if self.force is not None and most and not least <= self.force <= most:
            raise ValueError(
                f"force: a {self.data.title} has {least:g} to {most:g} N, not {self.force:g}"
            )
        return self

    @property
    def data(self) -> Model:
        """What is known of the model."""
        return MODELS[self.model]

    @property
    def tool(self) -> Fingers | Vacuum:
        """How it is spoken to."""
        return (self.data.inside if self.grip == "inside" else None) or self.data.map

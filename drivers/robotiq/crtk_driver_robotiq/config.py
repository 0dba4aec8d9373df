"""What a user may set: the keys of the file, and the options of ``crtk-driver robotiq``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Final, Literal, Self

from pydantic import Field, model_validator

from crtk_driver_robotiq.models import MODELS, Model
from crtk_drivers.kit.modbus_settings import ModbusConfig

__all__ = ["RobotiqConfig"]

CONTROLLER_UNIT: Final = 2
"""Of Robotiq's own controller in Modbus TCP (2F-200 manual, 4.10.1)."""


class RobotiqConfig(ModbusConfig):
    """A Robotiq gripper."""

    HEADINGS: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "The gripper": ("model", "unit", "stroke", "joint", "open_count", "closed_count"),
        "The way to it": ModbusConfig.WAY,
        "What it does": ("activate", "on_close", "speed", "force", "newtons_per_ampere"),
        **ModbusConfig.HEADINGS,
    }
    PORTS: ClassVar[Mapping[str, int]] = {**ModbusConfig.PORTS, "controller": 502, "urcap": 63352}

    model: Literal["2f-85", "2f-140", "hand-e"] = Field(
        default="2f-85", description="Which gripper it is; it cannot be asked."
    )
    unit: Literal["m", "rad"] = Field(
        default="m",
        description="Unit of its joint: the opening between the fingers in m, or the angle of a jaw in rad, "
        "for programs that expect one. Closed is 0 in both.",
    )
    stroke: float | None = Field(
        default=None,
        gt=0.0,
        le=3.0,
        description="Opening in that unit when it is open; with fingers as delivered if null.",
    )
    joint: str = Field(default="opening", min_length=1, max_length=64, description="Of the joint.")
    open_count: int = Field(
        default=3, ge=0, le=254, description="Position (gPO) that it reads when it is open."
    )
    closed_count: int = Field(
        default=230,
        ge=1,
        le=255,
        description="The same when it is closed; `crtk-driver robotiq calibrate` measures both.",
    )
    link: Literal["serial", "tool", "modbus", "controller", "urcap"] = Field(
        default="serial",
        description="Modbus RTU at a serial port; the same through a robot's tool (TCP 54321); Modbus TCP of "
        "a gateway; that of Robotiq's own controller, whose registers are others; or the text server of the "
        "Robotiq URCap (TCP 63352).",
    )
    baud: int = Field(default=115_200, ge=1200, le=4_000_000, description="Bits a second there.")
    address: int = Field(
        default=9,
        ge=1,
        le=247,
        description="Modbus address of the gripper; 2 if it is not given and link is controller.",
    )
    activate: Literal["if needed", "always", "never"] = Field(
        default="if needed",
        description="Whether `enable` activates it, which opens and closes the fingers fully: when it is not "
        "activated or its fault asks for it, but not while it may hold something; always; or never.",
    )
    on_close: Literal["hold", "release", "nothing"] = Field(
        default="hold",
        description="How it is left when the program ends while it is enabled: stopped where it is, a grip "
        "kept; opened; or with nothing sent, so that a motion goes on. A lost link or a fault opens nothing.",
    )
    speed: float | None = Field(
        default=None,
        gt=0.0,
        description="Greatest speed in m/s (rad/s); its own if null. It has a least one as well.",
    )
    force: float = Field(
        default=0.3,
        ge=0.0,
        le=1.0,
        description="Share of the way from its least force to its greatest; 0 is not no force.",
    )
    newtons_per_ampere: float | None = Field(
        default=None,
        gt=0.0,
        le=10_000.0,
        description="What the motor's current means at the fingers, from a measurement of yours: measured_js "
        "has no effort if null.",
    )

    @model_validator(mode="before")
    @classmethod
    def _at_controller(cls, values: Any) -> Any:
        if isinstance(values, Mapping) and values.get("link") == "controller":
            return {"address": CONTROLLER_UNIT, **values}
        return values

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if not self.open_count < self.closed_count:
            raise ValueError(
                f"open_count ({self.open_count}) must be below closed_count ({self.closed_count})"
            )
        if self.unit == "rad" and not (self.stroke or self.data.angle):
            raise ValueError(f"unit: the fingers of a {self.data.title} do not turn; give stroke")
        return self

    @property
    def data(self) -> Model:
        """What is known of the model."""
        return MODELS[self.model]

    @property
    def travel(self) -> float:
        """Opening when it is open, in the unit of the joint."""
        return self.stroke or (self.data.stroke if self.unit == "m" else self.data.angle)

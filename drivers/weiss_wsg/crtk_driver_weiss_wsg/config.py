"""What a user may set: the keys of the file, and the options of ``crtk-driver weiss-wsg``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Literal, Self

from pydantic import Field, model_validator

from crtk_driver_weiss_wsg.tables import MODELS, Model
from crtk_drivers.config import DeviceConfig
from crtk_drivers.kit.serial_server import PortName

__all__ = ["WsgConfig"]


class WsgConfig(DeviceConfig):
    """A WSG gripper."""

    HEADINGS: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "The gripper": ("model", "joint", "soft_limits"),
        "The way to it": ("link", "host", "tcp_port", "port", "baud", "rate"),
        "What it does": (
            "home",
            "home_direction",
            "on_close",
            "speed",
            "acceleration",
            "force",
            "part_width",
            "release_by",
        ),
        **DeviceConfig.HEADINGS,
    }

    model: Literal["wsg-50-110", "wsg-50-210", "wsg-32-068"] = Field(
        default="wsg-50-110", description="Which gripper it is; its stroke is compared with that."
    )
    joint: str = Field(default="opening", min_length=1, max_length=64, description="Of the joint.")
    soft_limits: tuple[float, float] | None = Field(
        default=None,
        description="Least and greatest opening in m, of its joint and, but in text mode, of the gripper "
        "itself, which are set by `enable`; its whole stroke if null.",
    )
    link: Literal["tcp", "text", "serial"] = Field(
        default="tcp",
        description="Its binary protocol by TCP; its text mode (GCL) by TCP; or the binary protocol at a "
        "serial port. Which of them it speaks is set in its web page.",
    )
    host: str = Field(default="", description="Address of the gripper.")
    tcp_port: int = Field(default=1000, ge=1, le=65535, description="TCP port of the gripper.")
    port: PortName = Field(
        default="", description="Serial port: /dev/ttyUSB0, or socket://HOST:PORT."
    )
    baud: int = Field(default=115_200, ge=1200, le=4_000_000, description="Bits a second there.")
    rate: float = Field(
        default=50.0, ge=1.0, le=140.0, description="Samples that it sends a second."
    )
    home: Literal["if needed", "always", "never"] = Field(
        default="if needed",
        description="Whether `enable` lets it find its reference, for which it moves to an end of its "
        "stroke: when it has none, always, or never; but not while it may hold something.",
    )
    home_direction: Literal["as set", "open", "close"] = Field(
        default="as set", description="To which end: as its web page says, or to this one."
    )
    on_close: Literal["hold", "release", "nothing"] = Field(
        default="hold",
        description="How it is left when the program ends while it is enabled: stopped where it is, a grip "
        "kept; opened; or with nothing sent, so that a motion goes on. A lost link or a fault opens nothing.",
    )
    speed: float | None = Field(
        default=None, gt=0.0, description="Greatest speed in m/s; its own if null."
    )
    acceleration: float | None = Field(
        default=None, gt=0.0, description="Acceleration in m/s²; as it is set if null."
    )
    force: float = Field(
        default=20.0,
        gt=0.0,
        description="Force in N with which it grips, and with which it holds what a move meets.",
    )
    part_width: float = Field(
        default=0.0, ge=0.0, description="Width in m of what the service grip is to find."
    )
    release_by: float = Field(
        default=0.01, gt=0.0, description="By how many m the service release opens."
    )

    @model_validator(mode="after")
    def _fits(self) -> Self:
        data = self.data
        for name, unit, given, (low, high) in (
            ("speed", "m/s", self.speed, data.speed),
            ("acceleration", "m/s²", self.acceleration, data.acceleration),
            ("force", "N", self.force, data.force),
            ("part_width", "m", self.part_width, (0.0, data.stroke)),
            ("release_by", "m", self.release_by, (0.0, data.stroke)),
        ):
            if given is not None and not low <= given <= high:
                raise ValueError(
                    f"{name}: {given:g} {unit} is not in what a {self.model} can, {low:g} to {high:g} {unit}"
                )
        low, high = self.range
        if not 0.0 <= low < high <= data.stroke:
            raise ValueError(
                f"soft_limits: {low:g} to {high:g} m is no part of its stroke of {data.stroke:g} m"
            )
        return self

    @property
    def data(self) -> Model:
        """What is known of the model."""
        return MODELS[self.model]

    @property
    def range(self) -> tuple[float, float]:
        """Least and greatest opening in m."""
        return self.soft_limits or (0.0, self.data.stroke)

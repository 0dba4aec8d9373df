"""What a user may set: the keys of the file, and the options of ``crtk-driver schunk``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Literal, Self

from pydantic import Field, model_validator

from crtk_drivers.kit.modbus_settings import ModbusConfig

__all__ = ["SchunkConfig"]


class SchunkConfig(ModbusConfig):
    """A SCHUNK gripper: EGU, EGK or EZU."""

    HEADINGS: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "The gripper": ("lower", "upper", "speed", "max_force", "joint"),
        "The way to it": ModbusConfig.WAY,
        "What it does": ("grip_at_end", "force", "keep_unpowered", "on_close"),
        **ModbusConfig.HEADINGS,
    }
    PORTS: ClassVar[Mapping[str, int]] = {**ModbusConfig.PORTS, "http": 80}
    PARITY: ClassVar[str] = "even"

    lower: float = Field(
        default=0.0, ge=-1.0, le=1.0, description="Opening when it is closed, in m."
    )
    upper: float = Field(
        default=0.083,
        gt=0.0,
        le=1.0,
        description="Opening when it is open, in m. What a gripper cannot do of this, of speed and of "
        "max_force is refused when it is connected, with its own values.",
    )
    speed: float = Field(default=0.115, gt=0.0, le=5.0, description="Greatest speed, in m/s.")
    max_force: float = Field(
        default=150.0, gt=0.0, le=10_000.0, description="Greatest force of a grip, in N."
    )
    joint: str = Field(default="opening", min_length=1, max_length=64, description="Of the joint.")
    link: Literal["http", "serial", "tool", "modbus"] = Field(
        default="http",
        description="The web server of its fieldbus module (EtherNet/IP, PROFINET, EtherCAT); Modbus RTU at "
        "a serial port; the same through a robot's tool (TCP 54321); or Modbus TCP by a gateway.",
    )
    baud: int = Field(default=115_200, ge=1200, le=4_000_000, description="Bits a second there.")
    address: int = Field(default=12, ge=1, le=247, description="Modbus address of the gripper.")
    rate: float = Field(default=50.0, ge=1.0, le=200.0, description="Samples a second.")
    grip_at_end: bool = Field(
        default=True,
        description="A position at the closed end is a grip with `force`, which ends at what it holds; "
        "otherwise a move, which what is in its way ends with an error.",
    )
    force: float | None = Field(
        default=None,
        gt=0.0,
        le=10_000.0,
        description="Of such a grip, in N; half of the greatest if null.",
    )
    keep_unpowered: bool = Field(
        default=True,
        description="Grips are kept by the brake when power is lost; models with a brake (M) only.",
    )
    on_close: Literal["hold", "release", "nothing"] = Field(
        default="hold",
        description="How it is left when the program ends while it is enabled: stopped where it is, a grip "
        "kept; what it holds let go; or with nothing sent, so that a motion goes on. A lost link or a fault "
        "lets nothing go.",
    )

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if not self.lower < self.upper:
            raise ValueError(f"lower ({self.lower:g}) must be below upper ({self.upper:g})")
        if self.force is not None and self.force > self.max_force:
            raise ValueError(f"force ({self.force:g}) must not be above max_force")
        return self

"""What a user may set: the keys of the file, and the options of ``crtk-driver robotiq-ft300``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from crtk_drivers.kit.modbus_settings import ModbusConfig
from crtk_drivers.kit.software_bias import MOST_LOAD

__all__ = ["Ft300Config"]

Load = Annotated[float, Field(ge=-MOST_LOAD, le=MOST_LOAD)]


class Ft300Config(ModbusConfig):
    """A Robotiq FT 300 or FT 300-S."""

    HEADINGS: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "The way to it": ModbusConfig.WAY,
        "What it measures": ("source", "frame_id", "bias", "alarm"),
        **ModbusConfig.HEADINGS,
    }

    link: Literal["serial", "tool", "modbus"] = Field(
        default="serial",
        description="A serial port; the same through a robot's tool (TCP 54321); or a gateway for Modbus "
        "TCP, which passes registers on and no stream.",
    )
    baud: int = Field(default=19_200, ge=1200, le=4_000_000, description="Bits a second there.")
    address: int = Field(default=9, ge=1, le=247, description="Modbus address of the sensor.")
    reply_timeout: float = Field(
        default=0.1,
        gt=0.0,
        le=5.0,
        description="A question of Modbus that is not answered for this long, in s, is asked again.",
    )
    source: Literal["stream", "registers"] | None = Field(
        default=None,
        description="Where loads come from: its stream, 100 a second; or registers, which are asked for. The "
        "stream if null, but by link modbus registers.",
    )
    rate: float = Field(
        default=40.0,
        ge=1.0,
        le=100.0,
        description="Samples a second from registers; a stream has its own 100. A line of 19200 bit/s has "
        "room for 60.",
    )
    frame_id: str = Field(
        default="ft_sensor", min_length=1, max_length=100, description="Frame of the sensor."
    )
    bias: tuple[Load, Load, Load, Load, Load, Load] = Field(
        default=(0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        description="Software bias to begin with: N and N·m, in the sensor's frame.",
    )
    alarm: float = Field(
        default=1.0,
        gt=0.0,
        le=10.0,
        description="Share of the rated load (300 N, 30 N·m) above which it is told as overload.",
    )

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if self.link == "modbus" and self.source == "stream":
            raise ValueError("source: Modbus TCP passes no stream on; take registers")
        return self

    @property
    def streams(self) -> bool:
        """Whether loads come from the stream."""
        return self.source != "registers" and self.link != "modbus"

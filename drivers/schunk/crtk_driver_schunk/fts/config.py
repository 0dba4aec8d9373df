"""Configuration of an FTS: keys, defaults, units and bounds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from crtk_drivers.config import DeviceConfig
from crtk_drivers.kit.software_bias import MOST_LOAD

__all__ = ["FtsConfig"]

Load = Annotated[float, Field(ge=-MOST_LOAD, le=MOST_LOAD)]


class FtsConfig(DeviceConfig):
    """A SCHUNK force/torque sensor at its Ethernet box."""

    HEADINGS: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "Sensor": ("host", "rate", "low_pass", "output_rate", "on_saturation", "bias", "frame_id"),
        "Network": ("tcp_port", "udp_port", "receive_buffer"),
        **DeviceConfig.HEADINGS,
    }

    host: str = Field(default="", max_length=253, description="Address or name of the box.")
    tcp_port: int = Field(default=82, ge=1, le=65535, description="TCP port of its commands.")
    udp_port: int = Field(
        default=54843,
        ge=0,
        le=65535,
        description="UDP port of this machine that it sends to; another one for each sensor. 0: any free "
        "one. Old firmware knows 54843 only.",
    )
    rate: float = Field(
        default=500.0, ge=10.0, le=1000.0, description="Rate of measured_cf, in Hz."
    )
    low_pass: float | None = Field(
        default=None,
        gt=0.0,
        le=500.0,
        description="Cut-off of a second-order low-pass in Hz; null: the mean of all measurements since "
        "the last value.",
    )
    output_rate: Literal[1000, 500, 250, 100] | None = Field(
        default=None,
        description="Measurements a second, written to the box; left as it is if null.",
    )
    on_saturation: Literal["flag", "invalid", "fault"] = Field(
        default="flag",
        description="Beyond what the sensor can measure: say so in diagnostics (flag), mark measured_cf "
        "as invalid as well, or go to FAULT.",
    )
    bias: tuple[Load, Load, Load, Load, Load, Load] = Field(
        default=(0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        description="Software bias to begin with: N and N·m, in the sensor's frame.",
    )
    frame_id: str = Field(
        default="ft_sensor", min_length=1, max_length=100, description="Frame of the sensor."
    )
    receive_buffer: int = Field(
        default=1 << 18,
        ge=65536,
        le=1 << 28,
        description="Bytes that are asked of the kernel for what waits to be read.",
    )

"""What a user may set: the keys of the file, and the options of ``crtk-driver optoforce``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, ClassVar, Final, Literal, Self

from pydantic import Field, model_validator

from crtk_driver_optoforce.frames import FILTERS
from crtk_drivers.config import DeviceConfig
from crtk_drivers.kit.serial_server import PortName
from crtk_drivers.kit.software_bias import MOST_LOAD

__all__ = ["OptoForceConfig"]

Load = Annotated[float, Field(ge=-MOST_LOAD, le=MOST_LOAD)]
Scale = Annotated[float, Field(gt=0.0, le=1000.0)]

_SENSORS: Final = {"3-axis": 1, "6-axis": 1, "4x3-axis": 4}


class OptoForceConfig(DeviceConfig):
    """An OptoForce sensor, or four of them at one unit."""

    HEADINGS: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "Sensor": ("port", "sensor", "scale", "rate", "low_pass"),
        "What it measures": ("on_saturation", "bias", "frame_id", "baud"),
        **DeviceConfig.HEADINGS,
    }

    port: PortName = Field(
        default="", max_length=255, description="/dev/serial/by-id/..., or socket://HOST:PORT."
    )
    baud: int = Field(
        default=1_000_000,
        ge=9600,
        le=4_000_000,
        description="Bits a second; at USB it means nothing.",
    )
    sensor: Literal["3-axis", "6-axis", "4x3-axis"] = Field(
        default="3-axis",
        description="What hangs at the unit; 4x3-axis: four sensors of three axes.",
    )
    scale: tuple[Scale, ...] | None = Field(
        default=None,
        max_length=12,
        description="N (N·m) of one count on each axis, from the sensor's sensitivity report: the rated load "
        "by its counts. 3 values, 6 for 6-axis; for 4x3-axis 3 for all or 12.",
    )
    rate: Literal[1000, 333, 100, 30, 10] = Field(
        default=100, description="Measurements a second, written to the unit."
    )
    low_pass: float | None = Field(
        default=15.0,
        description="Cut-off in Hz of its own filter, written to the unit: 500, 150, 50, 15, 5, 1.5; null: "
        "none.",
    )
    on_saturation: Literal["flag", "invalid", "fault"] = Field(
        default="flag",
        description="When an axis is overloaded: say so in diagnostics (flag), mark measured_cf as invalid "
        "as well, or go to FAULT.",
    )
    bias: tuple[Load, Load, Load, Load, Load, Load] = Field(
        default=(0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        description="Software bias to begin with: N and N·m, in the sensor's frame; not for 4x3-axis.",
    )
    frame_id: str = Field(
        default="ft_sensor",
        min_length=1,
        max_length=100,
        description="Frame of the sensor; of four ft_sensor_1 to ft_sensor_4.",
    )

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if self.low_pass not in FILTERS:
            known = ", ".join(f"{cutoff:g}" for cutoff in FILTERS if cutoff is not None)
            raise ValueError(f"low_pass: it has no filter of {self.low_pass:g} Hz, but {known}")
        if self.scale is not None and len(self.scale) not in (self.axes, self.sensors * self.axes):
            raise ValueError(
                f"scale: {len(self.scale)} values for {self.sensor}, which has {self.axes} axes"
            )
        if self.sensors > 1 and any(self.bias):
            raise ValueError("bias: of which of four sensors? Use the service of each")
        return self

    @property
    def sensors(self) -> int:
        """How many there are at the unit."""
        return _SENSORS[self.sensor]

    @property
    def axes(self) -> int:
        """Of each sensor."""
        return 6 if self.sensor == "6-axis" else 3

    def scale_of(self, number: int) -> tuple[float, ...]:
        """Return N (N·m) of one count on each axis of a sensor, from 0 on; NaN while it is not given."""
        if self.scale is None:
            return (math.nan,) * self.axes
        first = 0 if len(self.scale) == self.axes else number * self.axes
        return self.scale[first : first + self.axes]

"""Configuration of a NetFT sensor: keys, defaults, units and bounds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from crtk_driver_ati_netft import rdt, tcp49151, units
from crtk_driver_ati_netft.profiles import PROFILES, Mode
from crtk_driver_ati_netft.stream import RECEIVE_BUFFER
from crtk_driver_ati_netft.units import Scale
from crtk_drivers.config import DeviceConfig, Settings
from crtk_drivers.kit.software_bias import MOST_LOAD
from crtk_drivers.ros.names import checked_namespace

HTTP_PORT = 80

Load = Annotated[float, Field(ge=-MOST_LOAD, le=MOST_LOAD)]
Small = Annotated[float, Field(ge=-100.0, le=100.0)]
"""A length in m, an angle in rad, an acceleration in m/s²."""

Vector3 = tuple[Small, Small, Small]
Vector6 = tuple[Small, Small, Small, Small, Small, Small]
LoadVector = tuple[Load, Load, Load, Load, Load, Load]


class ScaleConfig(Settings):
    """What a count is worth, for a sensor whose web page cannot be read, or is not believed."""

    counts_per_force: float = Field(gt=0.0, description="Counts in one unit of force (cfgcpf).")
    counts_per_torque: float = Field(gt=0.0, description="Counts in one unit of torque (cfgcpt).")
    force_unit: str = Field(default="N", description="lbf, N, klbf, kN, kgf or gf.")
    torque_unit: str = Field(default="Nm", description="lbf-in, lbf-ft, Nm, Nmm, kgf-cm or kNm.")

    @model_validator(mode="after")
    def _known(self) -> ScaleConfig:
        for name, table in (("force_unit", units.FORCE), ("torque_unit", units.TORQUE)):
            if units.factor(table, getattr(self, name)) is None:
                raise ValueError(f"{name}: {getattr(self, name)!r} is none of {', '.join(table)}")
        _ = self.scale
        return self

    @property
    def scale(self) -> Scale:
        """As the rest of the driver takes it."""
        force = units.factor(units.FORCE, self.force_unit)
        torque = units.factor(units.TORQUE, self.torque_unit)
        return Scale(self.counts_per_force, self.counts_per_torque, force or 0.0, torque or 0.0)


class SensorConfig(Settings):
    """Settings of the sensor itself, written when the driver connects; null leaves them as they are."""

    configuration: int | None = Field(
        default=None, ge=0, le=15, description="Active configuration, 0 to 15."
    )
    internal_rate: int | None = Field(
        default=None, ge=1, le=10000, description="Measurements per second; Axia only."
    )
    rdt_rate: int | None = Field(
        default=None,
        ge=1,
        le=10000,
        description="Records per second; the sensor takes the next fraction of its internal rate "
        "above it.",
    )
    filter_code: int | None = Field(
        default=None, ge=0, le=12, description="Code of the sensor's own low-pass, 0 for none."
    )
    buffer_size: int | None = Field(
        default=None, ge=1, le=rdt.MOST_RECORDS, description="Records per datagram, mode buffered."
    )
    tool_transform: Vector6 | None = Field(
        default=None, description="Tool transform in the sensor: m, and rotations in rad."
    )


class ToolConfig(Settings):
    """What hangs on the sensor, for the compensation of its weight."""

    mass: float = Field(ge=0.0, le=1000.0, description="In kg.")
    center_of_mass: Vector3 = Field(
        default=(0.0, 0.0, 0.0), description="In the sensor's frame, in m."
    )


class NetFtConfig(DeviceConfig):
    """An ATI NetFT sensor, or one that speaks its protocol."""

    HEADINGS: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "Sensor": ("host", "profile", "mode", "rate", "low_pass", "on_saturation", "alarm"),
        "Network": (
            "transport",
            "rdt_port",
            "tcp_port",
            "http_port",
            "http",
            "http_timeout",
            "page_period",
            "receive_buffer",
        ),
        "Frames and the arm that carries it": (
            "frame_id",
            "measuring_frame_id",
            "arm",
            "orientation_timeout",
        ),
    }

    host: str = Field(default="", max_length=253, description="Address or name of the sensor.")
    profile: Literal["auto", "netbox", "axia", "schunk", "onrobot"] = Field(
        default="auto", description="Family of sensors; auto asks the sensor's web page."
    )
    transport: Literal["auto", "udp", "tcp"] = Field(
        default="auto",
        description="UDP (RDT), or TCP where UDP is blocked: some hundred measurements per second "
        "of 16 bits. auto falls back to TCP.",
    )
    mode: Literal["realtime", "single", "buffered"] = Field(
        default="realtime",
        description="Records per datagram: one (realtime; single is the same by another command), or "
        "several (buffered: less load, later).",
    )
    rdt_port: int = Field(default=rdt.PORT, ge=1, le=65535, description="UDP port of RDT.")
    tcp_port: int = Field(default=tcp49151.PORT, ge=1, le=65535, description="TCP port.")
    http_port: int = Field(default=HTTP_PORT, ge=1, le=65535, description="Port of the web page.")
    http: bool = Field(
        default=True, description="Read the sensor's web page; if false, `scale` is needed."
    )
    http_timeout: float = Field(default=1.0, gt=0.0, le=10.0, description="For each page, in s.")
    page_period: float = Field(
        default=5.0,
        ge=0.0,
        le=3600.0,
        description="The web page is read again every so many s while the sensor streams, and when the load "
        "jumps (over TCP the scale as well): what it says otherwise ends in FAULT. 0: never.",
    )
    scale: ScaleConfig | None = Field(
        default=None, description="What a count is worth; what the sensor says, if null."
    )
    sensor: SensorConfig = Field(
        default=SensorConfig(), description="Settings of the sensor itself."
    )
    rate: float = Field(
        default=500.0,
        ge=10.0,
        le=8000.0,
        description="Rate of measured_cf, in Hz. Programs in the same process get every measurement.",
    )
    low_pass: float | None = Field(
        default=None,
        gt=0.0,
        le=4000.0,
        description="Cut-off of a second-order low-pass in Hz; null: the mean of all measurements since "
        "the last value.",
    )
    frame_id: str = Field(
        default="ft_sensor", min_length=1, max_length=100, description="Frame of the sensor."
    )
    measuring_frame_id: str = Field(
        default="",
        max_length=100,
        description="Frame of measured_cf, at `point` and turned by `rotation`; that of the sensor if "
        "empty.",
    )
    point: Vector3 = Field(
        default=(0.0, 0.0, 0.0),
        description="Point about which measured_cf states the moment, in the sensor's frame, in m.",
    )
    rotation: Vector3 = Field(
        default=(0.0, 0.0, 0.0),
        description="Rotation vector of the axes of measured_cf in the sensor's frame, in rad.",
    )
    bias: LoadVector = Field(
        default=(0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        description="Software bias to begin with: N and N·m, in the sensor's frame.",
    )
    tool: ToolConfig | None = Field(
        default=None, description="Tool whose weight is taken off; none if null."
    )
    gravity: Vector3 = Field(
        default=(0.0, 0.0, -9.80665),
        description="Acceleration of free fall in the frame that `orientation` refers to, in m/s².",
    )
    orientation: Vector3 | None = Field(
        default=None,
        description="Rotation vector of the sensor in that frame, for a sensor that is not moved, in "
        "rad. Otherwise it comes by the input `orientation`, or from `arm`.",
    )
    arm: str = Field(
        default="",
        max_length=200,
        description="ROS namespace of the CRTK arm that carries the sensor, such as /ur5: its measured_cp "
        "gives the orientation.",
    )
    mounting: Vector3 = Field(
        default=(0.0, 0.0, 0.0),
        description="Rotation vector of the sensor in the frame whose poses come by `orientation` (the "
        "flange of an arm), in rad.",
    )
    orientation_timeout: float = Field(
        default=0.2,
        gt=0.0,
        le=1e6,
        description="An orientation that was not renewed for this long counts no more, in s: with a tool, "
        "measured_cf is then marked as invalid.",
    )
    on_saturation: Literal["flag", "invalid", "fault"] = Field(
        default="flag",
        description="Beyond what the sensor can measure: say so in diagnostics (flag), mark measured_cf "
        "as invalid as well, or go to FAULT.",
    )
    alarm: float = Field(
        default=1.0,
        gt=0.0,
        le=10.0,
        description="Share of the rated load that is told as overload.",
    )
    recordings: str = Field(
        default="",
        max_length=4096,
        description="Directory into which the service record_start writes; none if empty.",
    )
    receive_buffer: int = Field(
        default=RECEIVE_BUFFER,
        ge=65536,
        le=1 << 28,
        description="Bytes that are asked of the kernel for what waits to be read.",
    )

    @model_validator(mode="after")
    def _possible(self) -> NetFtConfig:
        if self.profile != "auto" and Mode(self.mode) not in PROFILES[self.profile].starts:
            raise ValueError(f"mode: {self.profile} has no {self.mode}")
        if self.arm:
            checked_namespace(self.arm)
        if self.arm and self.orientation is not None:
            raise ValueError("arm: cannot be given together with a fixed orientation")
        if not self.http and self.scale is None and self.profile != "onrobot":
            raise ValueError("scale: is needed when http is false")
        moved = any(self.point) or any(self.rotation)
        if moved and self.measuring_frame_id in ("", self.frame_id):
            raise ValueError(
                "measuring_frame_id: needs a name of its own with a point or a rotation"
            )
        return self

"""Configuration of one CANopen joint, an axis of a drive: keys, defaults, units and bounds."""

from __future__ import annotations

from typing import Annotated, Final, Literal

from pydantic import Field, field_validator, model_validator

from crtk_driver_canopen.drive_profile import AUTO, NONE, built_in
from crtk_driver_canopen.homing import METHODS
from crtk_driver_canopen.identity import Identity
from crtk_driver_canopen.joint_scales import JointScales
from crtk_driver_canopen.modes import WAYS, OpMode, Way
from crtk_driver_canopen.objects import is_command, object_text, parse_object
from crtk_drivers.config import Settings

NodeId = Annotated[int, Field(ge=1, le=127)]
"""Id of a node on its bus."""

CobIds = Literal["predefined", "drive"] | tuple[Annotated[int, Field(ge=1, le=0x7FF)], ...]
"""Where COB-IDs of PDOs come from."""

ModeName = Literal["csp", "csv", "cst", "pp", "pv", "tq", "ip"]

MODE_NAMES: Final[dict[ModeName, OpMode]] = {
    "csp": OpMode.CSP,
    "csv": OpMode.CSV,
    "cst": OpMode.CST,
    "pp": OpMode.PP,
    "pv": OpMode.PV,
    "tq": OpMode.TQ,
    "ip": OpMode.IP,
}

_U32: Final = 0xFFFFFFFF


class IdentityConfig(Settings):
    """Who a node must be (1018h); what is null is not compared."""

    vendor: int | None = Field(default=None, ge=0, le=_U32, description="Vendor id (1018h:1).")
    product: int | None = Field(default=None, ge=0, le=_U32, description="Product code (1018h:2).")
    revision: int | None = Field(default=None, ge=0, le=_U32, description="Revision (1018h:3).")
    serial: int | None = Field(default=None, ge=0, le=_U32, description="Serial number (1018h:4).")
    name: str = Field(default="", max_length=200, description="Device name (1008h); any if empty.")

    @property
    def wanted(self) -> Identity:
        """The same as a value."""
        return Identity(
            vendor=self.vendor,
            product=self.product,
            revision=self.revision,
            serial=self.serial,
            name=self.name,
        )


class HomingConfig(Settings):
    """How a joint is homed. What is null stays as it is in the drive."""

    method: int = Field(
        ge=-128,
        le=127,
        description="Homing method (6098h), 17 to 37 or the manufacturer's below 0.",
    )
    speed_switch: float | None = Field(
        default=None, gt=0.0, description="Speed towards the switch (6099h:1), in rad/s (m/s)."
    )
    speed_zero: float | None = Field(
        default=None, gt=0.0, description="Speed towards the index (6099h:2), in rad/s (m/s)."
    )
    acceleration: float | None = Field(
        default=None, gt=0.0, description="Acceleration (609Ah), in rad/s² (m/s²)."
    )
    position: float | None = Field(
        default=None,
        description="Position of the joint at the home point (607Ch, or what its profile has for it), in "
        "rad (m).",
    )
    home_offset: Literal["position", "zero"] = Field(
        default="position",
        description="What the drive takes the home offset (607Ch) for: the position at the home point, "
        "or the way from there to zero, which is the negative of it.",
    )
    timeout: float = Field(default=60.0, gt=0.0, le=3600.0, description="Longest time, in s.")
    required: bool = Field(
        default=False, description="It counts as homed after `home` only, not from the start."
    )

    @field_validator("method")
    @classmethod
    def _known(cls, method: int) -> int:
        if method >= 0 and method not in METHODS:
            numbers = ", ".join(map(str, METHODS))
            raise ValueError(f"there is no homing method {method}, but {numbers}, and below 0")
        return method


class JointConfig(JointScales):
    """One joint: an axis of a drive."""

    node: NodeId = Field(description="Id of the node.")
    axis: int = Field(
        default=0,
        ge=0,
        le=7,
        description="Axis of a node with several: objects at 800h times this.",
    )
    eds: str = Field(
        default="",
        max_length=4096,
        description="EDS or DCF file of the drive: names and types of objects, and values to write.",
    )
    identity: IdentityConfig = Field(default=IdentityConfig(), description="Who the node must be.")
    profile: str = Field(
        default=AUTO,
        min_length=1,
        max_length=4096,
        description="What its make does otherwise than CiA 402: a name (epos4), a .toml file, none, or "
        "auto: by its identity (1018h).",
    )
    lower: float = Field(description="Least position, in rad (m).")
    upper: float = Field(description="Greatest position, in rad (m).")
    velocity: float = Field(gt=0.0, le=1000.0, description="Limit in rad/s (m/s).")
    acceleration: float = Field(
        default=10.0, gt=0.0, le=100_000.0, description="Limit in rad/s² (m/s²)."
    )
    jerk: float | None = Field(
        default=None,
        gt=0.0,
        le=1e7,
        description="Limit in rad/s³ (m/s³); ten times the acceleration in a second if null.",
    )
    effort: float = Field(
        default=0.0, ge=0.0, le=100_000.0, description="Limit in N·m (N); 0: no efforts are taken."
    )
    modes: tuple[ModeName, ...] = Field(
        default=("csp",),
        description="Modes of operation that are used: csp, csv, cst, pp, pv, tq, ip.",
    )
    homing: HomingConfig | None = Field(default=None, description="Homing; none if null.")
    quick_stop_option: int | None = Field(
        default=None,
        ge=-32768,
        le=8,
        description="What a quick stop does (605Ah), for example 6: quick stop ramp, and stay; the "
        "drive's own if null.",
    )
    abort_option: int | None = Field(
        default=3,
        ge=-32768,
        le=3,
        description="What the drive does when it does not hear us any more (6007h): 1 fault, 2 voltage "
        "off, 3 quick stop; the drive's own if null.",
    )
    shutdown_option: int | None = Field(
        default=None,
        ge=-32768,
        le=1,
        description="What a shutdown does (605Bh): 0 motor off at once, 1 slow down first; the drive's own "
        "if null.",
    )
    disable_option: int | None = Field(
        default=None,
        ge=-32768,
        le=1,
        description="What disabling the operation does (605Ch): 0 motor off at once, 1 slow down first; the "
        "drive's own if null.",
    )
    halt_option: int | None = Field(
        default=None,
        ge=-32768,
        le=4,
        description="What a halt does (605Dh), in homing and in moves of the drive's own: 1 slow down ramp, "
        "2 quick stop ramp; the drive's own if null.",
    )
    fault_option: int | None = Field(
        default=None,
        ge=-32768,
        le=4,
        description="What the drive does in a fault (605Eh): 0 motor off at once, 1 slow down ramp, 2 quick "
        "stop ramp; the drive's own if null.",
    )
    drive_limits: Literal["write", "keep"] = Field(
        default="write",
        description="Whether the drive is given this range and speed as its own limits (607Dh, 607Fh, "
        "6080h), or keeps those that it has.",
    )
    following_error: float | None = Field(
        default=None,
        gt=0.0,
        description="FAULT when the joint is further than this from where it was told to be, in rad (m); a "
        "tenth of a second at its greatest velocity if null.",
    )
    arrival: float | None = Field(
        default=None,
        gt=0.0,
        description="A move has ended when the joint is nearer than this to its goal, in rad (m); a fiftieth "
        "of a second at its greatest velocity if null.",
    )
    parameters: dict[str, int] = Field(
        default={},
        description="Objects that are written before the first enable, by index:sub or name: "
        "{6065: 2000}.",
    )
    first_rpdo: int | None = Field(
        default=None,
        ge=1,
        le=512,
        description="First RPDO that is used; the next free one if null.",
    )
    first_tpdo: int | None = Field(
        default=None,
        ge=1,
        le=512,
        description="First TPDO that is used; the next free one if null.",
    )
    rpdo_cob_ids: CobIds = Field(
        default="predefined",
        description="COB-IDs of its RPDOs: of the predefined connection set (up to 4 of a node), those that "
        "the drive has (14xxh:1), or a list.",
    )
    tpdo_cob_ids: CobIds = Field(
        default="predefined",
        description="The same of its TPDOs (18xxh:1).",
    )

    @field_validator("profile")
    @classmethod
    def _known_profile(cls, name: str) -> str:
        known = (AUTO, NONE, *sorted(built_in()))
        if name not in known and not name.endswith(".toml"):
            raise ValueError(
                f"there is no drive profile {name!r}, but {', '.join(known)}, and .toml files: "
                "'crtk-driver canopen profile EDS' writes one"
            )
        return name

    @field_validator("parameters")
    @classmethod
    def _objects(cls, parameters: dict[str, int]) -> dict[str, int]:
        for text in parameters:
            index, sub = parse_object(text)
            if is_command(index):
                raise ValueError(
                    f"{object_text(index, sub)} moves or powers a drive, or stores: that is never written "
                    "from a file"
                )
        return parameters

    @model_validator(mode="after")
    def _possible(self) -> JointConfig:
        if not self.lower < self.upper:
            raise ValueError(f"lower ({self.lower:g}) must be below upper ({self.upper:g})")
        if not self.modes or len(set(self.modes)) != len(self.modes):
            raise ValueError("modes: give at least one, and none twice")
        return self

    @property
    def following(self) -> float:
        """How far it may be from where it was told to be, in rad (m)."""
        return 0.1 * self.velocity if self.following_error is None else self.following_error

    @property
    def arrives_within(self) -> float:
        """How near to its goal a move has ended, in rad (m)."""
        return 0.02 * self.velocity if self.arrival is None else self.arrival

    @property
    def op_modes(self) -> tuple[OpMode, ...]:
        """Modes of operation that are used, the first one first."""
        return tuple(MODE_NAMES[name] for name in self.modes)

    @property
    def ways(self) -> frozenset[Way]:
        """What it can be told to follow."""
        return frozenset(
            way
            for way, modes in WAYS.items()
            if any(mode in self.op_modes for mode in modes)
            and (way is not Way.EFFORTS or self.effort > 0.0)
        )

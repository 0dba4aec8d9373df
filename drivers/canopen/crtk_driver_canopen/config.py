"""Configuration of CANopen joints: keys, defaults, units and bounds."""

from __future__ import annotations

from typing import Annotated, Final, Literal

from pydantic import Field, field_validator, model_validator

from crtk_driver_canopen.drive_profile import AUTO, NONE, built_in
from crtk_driver_canopen.homing import METHODS
from crtk_driver_canopen.identity import Identity
from crtk_driver_canopen.joint_scales import JointScales
from crtk_driver_canopen.modes import WAYS, OpMode, Way
from crtk_driver_canopen.objects import is_command, object_text, parse_object
from crtk_driver_canopen.parameter_owners import written_otherwise
from crtk_driver_canopen.units import check_wire, interpolation_period
from crtk_drivers.config import DeviceConfig, Settings

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


class BusConfig(Settings):
    """The CAN bus, as python-can opens it."""

    interface: str = Field(
        default="socketcan",
        min_length=1,
        max_length=64,
        description="Interface of python-can: socketcan, slcan, pcan, kvaser, socketcand, crtk, ...",
    )
    channel: str = Field(
        default="can0", max_length=250, description="Channel of that interface, for example can0."
    )
    bitrate: int = Field(
        default=1_000_000,
        ge=10_000,
        le=1_000_000,
        description="In bit/s. For socketcan it is that to which the interface was set.",
    )
    options: dict[str, str | int | float | bool] = Field(
        default={},
        description="Further arguments of the interface, for example host and port of socketcand.",
    )
    load_limit: float = Field(
        default=0.8,
        gt=0.0,
        le=1.0,
        description="Share of the bus that the cycle may take at worst; more is refused.",
    )


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


class HeartbeatConfig(Settings):
    """Heartbeats both ways, in s. CANopen counts them in ms."""

    ours: float = Field(
        default=0.05, ge=0.0, le=10.0, description="Time between two of our heartbeats; 0: none."
    )
    ours_timeout: float = Field(
        default=0.2,
        ge=0.0,
        le=60.0,
        description="A drive stops by itself when it heard none of ours for this long (1016h); 0: "
        "never.",
    )
    drives: float = Field(
        default=0.1,
        ge=0.0,
        le=10.0,
        description="Time between two heartbeats of a drive (1017h); 0: none.",
    )
    error_behaviour: int | None = Field(
        default=0,
        ge=0,
        le=2,
        description="What the node does besides when it does not hear us (1029h:1): 0 pre-operational, so "
        "that it follows no late PDO, 1 nothing, 2 stopped; its own if null.",
    )
    drives_timeout: float = Field(
        default=0.3,
        ge=0.0,
        le=60.0,
        description="FAULT when a drive was not heard for this long; 0: not watched.",
    )
    required: bool = Field(
        default=True,
        description="Refuse a drive that ignores its heartbeat times or abort option: nothing would "
        "stop it when this computer fails.",
    )

    @model_validator(mode="after")
    def _in_time(self) -> HeartbeatConfig:
        pairs = (
            ("ours", self.ours, self.ours_timeout),
            ("drives", self.drives, self.drives_timeout),
        )
        for name, period, timeout in pairs:
            if timeout and not period:
                raise ValueError(f"{name}_timeout needs heartbeats: give {name}")
            if timeout and timeout < 2.0 * period:
                raise ValueError(
                    f"{name}_timeout ({timeout:g} s) must be at least twice {name} ({period:g} s), or "
                    "one lost frame stops everything"
                )
        return self


class CanopenConfig(DeviceConfig):
    """An arm of CiA 402 drives on one CAN bus."""

    bus: BusConfig = Field(default=BusConfig(), description="The CAN bus.")
    joints: dict[str, JointConfig] = Field(
        default={}, max_length=64, description="Joints by name, in the order of joint vectors."
    )
    period: float = Field(
        default=0.004, ge=0.001, le=0.1, description="Time between two SYNCs, in s."
    )
    sync: Literal["auto", "thread", "kernel"] = Field(
        default="auto",
        description="Who sends the SYNC: this program's I/O thread, or the kernel; auto: the kernel on "
        "socketcan.",
    )
    sync_counter: int = Field(
        default=0, ge=0, le=240, description="Highest value of the SYNC counter (1019h); 0: none."
    )
    feedback: tuple[Literal["velocity", "effort"], ...] = Field(
        default=("velocity", "effort"),
        description="What is measured beside the position. Each costs time on the bus.",
    )
    feedback_every: int = Field(
        default=1, ge=1, le=240, description="Velocity and effort come with every n-th SYNC."
    )
    master_node: NodeId = Field(default=127, description="Id of this computer, for its heartbeat.")
    heartbeat: HeartbeatConfig = Field(default=HeartbeatConfig(), description="Heartbeats.")
    missed_cycles: int = Field(
        default=3, ge=1, le=100, description="FAULT when a drive missed more cycles in a row."
    )
    sdo_timeout: float = Field(
        default=0.5, gt=0.0, le=10.0, description="Longest time for each answer of an SDO, in s."
    )
    on_joint_fault: Literal["quick_stop", "hold", "disable"] = Field(
        default="quick_stop",
        description="What the other joints do when one has a fault: stop quickly, hold their position, "
        "or let go.",
    )
    moves: Literal["trajectory", "drives"] = Field(
        default="trajectory",
        description="Who plans move_jp where the joints have both csp (or ip) and pp: this program, in "
        "each cycle, or each drive its own way.",
    )
    disable: Literal["switch_off", "hold"] = Field(
        default="switch_off",
        description="What disable does: take the power from the motors, or leave them holding.",
    )
    on_close: Literal["hold", "power_off"] = Field(
        default="power_off",
        description="How the drives are left at the end, once the joints stand: without power, or holding, "
        "which nothing watches any more.",
    )
    candump: str = Field(
        default="",
        max_length=4096,
        description="File to which all frames are logged; none if empty.",
    )

    @field_validator("sync_counter")
    @classmethod
    def _countable(cls, overflow: int) -> int:
        if overflow == 1:
            raise ValueError("the SYNC counter goes up to 2 at least (CiA 301); 0: none")
        return overflow

    @field_validator("period")
    @classmethod
    def _expressible(cls, period: float) -> float:
        interpolation_period(period)
        return period

    @model_validator(mode="after")
    def _chain(self) -> CanopenConfig:
        taken: dict[tuple[int, int], str] = {}
        identities: dict[int, str] = {}
        for name, joint in self.joints.items():
            if not name:
                raise ValueError("joints: a joint has no name")
            other = taken.setdefault((joint.node, joint.axis), name)
            if other != name:
                raise ValueError(
                    f"joints.{name}: node {joint.node}, axis {joint.axis} is also that of {other}"
                )
            if joint.node == self.master_node:
                raise ValueError(
                    f"joints.{name}.node: {joint.node} is the id of this computer (master_node)"
                )
            check_wire(name, joint, joint.known_units)
            for text in joint.parameters:
                other = written_otherwise(text, joint, moves=self.drives_plan)
                if other:
                    raise ValueError(f"joints.{name}.parameters: {other}")
            first = identities.setdefault(joint.node, name)
            if self.joints[first].identity != joint.identity:
                raise ValueError(
                    f"joints.{name}.identity: differs from that of {first}, which is on the same node"
                )
        if self.joints and not self.ways:
            modes = "; ".join(f"{name}: {', '.join(j.modes)}" for name, j in self.joints.items())
            raise ValueError(
                "joints: nothing could be commanded, for no kind of mode (csp or ip, pp, csv or pv, cst or "
                f"tq with an effort limit) is there for every joint: {modes}"
            )
        if self.heartbeat.ours_timeout * 1000 > 0xFFFF or self.heartbeat.drives * 1000 > 0xFFFF:
            raise ValueError("heartbeat: times are 65.535 s at most")
        return self

    @property
    def ways(self) -> tuple[Way, ...]:
        """What all joints can be told to follow; the first one is that in which they hold still."""
        return tuple(
            w for w in Way if self.joints and all(w in j.ways for j in self.joints.values())
        )

    @property
    def drives_plan(self) -> bool:
        """Whether move_jp is planned by the drives."""
        return Way.MOVES in self.ways and (self.moves == "drives" or Way.POSITIONS not in self.ways)

    @property
    def kernel_sync(self) -> bool:
        """Whether the kernel sends the SYNC."""
        return self.sync == "kernel" or (self.sync == "auto" and self.bus.interface == "socketcan")

    @property
    def nodes(self) -> tuple[int, ...]:
        """Ids of the nodes, in the order of their first joint."""
        return tuple(dict.fromkeys(joint.node for joint in self.joints.values()))

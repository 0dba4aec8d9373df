"""Configuration of an arm of CANopen joints on one bus: keys, defaults, units and bounds."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, field_validator, model_validator

from crtk_driver_canopen.joint_config import JointConfig, NodeId
from crtk_driver_canopen.modes import Way
from crtk_driver_canopen.parameter_owners import written_otherwise
from crtk_driver_canopen.units import check_wire, interpolation_period
from crtk_drivers.config import DeviceConfig, Settings


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

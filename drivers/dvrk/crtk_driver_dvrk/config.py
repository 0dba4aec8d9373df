"""What a user may set: the keys of the file, and the options of ``crtk-driver dvrk``."""

from __future__ import annotations

import ipaddress
from collections.abc import Mapping
from typing import ClassVar, Self

from pydantic import Field, model_validator

from crtk_driver_dvrk.packets import PORT
from crtk_drivers.config import DeviceConfig

__all__ = ["DvrkConfig"]

_LINK_LOCAL = ipaddress.IPv4Network("169.254.0.0/16")


class DvrkConfig(DeviceConfig):
    """An arm of a da Vinci Research Kit, whose state is read, and which is driven where that is asked for."""

    HEADINGS: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "The controller": ("host", "udp_port", "broadcast"),
        "The arm": ("io", "robot", "coupling", "joint_names"),
        "What it does": ("rate", "reply_timeout"),
        "Driving": (
            "drive",
            "current_share",
            "angular_velocity",
            "linear_velocity",
            "watchdog",
            "feedback_timeout",
            "current_error",
        ),
        **DeviceConfig.HEADINGS,
    }

    host: str = Field(
        default="",
        max_length=255,
        description="IPv4 address of the board with the Ethernet cable; dVRK's is 169.254.0.100.",
    )
    udp_port: int = Field(default=PORT, ge=1, le=65535, description="UDP port of the boards.")
    broadcast: str | None = Field(
        default=None,
        max_length=255,
        description="Address at which boards are told which address they have, since they forget it without "
        "power; empty: they are not. If null, 169.254.255.255 where `host` is in 169.254.0.0/16.",
    )
    io: str = Field(
        default="",
        max_length=1000,
        description="Path of the arm's file of inputs and outputs (sawRobotIO1394-….json, in SI units).",
    )
    robot: str = Field(
        default="",
        max_length=100,
        description="Name of the arm in that file; the only one if empty.",
    )
    coupling: str = Field(
        default="",
        max_length=1000,
        description="Path of a file of dVRK with coupling.ActuatorToJointPosition: that of the instrument "
        "(4 x 4, the last four actuators) or of the whole arm. Empty: joints are actuators.",
    )
    joint_names: tuple[str, ...] = Field(
        default=(),
        max_length=16,
        description="Names of the joints, one for each actuator; joint_1, joint_2, ... if empty.",
    )
    rate: float = Field(
        default=250.0, ge=10.0, le=1000.0, description="How often all boards are read, in Hz."
    )
    reply_timeout: float = Field(
        default=0.02,
        ge=0.002,
        le=0.5,
        description="Longest time for the answers of one reading, in s; then all are asked anew.",
    )

    drive: bool = Field(
        default=False,
        description="Drive the arm by efforts of its joints. Without it nothing is written that moves or "
        "powers anything. Read what the page on dVRK controllers says of it first.",
    )
    current_share: float = Field(
        default=0.5,
        gt=0.0,
        le=1.0,
        description="Share of each maximum_current of `io` that may be used.",
    )
    angular_velocity: float = Field(
        default=1.0, gt=0.0, le=20.0, description="Fastest that a revolute joint may get, in rad/s."
    )
    linear_velocity: float = Field(
        default=0.2, gt=0.0, le=2.0, description="Fastest that a prismatic joint may get, in m/s."
    )
    watchdog: float = Field(
        default=0.05,
        ge=0.005,
        le=0.3,
        description="Seconds without a packet of this driver after which boards switch amplifiers off.",
    )
    feedback_timeout: float = Field(
        default=0.05,
        ge=0.005,
        le=2.0,
        description="Seconds without a state of all boards after which the arm is switched off.",
    )
    current_error: float = Field(
        default=0.4,
        ge=0.05,
        le=3.0,
        description="A by which a measured current may be another one than was asked for, for 0.1 s.",
    )

    @model_validator(mode="after")
    def _addresses(self) -> Self:
        for key in ("host", "broadcast"):
            value = getattr(self, key)
            try:
                ipaddress.IPv4Address(value or "0.0.0.0")
            except ValueError as error:
                raise ValueError(
                    f"{key}: {value!r} is no IPv4 address, which boards have"
                ) from error
        return self

    @property
    def told_at(self) -> str:
        """Where boards are told their address; empty: they are not."""
        if self.broadcast is not None:
            return self.broadcast
        is_local = ipaddress.IPv4Address(self.host or "0.0.0.0") in _LINK_LOCAL
        return str(_LINK_LOCAL.broadcast_address) if is_local else ""

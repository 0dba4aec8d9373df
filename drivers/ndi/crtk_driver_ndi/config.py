"""Configuration of a tracker: keys, defaults, units and bounds."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import ClassVar, Final, Literal

from pydantic import Field, model_validator

from crtk_driver_ndi.families import FAMILIES, UNKNOWN, Family
from crtk_driver_ndi.rom import read_rom
from crtk_drivers.config import DeviceConfig, Settings
from crtk_drivers.config.settings import PoseConfig, Seconds

__all__ = ["BAUDS", "TCP_PORT", "NdiConfig", "ToolConfig"]

TCP_PORT: Final = 8765

BAUDS: Final[Mapping[int, str]] = {
    9600: "0",
    38400: "3",
    57600: "4",
    115200: "5",
    921600: "6",
    1228739: "7",
}
"""Rates and their digits in COMM. 14400 and 19200 exist, and do not work (PlusLib, pull request 244)."""


class ToolConfig(Settings):
    """A tool: wireless by its rom; wired by as many of its numbers, its port and channel as it needs."""

    name: str = Field(
        default="",
        max_length=40,
        description="Its namespace below the tracker's: letters, digits and underscores. From its part "
        "number if empty.",
    )
    rom: str = Field(
        default="",
        description="Path of the definition (.rom) of a wireless tool; with `port`, "
        "of a wired one that has none in its own memory (Aurora).",
    )
    part_number: str = Field(
        default="",
        max_length=20,
        description="Of a wired tool, as `crtk-driver ndi scan` shows it.",
    )
    serial_number: str = Field(
        default="", max_length=8, description="Of a wired tool, as `crtk-driver ndi scan` shows it."
    )
    port: int | None = Field(
        default=None, ge=1, le=99, description="Where a wired tool is plugged in, from 1."
    )
    channel: int | None = Field(
        default=None,
        ge=0,
        le=99,
        description="Which sensor of a wired tool with two: 0 or 1. The first that is free if null.",
    )

    tip: PoseConfig | None = Field(
        default=None,
        description="Where its tip is in its own frame, as `crtk-driver calibrate pivot` finds it; poses are "
        "then those of the tip.",
    )

    @model_validator(mode="after")
    def _one_source(self) -> ToolConfig:
        is_numbered = bool(self.part_number or self.serial_number)
        if not (self.rom or is_numbered or self.port):
            raise ValueError("give rom, or part_number, serial_number or port of a wired tool")
        if self.rom and is_numbered:
            raise ValueError(
                "give rom, or part_number and serial_number, not both: rom may have port"
            )
        if self.channel is not None and not (is_numbered or self.port):
            raise ValueError("channel: is of a wired tool; give port too")
        if self.name and not re.fullmatch(r"[a-z][a-z0-9_]*", self.name):
            raise ValueError(f"name: {self.name!r} is not made of a-z, 0-9 and _, a letter first")
        return self

    @property
    def is_wireless(self) -> bool:
        """Whether the tracker gives it a handle only when it is asked for one."""
        return bool(self.rom) and self.port is None

    @property
    def namespace(self) -> str:
        """Its name, or what its part number makes of one: ``tool_8700339``.

        Raises:
            ConfigError: its definition cannot be read.
        """
        if self.name:
            return self.name
        number = (
            read_rom(self.rom).part_number if self.rom else self.part_number or self.serial_number
        )
        if not number and self.port:
            number = f"port_{self.port}"
        if self.channel:
            number += f"_{self.channel}"
        return "tool_" + (re.sub(r"[^a-z0-9]+", "_", number.lower()).strip("_") or "unnamed")


class NdiConfig(DeviceConfig):
    """A Polaris or Aurora tracker."""

    HEADINGS: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "Tracker": (
            "transport",
            "host",
            "tcp_port",
            "port",
            "baud",
            "family",
            "replies",
            "volume",
            "track_frequency",
        ),
        "Tools": ("tools", "reference", "outside", "strays", "frame_id"),
    }

    transport: Literal["tcp", "serial"] = Field(
        default="tcp", description="Vega and Lyra: tcp. Vicra, Spectra, Aurora: serial (or USB)."
    )
    host: str = Field(default="", max_length=253, description="Address or name of the tracker.")
    tcp_port: int = Field(default=TCP_PORT, ge=1, le=65535, description="TCP port.")
    port: str = Field(default="", description="Serial port, best its name under /dev/serial/by-id.")
    baud: Literal[9600, 38400, 57600, 115200, 921600, 1228739] = Field(
        default=115200, description="Rate of the serial line to be used, in bit/s."
    )
    family: Literal["auto", "vicra", "spectra", "vega", "vega-vt", "vega-xt", "lyra", "aurora"] = (
        Field(default="auto", description="What it is; auto asks it, and reads at 60 Hz.")
    )
    replies: Literal["auto", "BX2", "BX", "TX"] = Field(
        default="auto", description="How frames are asked for; auto takes the best that it has."
    )
    volume: int | None = Field(
        default=None, ge=0, le=15, description="Volume to be selected (VSEL); as it is if null."
    )
    track_frequency: Literal[20, 30, 60] | None = Field(
        default=None,
        description="Frames that a Polaris takes, in Hz: Param.Tracking.Track Frequency, or IRATE of an "
        "older one. As it is if null.",
    )
    tools: tuple[ToolConfig, ...] = Field(default=(), description="The tools.")
    reference: str = Field(
        default="",
        description="Name of the tool in whose frame the others are given; their `local/measured_cp` is in "
        "that of the tracker. The tracker's own frame if empty.",
    )
    outside: Literal["tell", "missing"] = Field(
        default="tell",
        description="A tool that is seen outside of the volume, or partly: tell its pose and its quality, or "
        "take it as missing.",
    )
    strays: bool = Field(
        default=False,
        description="Ask for markers that belong to no tool, too: they are in `measured_cp_array`.",
    )
    frame_id: str = Field(
        default="tracker", min_length=1, max_length=100, description="Name of the tracker's frame."
    )
    open_timeout: Seconds = Field(
        default=30.0,
        description="Longest time to connect, in s. To initialise a tracker takes seconds.",
    )

    @model_validator(mode="after")
    def _named(self) -> NdiConfig:
        names = [tool.name for tool in self.tools if tool.name]
        if twice := {name for name in names if names.count(name) > 1}:
            raise ValueError(f"tools: {', '.join(sorted(twice))} more than once")
        return self

    @property
    def known_family(self) -> Family:
        """What the configuration says that it is."""
        return FAMILIES.get(self.family, UNKNOWN)

    @property
    def rate(self) -> float:
        """Frames a second, as far as the configuration knows."""
        rate = self.known_family.rate
        return rate if self.track_frequency is None else min(rate, float(self.track_frequency))

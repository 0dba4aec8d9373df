"""The simulated tools and their registers as data (Connectivity Guide 1.22, data sheets)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class Registers:
    """Where a tool with fingers has what: registers by their addresses.

    Attributes:
        writes: how many can be written, from 0 on; the last starts and stops.
        force, width, speed: which of these is what; -1: there is none.
        starts: orders that move, with whether they grip from inside; others are ignored.
        stop: the order that stops.
        flags: bit 0 busy, bit 1 grip detected.
        widths: registers that tell the opening in 0.1 mm.
        inner: registers that tell it outside of the fingers.
        ranges: registers of the least and greatest opening, and of those of `inner`.
        offset: register of the fingertips' thickness.
        told_force: register of the force, in N, closing negative.
        force_unit: N of a count.
        calibrated: flag that is set while it is.
    """

    writes: int
    force: int
    width: int
    speed: int
    starts: Mapping[int, bool | None]
    stop: int
    flags: int
    widths: tuple[int, ...]
    inner: tuple[int, ...] = ()
    ranges: tuple[int, ...] = ()
    offset: int = 0
    told_force: int = 0
    force_unit: float = 0.1
    calibrated: int = 0


@dataclass(frozen=True)
class Channels:
    """Where a vacuum tool has what: vacuum of both channels in thousandths."""

    vacuum: tuple[int, ...] = (0x0102, 0x0103)
    limit: int = 0x0002


@dataclass(frozen=True)
class Model:
    """Product code, registers, range in m, greatest force in N, speed in m/s."""

    code: int
    family: Registers | Channels
    range: tuple[float, float] = (0.0, 0.0)
    force: float = 0.0
    speed: float = 0.0


RG: Final = Registers(
    3, 0, 1, -1, {1: None, 16: None}, 8, 0x010C, widths=(0x0113,), inner=(0x010B,), offset=0x0102
)
TWO: Final = Registers(
    4,
    1,
    0,
    2,
    {1: False, 2: True},
    3,
    0x0100,
    widths=(0x0101,),
    inner=(0x0102,),
    ranges=(0x0103, 0x0104, 0x0105, 0x0106),
    told_force=0x0107,
    force_unit=1.0,
)
THREE: Final = Registers(
    4,
    0,
    1,
    -1,
    {1: None, 2: None, 5: None},
    4,
    0x0100,
    widths=(0x0102,),
    inner=(0x0101,),
    ranges=(0x0201, 0x0202),
    force_unit=0.24,
    calibrated=0x08,
)
MODELS: Final[Mapping[str, Model]] = {
    "rg2": Model(0x20, RG, (0.0, 0.110), 40.0, 0.184),
    "rg6": Model(0x21, RG, (0.0, 0.160), 120.0, 0.160),
    "2fg7": Model(0xC0, TWO, (0.0, 0.073), 140.0, 0.450),
    "2fg14": Model(0xC1, TWO, (0.0, 0.073), 280.0, 0.450),
    "3fg15": Model(0x70, THREE, (0.004, 0.152), 240.0, 0.125),
    "vg10": Model(0x10, Channels()),
    "vgc10": Model(0x11, Channels()),
}

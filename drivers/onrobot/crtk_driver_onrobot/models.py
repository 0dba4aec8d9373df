"""The grippers and their register maps as data.

Sources: OnRobot Connectivity Guide 1.22 as programs of others have it (takuya-ki/onrobot-rg and onrobot-vg,
headers of a ROS 2 driver), the test peer of OnRobot/onrobot-ros2 (product codes), data sheets (range, force,
speed).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import ClassVar, Final, NamedTuple

from crtk_drivers.kit.gripping import Fault

__all__ = ["IDENTITY", "MODELS", "PER_MILLE", "FaultBit", "Fingers", "Model", "Spot", "Vacuum"]


class Spot(NamedTuple):
    """A value in a register: its address, what one count means in SI units, and whether it has a sign."""

    address: int
    unit: float = 1.0
    signed: bool = False


class Span(NamedTuple):
    """Registers that are read together."""

    address: int
    size: int


class FaultBit(NamedTuple):
    """What a status bit means; `when` it has this value."""

    mask: int
    fault: Fault
    when: bool = True


IDENTITY: Final = Span(0x0600, 25)
"""Product code, firmware at 4 and 5, serial number as text from 9 on; of every device."""

_MM: Final = 1e-4
"""Lengths are in tenths of a millimetre."""


@dataclass(frozen=True)
class Fingers:
    """How grippers of a family are spoken to.

    Attributes:
        status: registers of the status.
        flags: register of bit 0, busy, and bit 1, grip detected.
        opening: between the fingertips.
        command: what is written from register 0 on, in this order: ``opening``, ``force`` and ``speed`` with
            what a count means, or a number, which is written as it is; the last is the order itself.
        stop: what is written there to stop.
        details: registers of the range, which are read beside the status.
        other: registers that have what is needed of the status as well, fewer of them.
        range: where the least and the greatest opening are told.
        offset: where each fingertip's thickness is told, by which the range is less.
        effort: force at the fingers, closing negative.
        faults: bits of `flags`; the first that is set counts.
    """

    status: Span
    flags: int
    opening: Spot
    command: tuple[tuple[str, float] | int, ...]
    stop: int
    details: Span
    range: tuple[Spot, Spot] | None = None
    offset: Spot | None = None
    effort: Spot | None = None
    faults: tuple[FaultBit, ...] = ()
    other: Span | None = None


@dataclass(frozen=True)
class Vacuum:
    """How vacuum grippers are spoken to.

    Attributes:
        status: vacuum of each channel, in thousandths.
        details: limit of the current, in mA.
        channels: their names; each has a register, from 0 on: the high byte says what to do, the low byte the
            vacuum in percent.
        release, grip: what to do.
    """

    status: Span
    details: Span
    channels: tuple[str, ...] = ("a", "b")
    release: int = 0x0000
    grip: int = 0x0100
    other: ClassVar[None] = None


PER_MILLE: Final = 101.325
"""Pa below the ambient pressure that a thousandth of vacuum means."""

_LATCH: Final = (
    "Free the fingers and release the switch. Then its power must go and come back: the service power_cycle "
    "(Compute Box), or the tool's voltage off and on. Enable it after that."
)
_RG: Final = Fingers(
    status=Span(0x010B, 9),
    other=Span(0x010C, 8),
    flags=0x010C,
    opening=Spot(0x0113, _MM),
    command=(("force", 0.1), ("opening", _MM), 16),
    stop=8,
    details=Span(0x0102, 1),
    offset=Spot(0x0102, _MM, signed=True),
    faults=(
        FaultBit(0x04, Fault("its safety switch 1 is pushed", _LATCH)),
        FaultBit(0x10, Fault("its safety switch 2 is pushed", _LATCH)),
        FaultBit(0x08, Fault("its safety circuit 1 has tripped", _LATCH)),
        FaultBit(0x20, Fault("its safety circuit 2 has tripped", _LATCH)),
        FaultBit(0x40, Fault("a safety switch was pushed when it was powered on", _LATCH)),
    ),
)


def _two_fingers(inside: bool) -> Fingers:
    lower, upper = (0x0105, 0x0106) if inside else (0x0103, 0x0104)
    return Fingers(
        status=Span(0x0100, 8),
        flags=0x0100,
        opening=Spot(0x0102 if inside else 0x0101, _MM, signed=True),
        command=(("opening", _MM), ("force", 1.0), ("speed", 0.01), 2 if inside else 1),
        stop=3,
        details=Span(0x0103, 4),
        range=(Spot(lower, _MM, signed=True), Spot(upper, _MM)),
        effort=Spot(0x0107, 1.0, signed=True),
    )


def _three_fingers(inside: bool) -> Fingers:
    return Fingers(
        status=Span(0x0100, 4),
        other=Span(0x0100, 3),
        flags=0x0100,
        opening=Spot(0x0102, _MM),
        command=(("force", 0.24), ("opening", _MM), int(inside), 1),
        stop=4,
        details=Span(0x0201, 2),
        range=(Spot(0x0201, _MM), Spot(0x0202, _MM)),
        faults=(
            FaultBit(
                0x08,
                Fault("it is not calibrated", "Calibrate it (OnRobot's web client)."),
                when=False,
            ),
        ),
    )


@dataclass(frozen=True)
class Model:
    """One model.

    Attributes:
        title: for people.
        code: product code.
        map: how it is spoken to.
        inside: the same to grip from inside, where that is another order.
        upper: the greatest opening with any fingers, in m.
        force: least and greatest, in N.
        speed: greatest of the opening, in m/s.
    """

    title: str
    code: int
    map: Fingers | Vacuum
    inside: Fingers | None = None
    upper: float = 0.0
    force: tuple[float, float] = field(default=(0.0, 0.0))
    speed: float = 0.0


_VG = Vacuum(status=Span(0x0102, 2), details=Span(0x0002, 1))
_2FG = (_two_fingers(inside=False), _two_fingers(inside=True))
_3FG = (_three_fingers(inside=False), _three_fingers(inside=True))

MODELS: Mapping[str, Model] = MappingProxyType(
    {
        "rg2": Model("RG2", 0x20, _RG, None, 0.110, (3.0, 40.0), 0.184),
        "rg6": Model("RG6", 0x21, _RG, None, 0.160, (25.0, 120.0), 0.160),
        "2fg7": Model("2FG7", 0xC0, *_2FG, 0.075, (20.0, 140.0), 0.450),
        "2fg14": Model("2FG14", 0xC1, *_2FG, 0.105, (30.0, 280.0), 0.450),
        "3fg15": Model("3FG15", 0x70, *_3FG, 0.180, (10.0, 240.0), 0.125),
        "vg10": Model("VG10", 0x10, _VG),
        "vgc10": Model("VGC10", 0x11, _VG),
    }
)
"""By the name in a configuration."""

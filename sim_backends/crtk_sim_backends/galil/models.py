"""What simulated controllers are called, and what their data records are made of (manuals, chapter 4)."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from crtk_sim_backends.galil.axis import Axis


@dataclass(frozen=True)
class Model:
    """One controller.

    Attributes:
        revision: its answer to ^R^V.
        head: bytes before the first axis, the header included.
        tail: bytes of an axis beyond the first 30.
        header: it begins with flags, axes and size.
        sample, error, amplifier: where these are; amplifier None: nowhere.
        general, coordinated: bytes of these blocks, for QZ.
    """

    revision: str
    head: int
    tail: int
    header: bool
    sample: int
    error: int
    amplifier: int | None
    general: int
    coordinated: int


MODELS: Final[dict[str, Model]] = {
    "4143": Model("DMC4143 Rev 1.3d", 82, 6, True, 4, 50, 52, 58, 20),
    "52040": Model("DMC52040 Rev 1.0", 82, 6, True, 4, 50, 52, 58, 20),
    "30010": Model("DMC30010 Rev 1.2c", 38, 6, True, 4, 10, 18, 22, 12),
    "2143": Model("DMC2143 Rev 1.0p", 44, 0, True, 4, 26, None, 24, 16),
    "1806": Model("DMC1806 Rev 1.0e", 78, 0, False, 0, 46, None, 62, 16),
}

_MOVING, _EDGE, _HOMING, _OFF = 0x8000, 0x1000, 0x0800, 0x0001
_VOLT: Final = 32767 / 9.9982


def record(model: Model, axes: Sequence[Axis], sample: int, error: int, amplifier: int) -> bytes:
    """Return the data record as it is now."""
    head = bytearray(model.head)
    if model.header:
        size = model.head + (30 + model.tail) * len(axes)
        struct.pack_into("<BBH", head, 0, 0x87, (1 << len(axes)) - 1, size)
    struct.pack_into("<H", head, model.sample, sample & 0xFFFF)
    head[model.error] = error
    if model.amplifier is not None:
        struct.pack_into("<I", head, model.amplifier, amplifier)
    return bytes(head) + b"".join(_axis(model, axis) for axis in axes)


def _axis(model: Model, axis: Axis) -> bytes:
    status = _MOVING * axis.moving | _HOMING * axis.homing | _OFF * (not axis.on)
    status |= _EDGE * axis.finding
    switches = 0x08 * axis.forward_limit | 0x04 * axis.reverse_limit | 0x02 * axis.home_switch
    place = round(axis.reference), axis.counts, round(axis.reference) - axis.counts, 0
    moved = round(64 * axis.velocity), round(axis.volts * _VOLT)
    block = struct.pack("<HBB6iH", status, switches, axis.stop_code, *place, *moved, 0)
    return block + bytes(model.tail)

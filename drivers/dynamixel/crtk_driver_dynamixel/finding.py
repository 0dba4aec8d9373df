"""Chains of servos on the serial ports of this machine, for a lab file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

from crtk_driver_dynamixel.tool_options import BAUDS
from crtk_driver_dynamixel.tools import require_libraries
from crtk_drivers.kit.adapters import serial_adapters
from crtk_drivers.plugins import Finder, FoundDevice

IDS: Final = range(31)
"""Ids that are asked; `crtk-driver dynamixel scan` asks all."""

PROTOCOLS: Final = (2, 1)


def _look(port: str) -> Iterable[FoundDevice]:
    """Ask the common ids at the rates that servos have.

    Raises:
        MissingExtra: a library is not installed.
        ConnectionFailed: the port cannot be opened.
    """
    require_libraries()
    from crtk_driver_dynamixel.terminal import Found, scan_bus

    answers = scan_bus("", port, BAUDS, PROTOCOLS, IDS)
    found = [one for one in answers if isinstance(one, Found)]
    if not found:
        return []
    ((baud, _),) = Counter(one.baud for one in found).most_common(1)
    chain = sorted((one for one in found if one.baud == baud), key=lambda one: one.id)
    told = ", ".join(f"{one.model} (id {one.id})" for one in chain)
    others = sorted({one.baud for one in found} - {baud})
    told += "".join(f"; others at {rate} bit/s" for rate in others)
    joints = _joints([(one.id, one.model, one.protocol) for one in chain if one.is_known])
    return [FoundDevice({"port": port, "baud": baud, "joints": joints}, told)]


def _joints(servos: Sequence[tuple[int, str, int]]) -> Mapping[str, Any]:
    return {
        f"joint_{number}": {"id": id, "model": model} | ({"protocol": 1} if protocol == 1 else {})
        for number, (id, model, protocol) in enumerate(servos, 1)
    }


FINDER: Final = Finder(serial_adapters, lambda place: place.startswith("/"), _look)

"""Commands for people: what a gripper is, can and does."""

from __future__ import annotations

import time
from typing import Any, Final

from rich.console import Console

from crtk_driver_schunk.gripper.config import SchunkConfig
from crtk_driver_schunk.gripper.faults import WARNINGS, fault_of
from crtk_driver_schunk.gripper.image import SIZE, STATUS, State, Status
from crtk_driver_schunk.gripper.link import Question
from crtk_driver_schunk.gripper.parameters import describe
from crtk_drivers.plugins import Tool

__all__ = ["TOOLS"]


def _info(config: SchunkConfig, options: Any) -> int:
    from crtk_driver_schunk.gripper.connecting import ask, make_link, told_by

    deadline = time.monotonic() + config.open_timeout
    link = make_link(config)
    try:
        link.open(deadline)
        told = told_by(link, deadline)
        image = ask(link, Question(STATUS, SIZE), deadline)
    finally:
        link.close()
    found = describe(told)
    status = Status.parse(image, found.order)
    fault = fault_of(status.error) if State.ERROR in status.bits else None
    rows = {
        "model": f"{found.model}, {found.fieldbus}",
        "serial, firmware": f"{found.serial}, {found.firmware}",
        "lower, upper": f"{found.lower:.6g}, {found.upper:.6g}",
        "speed": f"{found.speed:.6g}",
        "max_force": f"{found.max_force:.6g}",
        "position": f"{status.position:.6f} m",
        "status": ", ".join(bit.name.lower().replace("_", " ") for bit in status.bits if bit.name),
        "warning": WARNINGS.get(status.warning, f"{status.warning:02X}")
        if status.warning
        else "none",
        "error": "none" if fault is None else f"{fault.text}. {fault.remedy}",
    }
    console = Console(highlight=False)
    for name, value in rows.items():
        console.print(f"{name:<18}{value}")
    return 0


TOOLS: Final = (Tool("info", "tells what it is, can and reports; nothing is written", _info),)

"""What a run may do, and to which device: what was asked for, and what the lab file allows."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

from crtk_drivers.labs.bench.calls import About
from crtk_drivers.labs.bench.declared import BenchTest, Safety, Suite
from crtk_drivers.labs.lab_file import LabDevice

__all__ = ["BenchOptions", "lacking"]

FASTEST_TRAVEL: Final = 0.5
"""Share of its speed at which a real device may go through its space."""


@dataclass(frozen=True)
class BenchOptions:
    """What a run is asked to do.

    Attributes:
        suite: which tests.
        only: ids of tests, instead of those of the suite.
        may_move: whoever started it stands beside it, and wants motion.
        out: folder of the run; it may not exist.
        may_travel: names of the devices that may go anywhere in their space.
    """

    suite: Suite
    only: tuple[str, ...]
    may_move: bool
    out: Path
    may_travel: tuple[str, ...] = ()


def lacking(test: BenchTest, about: About, device: LabDevice, options: BenchOptions) -> str:
    """Return why a test is skipped, in words; empty if it is not."""
    missing = [
        name for name in (*test.acquisition.needs, *test.needs) if name not in about.commands
    ]
    if missing:
        return f"the device does not offer {', '.join(missing)}"
    safety = test.acquisition.safety
    if safety >= Safety.FAULT and not device.sim:
        return "takes processes away, which is done to simulators only"
    if safety is Safety.READ or device.sim or device.plugin.is_model:
        return ""
    if not options.may_move:
        return "needs --may-move: it enables the device"
    wrong = [
        f"{name} is {about.readings.get(name, 'not told')}, not {value}"
        for name, value in device.entry.identity.items()
        if about.readings.get(name) != value
    ]
    if wrong:
        return f"it is another device than the lab file says: {'; '.join(wrong)}"
    if about.capabilities.needs_homing and not about.is_homed:
        return "needs to be homed, which the bench does not do to hardware"
    space = device.entry.space
    if safety >= Safety.SMALL and space is None:
        return "needs `space` in the lab file: where it may go"
    if space is not None and space.tool_box and "measured_cp" not in about.commands:
        return "its space has a `tool_box`, and it does not tell where its tool is"
    return _lacking_to_travel(device, options) if safety >= Safety.LARGE else ""


def _lacking_to_travel(device: LabDevice, options: BenchOptions) -> str:
    """Return why a device may not go through all of its space, in words; empty if it may."""
    space = device.entry.space
    if space is None or not space.joints:
        return "needs `space.joints` in the lab file: it goes to the ends of these ranges"
    if space.speed > FASTEST_TRAVEL:
        return (
            f"its space has a `speed` of {space.speed:g}: it goes to the ends of its space, "
            f"at {FASTEST_TRAVEL:g} at most"
        )
    if device.name not in options.may_travel:
        return f"needs --may-travel {device.name}: it goes through all of its space"
    return ""

"""Commands for people: what a tracker is, what is plugged in, what a tool definition says, a beep."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Final

from pydantic import Field
from rich.console import Console
from rich.table import Table

from crtk_driver_ndi.config import NdiConfig
from crtk_driver_ndi.families import FREQUENCIES, TRACK_FREQUENCY
from crtk_driver_ndi.link import NdiLink, Refused
from crtk_driver_ndi.rom import LEAST_MARKERS, TYPES, Rom, read_rom
from crtk_driver_ndi.setup import PortInfo, Prepared, free, identify, prepare
from crtk_drivers.config import Settings
from crtk_drivers.errors import DeviceError
from crtk_drivers.plugins import Tool

_OUT = Console(highlight=False)

_PARAMETERS: Final = (
    "Features.Hardware.Model",
    "Features.Hardware.Serial Number",
    "Features.Firmware.Version",
    "Param.Tracking.Available Volumes",
    "Param.Tracking.Selected Volume",
    TRACK_FREQUENCY,
)
"""What newer trackers tell by GET."""


_HERTZ: Final = {str(value): hertz for hertz, value in FREQUENCIES.items()}

NOT_INITIALISED: Final = 0x10
"""The error of a tracker that was just switched on."""


class NoOptions(Settings):
    """No options."""


class RomOptions(Settings):
    """Options of `rom`."""

    file: str = Field(description="Tool definition (.rom).")


@contextmanager
def _connected(config: NdiConfig) -> Iterator[tuple[NdiLink, float]]:
    """A tracker, and the monotonic deadline of what is asked of it."""
    link, deadline = NdiLink(config), time.monotonic() + config.open_timeout
    try:
        link.open(deadline)
        yield link, deadline
    finally:
        link.close()


def info(config: NdiConfig, options: NoOptions) -> int:
    """Print what a tracker is. It goes on with what it does."""
    with _connected(config) as (link, deadline):
        identity = identify(link, deadline)
        for line in identity.lines:
            _OUT.print(line, markup=False)
        family = identity.family
        rows = [
            ("family", family.product),
            ("API revision", identity.revision or "older than that"),
            ("frames", f"{family.rate:g} a second, at most"),
            ("volume", family.volume),
            ("asked by", ", ".join(family.replies)),
        ]
        for name in _PARAMETERS:
            try:
                told = link.ask(f"GET:{name}", deadline).text
            except Refused:
                continue
            rows += [
                (
                    key,
                    f"{value} ({_HERTZ[value]} Hz)"
                    if key == TRACK_FREQUENCY and value in _HERTZ
                    else value,
                )
                for key, _, value in (x.partition("=") for x in told.splitlines())
            ]
    for key, value in rows:
        _OUT.print(f"{key}: {value}", markup=False)
    return 0


def scan(config: NdiConfig, options: NoOptions) -> int:
    """Initialise a tracker, print what is plugged in as a configuration has it, and free it again."""
    with _connected(config) as (link, deadline):
        taken: set[int] = set()
        try:
            prepared = prepare(link, config, (), deadline, taken)
        finally:
            with suppress(DeviceError):  # what went wrong before is what is told
                free(link, taken, deadline)
    _OUT.print(f"{prepared.identity.family.product} at {link.where}", markup=False)
    for information in prepared.infos.values():
        _OUT.print(f"\n# {information}", markup=False)
        _OUT.print("\n".join(("[[tools]]", *_names(information, prepared))), markup=False)
    for problem in prepared.problems:
        _OUT.print(f"\n{problem}", markup=False)
    if not prepared.infos:
        _OUT.print("No wired tool is plugged in; wireless ones come from their .rom files.")
    return 0


def _names(information: PortInfo, prepared: Prepared) -> Iterator[str]:
    """Yield the keys that tell one sensor from all others: no more than it needs."""
    others = [each for each in prepared.infos.values() if each is not information]
    for key in ("part_number", "serial_number", "port", "channel"):
        value = getattr(information, key)
        if value == "" or (key == "port" and not value):
            continue
        alike = [each for each in others if getattr(each, key) == value]
        if not others or len(alike) < len(others) or key == "part_number":
            yield f'{key} = "{value}"' if isinstance(value, str) else f"{key} = {value}"
        others = alike
        if not others:
            return


def rom(config: NdiConfig, options: RomOptions) -> int:
    """Print what a tool definition says, and whether it is sound."""
    found = read_rom(options.file)
    kind = TYPES.get(found.kind, f"type {found.kind}")
    _OUT.print(
        f"{kind} {found.part_number}, by {found.manufacturer}, revision {found.revision}\n"
        f"{_count_of(found)}, of which {found.least_markers} must be seen, within "
        f"{found.largest_error:g} mm and {found.largest_angle}°",
        markup=False,
    )
    table = Table("marker", "x", "y", "z", title="in mm")
    for number, marker in enumerate(found.markers, start=1):
        table.add_row(str(number), *(f"{value:.3f}" for value in marker))
    _OUT.print(table)
    return 0


def _count_of(found: Rom) -> str:
    count = len(found.markers)
    if count >= LEAST_MARKERS:
        return f"{count} markers"
    return f"{count} sensor{'s' * (count > 1)} (a wired tool of an Aurora)"


def beep(config: NdiConfig, options: NoOptions) -> int:
    """Beep once; 1 if it is busy. A tracker that nobody has initialised yet is, with its tools left alone."""
    with _connected(config) as (link, deadline):
        try:
            answer = link.ask("BEEP:1", deadline).text
        except Refused as refusal:
            if refusal.code != NOT_INITIALISED:
                raise
            link.ask("INIT:", deadline)
            answer = link.ask("BEEP:1", deadline).text
    _OUT.print("it beeped" if answer == "1" else "it is busy, and did not beep")
    return 0 if answer == "1" else 1


def _no_hardware(config: NdiConfig) -> None:
    pass


TOOLS: Final = (
    Tool("info", "tell what a tracker is, its rate and its volumes", info, NoOptions),
    Tool("scan", "tell which tools are plugged in", scan, NoOptions),
    Tool("rom", "tell what a tool definition says", rom, RomOptions, ("file",), _no_hardware),
    Tool("beep", "beep once", beep, NoOptions),
)

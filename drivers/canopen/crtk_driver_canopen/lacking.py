"""Drives that lack objects, or let them only be written: asked by the standard's table, and done without."""

from __future__ import annotations

import time
from collections.abc import Collection
from typing import Final

from crtk_driver_canopen.modes import OpMode, mode_text, supported
from crtk_driver_canopen.objects import OBJECTS
from crtk_driver_canopen.sdo import ObjectIgnored, Sdo, SdoAborted
from crtk_driver_canopen.standard import ROWS, Category, Row
from crtk_driver_canopen.units import interpolation_period
from crtk_drivers.errors import DeviceError

_SHOWN_WITHIN: Final = 1.0
"""Seconds for a drive to show the mode that was written."""

_MILLISECONDS: Final = -3
"""Exponent of the interpolation period that a drive without 60C2h:2 counts in (its default, CiA 402-2)."""


def missing_objects(
    sdo: Sdo, name: str, modes: Collection[OpMode], wanted: Collection[str] = ()
) -> list[Row]:
    """Return the optional objects that a drive lacks, of those that matter in the modes that are used.

    Args:
        sdo: of the axis.
        name: of the joint.
        modes: of operation that are used, with homing.
        wanted: names of objects for which the configuration has a value.

    Raises:
        DeviceError: it lacks one for which nothing stands in.
        SdoSilent, ProtocolError, BusLost: it does not answer as it should.
    """
    found = []
    for row in ROWS:
        asked = row.used & set(modes) or row.name in wanted
        if not asked or sdo.has(row.entry):
            continue
        refused = row.refused(modes)
        if refused:
            raise DeviceError(
                f"joint {name}: the drive has no {row.entry.on_axis(sdo.axis)}, and nothing stands in for it "
                f"in {refused} by CiA 402",
                where=sdo.where,
                remedy=f"Use other `joints.{name}.modes` or no `homing`, or another drive.",
            )
        found.append(row)
    return found


def note_missing(sdo: Sdo, rows: Collection[Row], notes: list[str]) -> None:
    """Say once what a drive is used without."""
    if rows:
        told = "; ".join(f"no {row.entry.on_axis(sdo.axis)}: {row.without}" for row in rows)
        notes.append(f"done without optional objects that the drive lacks: {told}")


def check_changes(sdo: Sdo, name: str) -> None:
    """Refuse a drive that is to change its mode, and cannot be told or asked.

    Raises:
        DeviceError: it lacks the mode (6060) or what shows it (6061).
        SdoSilent, ProtocolError, BusLost: it does not answer as it should.
    """
    for row in ROWS:
        if row.conditional and not sdo.has(row.entry):
            raise DeviceError(
                f"joint {name}: the drive has no {row.entry.on_axis(sdo.axis)} ({Category.CONDITIONAL} by "
                "CiA 402), so that it can be used in one mode alone",
                where=sdo.where,
                remedy=f"Give `joints.{name}.modes` the one mode that it has, and no `homing`.",
            )


def ensure_mode(sdo: Sdo, name: str, mode: OpMode, notes: list[str]) -> None:
    """Set the one mode in which a joint is used, and see that the drive is in it.

    By DSP 402 V2.0 the mode (6060) can only be written; then the mode that is shown (6061) tells. A drive
    with one mode need not have either of them.

    Raises:
        DeviceError: it has no such mode, or does not show it.
        ObjectIgnored, SdoAborted, SdoSilent, ProtocolError: it does not take it.
    """
    entry, display = OBJECTS["mode_of_operation"], OBJECTS["mode_of_operation_display"]
    if sdo.has(entry):
        if sdo.ensure(entry, mode, f"Check the modes of {name}."):
            if not sdo.has(display):
                notes.append(
                    f"no {display.on_axis(sdo.axis)}: that it is in its mode is not read back"
                )
            return
        if not sdo.has(display):
            notes.append(f"{entry} can only be written, and there is no {display}: not read back")
            return
        _wait_for_mode(sdo, name, mode)
        return
    shown, word = sdo.find(display), sdo.find(OBJECTS["supported_drive_modes"])
    if shown != mode and (shown is not None or supported(word or 0) != {mode}):
        has = mode_text(shown) if shown is not None else "what it is in is not told (6061h)"
        raise DeviceError(
            f"joint {name}: the drive has no {entry.on_axis(sdo.axis)}, so that it cannot be brought into "
            f"{mode_text(mode)}: {has}",
            where=sdo.where,
            remedy=f"Give `joints.{name}.modes` the one mode that it has.",
        )
    notes.append(f"no {entry.on_axis(sdo.axis)}: it has {mode_text(mode)} alone")


def _wait_for_mode(sdo: Sdo, name: str, mode: OpMode) -> None:
    display = OBJECTS["mode_of_operation_display"]
    deadline = time.monotonic() + _SHOWN_WITHIN
    while (shown := sdo.read(display)) != mode:
        if time.monotonic() > deadline:
            raise ObjectIgnored(
                f"{display.on_axis(sdo.axis)}: {mode_text(mode)} was written to 6060h, and the drive still "
                f"shows {mode_text(shown)} after {_SHOWN_WITHIN:g} s",
                where=sdo.where,
                remedy=f"Check the modes of {name}.",
            )


def ensure_period(sdo: Sdo, period: float) -> None:
    """Tell a drive the period of the cycle (60C2), in the power of ten that it takes.

    4 ms are 4 times 10^-3 s as well as 40 times 10^-4 s; drives exist whose exponent is fixed.

    Args:
        sdo: of the axis.
        period: in s.

    Raises:
        DeviceError: it cannot be told this period.
        ObjectIgnored, SdoAborted, SdoSilent, ProtocolError: it does not take it.
    """
    entry, power = (
        OBJECTS["interpolation_period_value"],
        OBJECTS["interpolation_period_exponent"],
    )
    held = sdo.find(power)
    fixed = held is None
    value, exponent = interpolation_period(period)
    pairs = []
    while value <= 0xFF:
        pairs.append((value, exponent))
        value, exponent = 10 * value, exponent - 1
    own = _MILLISECONDS if held is None else held
    pairs.sort(key=lambda pair: pair[1] != own)
    refusal: SdoAborted | None = None
    for value, exponent in pairs:
        if fixed and exponent != own:
            continue
        try:
            sdo.ensure(entry, value)
            if not fixed:
                sdo.ensure(power, exponent)
        except SdoAborted as error:
            refusal = error
        else:
            return
    raise DeviceError(
        f"{entry.on_axis(sdo.axis)}: the drive cannot be told a period of {1e3 * period:g} ms"
        + (f" ({refusal.message})" if refusal is not None else ": it counts whole milliseconds"),
        where=sdo.where,
        remedy="Give a `period` that it takes.",
    )

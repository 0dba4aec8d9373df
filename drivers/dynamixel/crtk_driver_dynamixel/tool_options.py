"""Options of the commands for people, see `crtk_driver_dynamixel.tools`."""

from __future__ import annotations

from typing import Final

from pydantic import Field, field_validator

from crtk_drivers.config import Settings

BAUDS: Final = (57_600, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 115_200, 9_600)
"""Rates that servos have, the common ones first; 57600 is the factory's."""
IDS: Final = range(253)


class ScanOptions(Settings):
    """Options of `scan`."""

    bauds: str = Field(
        default="all",
        description="Rates to try, in bit/s with commas; 'all', or 'set' for that of the configuration.",
    )
    ids: str = Field(default="0-252", description="Ids to try: 1-8, or 1,2,11.")
    protocols: str = Field(default="2,1", description="Protocols to try.")
    out: str = Field(default="", description="File for a configuration to start from, as YAML.")

    @field_validator("bauds")
    @classmethod
    def _bauds(cls, text: str) -> str:
        if text not in ("all", "set"):
            numbers(text, 9600, 10_500_000)
        return text

    @field_validator("ids")
    @classmethod
    def _ids(cls, text: str) -> str:
        numbers(text, IDS.start, IDS.stop - 1)
        return text

    @field_validator("protocols")
    @classmethod
    def _protocols(cls, text: str) -> str:
        numbers(text, 1, 2)
        return text


def numbers(text: str, least: int, most: int) -> list[int]:
    """Return the numbers of a text such as ``1-8,11``.

    Raises:
        ValueError: not such a text, or beyond these bounds.
    """
    found: list[int] = []
    for part in text.split(","):
        first, _, last = part.strip().partition("-")
        if not first.isdecimal() or not (last or first).isdecimal():
            raise ValueError(f"{part.strip()!r} is neither a number nor a range such as 1-8")
        found += range(int(first), int(last or first) + 1)
    wrong = [number for number in found if not least <= number <= most]
    if wrong or not found:
        raise ValueError(f"{text!r}: numbers from {least} to {most} are possible")
    return list(dict.fromkeys(found))


class InfoOptions(Settings):
    """Options of `info`."""

    cycles: int = Field(
        default=100, ge=1, le=100_000, description="Readings by which the rate is measured."
    )


class CalibrateOptions(Settings):
    """Options of `calibrate`."""

    out: str = Field(
        default="",
        description="File to be written; that of the configuration's key calibration if empty.",
    )
    at: str = Field(
        default="",
        description="Positions of the joints in the pose, as YAML: {elbow: 1.57}; 0 for those left out.",
    )
    eeprom: bool = Field(
        default=False,
        description="Put it into the Homing Offset of the servos where it fits; the driver writes it when it "
        "is enabled.",
    )
    ask: bool = Field(default=True, description="Wait for Enter; if not, read at once.")


class LimitsOptions(Settings):
    """Options of `limits`."""

    write: bool = Field(default=True, description="Write what differs; if not, only tell it.")

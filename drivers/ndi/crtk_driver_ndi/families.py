"""What the families of trackers have of their own: rates, volumes, dialects. Data alone.

Rates and volumes: NDI's data sheets. Volumes are for people; what a tracker really does it tells itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

__all__ = [
    "FAMILIES",
    "FREQUENCIES",
    "STEPS",
    "TRACK_FREQUENCY",
    "UNKNOWN",
    "Family",
    "family_named",
]


@dataclass(frozen=True, slots=True)
class Family:
    """One family.

    Attributes:
        product: its name, which it tells as well: how it is found out.
        rate: frames a second, at most.
        volume: where tools are seen, in words.
        replies: how it can be asked for frames, the best first; see `crtk_driver_ndi.frames.PARSERS`.
        error_is_length: whether the error of a tool is mm RMS; else an indicator without a unit.
    """

    product: str
    rate: float
    volume: str
    replies: tuple[str, ...] = ("BX", "TX")
    error_is_length: bool = True


TRACK_FREQUENCY: Final = "Param.Tracking.Track Frequency"
"""The parameter of newer trackers; IRATE takes the same values on older ones."""
FREQUENCIES: Final[Mapping[int, int]] = MappingProxyType({20: 0, 30: 1, 60: 2})
"""Its values by frames a second."""
STEPS: Final[Mapping[str, int]] = MappingProxyType({"0": 3, "1": 2, "2": 1})
"""By how much frame numbers rise, by its value: a frame that is not taken is counted all the same."""

_PYRAMID: Final = "a pyramid, z from -0.95 to -2.4 m, or to -3 m"
_NEWER: Final = ("BX2", "BX", "TX")

FAMILIES: Final[Mapping[str, Family]] = MappingProxyType(
    {
        "vicra": Family("Polaris Vicra", 20.0, "z from -0.557 to -1.336 m"),
        "spectra": Family("Polaris Spectra", 60.0, _PYRAMID),
        "vega": Family("Polaris Vega ST", 60.0, _PYRAMID, _NEWER),
        "vega-vt": Family("Polaris Vega VT", 120.0, _PYRAMID, _NEWER),
        "vega-xt": Family("Polaris Vega XT", 400.0, _PYRAMID, _NEWER),
        "lyra": Family("Polaris Lyra", 60.0, "close to the tracker", _NEWER),
        "aurora": Family(
            "Aurora",
            40.0,
            "a cube of 0.5 m, or a dome, in front of the field generator",
            _NEWER,
            error_is_length=False,
        ),
    }
)

UNKNOWN: Final = Family("an NDI tracker", 60.0, "not known", _NEWER)
"""What is not any of them, and what has not been asked yet."""


def family_named(told: str) -> Family:
    """Return the family whose product is named in what a tracker tells of itself."""
    for family in FAMILIES.values():
        if family.product.lower() in told.lower():
            return family
    for word, name in (("vega", "vega"), ("vicra", "vicra"), ("spectra", "spectra")):
        if word in told.lower():
            return FAMILIES[name]
    return UNKNOWN

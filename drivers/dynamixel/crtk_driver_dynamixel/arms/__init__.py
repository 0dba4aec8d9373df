"""Configurations of open arms, each with a URDF: what the key ``arm`` names.

Dimensions are those that the makers publish; the geometry of links is boxes and cylinders. An arm of yours
may differ in its zero, its signs and its ids: a copy of the file is the place to say so.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from crtk_drivers.config.file import read_file
from crtk_drivers.errors import ConfigError
from crtk_drivers.errors.near_names import near_names

__all__ = ["arm_file", "beneath", "names"]

_FOLDER = Path(__file__).parent
_SUFFIXES = (".yaml", ".yml", ".toml")


def names() -> tuple[str, ...]:
    """Return the arms of this package."""
    return tuple(sorted(path.stem for path in _FOLDER.glob("*.yaml")))


def arm_file(arm: str) -> Path:
    """Return the file of an arm: one of `names`, or the path of a file.

    Raises:
        ConfigError: there is no such arm.
    """
    if arm.endswith(_SUFFIXES):
        return Path(arm).expanduser()
    if arm in names():
        return _FOLDER / f"{arm}.yaml"
    meant = near_names(arm, names())
    raise ConfigError(
        f"arm: there is no arm {arm!r}",
        remedy=f"Did you mean {meant[0]!r}?"
        if meant
        else f"There are {', '.join(names())}; a file of your own ends in .yaml or .toml.",
    )


def beneath(values: Mapping[str, Any], arm: str) -> dict[str, Any]:
    """Return `values` with those of an arm beneath them; paths in the arm's file are relative to it.

    Raises:
        ConfigError: no such arm, its file cannot be read, or names an arm itself.
    """
    path = arm_file(arm)
    below = dict(read_file(path).values)
    if "arm" in below:
        raise ConfigError(
            "arm: names another arm", where=str(path), remedy="Copy its keys into this file."
        )
    kinematics = below.get("kinematics")
    if isinstance(kinematics, dict) and isinstance(kinematics.get("urdf"), str):
        below["kinematics"] = {**kinematics, "urdf": str(path.parent / kinematics["urdf"])}
    for key in ("calibration", "turns"):
        if isinstance(below.get(key), str) and below[key]:
            below[key] = str(path.parent / below[key])
    return _merged(below, values)


def _merged(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    merged = dict(below)
    for key, value in above.items():
        under = merged.get(key)
        both = isinstance(under, Mapping) and isinstance(value, Mapping)
        merged[key] = _merged(under, value) if both else value  # type: ignore[arg-type]
    return merged

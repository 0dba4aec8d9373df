"""The dozens of counters of a device in a few lines: those that begin alike, and those of its joints."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence

_TOKEN = re.compile(r"[^ _]+[ _]*")
"""A word of a name with what separates it from the next one."""


_PERCENT = "share"
"""Unit of a part of 1."""


def grouped(
    counters: Mapping[str, float],
    words: Mapping[str, str],
    joints: Sequence[str],
    units: Mapping[str, str],
) -> list[str]:
    """Return the lines: what stands alone, then each group, then the quantities that each joint has.

    Args:
        counters: by name.
        words: what some of these numbers mean, by the same names.
        joints: their names, in order.
        units: of some of these numbers, by the same names; see `Device.counter_units`.
    """
    shown = {
        in_words(name): words.get(name) or number_with_unit(value, units.get(name, ""))
        for name, value in counters.items()
    }
    of_joints = _of_joints(shown, joints)
    for quantity in of_joints:
        for joint in joints:
            del shown[f"{joint} {quantity}"]
    singles: list[str] = []
    groups: list[str] = []
    for names in _alike(shown):
        if len(names) == 1:
            singles.append(f"{names[0]} {shown[names[0]]}")
        else:
            begin = _common(names)
            members = ", ".join(f"{name[len(begin) :]} {shown[name]}" for name in names)
            groups.append(f"{begin.rstrip(' _')}: {members}")
    per_joint = [f"{quantity} by joint: {', '.join(each)}" for quantity, each in of_joints.items()]
    return [*([", ".join(singles)] if singles else []), *groups, *per_joint]


def in_words(name: str) -> str:
    """Return the name of a counter as people read it, without underscores."""
    # Beside spaces they belong to the name of a joint: `elbow_1 current`.
    return name if " " in name else name.replace("_", " ")


def number_with_unit(value: float, unit: str) -> str:
    """Return a number with its unit: less than a second in ms, a share in percent."""
    if math.isnan(value):
        return "not known"
    if unit == _PERCENT:
        return f"{_number(100.0 * value)} %"
    if unit == "s" and 0.0 < abs(value) < 1.0:
        return f"{_number(1e3 * value)} ms"
    return f"{_number(value)} {unit}".rstrip()


def _of_joints(shown: Mapping[str, str], joints: Sequence[str]) -> dict[str, list[str]]:
    """Return the values of quantities that every joint has."""
    if not joints:
        return {}
    begin = f"{joints[0]} "
    quantities = [name.removeprefix(begin) for name in shown if name.startswith(begin)]
    return {
        quantity: [shown[f"{joint} {quantity}"] for joint in joints]
        for quantity in quantities
        if all(f"{joint} {quantity}" in shown for joint in joints)
    }


def _alike(names: Iterable[str]) -> list[list[str]]:
    """Return the names in groups that begin with the same word, and go on after it."""
    groups: dict[str, list[str]] = {}
    for name in names:
        tokens = _TOKEN.findall(name)
        first = tokens[0] if len(tokens) > 1 else name
        groups.setdefault(first, []).append(name)
    return list(groups.values())


def _common(names: Sequence[str]) -> str:
    """Return the words with which all of them begin, so that each has one more."""
    begin = ""
    for tokens in zip(*(_TOKEN.findall(name)[:-1] for name in names), strict=False):
        if len(set(tokens)) > 1:
            break
        begin += tokens[0]
    return begin


def _number(value: float) -> str:
    if float(value).is_integer() or 999.5 <= abs(value) < 1e15:
        return f"{value:.0f}"
    return f"{value:.3g}"

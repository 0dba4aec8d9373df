"""The dozens of counters of a device in a few lines: those that begin alike, and those of its joints."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence

_TOKEN = re.compile(r"[^ _]+[ _]*")
"""A word of a name with what separates it from the next one."""


def grouped(
    counters: Mapping[str, float], words: Mapping[str, str], joints: Sequence[str]
) -> list[str]:
    """Return the lines: what stands alone, then each group, then the quantities that each joint has.

    Args:
        counters: by name.
        words: what some of these numbers mean, by the same names.
        joints: their names, in order.
    """
    shown = {name: words.get(name) or _number(value) for name, value in counters.items()}
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
    if math.isnan(value):
        return "not known"
    return str(int(value)) if float(value).is_integer() else f"{value:.3g}"

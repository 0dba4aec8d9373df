"""The bounds of a lab file: which figures may have one, and what it means for them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Final

from crtk_drivers.errors import ConfigError
from crtk_drivers.errors.near_names import near_names
from crtk_drivers.labs.lab_file import BoundEntry, Lab
from crtk_drivers.labs.lab_outline import LabOutline
from crtk_drivers.labs.verdicts.judging import Bound, Comparison, Quantity, Worse

OWN_GROUP: Final = "lab"
"""First part of the ids of what a lab's own tests measure."""

_OF_TOLD: Final = {
    Worse.HIGHER: Comparison.AT_MOST,
    Worse.LOWER: Comparison.AT_LEAST,
    Worse.EITHER: Comparison.WITHIN,
}
"""How a figure is judged that is only told, once it has a bound."""


def check_bounds(lab: Lab | LabOutline, quantities: Mapping[str, Quantity]) -> None:
    """Refuse bounds of figures that there are not, and those that say nothing of theirs.

    Args:
        lab: whose file it is.
        quantities: of the bench, by id; what the lab's own tests measure is known once they do.

    Raises:
        ConfigError: with the line.
    """
    for name, entry in lab.settings.bounds.items():
        quantity = quantities.get(name)
        if quantity is not None:
            trouble, remedy = bound_trouble(quantity, entry), ""
        elif name.partition(".")[0] == OWN_GROUP:
            continue
        else:
            trouble = "there is no such figure"
            meant = near_names(name, quantities)
            remedy = f"Did you mean {meant[0]!r}?" if meant else _WHERE_THEY_ARE
        if trouble:
            where = lab.bound_places.get(name, str(lab.path))
            raise ConfigError(f"bounds.{name}: {trouble}", where=where, remedy=remedy)


_WHERE_THEY_ARE: Final = (
    "crtk-driver bench list --figures has all of them; those of the lab's own tests begin with "
    f"{OWN_GROUP!r}."
)


def bound_trouble(quantity: Quantity, entry: BoundEntry) -> str:
    """Return why a figure cannot be judged by a bound; empty if it can."""
    comparison = _comparison(quantity)
    if comparison is Comparison.WITHIN:
        if quantity.comparison is Comparison.TOLD and entry.lower is None:
            return "a change either way is for the worse: give `lower` beside `value`"
        if entry.lower is not None and entry.lower > entry.value:
            return f"lower {entry.lower:g} is above value {entry.value:g}"
    elif entry.lower is not None:
        return f"it is judged by one bound, {comparison} `value`: leave `lower` out"
    return ""


def bounded(quantity: Quantity, entry: BoundEntry, default: Bound | None) -> tuple[Quantity, Bound]:
    """Return a figure as it is judged by the lab file, and the bound.

    Args:
        quantity: as the test declares it.
        entry: of the lab file.
        default: that holds without it; its lower end is kept where the lab file has none.
    """
    lower = -math.inf if default is None else default.lower
    if entry.lower is not None:
        lower = entry.lower
    bound = Bound(entry.value, f"the lab file: {entry.because}", lower)
    return replace(quantity, comparison=_comparison(quantity)), bound


def _comparison(quantity: Quantity) -> Comparison:
    if quantity.comparison is Comparison.TOLD:
        return _OF_TOLD[quantity.worse]
    return quantity.comparison

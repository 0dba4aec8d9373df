"""The page of a simulator in the browser, and what it shows, as data.

Every simulator has the same page. It answers two requests on its control socket: ``scene`` (once) with what
does not change, a :class:`Scene`, and ``live`` (thirty times a second, while a browser watches) with what
does, a :class:`Live`. Both are plain dictionaries, since the second is made in the simulator's loop. Gauges
are in the units that they name; a chain is in m and rad. A device has the same page
(:mod:`crtk_sim_backends.page.device`), without buttons.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, NotRequired, TypeAlias, TypedDict

from crtk_sim_backends.control import token

__all__ = [
    "Button",
    "Chain",
    "Gauge",
    "Gauges",
    "Live",
    "Row",
    "Scene",
    "address_of",
    "button",
    "fault_row",
]

Transform: TypeAlias = Sequence[float]
"""Twelve numbers: three rows of rotation and position, m."""

Row: TypeAlias = tuple[str, str, str]
"""Name, text, and how it is shown: good, fair, bad, or as it is ("")."""


class Chain(TypedDict):
    """Revolute joints, each turning about z of its frame: from the link before, or the base, to it."""

    joints: Sequence[Transform]
    tip: Transform  # from the last link to the flange


class Button(TypedDict):
    """A fault that can be let begin with a click."""

    text: str
    kind: str
    parameters: Mapping[str, Any]


class Scene(TypedDict):
    """What does not change."""

    title: str
    detail: str
    host: str
    buttons: Sequence[Button]
    notes: Mapping[str, str]  # what a row means, by its name
    chain: Chain | None  # None: its gauges take the place of the arm


class Gauge(TypedDict):
    """A value between its limits; None for no limit: its scale ends at `span`, or at 360 unnamed."""

    name: str
    low: float | None
    high: float | None
    span: NotRequired[float]
    value: float
    goal: NotRequired[float | None]
    rate: NotRequired[float]
    state: NotRequired[tuple[str, str]]  # text, and how it is shown


class Gauges(TypedDict):
    """Values of one unit."""

    title: str
    unit: str
    rate: str  # unit of the rates; empty for none
    digits: int
    gauges: Sequence[Gauge]


class Live(TypedDict):
    """What changes."""

    gauges: Sequence[Gauges]
    sections: Mapping[str, Sequence[Row]]
    faults: Sequence[str]  # kinds that are in force
    q: NotRequired[Sequence[float]]  # of the chain
    tool: NotRequired[Sequence[float]]  # at the flange: position and rotation vector


FAULTS: Final = "faults"
"""Name of the row that tells the faults in force."""


def button(text: str, kind: str, **parameters: Any) -> Button:
    """Return a button for a fault."""
    return {"text": text, "kind": kind, "parameters": parameters}


def fault_row(faults: Sequence[str]) -> Row:
    """Return the row that tells the faults in force."""
    return FAULTS, ", ".join(faults) or "none", "bad" if faults else ""


def address_of(host: str, port: int) -> str:
    """Return the address of a page, with which it may let faults begin."""
    return f"http://{host}:{port}/#{token()}"

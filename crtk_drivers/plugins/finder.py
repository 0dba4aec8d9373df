"""How hardware of one kind is looked for: where it may be, and what answers there."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

__all__ = ["Finder", "FoundDevice"]


@dataclass(frozen=True)
class FoundDevice:
    """Hardware that answered.

    Attributes:
        settings: of its configuration: where it is and who is there. What hardware cannot tell is left out.
        told: what it is, in words.
    """

    settings: Mapping[str, Any]
    told: str


@dataclass(frozen=True)
class Finder:
    """Looks for hardware, and changes nothing of it.

    Attributes:
        places: returns where it may be on this machine: serial ports, CAN interfaces.
        takes: says whether a place, as a person writes it, is of the kind that is looked at.
        look: asks at one place who is there, in a minute at most. Raises CrtkError if it cannot be opened.
    """

    places: Callable[[], Iterable[str]]
    takes: Callable[[str], bool]
    look: Callable[[str], Iterable[FoundDevice]]

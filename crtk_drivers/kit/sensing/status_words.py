"""What the status word of a measurement means. The tables themselves are those of the drivers."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

SUMMARY: Final = 0x80000000
"""The bit that ATI's sensors set when any error bit is set."""


class Meaning(StrEnum):
    """What a status bit says of the data of its record."""

    NOTICE = "notice"
    """The data are good: a monitor condition is latched, the sensor is busy, ..."""
    SATURATED = "saturated"
    """The load is beyond what the sensor can measure: the data are a lower bound of it."""
    ERROR = "error"
    """The data cannot be relied on."""


@dataclass(frozen=True, slots=True)
class Bit:
    """One bit (or any bits of `mask`) of a status word."""

    mask: int
    meaning: Meaning
    text: str


@dataclass(frozen=True)
class StatusTable:
    """The status word of one family of sensors.

    Attributes:
        bits: those that have a meaning.
        has_summary: bit 31 is set beside any error.
        notices_set_summary: and beside a notice as well.
    """

    bits: tuple[Bit, ...]
    has_summary: bool
    notices_set_summary: bool = False
    errors: int = field(init=False)
    saturated: int = field(init=False)
    notices: int = field(init=False)

    def __post_init__(self) -> None:
        for name, meaning in (
            ("errors", Meaning.ERROR),
            ("saturated", Meaning.SATURATED),
            ("notices", Meaning.NOTICE),
        ):
            mask = 0
            for bit in self.bits:
                if bit.meaning is meaning:
                    mask |= bit.mask
            object.__setattr__(self, name, mask)

    @property
    def explains_summary(self) -> int:
        """Bits beside which the summary bit says nothing more."""
        notices = self.notices if self.notices_set_summary else 0
        return self.errors | self.saturated | notices

    def is_error(self, status: NDArray[np.uint32]) -> NDArray[np.bool_]:
        """Say of each status word (n,) whether its data cannot be relied on; saturation not counted."""
        found: NDArray[np.bool_] = (status & self.errors) != 0
        if self.has_summary:
            found |= ((status & SUMMARY) != 0) & ((status & self.explains_summary) == 0)
        return found

    def is_saturated(self, status: NDArray[np.uint32]) -> NDArray[np.bool_]:
        """Say of each status word (n,) whether the load was beyond what can be measured."""
        found: NDArray[np.bool_] = (status & self.saturated) != 0
        return found

    def texts(self, status: int, meanings: Iterable[Meaning] = tuple(Meaning)) -> tuple[str, ...]:
        """Return a status word in words, highest bit first; empty if there is nothing to say."""
        wanted = frozenset(meanings)
        found = [bit for bit in self.bits if status & bit.mask]
        texts = [bit.text for bit in found if bit.meaning in wanted]
        unknown = status
        for bit in self.bits:
            unknown &= ~bit.mask
        if self.has_summary:
            if status & SUMMARY and not status & self.explains_summary and Meaning.ERROR in wanted:
                texts.insert(0, "an error that the status word does not name")
            unknown &= ~SUMMARY
        if unknown and Meaning.NOTICE in wanted:
            texts.append(f"undocumented bits 0x{unknown:08x}")
        return tuple(texts)


def combined(status: NDArray[Any]) -> int:
    """Return all bits that are set in any of the status words (n,)."""
    return int(np.bitwise_or.reduce(status)) if status.size else 0

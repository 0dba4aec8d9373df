"""Ways in which axes follow a stream of positions: what to send in each cycle. No I/O, no clock but samples.

A controller has no mode for a position in each cycle. PVT takes short pieces with position, velocity and
time, which it joins by cubic curves; position tracking (PT) goes to the newest position with the
controller's own ramp, which slows down before each; PA and BG go to one position after another, and rest
between.

Source: Galil command reference, PV and BT, PT, PA and BG.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, Protocol

from crtk_driver_galil.codes import EMPTY
from crtk_driver_galil.record import AXES, Record
from crtk_drivers.kit import Trail
from crtk_drivers.kit.axes import PieceEnds

_SHORTEST: Final = 2
"""Samples of a piece, which are even."""


def by_axes(letters: str, values: Sequence[int]) -> str:
    """Return the operands of a command for some axes: ``,1000,,-5`` for B and D.

    Args:
        letters: of the axes.
        values: one for each.
    """
    fields = dict(zip(letters, values, strict=True))
    last = max(AXES.index(letter) for letter in letters)
    return ",".join(str(fields.get(letter, "")) for letter in AXES[: last + 1])


class Tracking(Protocol):
    """One way. `lines` is called in each cycle with the newest setpoint; `reset` after a stop."""

    def lines(self, counts: Sequence[int], record: Record) -> list[str]:
        """Return the commands that lead the axes to `counts`."""

    def reset(self) -> None:
        """Forget the stream: the axes have been stopped."""

    @property
    def restarts(self) -> int:
        """How many times the stream had to begin anew by itself."""


class PositionTracking:
    """PT: each position is the goal of a ramp of the controller's own.

    Args:
        letters: of the axes.
    """

    restarts = 0

    def __init__(self, letters: str) -> None:
        self._letters = letters
        self._sent: list[int] | None = None

    def reset(self) -> None:
        """See `Tracking`."""
        self._sent = None

    def lines(self, counts: Sequence[int], record: Record) -> list[str]:
        """See `Tracking`. What PA was told before would be its first goal: so that is where it stands."""
        lines = []
        if self._sent is None:
            here = [record.axes[letter].reference for letter in self._letters]
            on = by_axes(self._letters, [1] * len(self._letters))
            lines += [f"PA {by_axes(self._letters, here)}", f"PT {on}"]
        if list(counts) != self._sent:
            lines.append(f"PA {by_axes(self._letters, counts)}")
        self._sent = list(counts)
        return lines


class StopAndGo:
    """PA and BG, as soon as all axes rest.

    Args:
        letters: of the axes.
    """

    restarts = 0

    def __init__(self, letters: str) -> None:
        self._letters = letters
        self._begun: int | None = None
        self._sent: list[int] | None = None

    def reset(self) -> None:
        """See `Tracking`."""
        self._sent = self._begun = None

    def lines(self, counts: Sequence[int], record: Record) -> list[str]:
        """See `Tracking`."""
        axes = [record.axes[letter] for letter in self._letters]
        away = list(counts) != [axis.reference for axis in axes]
        begun = self._begun is not None and since(self._begun, record.sample) < _TAKEN
        if any(axis.is_moving for axis in axes) or begun or not away:
            return []
        self._begun, self._sent = record.sample, list(counts)
        going = "".join(
            letter
            for letter, axis, goal in zip(self._letters, axes, counts, strict=True)
            if axis.reference != goal
        )
        return [f"PA {by_axes(self._letters, counts)}", f"BG {going}"]


_TAKEN: Final = 20
"""Samples in which a record shows that a motion was begun."""


def since(earlier: int, later: int) -> int:
    """Return the samples between two numbers of 16 bits; negative if the second one is the earlier."""
    return (later - earlier + 0x8000 & 0xFFFF) - 0x8000


class PvtPieces:
    """PV: pieces of equal time, sent when the controller's clock says that one more is needed.

    A piece ends where the setpoints were when it was due, between those of two cycles, so that it does not
    matter when a cycle comes.

    Args:
        letters: of the axes.
        fastest: counts/s of each, beyond which no piece goes.
        period: of a piece, in samples of the controller.
        lead: pieces that wait in its buffer; so many pieces and one more later it is where it was sent.

    Attributes:
        restarts: see `Tracking`.
    """

    def __init__(self, letters: str, fastest: Sequence[float], period: int, lead: int) -> None:
        self._letters = letters
        self._period = max(_SHORTEST, period // 2 * 2)
        most = [max(1, int(rate * self._period / 1000.0)) for rate in fastest]
        self._ends = PieceEnds(most)
        self._lead = lead * self._period
        self._begun = False
        self._end = 0
        self._clock = 0
        self._sample = 0
        self._trail = Trail()
        self.restarts = 0

    def reset(self) -> None:
        """See `Tracking`."""
        self._begun = False

    def lines(self, counts: Sequence[int], record: Record) -> list[str]:
        """See `Tracking`."""
        if self._begun:
            self._clock += max(0, since(self._sample, record.sample))
            codes = {record.axes[letter].stop_code for letter in self._letters}
            if self._clock >= self._end or (codes & EMPTY and self._clock > self._lead):
                self._begun = False
                self.restarts += 1
        self._sample = record.sample
        if not self._begun and any(record.axes[letter].is_moving for letter in self._letters):
            return []  # pieces that came late are carried out still
        lines = [] if self._begun else self._begin(record)
        self._trail.add(self._clock, counts)
        while self._end - self._clock < self._lead:
            due = self._trail.at(self._end - self._lead)
            lines += self._piece([round(place) for place in due])
        return lines

    def _begin(self, record: Record) -> list[str]:
        """Return pieces that stand, and what starts them."""
        self._begun = True
        here = [record.axes[letter].reference for letter in self._letters]
        self._ends.begin(here)
        self._trail.begin()
        self._trail.add(0, here)
        self._clock = self._end = 0
        lines = []
        while self._end < self._lead:
            lines += self._piece(here)
        return [*lines, f"BT {self._letters}"]

    def _piece(self, goal: Sequence[int]) -> list[str]:
        rate = 1000.0 / self._period
        lines = [
            f"PV{letter}={round(way)},{round(way * rate)},{self._period}"
            for letter, way in zip(self._letters, self._ends.towards(goal), strict=True)
        ]
        self._end += self._period
        return lines

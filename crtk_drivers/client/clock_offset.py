"""How far the clock of another machine is off ours, by round trips as in NTP.

A driver stamps its answer to the service ``operating_state`` by the clock of its machine. That was between
question and answer: half a round trip is all by which the middle can be wrong. Source: RFC 5905, section 8.

Question and answer are taken by the monotonic clock, which nobody sets. Our wall clock is read once, at the
end: if it was set meanwhile, the offset is that of the clock as it is now.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from crtk_drivers.errors import CrtkError
from crtk_drivers.samples import ClockOffset

if TYPE_CHECKING:
    from crtk_drivers.client.ros_link import Caller

EXCHANGES: Final = 8
"""For one measurement. The shortest round trip counts: the others have waited for a processor."""

AGREEING: Final = 3
"""Exchanges that must allow one offset, the newest among them.

Of a driver whose clock was set back the stamps stand still until that has caught up. Two exchanges in
succession can allow that; three cannot."""

ANSWERED_WITHIN: Final = 1.0
"""Seconds for an exchange."""


@dataclass(frozen=True, slots=True)
class Exchange:
    """A reading of a clock: by our monotonic clock between `sent` and `received`. All in ns."""

    sent: int
    received: int
    stamp: int

    @property
    def round_trip(self) -> int:
        """Twice by how much the middle can be wrong, in ns."""
        return self.received - self.sent

    @property
    def twice_ahead(self) -> int:
        """Twice the clock minus our monotonic one, in ns, if it was read in the middle.

        Twice, as an integer: a float has not enough digits for nanoseconds since 1970.
        """
        return 2 * self.stamp - self.sent - self.received

    def agrees(self, other: Exchange) -> bool:
        """Whether one clock that nobody sets can have given both stamps."""
        return abs(self.twice_ahead - other.twice_ahead) <= self.round_trip + other.round_trip


def offset_of(exchanges: Sequence[Exchange], ours: Exchange) -> ClockOffset | None:
    """Return the offset of another clock; None if its readings do not agree: it was set meanwhile.

    Args:
        exchanges: readings of the other clock, the newest last.
        ours: a reading of our wall clock, by the same monotonic clock.
    """
    agreeing = [each for each in exchanges if each.agrees(exchanges[-1])]
    if len(agreeing) < AGREEING:
        return None
    best = min(agreeing, key=lambda each: each.round_trip)
    return ClockOffset(
        (best.twice_ahead - ours.twice_ahead) / 2e9, (best.round_trip + ours.round_trip) / 2e9
    )


def measured_offset(
    caller: Caller, is_over: Callable[[], bool] = lambda: False
) -> ClockOffset | None:
    """Return the offset of the clock of the driver that answers; None if it does not, or was set meanwhile.

    Args:
        caller: of its service ``operating_state``.
        is_over: asked between two exchanges; once it is true, nothing more is asked, and None is returned.
    """

    def ask() -> int:
        return caller.operating_state(ANSWERED_WITHIN).wall_ns

    try:
        exchanges = [_exchange(ask) for _ in range(EXCHANGES) if not is_over()]
    except CrtkError:
        return None
    if is_over():
        return None
    return offset_of(exchanges, _exchange(time.time_ns))


def _exchange(read: Callable[[], int]) -> Exchange:
    sent = time.monotonic_ns()
    stamp = read()
    return Exchange(sent, time.monotonic_ns(), stamp)

"""A monotonic clock that a test turns by hand."""

from __future__ import annotations

from crtk_drivers.samples import Stamp

_EPOCH_NS = 1_700_000_000_000_000_000


class FakeClock:
    """Seconds that pass only when `advance` says so; call it where `time.monotonic` is called.

    Args:
        now: seconds to start from.
    """

    def __init__(self, now: float = 1000.0) -> None:
        self.now = now

    def __call__(self) -> float:
        """Return the present, in s."""
        return self.now

    def advance(self, seconds: float) -> float:
        """Let `seconds` pass and return the present."""
        self.now += seconds
        return self.now

    def stamp(self) -> Stamp:
        """Return the present on both clocks, which agree with each other."""
        return Stamp(_EPOCH_NS + round(self.now * 1e9), self.now)

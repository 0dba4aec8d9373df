"""Counters of a device and the immutable picture of them from which diagnostics are made."""

from __future__ import annotations

import threading
from collections import Counter, deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from crtk_drivers.commands import is_name
from crtk_drivers.device import Note
from crtk_drivers.errors import CommandRefused, with_remedy

_RATE_WINDOW = 100


@dataclass(frozen=True, slots=True)
class Health:
    """A snapshot. Times in s, rates in Hz.

    `broken_samples` held something that is not finite; `warnings_left_out` were like one told shortly before.
    """

    connected: bool = False
    rate: float = 0.0
    rate_expected: float = 0.0
    cycles: int = 0
    late_cycles: int = 0
    worst_cycle: float = 0.0
    samples: int = 0
    broken_samples: int = 0
    setpoints: int = 0
    sample_age: float = float("inf")
    stream: str = ""
    reconnects: int = 0
    stream_timeouts: int = 0
    clamped: int = 0
    warnings_left_out: int = 0
    refusals: Mapping[str, int] = field(default_factory=dict)
    last_refusal: str = ""
    device: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[Note, ...] = ()


class HealthRecorder:
    """The counters. Cycle figures are written by one I/O thread; refusals by any thread.

    `own_names` are those of a device's services and inputs beyond CRTK.
    """

    def __init__(
        self, rate_expected: float, late_after: float, own_names: Iterable[str] = ()
    ) -> None:
        self.connected = False
        self.stream = ""
        self.samples = 0
        self.broken_samples = 0
        self.setpoints = 0
        self.reconnects = 0
        self.stream_timeouts = 0
        self.clamped = 0
        self.warnings_left_out = 0
        self._rate_expected = rate_expected
        self._late_after = late_after
        self._own_names = frozenset(own_names)
        self._cycles = 0
        self._late_cycles = 0
        self._worst_cycle = 0.0
        self._times: deque[float] = deque(maxlen=_RATE_WINDOW + 1)
        self._lock = threading.Lock()
        self._refusals: Counter[str] = Counter()
        self._last_refusal = ""

    def cycle(self, now: float) -> None:
        """Count one I/O cycle that ended at `now`."""
        self._cycles += 1
        if self._times:
            period = now - self._times[-1]
            self._worst_cycle = max(self._worst_cycle, period)
            if period > self._late_after:
                self._late_cycles += 1
        self._times.append(now)

    def pause(self) -> None:
        """Forget the last cycle: the time until the next one is not a period."""
        self._times.clear()

    def refused(self, refusal: CommandRefused) -> int:
        """Count a refusal and return how many of its kind there have been."""
        # Any text may be submitted: the table must not grow.
        known = is_name(refusal.command) or refusal.command in self._own_names
        key = f"{refusal.command if known else 'unknown'}: {refusal.reason}"
        with self._lock:
            self._refusals[key] += 1
            self._last_refusal = with_remedy(refusal.message, refusal.remedy)
            return self._refusals[key]

    def snapshot(
        self, sample_age: float, device: Mapping[str, float], notes: tuple[Note, ...] = ()
    ) -> Health:
        """Return the counters as they are now."""
        times = list(self._times)
        span = times[-1] - times[0] if len(times) > 1 else 0.0
        with self._lock:
            refusals, last_refusal = dict(self._refusals), self._last_refusal
        return Health(
            connected=self.connected,
            rate=(len(times) - 1) / span if span > 0.0 else 0.0,
            rate_expected=self._rate_expected,
            cycles=self._cycles,
            late_cycles=self._late_cycles,
            worst_cycle=self._worst_cycle,
            samples=self.samples,
            broken_samples=self.broken_samples,
            setpoints=self.setpoints,
            sample_age=sample_age,
            stream=self.stream,
            reconnects=self.reconnects,
            stream_timeouts=self.stream_timeouts,
            clamped=self.clamped,
            warnings_left_out=self.warnings_left_out,
            refusals=refusals,
            last_refusal=last_refusal,
            device=dict(device),
            notes=notes,
        )

"""The promises of every device that measures, judged by what acts on its simulator: one class for each.

See `crtk_drivers.testing.world.promises.judges`, of which two look here as well.
"""

from __future__ import annotations

import math
from typing import Final, Protocol

from crtk_drivers.testing.world.machine.kernel import EPOCH, NS
from crtk_drivers.testing.world.promises.instrument import (
    BIASED,
    RAW,
    ForceSensor,
    Found,
    Missing,
    Sight,
)
from crtk_drivers.testing.world.promises.judges import CLOCKS, SETTLED, Fresh, Stuck
from crtk_drivers.testing.world.promises.subject import PERIOD


class _Judge(Protocol):
    @property
    def kind(self) -> str:
        """Of the finding."""

    def look(self, scene: Sight, /) -> str | None:
        """Return what is wrong, if anything is."""


class Stamps:
    """Whenever a value is published as valid."""

    kind = "a stamp is wrong"
    promise = "A valid value is fresh and finite; its stamp is one moment, and never goes back."

    def __init__(self) -> None:
        self._offset, self._set_at = 0, -math.inf
        self._last: dict[str, tuple[float, int, float]] = {}

    def look(self, sight: Sight) -> str | None:
        """Return what is wrong, if anything is."""
        kernel = sight.world.kernel
        if kernel.wall_offset != self._offset:
            self._offset, self._set_at = kernel.wall_offset, sight.now
        for name in _readings(sight):
            found = sight.found(name)
            if found is not None and (text := self._look(sight, name, found)):
                return f"{name}: {text}"
        return None

    def _look(self, sight: Sight, name: str, found: Found) -> str | None:
        numbers, stamp, stale_after = found
        at, now = stamp.monotonic, sight.now
        if not all(map(math.isfinite, numbers)):
            return f"{numbers} is published as valid"
        if now - at > stale_after + CLOCKS:
            return f"it is valid, and {now - at:.4f} s old"
        wall = (stamp.wall_ns - EPOCH - self._offset) / NS
        was_set = now < max(self._set_at, sight.disturbed) + SETTLED
        if at > now + CLOCKS or not (was_set or abs(wall - at) < CLOCKS):
            return f"the stamp is {stamp}, of two moments or to come"
        before, wall_before, seen = self._last.get(name, (-math.inf, 0, -math.inf))
        self._last[name] = at, stamp.wall_ns, now
        was_set = was_set or self._set_at >= seen
        if at < before:
            return f"the stamp goes back by {before - at:.6f} s"
        if stamp.wall_ns < wall_before and not was_set:
            return f"the stamp goes back by {(wall_before - stamp.wall_ns) / NS:.6f} s of the wall's clock"
        return None


class Measured:
    """Whenever a value is published as valid."""

    kind = "it was not so"
    promise = "A valid value was true when its stamp says; what is missing has none."

    def look(self, sight: Sight) -> str | None:
        """Return what is wrong, if anything is."""
        if sight.now < sight.disturbed + SETTLED:
            return None
        instrument = sight.instrument
        for name in sight.acting:
            if (found := sight.found(name)) is None:
                continue
            at = found.stamp.monotonic
            span = sight.was(name, at - instrument.early, min(sight.now, at + instrument.late))
            if span is None:
                continue
            age = f"stamped {sight.now - at:.4f} s ago"
            if span.is_missing:
                return (
                    f"{name} is {_text(found.numbers)}, {age}, and there was nothing to be measured"
                )
            if not span.has(found.numbers, instrument.error):
                return (
                    f"{name} is {_text(found.numbers)}, {age}; it was between {_text(span.lower)} and "
                    f"{_text(span.upper)}, the last change was {sight.now - sight.changed:.4f} s ago"
                )
        return None


class Tared:
    """Whenever a force less its bias is published as valid."""

    kind = "a bias is mixed"
    promise = "A force is told less one bias that was in force since it was measured."

    def look(self, sight: Sight) -> str | None:
        """Return what is wrong, if anything is."""
        instrument = sight.instrument
        if not isinstance(instrument, ForceSensor) or sight.now < sight.disturbed + SETTLED:
            return None
        found = sight.found(BIASED)
        if found is None:
            return None
        at = found.stamp.monotonic
        span = sight.was(RAW, at - instrument.early, min(sight.now, at + instrument.late))
        known = sight.biases.between(at - PERIOD, sight.now)
        biases = [each for each in known if not isinstance(each, Missing)]
        if span is None or not biases or span.is_missing:
            return None
        for bias in biases:
            whole = [value + off for value, off in zip(found.numbers, bias, strict=True)]
            if span.has(whole, instrument.error):
                return None
        return (
            f"measured_cf is {_text(found.numbers)}, stamped {sight.now - at:.4f} s ago; it was between "
            f"{_text(span.lower)} and {_text(span.upper)}, the bias {' or '.join(map(_text, biases))}"
        )


def _readings(sight: Sight) -> list[str]:
    own = [BIASED] if isinstance(sight.instrument, ForceSensor) else []
    return [*sight.acting, *own]


def _text(numbers: tuple[float, ...]) -> str:
    return f"({', '.join(f'{number:.5g}' for number in numbers)})"


JUDGES: Final = (Stamps, Measured, Tared, Fresh, Stuck)
"""All of them."""


def judge(sight: Sight) -> None:
    """Let all judges look from now on."""
    judges: list[_Judge] = [each() for each in JUDGES]
    find = sight.world.find

    def look() -> None:
        sight.look()
        for each in judges:
            if text := each.look(sight):
                find(each.kind, text)
                return

    sight.world.every(PERIOD, look)

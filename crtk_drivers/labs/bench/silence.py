"""What a device that falls silent is seen to tell, and when: as it is asked again and again meanwhile."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Final

import numpy as np

from crtk_drivers.labs.bench.acquisition import Subject
from crtk_drivers.labs.bench.bed import Bed
from crtk_drivers.labs.bench.calls import Glance
from crtk_drivers.labs.verdicts.estimates import exact, within
from crtk_drivers.labs.verdicts.judging import Bound, Findings, Quantity
from crtk_drivers.samples import Array, JointState, Stamp
from crtk_drivers.state import OperatingState

LOOK: Final = 0.01
"""Seconds between two looks."""

ON_ITS_WAY: Final = 0.05
"""Seconds in which what was on its way when it fell silent may still come."""

BUSY: Final = 0.02
"""Seconds by which the bench's own timer may be late."""

BACK: Final = 20.0
"""Seconds that are waited for a device to measure again."""

MOVED: Final = 5e-3
"""rad (m): what a device may have settled by while nobody looked."""


def reaction_alone(subject: Subject) -> float:
    """Return in how many s a device begins to stop that nobody commands any more."""
    return subject.link_timeout + subject.silence + subject.lag + 4.0 * subject.period


def way_alone(subject: Subject, speed: Array) -> Array:
    """Return how far each joint (n,) may go then, in rad or m, that had a speed."""
    deceleration = np.array([limit.acceleration for limit in subject.limits])
    fast = np.abs(speed)
    found: Array = fast * reaction_alone(subject) + fast**2 / (2.0 * deceleration) + MOVED
    return found


def looked(bed: Bed, seconds: float) -> list[tuple[float, int, str]]:
    """Return when the bench looked, the stamp (ns) of what was measured, and the state."""
    looks = []
    begin = time.monotonic()
    while (now := time.monotonic() - begin) < seconds:
        glance = bed.glance()
        looks.append((now, _stamp_of(glance).wall_ns, str(glance.status.state)))
        time.sleep(LOOK)
    return looks


def _stamp_of(glance: Glance) -> Stamp:
    for name in ("measured_js", "measured_cf", "measured_cp"):
        if name in glance.values:
            value, stamp = glance.values[name]
            if not isinstance(value, JointState) or value.position.size:
                return stamp
    raise LookupError("it measures nothing")


@dataclass(frozen=True)
class Silence:
    """What is measured of a silence.

    Attributes:
        restamped: samples that are told as fresh though none came.
        invalid: until data are told as invalid.
        fault: until FAULT.
    """

    restamped: Quantity
    invalid: Quantity
    fault: Quantity

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """All of them."""
        return self.restamped, self.invalid, self.fault

    def judged(self, subject: Subject) -> Findings:
        """Judge what was `looked` at, and kept as ``looks``."""
        looks = subject.kept["looks"]
        period = float(max(np.diff([at for at, *_ in looks]), default=LOOK))
        last = max((stamp for at, stamp, _ in looks if at < ON_ITS_WAY), default=0)
        fresh = sum(stamp > last for at, stamp, _ in looks if at >= ON_ITS_WAY)
        invalid = next((at for at, stamp, _ in looks if stamp == 0), None)
        fault = next((at for at, *_, state in looks if state == OperatingState.FAULT), None)
        never_fresh = Bound(0.0, "stale data is never stamped fresh")
        found = [subject.measured(self.restamped, exact(fresh, len(looks)), never_fresh)]
        for quantity, at, allowed, source in (
            (self.invalid, invalid, subject.stale_after, "five periods, or 20 ms"),
            (self.fault, fault, subject.sample_timeout + 0.1, "sample_timeout and 0.1 s"),
        ):
            bound = Bound(allowed + ON_ITS_WAY, f"{source}; 50 ms for what was on its way")
            estimate = None if at is None else within(at, period)
            why = "" if at else "it never was"
            found.append(subject.measured(quantity, estimate, bound, why=why))
        never = (f"{one.quantity.title}: never" for one in found if one.estimate is None)
        return Findings(tuple(found), tuple(never), doubts=subject.too_busy(BUSY))

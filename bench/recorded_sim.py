"""The real simulator, with notes of what it does.

sent     for each package: controller's time, wall time (ns)
delays   for each control period: when it began (monotonic s), and how late (s)
"""

from __future__ import annotations

import time

from bench.recording import Recording
from crtk_sim_backends.ur import SIM, pace
from crtk_sim_backends.ur.ports import rtde


def record() -> None:
    """Put the notes in place."""
    sent = Recording("sent", 2)
    original = rtde.OutputRecipe.package

    def package(recipe: rtde.OutputRecipe, image: rtde.Image) -> bytes:
        sent.add((image["timestamp"], time.time_ns()))
        return original(recipe, image)

    rtde.OutputRecipe.package = package  # type: ignore[method-assign, assignment]
    delays = Recording("delays", 2)
    begin = pace.Pace.started

    def started(each: pace.Pace, now: float) -> float:
        delays.add((now, now - each.due))
        return begin(each, now)

    pace.Pace.started = started  # type: ignore[method-assign]


if __name__ == "__main__":
    record()
    raise SystemExit(SIM.main())

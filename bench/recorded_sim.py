"""The real simulator, with a note of when it sends each package: controller's time, wall time (ns)."""

from __future__ import annotations

import time

from bench.recording import Recording
from crtk_sim_backends.ur import SIM, rtde


def record() -> None:
    """Put the note in place."""
    sent = Recording("sent", 2)
    original = rtde.OutputRecipe.package

    def package(recipe: rtde.OutputRecipe, image: rtde.Image) -> bytes:
        sent.add((image["timestamp"], time.time_ns()))
        return original(recipe, image)

    rtde.OutputRecipe.package = package  # type: ignore[method-assign, assignment]


if __name__ == "__main__":
    record()
    raise SystemExit(SIM.main())

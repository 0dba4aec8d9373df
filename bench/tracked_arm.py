"""A simulated tracker and the marker of a virtual arm: ``python -m bench.tracked_arm``.

How far hand-eye calibration is off what is true, and how old what the tracker tells is while the arm moves.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any, Final

import numpy as np

import crtk_drivers
from crtk_drivers import plugins
from crtk_drivers.errors import DataTimeout
from crtk_drivers.front import LocalDevice
from crtk_drivers.geometry.frames import product, relative
from crtk_drivers.labs.calibration import hand_eye
from crtk_drivers.labs.calibration.stillness import Still, StillPoses, distance
from crtk_drivers.labs.lab_file import CarriedEntry
from crtk_drivers.labs.sim_coupling import Coupling, Told, followed
from crtk_drivers.samples import Array, Pose, vector
from crtk_drivers.session import open_session

PLACES: Final = 15
TRIALS: Final = 5
TURN: Final = np.array((0.15, 0.15, 0.15, 0.7, 0.7, 0.7))
"""rad: how far each joint goes at most from where it is."""
SWING: Final = 8.0
"""Seconds of a motion of the tool."""
FREQUENCY: Final = 0.5
LAGS: Final = np.arange(0.0, 0.15, 1e-3)

ENTRY: Final = CarriedEntry.model_validate(
    {
        "stands": {"position": (-1.1, -0.1, 0.4), "rpy": (0.0, -1.5708, 0.0)},
        "markers": {
            "pointer": {
                "on": "arm",
                "mounting": {"position": (0.02, -0.05, 0.11), "rpy": (0.5, 1.2, -0.7)},
            }
        },
    }
)


@contextmanager
def lab(**options: float) -> Iterator[tuple[Any, Any]]:
    """Give an arm and a tracker that sees its marker, both enabled."""
    plugin = plugins.device("ndi")
    with ExitStack() as stack:
        arm: Any = stack.enter_context(crtk_drivers.connect("virtual", rate=200.0))
        session = open_session(
            "ndi", plugins.device("ndi").load_config(None, {}), sim=True, sim_options=options
        )
        session.start()
        tracker: Any = stack.enter_context(LocalDevice(session))
        assert session.sim is not None

        def look() -> Told | None:
            pose, stamp = arm.measured_cp(age=0.0, wait=1.0, extra=True)
            return (pose, round(1e9 * stamp)) if stamp else None

        for each in followed(plugin, session.config, session.sim, ENTRY, "ndi"):
            stack.enter_context(Coupling(session.sim, each, look))
        arm.enable()
        tracker.enable()
        yield arm, tracker


def standing(arm: Any, marker: Any, taker: StillPoses) -> tuple[Pose, ...]:
    """Return means of arm and marker once both have stood."""
    while True:
        time.sleep(0.02)
        try:
            seen = arm.measured_cp(age=0.2, wait=0.0), marker.measured_cp(age=0.2, wait=0.0)
        except DataTimeout:
            taker.feed(time.monotonic(), None)
            continue
        if (means := taker.feed(time.monotonic(), seen)) is not None:
            return means


def calibrated(seed: int) -> list[float]:
    """Return how far tracker and marker are found off what is true: mm, degrees, mm, degrees."""
    random = np.random.default_rng(seed)
    with lab() as (arm, tracker):
        home, pairs, taker = arm.measured_js(wait=5.0).position, [], StillPoses(Still())
        for _ in range(PLACES):
            arm.move_jp(vector(home + TURN * random.uniform(-1.0, 1.0, 6))).wait(30.0)
            pairs.append(standing(arm, tracker.pointer, taker))
    found = hand_eye(*(list(each) for each in zip(*pairs, strict=True)))
    assert ENTRY.stands is not None
    true = ENTRY.stands.pose, ENTRY.markers["pointer"].mounting.pose
    off = [distance(*each) for each in zip((found.tracker, found.marker), true, strict=True)]
    return [part for moved, turned in off for part in (1e3 * moved, math.degrees(turned))]


def lag(latency: float) -> float:
    """Return by how many ms what the tracker tells is behind its stamps, while the arm swings."""
    assert ENTRY.stands is not None
    mounting = ENTRY.markers["pointer"].mounting.pose
    told: dict[str, dict[float, Array]] = {"arm": {}, "marker": {}}
    with lab(latency=latency) as (arm, tracker):
        home = arm.measured_js(wait=5.0).position
        begin = time.monotonic()
        while (now := time.monotonic() - begin) < SWING:
            swing = 0.15 * min(1.0, now) * math.sin(2.0 * math.pi * FREQUENCY * now)
            arm.servo_jp(vector(home + swing * np.eye(6)[0]))
            for name, device in (("arm", arm), ("marker", tracker.pointer)):
                pose, stamp = device.measured_cp(age=0.0, wait=1.0, extra=True)
                if stamp:
                    at = (
                        relative(ENTRY.stands.pose, product(pose, mounting))
                        if name == "arm"
                        else pose
                    )
                    told[name][stamp] = at.position
            time.sleep(0.005)
    axes = [(np.array(list(each)), np.array(list(each.values()))) for each in told.values()]
    (made, places), (seen, markers) = axes
    later = seen > seen[0] + 2.0
    errors = [
        np.linalg.norm(
            [np.interp(seen[later] - by, made, places[:, k]) - markers[later, k] for k in range(3)],
            axis=0,
        ).mean()
        for by in LAGS
    ]
    return 1e3 * float(LAGS[int(np.argmin(errors))])


def main() -> None:
    """Print the figures."""
    off = np.median([calibrated(seed) for seed in range(TRIALS)], axis=0)
    print(f"hand-eye, {PLACES} places, median of {TRIALS}:")
    print(f"  tracker off by {off[0]:.3f} mm, {off[1]:.4f} deg")
    print(f"  marker off by {off[2]:.3f} mm, {off[3]:.4f} deg")
    for latency in (0.0, 0.05):
        print(
            f"what is told is {lag(latency):.0f} ms behind its stamp at a latency of {1e3 * latency:.0f} ms"
        )


if __name__ == "__main__":
    main()

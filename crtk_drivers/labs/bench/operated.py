"""What an operator does when asked: the emergency stop is pressed, and pulled out again."""

from __future__ import annotations

import time
from typing import Final

import numpy as np

from crtk_drivers.labs.bench.acquisition import Acquisition, BenchTest, Safety, Subject, Suite
from crtk_drivers.labs.bench.bed import Bed
from crtk_drivers.labs.bench.calls import Glance
from crtk_drivers.labs.bench.operator import UNNOTICED
from crtk_drivers.labs.bench.trace import Trace
from crtk_drivers.labs.verdicts.estimates import exact, within
from crtk_drivers.labs.verdicts.judging import Bound, Comparison, Findings, Quantity, Verdict
from crtk_drivers.state import OperatingState

NOTICED: Final = 0.2
"""Seconds after which a pressed button is a FAULT of the device."""

HELD: Final = 2.0
"""Seconds for which the button is pressed, beside the time that an operator takes."""

AFTER: Final = 2.0
"""Seconds after which what the released button starts has begun."""

MOVED: Final = 5e-3
"""rad (m): what a brake may settle by."""

TIME = Quantity(
    "stop.emergency.time", "until it is not ENABLED any more", "s", Comparison.AT_MOST, guard=0.02
)
WAY = Quantity(
    "stop.emergency.distance",
    "way while the button is pressed",
    "mrad or mm",
    Comparison.AT_MOST,
    guard=0.2,
)
RELEASED_WAY = Quantity(
    "stop.emergency.after",
    "way after it is pulled out",
    "mrad or mm",
    Comparison.AT_MOST,
    guard=0.2,
)


def _has_stopped(glance: Glance) -> bool:
    return glance.status.state is not OperatingState.ENABLED


def _press_and_release(bed: Bed) -> None:
    bed.enable()
    bed.rest(0.3)
    before = bed.position
    with bed.expecting("an emergency stop"):
        with bed.emergency_stop(_has_stopped) as pressed:
            bed.keep(
                noticed=pressed.noticed,
                look=pressed.look,
                by_operator=pressed.by_operator,
                before=before.tolist(),
            )
            time.sleep(HELD)
            bed.keep(pressed=bed.position.tolist(), pressed_state=str(bed.state))
        time.sleep(AFTER)
        bed.keep(released=bed.position.tolist(), released_state=str(bed.state))
    bed.disable()
    bed.enable()
    bed.keep(enabled_again=True)
    bed.disable()


EMERGENCY_STOP: Final = Acquisition(
    "emergency_stop",
    "Presses the emergency stop while enabled, at rest, or asks the operator to, and pulls it out again.",
    Safety.FAULT,
    _press_and_release,
    ("measured_js",),
    suite=Suite.FULL,
    by_operator=True,
)


def _stops(trace: Trace, subject: Subject) -> Findings:
    kept = subject.kept
    found = []
    if kept["noticed"] is not None and not kept["by_operator"]:
        estimate = within(kept["noticed"], kept["look"], 1)
        bound = Bound(NOTICED, "a button that somebody pressed is known at once")
        found.append(subject.measured(TIME, estimate, bound))
    for quantity, begin, end, source in (
        (WAY, "before", "pressed", "a brake that settles"),
        (RELEASED_WAY, "pressed", "released", "nothing moves because a button is released"),
    ):
        ways = np.abs(np.subtract(kept[end], kept[begin]))
        worst = int(np.argmax(ways))
        found.append(
            subject.measured(
                quantity,
                exact(1e3 * float(ways[worst])),
                Bound(1e3 * MOVED, source),
                part=subject.joints[worst],
            )
        )
    violations = tuple(
        f"it is ENABLED {when}"
        for when, state in (
            ("while the button is pressed", kept["pressed_state"]),
            ("after the button was released, and nobody asked for that", kept["released_state"]),
        )
        if state == OperatingState.ENABLED
    )
    if kept["noticed"] is None:
        violations += (f"{UNNOTICED:g} s after the button was pressed it is still ENABLED",)
    is_open = not kept.get("enabled_again") and Verdict.FAIL not in {one.verdict for one in found}
    doubts = ("it was not ENABLED again after the button was released",) if is_open else ()
    return Findings(tuple(found), violations, doubts)


TESTS: Final = (
    BenchTest(
        "S7",
        "emergency stop",
        "stop",
        EMERGENCY_STOP,
        _stops,
        (TIME, WAY, RELEASED_WAY),
        of_kept=True,
    ),
)

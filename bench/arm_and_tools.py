"""Does the arm's 500 Hz notice what hangs at its tool? A simulated UR alone, with a gripper, and a sensor.

All drivers are in one process, as a user has them: the arm ENABLED, the gripper at its tool's line opening
and closing all the time, the FT 300 streaming at a serial line of its own (100 measurements a second; on one
line with a gripper it cannot be: 19200 bit/s, and while it streams nobody else is heard). Segments
alternate. `in another process` has a gripper and a sensor at work there: the arm's process has itself alone,
and the machine as much to do.
`late` is by how much later a controller's state was taken than the earliest of the same tenth of a second, by
the controller's own clock: so it is no matter if a busy machine slows that down. The simulated controller has
real-time priority where the system permits that, as the drivers' I/O threads have.

    python -m bench.arm_and_tools
"""

from __future__ import annotations

import multiprocessing
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from multiprocessing.synchronize import Event
from typing import Any, Final

import numpy as np

import crtk_drivers
from bench.report import options, ratio, show, spread

SETTLE: Final = 1.0
"""Seconds after the start that are not counted."""
PATIENCE: Final = 20.0
ALONE, ELSEWHERE = "arm alone", "in another process"
GRIPPER, BOTH = "with its gripper", "with gripper and sensor"
BLOCK: Final = 50
"""Cycles of which the earliest counts as in time."""
LONG: Final = 0.004
"""Seconds between two cycles that are two periods."""


@dataclass
class Loop:
    """What was measured of the arm's cycles, over all segments.

    Attributes:
        periods: s from each to the next.
        late: s by which each was later than the earliest of its block.
        grips, measurements: of what hangs at the tool, meanwhile.
        cpu: shares of a core.
    """

    periods: list[float] = field(default_factory=list)
    late: list[float] = field(default_factory=list)
    grips: int = 0
    measurements: int = 0
    seconds: float = 0.0
    cpu: list[float] = field(default_factory=list)


@contextmanager
def gripping(gripper: Any, loop: Loop) -> Iterator[None]:
    """Let it open and close meanwhile."""
    end = threading.Event()

    def work() -> None:
        while not end.is_set():
            for opening in (0.02, 0.06):
                gripper.move_jp([opening]).wait(PATIENCE)
                loop.grips += 1

    worker = threading.Thread(target=work)
    worker.start()
    try:
        yield
    finally:
        end.set()
        worker.join()


def beside(end: Event, ready: Event) -> None:
    """Have a gripper and a sensor at work, in a process of their own."""
    with (
        crtk_drivers.connect("robotiq", sim=True, link="tool") as gripper,
        crtk_drivers.connect("robotiq-ft300", sim=True) as force,
    ):
        gripper.enable()
        force.enable()
        with gripping(gripper, Loop()):
            ready.set()
            end.wait()


@contextmanager
def another_process() -> Iterator[None]:
    """Let them work there meanwhile."""
    context = multiprocessing.get_context("spawn")
    end, ready = context.Event(), context.Event()
    worker = context.Process(target=beside, args=(end, ready))
    worker.start()
    try:
        ready.wait(PATIENCE)
        yield
    finally:
        end.set()
        worker.join(PATIENCE)


def segment(loop: Loop, seconds: float, case: str) -> None:
    """Run one segment."""
    gripper, sensor = case in (GRIPPER, BOTH), case == BOTH
    with ExitStack() as stack:
        if case == ELSEWHERE:
            stack.enter_context(another_process())
        given: dict[str, Any] = {"gripper": "robotiq"} if gripper else {}
        given |= {"sample_timeout": 3.0, "watchdog_frequency": 2.0}
        prompt = {"realtime": True}
        arm: Any = stack.enter_context(
            crtk_drivers.connect("ur", sim=True, sim_options=prompt, **given)
        )
        arm.enable()
        if gripper:
            arm.gripper.wait_for_operating_state("DISABLED", PATIENCE)
            arm.gripper.enable()
            stack.enter_context(gripping(arm.gripper, loop))
        force: Any = None
        if sensor:
            force = stack.enter_context(crtk_drivers.connect("robotiq-ft300", sim=True))
            force.enable()
        taken: list[tuple[float, float]] = []
        device = arm.engine.device
        arm.engine.on_sample = lambda: taken.append(
            (time.monotonic(), device.robot_state.timestamp)
        )
        time.sleep(SETTLE)
        first, cpu = len(taken), time.process_time()
        before = force.health().samples if force else 0
        time.sleep(seconds)
        loop.cpu.append((time.process_time() - cpu) / seconds)
        loop.measurements += (force.health().samples if force else 0) - before
        times = np.array(taken[first:])
        arm.engine.on_sample = None
    loop.periods.extend(np.diff(times[:, 0]))
    behind = times[:, 0] - times[:, 1]
    for block in np.array_split(behind, max(1, len(behind) // BLOCK)):
        loop.late.extend(block - block.min())
    loop.seconds += seconds


def main() -> int:
    """Measure and print."""
    given = options(
        __doc__ or "", seconds=(40.0, "of each"), segments=(4, "into which they are split")
    )
    cases = {case: Loop() for case in (ALONE, ELSEWHERE, GRIPPER, BOTH)}
    for _ in range(given.segments):
        for case, loop in cases.items():
            segment(loop, given.seconds / given.segments, case)
    rows = [
        [
            name,
            f"{len(loop.periods) / sum(loop.periods):.2f}",
            f"{100.0 * float(np.mean(np.array(loop.periods) > LONG)):.2f}",
            *spread(loop.periods, 1e3, 2),
            *spread(loop.late, 1e3, 2)[:2],
            f"{100.0 * float(np.mean(loop.cpu)):.0f}",
            f"{loop.grips / loop.seconds:.1f}",
            f"{loop.measurements / loop.seconds:.0f}",
        ]
        for name, loop in cases.items()
    ]
    notes = []
    for other in (ALONE, ELSEWHERE):
        late = [float(np.percentile(cases[case].late, 99)) for case in (BOTH, other)]
        rates = [len(cases[case].periods) / sum(cases[case].periods) for case in (BOTH, other)]
        notes.append(f"{BOTH} to {other}: late p99 {ratio(*late)}, rate {ratio(*rates)}")
    columns = ("loop", "Hz", f">{1e3 * LONG:g} ms %", "p50 ms", "p99", "max")
    more = ("late p50", "p99", "CPU %", "grips/s", "F/s")
    show(
        f"The arm's cycles, {given.seconds:g} s each in {given.segments} segments",
        (*columns, *more),
        rows,
        [*notes, "p50 to max: from one cycle to the next. F: measurements of the sensor."],
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())

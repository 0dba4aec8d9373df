"""Simulated grippers by each way to them: samples a second, CPU, command to motion, grasp detected.

The driver is in this process, at its default rate. `motion` is from the call of move_jp to the first sample
that shows another position; `grasp` from the contact to `state/holds`, by the simulator's own clock, which is
asked a moment later. The last rows have the gripper at the tool of a simulated UR, which moves nothing, and
beside a busy Python thread.

    python -m bench.gripper
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from typing import Any, Final

import crtk_drivers
from bench.report import options, show, spread

PATIENCE: Final = 10.0
WIDTH: Final = 0.03
"""Of what is gripped, in m."""
OPEN: Final = 0.06
LINKS: Final = {
    "robotiq": ("serial", "tool", "modbus", "urcap"),
    "onrobot": ("modbus", "serial", "tool"),
    "schunk": ("http", "serial", "tool"),
}
IDLE: Final = 3.0
"""Seconds over which samples and CPU are counted."""


def wait(test: Callable[[], object]) -> None:
    """Return as soon as a test holds."""
    end = time.monotonic() + PATIENCE
    while not test():
        if time.monotonic() > end:
            raise TimeoutError
        time.sleep(0.0005)


def measure(gripper: Any, control: Any, rounds: int) -> list[str]:
    """Return what a gripper does, as a part of a row."""
    gripper.enable()
    before, cpu = gripper.health().samples, time.process_time()
    time.sleep(IDLE)
    rate = (gripper.health().samples - before) / IDLE
    share = (time.process_time() - cpu) / IDLE
    motions, grasps = [], []
    control.inject("object", width=WIDTH)
    for _ in range(rounds):
        gripper.move_jp([OPEN]).wait(PATIENCE)
        here = gripper.measured_js().position[0]
        begin = time.monotonic()
        move = gripper.move_jp([0.0])
        wait(lambda here=here: gripper.measured_js().position[0] != here)
        motions.append(time.monotonic() - begin)
        wait(gripper.state.holds)
        grasps.append(control.status()["stalled"])
        move.wait(PATIENCE)
    return [
        f"{rate:.0f}",
        f"{100.0 * share:.1f}",
        *spread(motions, 1e3, 1)[:2],
        *spread(grasps, 1e3, 1)[:2],
    ]


@contextmanager
def busy() -> Iterator[None]:
    """Let a thread compute in Python meanwhile."""
    stop = threading.Event()

    def compute() -> None:
        value = 0
        while not stop.is_set():
            value += 1

    worker = threading.Thread(target=compute)
    worker.start()
    try:
        yield
    finally:
        stop.set()
        worker.join()


def main() -> int:
    """Measure and print."""
    given = options(__doc__ or "", rounds=(5, "grips by each way"))
    rows = []
    for plugin, links in LINKS.items():
        for link in links:
            with crtk_drivers.connect(plugin, sim=True, link=link, sample_timeout=3.0) as gripper:
                measured = measure(gripper, gripper.sim.control, given.rounds)
                rows.append([f"{plugin}, {link}", *measured])
    with crtk_drivers.connect("ur", sim=True, gripper="robotiq", sample_timeout=3.0) as arm:
        arm.enable()
        wait(lambda: arm.gripper.operating_state().state == "DISABLED")
        control, notes = arm.sim.tool.control, []
        for name, beside in (("at a UR", nullcontext), ("at a UR, busy thread", busy)):
            before = arm.health()
            with beside():
                rows.append([name, *measure(arm.gripper, control, given.rounds)])
            after = arm.health()
            late = after.late_cycles - before.late_cycles
            notes.append(f"{name}: {late} of its {after.cycles - before.cycles} cycles late")
    columns = ("way", "samples/s", "CPU %", "motion ms", "p99", "grasp ms", "p99")
    show("Simulated grippers", columns, rows, notes)
    return 0


if __name__ == "__main__":
    sys.exit(main())

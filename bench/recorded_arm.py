"""The real simulator, with a note of each new goal that servoj gives to its arm.

goals          for each: its last joint's position, monotonic time (ns)
"""

from __future__ import annotations

import time

from bench.recording import Recording
from crtk_sim_backends.ur import SIM
from crtk_sim_backends.ur.motion import arm
from crtk_sim_backends.ur.motion.kinematics import Floats


def record() -> None:
    """Put the note in place."""
    goals = Recording("goals", 2)
    original = arm.Arm.servo
    newest = 0.0

    def servo(self: arm.Arm, goal: Floats, lookahead: float, gain: float) -> None:
        nonlocal newest
        if goal[-1] != newest:
            newest = goal[-1]
            goals.add((newest, time.monotonic_ns()))
        original(self, goal, lookahead, gain)

    arm.Arm.servo = servo  # type: ignore[method-assign]


if __name__ == "__main__":
    record()
    raise SystemExit(SIM.main())

"""The real simulator, with a note of each new goal that servoj gives to its arm, and of where the arm is.

goals          for each: its last joint's position, monotonic time (ns)
targets        for each cycle in which it moves: the last joint of target_q, monotonic time (ns)
"""

from __future__ import annotations

import time

from bench.recording import Recording
from crtk_sim_backends.ur import SIM
from crtk_sim_backends.ur.motion import arm
from crtk_sim_backends.ur.motion.kinematics import Floats


def record() -> None:
    """Put the note in place."""
    goals, targets = Recording("goals", 2), Recording("targets", 2)
    original, advanced = arm.Arm.servo, arm.Arm.step
    newest = 0.0

    def servo(self: arm.Arm, goal: Floats, lookahead: float, gain: float) -> None:
        nonlocal newest
        if goal[-1] != newest:
            newest = goal[-1]
            goals.add((newest, time.monotonic_ns()))
        original(self, goal, lookahead, gain)

    def step(self: arm.Arm) -> arm.LimitViolation | None:
        before = self.target_q[-1]
        violation = advanced(self)
        if self.target_q[-1] != before:
            targets.add((self.target_q[-1], time.monotonic_ns()))
        return violation

    arm.Arm.servo = servo  # type: ignore[method-assign]
    arm.Arm.step = step  # type: ignore[method-assign]


if __name__ == "__main__":
    record()
    raise SystemExit(SIM.main())

"""The simulated gripper itself, without its ports and without a clock."""

from __future__ import annotations

from crtk_sim_backends.faults import Fault
from crtk_sim_backends.kit.jaw import Jaw
from crtk_sim_backends.robotiq.gripper import CLOSED_ONTO, RESET, STATUS, Gripper

CLOSE = bytes.fromhex("09 00 00 ff ff ff")


def test_a_reset_clears_the_grip_at_once() -> None:
    gripper = Gripper("2f-85", Jaw(0.085, width=0.04), (3.0, 230.0), activated=True, lag=0.0)
    gripper.command(0, CLOSE)
    for _ in range(100):
        gripper.advance(0.01)
    assert gripper.report[0] >> 6 == CLOSED_ONTO

    gripper.end(Fault("unpowered", {}))  # no time passes
    assert gripper.read(STATUS, 1) == bytes((RESET, 0))


def test_fingers_pass_nothing_when_they_press_less() -> None:
    jaw = Jaw(0.05, width=0.03)
    for force, steps in ((80.0, 200), (235.0, 3), (80.0, 200)):
        for _ in range(steps):
            jaw.follow(0.0, 0.15, force, 0.002)
    assert jaw.opening > 0.028

"""Commands that were accepted and cannot be carried out: what they took the place of counts."""

from __future__ import annotations

import numpy as np
import pytest

from crtk_drivers.device import JointLimits
from crtk_drivers.engine import EngineOptions
from crtk_drivers.errors import Reason
from crtk_drivers.motion.move import Outcome
from crtk_drivers.samples import AxisMode, JointServo, vector
from crtk_drivers.state import OperatingState
from rigs.scripted_engine import Rig, jp, jv, two_joints

SLOW = JointLimits(-1.0, 1.0, velocity=1.0, acceleration=1.0, jerk=10.0, effort=5.0)
STEP = 0.04
"""Within `LimitPolicy.max_step` of a joint's speed, and further than it gets from rest in twice that time."""


def rig(**options: float) -> Rig:
    return Rig(EngineOptions(**options), two_joints(limits=(SLOW, SLOW))).enabled()  # type: ignore[arg-type]


def reasons(rig: Rig) -> list[tuple[str, Reason]]:
    return [(refusal.command, refusal.reason) for refusal in rig.told.refusals]


def test_a_hold_is_carried_out_though_what_came_after_it_cannot_be() -> None:
    arm = rig()
    move = arm.engine.submit("move_jp", jp(0.5, 0.5))
    arm.cycle(20)
    here = arm.device.position[0]
    arm.engine.submit("hold")
    arm.engine.submit("servo_jp", jp(here - STEP, 0.0))
    arm.cycle()
    assert reasons(arm) == [("servo_jp", Reason.STEP_TOO_LARGE)]
    assert arm.device.calls[-1] == "stop"
    assert move is not None
    assert (move.outcome, arm.engine.status.is_busy) == (Outcome.PREEMPTED, False)
    written = len(arm.written)
    arm.cycle(20)
    assert len(arm.written) == written, "the move went on"


def test_a_hold_is_carried_out_though_what_came_after_it_waited_too_long() -> None:
    arm = rig()
    arm.engine.submit("move_jp", jp(0.5, 0.5))
    arm.cycle(20)
    arm.engine.submit("hold")
    for _ in range(2):
        arm.engine.submit("servo_jr", jp(0.001, 0.0))
    arm.cycle(period=0.6)
    assert reasons(arm) == [("servo_jr", Reason.TOO_OLD)]
    written = len(arm.written)
    arm.cycle(20)
    assert (len(arm.written), arm.state) == (written, OperatingState.ENABLED)
    assert arm.device.calls[-1] == "stop"


@pytest.mark.parametrize("period", [0.01, 0.6])
def test_a_move_whose_place_was_taken_leaves_nobody_waiting(period: float) -> None:
    arm = rig()
    move = arm.engine.submit("move_jp", jp(0.5, 0.5))
    arm.engine.submit("servo_jp", jp(STEP, 0.0))
    assert arm.engine.status.is_busy
    arm.cycle(period=period)
    assert [command for command, _ in reasons(arm)] == ["servo_jp"]
    assert move is not None
    assert (move.outcome, arm.engine.status.is_busy) == (Outcome.PREEMPTED, False)


def test_a_move_goes_on_beside_a_stream_that_cannot_begin() -> None:
    arm = rig()
    move = arm.engine.submit("move_jp", jp(0.5, 0.5))
    arm.cycle(20)
    arm.engine.submit("servo_jp", jp(arm.device.position[0] - STEP, 0.0))
    arm.cycle()
    assert reasons(arm) == [("servo_jp", Reason.STEP_TOO_LARGE)]
    assert arm.engine.status.is_busy
    assert move is not None
    assert move.is_busy()


def test_positions_after_velocities_begin_as_any_stream_of_positions_does() -> None:
    arm = rig(stream_timeout=0.5)
    for _ in range(3):
        arm.engine.submit("servo_jv", jv(0.0, 0.0))
        arm.cycle()
    arm.cycle(12)
    arm.engine.submit("servo_jp", jp(STEP, 0.0))
    arm.cycle()
    assert reasons(arm) == [("servo_jp", Reason.STEP_TOO_LARGE)]
    arm.engine.submit("servo_jp", jp(0.004, 0.0))
    arm.cycle()
    arm.engine.submit("servo_jp", jp(0.004 + STEP, 0.0))
    arm.cycle()
    assert arm.written[-1].values[0] == 0.004 + STEP, "it has begun"


def test_mixed_setpoints_begin_as_any_stream_of_positions_does() -> None:
    arm = rig()
    modes = (AxisMode.POSITION, AxisMode.VELOCITY)

    def mixed(position: float) -> JointServo:
        return JointServo(modes, vector((position, 0.0)), vector((0.0, 0.1)))

    arm.engine.submit("servo_js", mixed(STEP))
    arm.cycle()
    assert reasons(arm) == [("servo_js", Reason.STEP_TOO_LARGE)]
    assert not arm.written
    arm.engine.submit("servo_js", mixed(0.004))
    arm.cycle()
    arm.engine.submit("servo_js", mixed(0.004 + STEP))
    arm.cycle()
    assert np.array([setpoint.values[0] for setpoint in arm.written]) == pytest.approx(
        [0.004, 0.004 + STEP]
    )

"""A stop by somebody else is no stop of ours: the next position must not undo it."""

from __future__ import annotations

import contextlib

import pytest

from crtk_drivers.errors import CommandRefused
from rigs.copley_bench import ONE, arm_at, drives
from rigs.waiting import LONG, eventually


@pytest.mark.parametrize("tracking", ["profile", pytest.param("stop_go", marks=pytest.mark.slow)])
def test_by_profiles_it_is_a_fault_though_the_axis_rests(tracking: str) -> None:
    with drives(travel=45_000) as sim, arm_at(sim, tracking=tracking, joints=ONE) as arm:
        arm.enable(LONG)
        goal = arm.setpoint_js().position.copy() + 0.02

        def streams() -> None:
            with contextlib.suppress(CommandRefused):
                arm.servo_jp(goal)

        def is_there() -> bool:
            streams()
            return bool(abs(arm.measured_js().position - goal).max() < 0.002)

        def is_told() -> bool:
            streams()
            sim.control.inject("foreign_stop")
            return arm.operating_state().state == "FAULT"

        eventually(is_there, "it is where it was sent")
        eventually(is_told, "it is in FAULT")
        assert "was ended, and not by this driver" in arm.operating_state().detail

"""Remote control: an arm is refused while the pendant has it, unless the controller obeys all the same."""

from __future__ import annotations

import numpy as np
import pytest

from crtk_drivers.errors import CommandRefused
from crtk_drivers.state import Reason
from rigs.ur_bench import HOME, LONG, WAYS, ur_bench

GOAL = [0.1, *HOME[1:]]
OF_URSIM = {"remote": False, "remote_enforced": False}
"""What UR's own simulator is like as it comes."""


@pytest.mark.parametrize("control", WAYS)
@pytest.mark.parametrize("sim", [{"remote": False}, OF_URSIM], ids=["robot", "ursim"])
def test_the_refusal_names_the_setting(control, sim):
    with ur_bench({"control": control}, **sim) as bench:
        with pytest.raises(CommandRefused) as caught:
            bench.arm.enable(timeout=LONG)
        assert caught.value.reason == Reason.LOCAL_CONTROL
        assert "remote control" in caught.value.remedy
        assert "require_remote_control: false" in caught.value.remedy


@pytest.mark.parametrize("control", WAYS)
def test_a_controller_that_obeys_in_local_control_is_enabled_if_so_configured(control):
    with ur_bench({"control": control, "require_remote_control": False}, **OF_URSIM) as bench:
        bench.enable()
        assert bench.arm.move_jp(GOAL).wait(LONG)
        np.testing.assert_allclose(bench.q(), GOAL, atol=1e-3)
        assert bench.arm.state.remote_control() is False, "it is told nevertheless"
        assert bench.arm.robot_mode(timeout=LONG) == "RUNNING"
        bench.arm.disable(timeout=LONG)
        assert bench.arm.power_on(timeout=LONG)


def test_a_robot_that_refuses_is_no_arm_all_the_same():
    with ur_bench({"control": "native", "require_remote_control": False}, remote=False) as bench:
        with pytest.raises(Exception, match="control program"):
            bench.arm.enable(timeout=LONG)
        assert bench.status.state != "ENABLED"

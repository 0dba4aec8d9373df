"""Defects of the simulated controller, without a wire."""

import pytest

from crtk_sim_backends.ur.defects import ArmDefects
from crtk_sim_backends.ur.safety.modes import RuntimeState, SafetyMode
from rigs.ur_controller import Bench


@pytest.mark.parametrize(
    ("ignores", "state"), [(0, RuntimeState.STOPPED), (1, RuntimeState.PLAYING)]
)
def test_a_watchdog_may_be_ignored(ignores: int, state: RuntimeState) -> None:
    bench = Bench(defects=(ArmDefects(ignores_watchdog=ignores),))
    bench.start('rtde_set_watchdog("input_int_register_0", 10, "stop")\nwhile True:\nsync()\nend')
    bench.seconds(0.5)
    assert bench.controller.runtime_state == state


@pytest.mark.parametrize(
    ("ignores", "mode"), [(0, SafetyMode.ROBOT_EMERGENCY_STOP), (1, SafetyMode.NORMAL)]
)
def test_the_button_on_the_pendant_may_do_nothing(ignores: int, mode: SafetyMode) -> None:
    bench = Bench(defects=(ArmDefects(ignores_emergency_stop=ignores),))
    bench.controller.emergency_stop()
    bench.ticks(2)
    assert bench.controller.safety.mode == mode


def test_what_is_told_is_no_truth_for_programs() -> None:
    bench = Bench(defects=(ArmDefects(position_drift=0.1, velocity_scale=1.5, joints=(1,)),))
    bench.start("movej([0.5, -1.57, 1.57, -1.57, -1.57, 0.3], a=2, v=1)\nsync()")
    fastest = [0.0, 0.0]
    for _ in range(500):
        bench.ticks(1)
        arm = bench.controller.plant.arm
        fastest = [max(fastest[0], arm.actual_qd[0]), max(fastest[1], bench["actual_qd"][0])]
        assert bench["actual_qd"][5] == arm.actual_qd[5]
    assert fastest[1] == pytest.approx(1.5 * fastest[0])
    assert bench.controller.plant.arm.actual_q[0] == pytest.approx(0.5, abs=1e-3)
    assert bench["actual_q"][0] == pytest.approx(0.5 + 0.1, abs=0.01)

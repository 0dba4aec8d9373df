"""The driver, with its own control program, at each generation of controllers, also slowed down ones."""

from __future__ import annotations

import numpy as np
import pytest

from crtk_sim_backends.ur import SIM
from rigs.ur_bench import HOME, LONG, driver_at, eventually

CONTROLLERS = [
    ("ur3", "3.12.0"),
    ("ur5", "3.15.8"),
    ("ur5e", "5.9.4"),
    ("ur5e", "5.12.4"),
    ("ur20", "5.26.3"),
    ("ur5e", "10.11.0"),
    ("ur5e", "10.15.0"),
]
MOVE = {"joint_velocity": 1.5, "joint_acceleration": 6.0}


@pytest.mark.sweep(3)
@pytest.mark.parametrize(("model", "version"), CONTROLLERS)
def test_an_arm_is_enabled_moved_streamed_and_disabled(model, version):
    of_x = {"robot_api": True, "robot_api_port": 0} if version.startswith("10.") else {}
    with (
        SIM.spawn(realtime=True, model=model, version=version, **of_x) as sim,
        driver_at(
            sim,
            {
                "control": "native",
                "model": model,
                "move": MOVE,
                "robot_api_port": sim.ports.get("robot_api", 80),
            },
        ) as bench,
    ):
        bench.enable()
        goal = [0.2, *HOME[1:]]
        assert bench.arm.move_jp(goal).wait(LONG)
        np.testing.assert_allclose(bench.q(), goal, atol=1e-3)
        for slider in (1.0, 0.25):
            bench.inject("speed_slider", fraction=slider)
            eventually(lambda s=slider: bench.device.pace == pytest.approx(s), "the slider is seen")
            before = bench.q()[5]

            def turns(begin: float = before) -> bool:
                bench.arm.servo_jv([0.0] * 5 + [0.3])
                return bool(bench.q()[5] > begin + 0.01)

            eventually(turns, "it turns")
            bench.arm.hold()
            eventually(lambda: bench.engine._stopping.confirmed, "the stop is read back")
        assert bench.status.state == "ENABLED", bench.status
        bench.arm.disable(timeout=LONG)
        assert bench.status.state == "DISABLED"

"""The CANopen arm on drives with the objects of EDS files like those of real ones: rpm, few objects."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from crtk_drivers.front import LocalDevice
from crtk_sim_backends.process import RunningSim
from rigs.canopen_arm import arm_of, drives, patient_arm_on
from rigs.waiting import LONG, eventually

SHEETS = Path(__file__).parents[2] / "data" / "eds"
TURN = 2.0 * np.pi


@pytest.fixture(scope="module")
def sim(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningSim]:
    path = tmp_path_factory.mktemp("drives") / "drives.yaml"
    names = ("rpm_servo", "generic", "few_objects")
    path.write_text(
        "".join(f"{n}: {{from_eds: {SHEETS / name}.eds}}\n" for n, name in enumerate(names, 1))
    )
    with drives(3, drives=str(path)) as sim:
        yield sim


def joint(node: int, **keys: Any) -> dict[str, Any]:
    return {
        "node": node,
        "gear": 50.0,
        "lower": -3.0,
        "upper": 3.0,
        "velocity": 1.0,
        "acceleration": 10.0,
        "rated_torque": 1.0,
        "effort": 0.0,
        "following_error": 1.0,
        **keys,
    }


def turned(sim: RunningSim, node: int) -> float:
    """How far the motor of a drive has turned, rad of the joint."""
    drive = sim.control.status()["drives"][str(node)]
    return float(drive["axes"][0]["revolutions"]) * TURN / 50.0


def moves(sim: RunningSim, arm: LocalDevice, nodes: tuple[int, ...]) -> None:
    arm.enable(LONG)
    goal = arm.measured_js().position + 0.1
    arm.move_jp(goal).wait(LONG)
    eventually(lambda: np.abs(arm.measured_js().position - goal).max() < 2e-3, "it is there")
    for node, position in zip(nodes, arm.measured_js().position, strict=True):
        assert turned(sim, node) == pytest.approx(position, abs=2e-3)


def test_drives_with_cyclic_modes_move_by_positions_and_velocities(sim: RunningSim) -> None:
    cyclic = {"modes": ("csp", "csv")}
    config = patient_arm_on(
        sim, 0, joints={"servo": joint(1, **cyclic), "generic": joint(2, **cyclic)}
    )
    with arm_of(config) as arm:
        moves(sim, arm, (1, 2))
        start = arm.measured_js().position

        def is_on_its_way() -> bool:
            arm.servo_jv([0.3, 0.3])
            return bool((arm.measured_js().position - start > 0.05).all())

        eventually(is_on_its_way, "it moves by velocities")
        eventually(lambda: arm.engine.is_at_rest, "the stream ends, and none waits")
        eventually(lambda: np.abs(arm.measured_js().velocity).max() < 1e-2, "it stands")
        moved = arm.measured_js().position - start
        assert ((moved > 0.05) & (moved < 0.5)).all(), moved
        assert [turned(sim, 1), turned(sim, 2)] == pytest.approx(start + moved, abs=2e-3)


def test_a_drive_with_few_objects_moves_by_profiles_of_its_own(sim: RunningSim) -> None:
    few = joint(3, modes=("pp",), counts_per_turn=65536.0)
    with arm_of(patient_arm_on(sim, 0, joints={"stage": few}, feedback=())) as arm:
        moves(sim, arm, (3,))


def test_an_rpm_drive_keeps_the_limits_of_the_joint_in_its_units(sim: RunningSim) -> None:
    config = patient_arm_on(sim, 0, joints={"servo": joint(1, modes=("pp",))})
    with arm_of(config):
        rpm = 60.0 * 50.0 / TURN
        assert sim.control.call("object", node=1, index=0x607F) == np.ceil(1.2 * rpm)
        assert sim.control.call("object", node=1, index=0x6081) == round(rpm)
        assert sim.control.call("object", node=1, index=0x6083) == round(10.0 * rpm)

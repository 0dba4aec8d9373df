"""COB-IDs of PDOs: given, those of the drives, and more than the predefined connection set has."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from crtk_driver_canopen import PLUGIN
from crtk_drivers.front import LocalDevice
from crtk_drivers.session import Session
from crtk_sim_backends.process import RunningSim
from rigs.canopen_arm import JOINT, arm_of, drives, patient_arm_on
from rigs.waiting import LONG, eventually

RPDO_5, TPDO_5, TPDO_6 = 0x1404, 0x1804, 0x1805


def axes_of_one_node(**last: Any) -> dict[str, Any]:
    """Three axes of one drive: with velocity and effort they need six TPDOs."""
    joints = {f"axis_{n}": {**JOINT, "node": 1, "axis": n, "modes": ("csp",)} for n in range(3)}
    joints["axis_2"] |= last
    return joints


def moves(sim: RunningSim, **last: Any) -> None:
    config = patient_arm_on(sim, 1, joints=axes_of_one_node(**last))
    with arm_of(config) as arm:
        arm.enable(LONG)
        goal = arm.setpoint_js().position + np.array((0.02, 0.03, 0.04))
        arm.move_jp(goal).wait(LONG)
        eventually(lambda: abs(arm.measured_js().position - goal).max() < 1e-3, "it is there")


@pytest.fixture(scope="module")
def sim() -> Any:
    with drives(1, axes=3, pdos=8) as running:
        yield running


def test_more_pdos_than_the_predefined_connection_set_has(sim: RunningSim) -> None:
    moves(sim, tpdo_cob_ids=(0x681, 0x682), rpdo_cob_ids=(0x691,))
    assert sim.control.call("object", node=1, index=TPDO_5, sub=1) & 0x8000_07FF == 0x681
    assert sim.control.call("object", node=1, index=TPDO_6, sub=1) & 0x8000_07FF == 0x682


def test_the_cob_ids_that_a_drive_has(sim: RunningSim) -> None:
    for index, cob_id in ((TPDO_5, 0x6A1), (TPDO_6, 0x6A2)):
        sim.control.call("object", node=1, index=index, sub=1, value=0x8000_0000 | cob_id)
    moves(sim, tpdo_cob_ids="drive")
    assert sim.control.call("object", node=1, index=TPDO_5, sub=1) & 0x8000_07FF == 0x6A1


@pytest.mark.parametrize(
    ("cob_id", "message"),
    [
        (0x8000_0000, "is no COB-ID of 11 bits"),
        (0xA000_0681, "is no COB-ID of 11 bits"),
        (0x8000_0181, "have one COB-ID, 0x181"),
    ],
)
def test_cob_ids_of_a_drive_that_cannot_be_used_are_refused_with_the_reason(
    sim: RunningSim, cob_id: int, message: str
) -> None:
    for index, value in ((TPDO_5, cob_id), (TPDO_6, 0x8000_06A2)):
        sim.control.call("object", node=1, index=index, sub=1, value=value)
    config = patient_arm_on(sim, 1, joints=axes_of_one_node(tpdo_cob_ids="drive"))
    arm = LocalDevice(Session(PLUGIN, config))
    try:
        arm._session.start()
        eventually(lambda: message in arm.operating_state().detail, message)
        assert not arm.engine.connected
    finally:
        arm.close()


def test_a_pdo_that_is_valid_from_before_and_not_used_is_switched_off(sim: RunningSim) -> None:
    sim.control.call("object", node=1, index=0x1806, sub=1, value=0x4000_06B1)
    moves(sim, tpdo_cob_ids=(0x681, 0x682))
    assert sim.control.call("object", node=1, index=0x1806, sub=1) & 0x8000_0000

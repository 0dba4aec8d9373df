"""A servo is silent when it was asked in vain, not when a driver that was held up has not asked it."""

import time

import numpy as np
import pytest

from crtk_driver_dynamixel.readings import Silences
from crtk_drivers.errors import ConnectionLost
from rigs.dynamixel_bench import WEIGHTLESS, arm_values, opened, sim_for
from rigs.waiting import LONG, eventually

SILENT = 0.1
VALUES = arm_values(silent_timeout=SILENT)


@pytest.fixture(scope="module")
def sim():
    with sim_for(VALUES, servos=WEIGHTLESS) as sim:
        yield sim


def test_a_driver_that_is_held_up_within_a_cycle_has_lost_nobody(sim):
    with opened(sim, VALUES) as arm:
        gripper = arm.children["gripper"]
        gripper.open(time.monotonic() + LONG)
        # The gripper is read with what the arm's cycle has brought: from here until the end of it.
        assert arm.read(time.monotonic() + LONG) is not None
        time.sleep(2.0 * SILENT)  # whoever is held up
        assert gripper.read(time.monotonic() + LONG) is not None
        assert gripper.condition.reason == ""
        gripper.close()


def test_servos_that_are_asked_in_vain_are_lost(sim):
    with opened(sim, VALUES) as arm:
        sim.control.inject("stall")
        with pytest.raises(ConnectionLost, match="no servo answers any more"):
            eventually(lambda: arm.read(time.monotonic() + LONG) and None, "it is told")
        sim.control.clear()


def test_silence_lasts_from_the_first_request_without_an_answer_to_the_last():
    silences = Silences(3)
    assert (silences.lasting == -np.inf).all()
    for began in (10.0, 11.0):
        silences.go_on(np.array([0, 2]), began, began + 0.1)
    silences.broken(np.array([True, False, False]))
    assert silences.lasting == pytest.approx([-np.inf, -np.inf, 1.1])
    silences.go_on(np.array([0]), 20.0, 20.2)
    assert silences.lasting == pytest.approx([0.2, -np.inf, 1.1])

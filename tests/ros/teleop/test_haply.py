"""The lab file of the examples: a simulated Haply leads a virtual arm, and feels its wall."""

from __future__ import annotations

import threading
from pathlib import Path

import numpy as np
import pytest

from crtk_drivers.client.teleop import Teleoperation, reached_sides, topic_pedals
from crtk_drivers.labs.lab_file import load_lab
from crtk_drivers.labs.lab_outline import load_teleop
from crtk_drivers.motion.teleop import Phase
from crtk_drivers.session import Session
from crtk_sim_backends.haply import SIM
from rigs.loopback_node import served
from rigs.waiting import LONG, eventually

LAB = Path(__file__).parents[3] / "examples" / "haply_teleop.toml"


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.timeout(180)
def test_the_arm_goes_the_way_of_the_handle_and_the_handle_feels_the_wall() -> None:
    lab, given = load_lab(LAB), load_teleop(LAB)
    haply, arm = lab.devices["haply"], lab.devices["arm"]
    patient = {"sample_timeout": 5.0, "stream_timeout": 0.5}
    settings = given.settings.model_copy(update={"timeout": 2.0})
    with SIM.spawn() as sim:
        handle = haply.plugin.sim_config(haply.config.model_copy(update=patient), sim)
        with (
            served(Session(haply.plugin, handle), haply.namespace),
            served(Session(arm.plugin, arm.config.model_copy(update=patient)), arm.namespace),
            reached_sides(given.leader, given.follower, LONG) as (link, leader, follower),
        ):
            for device in (leader, follower):
                device.enable()
            loop = Teleoperation(settings, leader, follower, topic_pedals(link, settings))
            stop = threading.Event()
            thread = threading.Thread(target=loop.run, args=(stop, lambda coupled: None))
            thread.start()
            try:
                eventually(lambda: loop.coupled.phase is Phase.RELEASED, "released")
                sim.control.inject("press", button="a")
                eventually(lambda: loop.coupled.phase is Phase.FOLLOWING, "following")
                start = follower.measured_cp(age=0).position
                sim.control.inject("push", x=0.5)

                def is_felt() -> bool:
                    return bool(sim.control.status()["force"][0] < -0.1)

                eventually(is_felt, "the wall pushes the hand back")
                way = follower.measured_cp(age=0).position - start
                assert way[0] > 0.02
                assert np.abs(way[1:]).max() < 0.01
                sim.control.clear("press")
                eventually(
                    lambda: not any(sim.control.status()["force"]), "let go, nothing is felt"
                )
            finally:
                stop.set()
                thread.join()
                problem = loop.end()
                loop.close()
            assert problem == ""

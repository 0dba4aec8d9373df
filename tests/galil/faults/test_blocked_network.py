"""A network that passes nothing for a while: what a killed driver had sent leads no axis anywhere later."""

from __future__ import annotations

import math

import pytest

from bench.reliability.activities import Plan
from crtk_driver_galil import PLUGIN
from crtk_drivers.labs.bench.relay import Mode, RelayProcess
from crtk_sim_backends.galil import RunningSim
from rigs.axes_bench import stands
from rigs.galil_bench import TURN, configuration, galil
from rigs.victims import victim
from rigs.waiting import eventually

SPEED = 1.0
"""rad/s."""
ON_ITS_WAY = 0.06
"""Seconds of a stream that may be kept: 0.03 until the driver knows, and what a busy machine adds."""
SAMPLES = 400
"""Of the controller, a millisecond each: for what goes on, and what was kept, to be over."""


def position(sim: RunningSim) -> float:
    """Return where the first joint is, in rad."""
    return float(sim.control.status()["position"][0]) / TURN * math.tau


def pass_time(sim: RunningSim) -> None:
    """Wait until the controller has gone on for a while."""
    end = sim.control.status()["sample"] + SAMPLES
    eventually(lambda: sim.control.status()["sample"] > end, "its time passes")


@pytest.mark.parametrize("mode", [Mode.DEAF, Mode.SILENT])
def test_a_killed_driver_leaves_no_setpoints_in_the_network(mode: Mode) -> None:
    with galil() as sim:
        config = configuration(sim)
        link = PLUGIN.link.of(config, sim)
        with RelayProcess(link) as relay:
            through = PLUGIN.link.at(config, relay.link)
            with victim("galil", through, Plan(velocity=SPEED, far=1.0), "servo_jp"):
                eventually(lambda: abs(position(sim)) > 0.1, "it moves")
                relay.mode = mode
                pass_time(sim)
                eventually(lambda: stands(sim), "it stands: nothing comes any more")
            before = position(sim)
            relay.mode = Mode.OPEN
            pass_time(sim)
            eventually(lambda: stands(sim), "it stands again")
            assert abs(position(sim) - before) < ON_ITS_WAY * SPEED

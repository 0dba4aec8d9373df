"""Simulated drives of makes with units of their own: figures of their manuals, by the motor's truth."""

from __future__ import annotations

import math

import pytest

from crtk_sim_backends.canopen.personality import PERSONALITIES
from rigs.canopen_drive import COUNTS, PV, Bench

ONE = {  # 60FF for 1 turn/s, 606C at that, and 6083 for 1 turn/s²
    "technosoft": (COUNTS * 65536 / 1000, COUNTS * 65536 / 1000, COUNTS * 65536 / 1e6),
    "kinco": (60 * 512 * COUNTS / 1875, 60 * 512 * COUNTS / 1875, COUNTS * 65536 / 4e6),
    "roboteq": (60, 60, 600),
    "ax2000": (COUNTS, COUNTS, None),
    "zlac8015d": (60, 600, None),
}


@pytest.mark.parametrize("make", ONE)
def test_velocities_and_ramps_are_those_of_its_manual(make: str) -> None:
    bench = Bench(personality=PERSONALITIES[make], modes=frozenset({1, 3}))
    speed, shown, ramp = ONE[make]
    bench.write(0x6081, 0, round(speed))
    bench.write(0x6083, 0, 1000 if ramp is None else round(ramp))  # times: ms to 6081
    bench.enable(PV)
    bench.write(0x60FF, 0, round(speed), "i")
    bench.run(0.5)
    motor = bench.axis.motor
    assert motor.velocity / math.tau == pytest.approx(0.5, abs=0.03)  # half of the ramp
    bench.run(1.5)
    assert motor.velocity / math.tau == pytest.approx(1.0, rel=0.01)
    assert bench.velocity() == pytest.approx(shown, rel=0.02)

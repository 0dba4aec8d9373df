"""Hardware slower than its joints' limits: where the joint really is when `move_jp` says that it is done."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
import pytest

from crtk_sim_backends.canopen import SIM as DRIVES
from crtk_sim_backends.canopen.objects import COUNTS
from rigs import copley_bench
from rigs.canopen_arm import arm_of, patient_arm_on
from rigs.ur_bench import ur_bench
from rigs.waiting import LONG, eventually

WAY = 0.4
"""rad that the last joint moves."""
COUNTS_PER_RADIAN = COUNTS * 100.0 / math.tau
"""Of a simulated drive, behind the gear of `rigs.canopen_arm`."""


class Slow(NamedTuple):
    """An enabled arm whose hardware is slower than the driver plans.

    Attributes:
        arm: it.
        truth: where its last joint really is, by its simulator, in rad from anywhere.
        off: rad from its goal within which a joint that has come to rest is.
    """

    arm: Any
    truth: Callable[[], float]
    off: float


@contextmanager
def ur(planned_by: str) -> Iterator[Slow]:
    """A UR whose speed slider is at 30 %."""
    with ur_bench({"control": "native", "move": {"planned_by": planned_by}}) as bench:
        bench.reset()
        bench.sim.control.inject("speed_slider", fraction=0.3)
        eventually(lambda: bench.device.pace == pytest.approx(0.3), "the slider is seen")
        yield Slow(bench.arm, lambda: bench.q()[-1], 1e-3)


@contextmanager
def canopen(modes: list[str], **objects: int) -> Iterator[Slow]:
    """A drive with objects of its own, of which it says nothing."""
    joint = {"modes": modes, "parameters": objects, "drive_limits": "keep"}
    with DRIVES.spawn(nodes=1) as sim, arm_of(patient_arm_on(sim, 1, joint)) as arm:
        arm.enable(timeout=LONG)

        def truth() -> float:
            counts = sim.control.call("object", node=1, index=0x6064, sub=0)
            return float(counts) / COUNTS_PER_RADIAN

        yield Slow(arm, truth, 2e-3)


@contextmanager
def copley() -> Iterator[Slow]:
    """Motors that turn slower than the joints' velocity."""
    with copley_bench.drives(motor_speed=6000) as sim, copley_bench.arm_at(sim) as arm:
        arm.enable(timeout=LONG)
        arm.home(timeout=LONG)

        def truth() -> float:
            return float(sim.control.status()["position"][-1]) / copley_bench.PER_RADIAN

        yield Slow(arm, truth, 2e-3)


HARDWARE: dict[str, Callable[[], Any]] = {
    "ur, its slider at 30 %": lambda: ur("driver"),
    "ur, its slider at 30 %, its own moves": lambda: ur("controller"),
    # 607Fh: three times slower; 6067h: "target reached" wherever it is.
    "canopen pp, reached at once": lambda: canopen(["pp"], **{"607F": 400_000, "6067": 2**32 - 2}),
    "canopen csp": lambda: canopen(["csp", "csv"]),
    "copley, slow motors": copley,
}


@pytest.mark.sweep(5)
@pytest.mark.parametrize("name", HARDWARE)
def test_a_move_is_done_where_the_joint_is(name: str) -> None:
    with HARDWARE[name]() as slow:
        goal = np.array(slow.arm.measured_js(age=0).position)
        goal[-1] += WAY
        begin = slow.truth()
        assert slow.arm.move_jp(goal).wait(LONG)
        assert abs(slow.truth() - begin) == pytest.approx(WAY, abs=slow.off)
        assert not slow.arm.is_busy()

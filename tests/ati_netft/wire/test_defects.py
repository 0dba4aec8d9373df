"""Defects of a simulated transducer are what the driver measures."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from crtk_sim_backends.netft.config import SimConfig
from crtk_sim_backends.options import ConfigError
from rigs.netft_bench import NetFtBench, netft_bench

LOAD = "constant:1,-2,3,0.1,-0.2,0.3"
RATE = 500
RAW = {"sensor": {"rdt_rate": RATE, "filter_code": 0}}


STEADY = 0.2
"""Seconds, in place of one, for what is the same in every measurement."""


def forces(bench: NetFtBench, seconds: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Return times (n,) in s and wrenches (n, 6) of every measurement of so long."""
    block = bench.record(seconds)
    return (block["stamp"] - block["stamp"][0]) * 1e-9, block["wrench"]


def spread(bench: NetFtBench) -> float:
    return float(forces(bench)[1][:, 2].std())


def line(bench: NetFtBench) -> float:
    t, wrench = forces(bench)
    found = np.mean((wrench[:, 2] - wrench[:, 2].mean()) * np.exp(-2j * np.pi * 50.0 * t))
    return 2.0 * float(abs(found))


def slope(bench: NetFtBench) -> float:
    t, wrench = forces(bench)
    return float(np.polyfit(t, wrench[:, 2], 1)[0])


def along_x(bench: NetFtBench) -> float:
    return float(forces(bench, STEADY)[1][:, 0].mean())


def left_by_bias(bench: NetFtBench) -> float:
    bench.front.sensor_bias()
    return float(forces(bench, STEADY)[1][:, 2].mean())


@dataclass(frozen=True)
class Case:
    """A figure that a defect changes, in N: what it is without, and with it."""

    measure: Callable[[NetFtBench], float]
    defects: str
    without: float
    with_it: float
    within: float


CASES = {
    "noise": Case(spread, "noise=0.5", 0.0, 0.5, 0.1),
    "line": Case(line, "line=0.5", 0.0, 0.5, 0.1),
    "drift": Case(slope, "drift=0.5", 0.0, 0.5, 0.05),
    "scale": Case(along_x, "scale=1.2", 1.0, 1.2, 0.01),
    "exchanged": Case(along_x, "exchanged=0+2", 1.0, 3.0, 0.01),
    "bias_left": Case(left_by_bias, "bias_left=0.1", 0.0, 0.3, 0.01),
}


@pytest.mark.sweep(3)
@pytest.mark.parametrize("name", CASES)
def test_a_defect_is_measured_and_is_not_without_it(name: str) -> None:
    case = CASES[name]
    for defects, wanted in (("", case.without), (case.defects, case.with_it)):
        with netft_bench(RAW, load=LOAD, defects=defects) as bench:
            assert case.measure(bench) == pytest.approx(wanted, abs=case.within)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("exchanged=1", "exchanged takes two axes"),
        ("exchanged=1+6", "exchanged takes two axes"),
        ("noise=1;drift=1", "one group"),
        ("backlash=1", "defects: .*backlash"),
    ],
)
def test_what_is_no_defect_is_refused(text: str, why: str) -> None:
    with pytest.raises(ConfigError, match=why):
        SimConfig(defects=text)

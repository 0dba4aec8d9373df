"""What simulated joints with defects tell of themselves, and how the option is read."""

import dataclasses
import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from statistics import mean, pstdev

import pytest

from crtk_sim_backends.canopen.config import SimConfig as CanopenSim
from crtk_sim_backends.defects import JointDefects, Sense, defects_of, read_defects
from crtk_sim_backends.dynamixel.config import SimConfig as DynamixelSim
from crtk_sim_backends.options import ConfigError
from crtk_sim_backends.ur.config import SimConfig as UrSim

PERIOD = 0.002
COMPANIONS = {"joints", "seed", "line_frequency", "jump_at"}

Told = Sequence[tuple[float, float, float]]


def run(text: str, q: Callable[[float], float], seconds: float = 1.0) -> Told:
    """What is told of a joint that goes along `q(t)`, with an effort of 2."""
    groups = read_defects(JointDefects, text)
    sense = Sense(groups[0] if groups else JointDefects(), 1)
    told = []
    for n in range(round(seconds / PERIOD)):
        t = n * PERIOD
        v = (q(t + 1e-6) - q(t - 1e-6)) / 2e-6
        told.append(sense.tell(q(t), v, 2.0, t))
    return told


def noise(text: str) -> float:
    return pstdev(position for position, _, _ in run(text, lambda t: 0.5))


def line(text: str) -> float:
    return max(position for position, _, _ in run(text, lambda t: 0.5)) - 0.5


def drift(text: str) -> float:
    told = run(text, lambda t: 0.5)
    return (told[-1][0] - told[0][0]) / (PERIOD * (len(told) - 1))


def largest_step(text: str) -> float:
    told = run(text, lambda t: 0.5 * t)
    return max(b[0] - a[0] for a, b in pairwise(told))


def both_sides(text: str) -> float:
    told = run(text, lambda t: 0.2 - abs(t - 0.5) * 0.4)
    return told[375][0] - told[125][0]


def late(text: str) -> float:
    """Seconds by which the zero of the velocity comes after the end of the way up."""
    told = run(text, lambda t: -((t - 0.5) ** 2))
    return PERIOD * sum(velocity > 1e-6 for _, velocity, _ in told) - 0.5


def velocity(text: str) -> float:
    return mean(velocity for _, velocity, _ in run(text, lambda t: 0.5 * t)) / 0.5


def effort(text: str) -> float:
    return mean(effort for _, _, effort in run(text, lambda t: 0.0)) / 2.0


def repeated(text: str) -> float:
    told = run(text, lambda t: 0.5 * t, 4.0)
    return mean(a == b for a, b in pairwise(told))


CASES = {
    "position_noise": (noise, "position_noise=1e-3", 0.0, 1e-3, 1e-4),
    "position_line": (line, "position_line=1e-3", 0.0, 1e-3, 1e-4),
    "position_drift": (drift, "position_drift=0.1", 0.0, 0.1, 1e-9),
    "position_jump": (largest_step, "position_jump=0.5,jump_at=0.25", 1e-3, 0.501, 1e-6),
    "backlash": (both_sides, "backlash=0.02", 0.0, 0.02, 1e-3),
    "velocity_lag": (late, "velocity_lag=0.05", 0.0, 0.05, 2 * PERIOD),
    "velocity_scale": (velocity, "velocity_scale=1.1", 1.0, 1.1, 1e-6),
    "effort_sign": (effort, "effort_sign=-1", 1.0, -1.0, 1e-9),
    "effort_scale": (effort, "effort_scale=1.5", 1.0, 1.5, 1e-9),
    "frozen_share": (repeated, "frozen_share=0.1", 0.0, 0.1, 0.03),
}


def test_the_table_has_every_defect() -> None:
    assert set(CASES) == {field.name for field in dataclasses.fields(JointDefects)} - COMPANIONS


@pytest.mark.parametrize("name", CASES)
def test_a_defect_is_told_and_is_not_without_it(name: str) -> None:
    figure, text, without, with_it, within = CASES[name]
    assert figure("") == pytest.approx(without, abs=within)
    assert figure(text) == pytest.approx(with_it, abs=within)
    assert abs(with_it - without) > 2.0 * within


def test_a_line_has_its_frequency() -> None:
    told = [q for q, _, _ in run("position_line=1e-3,line_frequency=10", lambda t: 0.0)]
    crossings = sum(a < 0.0 <= b for a, b in pairwise(told))
    assert crossings in (9, 10)


def test_joints_have_those_of_the_first_group_that_they_are_in() -> None:
    groups = read_defects(JointDefects, "joints=2+3, backlash=0.1; position_noise=0.2")
    assert defects_of(groups, 3) == JointDefects(joints=(2, 3), backlash=0.1)
    assert defects_of(groups, 1) == JointDefects(position_noise=0.2)
    assert defects_of(groups[:1], 1) is None
    assert read_defects(JointDefects, " ") == ()


@pytest.mark.parametrize("options", [CanopenSim, DynamixelSim, UrSim])
@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("backlas=1", r"defects: .*backlas.*backlash"),
        ("backlash=much", "defects: backlash takes a number, not 'much'"),
        ("backlash=nan", "defects: backlash takes a number"),
        ("joints=1+x", r"defects: joints takes .*'1\+x'"),
    ],
)
def test_what_is_no_defect_is_refused(options: type, text: str, why: str) -> None:
    with pytest.raises(ConfigError, match=why):
        options(defects=text)


def test_random_numbers_differ_from_joint_to_joint_and_repeat() -> None:
    defects = JointDefects(position_noise=1.0)
    one, same, other = (Sense(defects, joint).tell(0.0, 0.0, 0.0, 0.0)[0] for joint in (1, 1, 2))
    assert one == same
    assert not math.isclose(one, other)

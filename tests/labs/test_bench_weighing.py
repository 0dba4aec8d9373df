"""What is found of wrenches in several orientations, on made-up recordings: pure functions."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from crtk_drivers.geometry.quaternions import (
    quaternion_from_rotvec,
    quaternion_from_rpy,
    quaternion_product,
)
from crtk_drivers.labs.bench.acquisition import Subject
from crtk_drivers.labs.bench.catalogue import TESTS
from crtk_drivers.labs.bench.trace import Row, Trace
from crtk_drivers.labs.carried import Carried
from crtk_drivers.labs.verdicts.judging import Findings, Verdict
from crtk_drivers.samples import Pose, Text, Vector, Wrench, vector

BY_ID = {test.id: test for test in TESTS}
MOUNTED = (0.0, 0.0, float(np.sin(0.5)), float(np.cos(0.5)))
KNOWN = Carried(0.8, (0.0, 0.02, 0.06), MOUNTED)
BIAS = np.array([3.0, -2.0, 15.0, 0.2, -0.1, 0.05])
SUBJECT = Subject((), (), 500.0, 0.0, 1.0, 0.1, 0.5, 0.05, 0.0, carried=KNOWN)
MS = 1_000_000
BEGIN = 10**18


def orientations(count: int, far: float) -> list[Vector]:
    random = np.random.default_rng(3)
    return [quaternion_from_rotvec(vector(random.uniform(-far, far, 3))) for _ in range(count)]


def weighed(really: Carried, arms: list[Vector], noise: float = 0.02) -> Trace:
    """Return the recording of a sensor on which something really hangs, half a second in each orientation."""
    random = np.random.default_rng(4)
    rows: list[Row] = []
    at = BEGIN
    for arm in arms:
        for kind in ("weigh", "weighed"):
            said = json.dumps({"kind": "mark", "text": kind})
            rows.append(("events", at + (500 * MS if kind == "weighed" else 0), 0, Text(said)))
        pull = really.weight(arm).vector + BIAS
        scale = np.repeat((noise, 0.1 * noise), 3)
        for step in range(250):
            made = at + 2 * step * MS + 1
            value = pull + scale * random.normal(0.0, 1.0, 6)
            rows.append(("measured_cf", made, made, Wrench(vector(value[:3]), vector(value[3:]))))
            rows.append(("carrier/measured_cp", made, made, Pose(vector(np.zeros(3)), arm)))
        at += 1000 * MS
    return Trace.of(sorted(rows, key=lambda row: row[1]))


def found(trace: Trace, subject: Subject = SUBJECT) -> dict[str, Findings]:
    return {name: BY_ID[name].analyse(trace, subject) for name in ("F4", "F5")}


def values(findings: dict[str, Findings]) -> dict[str, float]:
    measured = [one for each in findings.values() for one in each.measurements]
    return {one.quantity.id: one.estimate.value for one in measured if one.estimate is not None}


def verdicts(findings: dict[str, Findings]) -> tuple[Verdict, Verdict]:
    return findings["F4"].verdict, findings["F5"].verdict


def test_what_hangs_there_is_found_whatever_the_bias_is() -> None:
    findings = found(weighed(KNOWN, orientations(8, 1.5)))
    assert verdicts(findings) == (Verdict.PASS, Verdict.PASS), findings
    figures = values(findings)
    assert figures["force.weight.mass"] == pytest.approx(0.8, abs=2e-3)
    assert figures["force.weight.center"] < 1.0
    assert figures["force.frame.angle"] < 0.1


def test_without_a_known_tool_its_mass_is_told_and_not_judged() -> None:
    unknown = replace(SUBJECT, carried=Carried(orientation=MOUNTED))
    findings = found(weighed(KNOWN, orientations(8, 1.5)), unknown)
    assert verdicts(findings) == (Verdict.PASS, Verdict.PASS), findings
    (mass, residual) = findings["F4"].measurements
    assert mass.estimate is not None
    assert mass.bound is None
    assert mass.estimate.value == pytest.approx(0.8, abs=2e-3)
    assert residual.quantity.id == "force.weight.residual"


@pytest.mark.parametrize("degrees", [1.0, 5.0, 90.0])
def test_another_mounting_than_the_lab_file_says_is_seen_by_its_angle(degrees: float) -> None:
    off = quaternion_from_rpy(np.radians(degrees), 0.0, 0.0).tolist()
    turned = quaternion_product(vector(MOUNTED), vector(off)).tolist()
    really = replace(KNOWN, orientation=tuple(turned))
    findings = found(weighed(really, orientations(12, 3.0)))
    figure = values(findings)["force.frame.angle"]
    # A direction along the axis of the turn is not turned.
    assert 0.3 * degrees < figure <= 1.05 * degrees
    assert (findings["F5"].verdict is Verdict.FAIL) is (degrees > 2.0)


def test_a_tool_that_is_not_there_fails() -> None:
    findings = found(weighed(Carried(), orientations(8, 1.5)))
    assert findings["F4"].verdict is Verdict.FAIL
    assert findings["F5"].verdict is Verdict.INCONCLUSIVE
    assert "too little to tell where down is" in findings["F5"].reason


@pytest.mark.parametrize(
    ("arms", "told"),
    [
        (orientations(5, 1.5), "5 orientations, 6 are needed"),
        (orientations(8, 0.1), "too much alike"),
    ],
)
def test_a_space_that_is_too_narrow_decides_nothing(arms: list[Vector], told: str) -> None:
    findings = found(weighed(KNOWN, arms))
    assert verdicts(findings) == (Verdict.INCONCLUSIVE, Verdict.INCONCLUSIVE)
    assert told in findings["F4"].reason


def test_a_recording_without_poses_decides_nothing() -> None:
    with pytest.raises(LookupError, match="wrenches and poses"):
        BY_ID["F4"].analyse(Trace.of([]), SUBJECT)

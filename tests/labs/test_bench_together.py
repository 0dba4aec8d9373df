"""Two devices at once: one motion that both see, and one that goes on when the other breaks."""

from __future__ import annotations

import json
from collections.abc import Callable

import pytest

from crtk_drivers.labs.bench.acquisition import Subject
from crtk_drivers.labs.bench.catalogue import TESTS
from crtk_drivers.labs.bench.trace import Row, Trace
from crtk_drivers.labs.carried import Carried
from crtk_drivers.labs.verdicts.judging import Verdict
from crtk_drivers.samples import JointState, Text, vector
from crtk_sim_backends.netft.defects import TransducerDefects
from rigs import stepped_bed
from rigs.bench_lab import ARM_200
from rigs.proof_table import tell_proof

BY_ID = {test.id: test for test in TESTS}


X1 = BY_ID["X1"]
TOOL = Carried(0.8, (0.0, 0.02, 0.06))


@pytest.mark.parametrize(
    ("behind", "verdict"), [(0, Verdict.PASS), (22, Verdict.FAIL)], ids=["in step", "0.11 s"]
)
def test_forces_that_lag_fail(
    behind: int, verdict: Verdict, record_property: Callable[[str, object], None]
) -> None:
    """As by a filter whose delay no stamp tells."""
    found = X1.analyse(*stepped_bed.acquired_carried(X1.acquisition, TOOL, ARM_200, behind=behind))
    named = "forces behind the pose" if behind else ""
    tell_proof(record_property, named, found.measurements, ("together.motion.lag",))
    ((quantity, judged),) = [(one.quantity.id, one.verdict) for one in found.measurements]
    assert (quantity, judged) == ("together.motion.lag", verdict)


def test_nothing_is_said_of_a_sensor_on_which_nothing_hangs() -> None:
    noisy = TransducerDefects(noise=0.05)
    found = X1.analyse(*stepped_bed.acquired_carried(X1.acquisition, Carried(), ARM_200, noisy))
    assert found.verdict is Verdict.INCONCLUSIVE
    assert "does anything hang on it?" in found.reason


SUBJECT = Subject((), (), 500.0, 0.0, 1.0, 0.1, 0.5, 0.05, 0.0)
MS = 1_000_000
BEGIN = 10**18


def event(kind: str, text: str, at: int, topic: str = "events") -> Row:
    return topic, BEGIN + at * MS, 0, Text(json.dumps({"kind": kind, "text": text}))


@pytest.mark.parametrize(
    ("lost", "state", "failing"),
    [
        (0, "", set()),
        (400, "", {"together.neighbours.late"}),
        (0, "FAULT", {"together.neighbours.states"}),
    ],
    ids=["sound", "late", "fault"],
)
def test_a_neighbour_that_is_disturbed_fails(lost: int, state: str, failing: set[str]) -> None:
    """Made up: no defect of one simulator reaches another device."""
    joints = JointState(position=vector([0.0]))
    rows: list[Row] = [event("mark", "break", 2000), event("mark", "mended", 5000)]
    if state:
        rows.append(event("state", state, 3000, "carrier/events"))
    for index in range(2500):
        every_other_is_lost = 2000 < 2 * index < 2000 + 2 * lost and index % 4
        if not every_other_is_lost:
            at = BEGIN + 2 * index * MS
            rows.append(("carrier/measured_js", at, at, joints))
    findings = BY_ID["X2"].analyse(Trace.of(sorted(rows, key=lambda row: row[1])), SUBJECT)
    beyond = {one.quantity.id for one in findings.measurements if one.verdict is Verdict.FAIL}
    assert beyond == failing, findings
    assert (findings.verdict is Verdict.FAIL) is bool(failing)

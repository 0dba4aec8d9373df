"""Two devices at once: one motion that both see, and one that goes on when the other breaks."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from crtk_drivers.labs.bench.catalogue import TESTS
from crtk_drivers.labs.bench.declared import Subject
from crtk_drivers.labs.bench.trace import Row, Trace
from crtk_drivers.labs.verdicts.judging import Verdict
from crtk_drivers.samples import JointState, Text, vector
from rigs.bench_lab import ARM, FT, carried_out, measured, of_sensor

BY_ID = {test.id: test for test in TESTS}


@pytest.mark.slow
@pytest.mark.timeout(120)
def test_two_devices_in_step_and_neighbours_fail_nowhere(tmp_path: Path) -> None:
    run = carried_out(tmp_path, ARM + FT, "X1", "X2", "F3")
    verdicts = of_sensor(run)
    assert Verdict.FAIL not in {verdict for verdict, _ in verdicts.values()}, verdicts
    assert "together.motion.lag" in measured(run)
    assert "force.saturation.told" in measured(run), "it is left as it was"
    assert measured(run)["together.neighbours.states"] is Verdict.PASS


@pytest.mark.slow
@pytest.mark.timeout(120)
def test_forces_that_lag_fail(tmp_path: Path) -> None:
    """By a filter of the driver whose delay no stamp tells: 0.11 s."""
    run = carried_out(tmp_path, f"{ARM}{FT}settings = {{ low_pass = 2.0 }}\n", "X1")
    assert measured(run)["together.motion.lag"] is Verdict.FAIL, of_sensor(run)


@pytest.mark.slow
@pytest.mark.timeout(120)
def test_nothing_is_said_of_a_sensor_on_which_nothing_hangs(tmp_path: Path) -> None:
    bare = "\n".join(line for line in FT.splitlines() if not line.startswith("tool"))
    run = carried_out(tmp_path, f'{ARM}{bare}\nsim_options = {{ defects = "noise=0.05" }}\n', "X1")
    verdict, reason = of_sensor(run)["X1"]
    assert verdict is Verdict.INCONCLUSIVE
    assert "does anything hang on it?" in reason


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

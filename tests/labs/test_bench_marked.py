"""The bench over an arm whose marker a tracker sees: its figures, and the proof that each can fail."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from operator import itemgetter
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest

from crtk_drivers.config import BoxConfig
from crtk_drivers.geometry.frames import product, relative
from crtk_drivers.labs import load_lab
from crtk_drivers.labs.bench import marked
from crtk_drivers.labs.bench.acquisition import Subject, Suite
from crtk_drivers.labs.bench.allowed import BenchOptions, Carrier, lacking
from crtk_drivers.labs.bench.calls import TOOLS
from crtk_drivers.labs.bench.catalogue import TESTS
from crtk_drivers.labs.bench.run import judged_again
from crtk_drivers.labs.bench.trace import Row, Trace
from crtk_drivers.labs.lab_file import BoundEntry
from crtk_drivers.labs.verdicts.judging import Findings, Verdict
from crtk_drivers.samples import Pose, Text
from crtk_sim_backends.ndi.defects import TrackerDefects
from rigs import stepped_bed
from rigs.bench_lab import ARM as ARM_FILE
from rigs.bench_lab import carried_out, measured
from rigs.carried_marker import MOUNTING, STANDS
from rigs.measured_poses import arm_and_marker, pose
from rigs.proof_table import tell_proof

BY_ID = {test.id: test for test in TESTS}
ARM = {"rate": 100.0}

Tell = Callable[[str, object], None]


def bound(value: float) -> BoundEntry:
    return BoundEntry(value=value, because="the datasheet")


DATASHEET = {
    "tracking.pose.accuracy": bound(1.0),
    "tracking.pose.repeatability": bound(0.3),
    "tracking.pose.turn_accuracy": bound(0.2),
    "tracking.pose.turn_repeatability": bound(0.1),
}


K4, M9 = ({quantity.id for quantity in BY_ID[test].quantities} for test in ("K4", "M9"))


@pytest.mark.sweep(1)
@pytest.mark.timeout(180)
@pytest.mark.parametrize(
    ("carried_out", "tracker", "arm", "passing", "failing"),
    [
        pytest.param("M9", {}, {}, K4 | M9, set(), marks=pytest.mark.slow),
        ("K4", {}, {}, K4, set()),
        ("K4", {"play": 3.0}, {}, set(), K4),
        pytest.param(
            "M9",
            {},
            {"calibration": 0.02, "repeatability": 2e-3},
            K4,
            M9,
            marks=pytest.mark.slow,
        ),
    ],
    ids=["sound, all of it", "sound", "loose marker", "arm"],
)
def test_what_is_wrong_fails_by_its_figure(
    carried_out: str,
    tracker: dict[str, float],
    arm: dict[str, float],
    passing: set[str],
    failing: set[str],
    record_property: Tell,
) -> None:
    """What K4 asks for is the begin of what M9 does: one acquisition tells of both."""
    values = ARM | ({"defects": arm} if arm else {})
    with patch.multiple(marked, PLACES=11, SETTLE=0.1, STOOD=0.15):
        trace, subject = stepped_bed.acquired_marked(
            BY_ID[carried_out].acquisition, values, TrackerDefects(**tracker), DATASHEET
        )
    tests = dict.fromkeys(("K4", carried_out))
    found = [one for test in tests for one in BY_ID[test].analyse(trace, subject).measurements]
    told = ",".join(f"{name}={value:g}" for name, value in {**tracker, **arm}.items())
    tell_proof(record_property, told, found, failing)
    assert {one.quantity.id: one.verdict for one in found} == {
        **dict.fromkeys(passing, Verdict.PASS),
        **dict.fromkeys(failing, Verdict.FAIL),
    }, found


def test_a_space_that_is_too_narrow_decides_nothing_and_breaks_nothing() -> None:
    box = {"lower": [0.52, -0.005, 0.367], "upper": [0.53, 0.005, 0.377]}  # where it is
    trace, subject = stepped_bed.acquired_marked(
        BY_ID["M9"].acquisition, ARM, TrackerDefects(), box=BoxConfig.model_validate(box)
    )
    for test in ("K4", "M9"):
        found = BY_ID[test].analyse(trace, subject)
        assert found.verdict is Verdict.INCONCLUSIVE
        assert found.reason == "marker was seen in 0 of 0 places, 10 are needed"


# ---------------------------------------------------------------------------------- on made-up recordings

BEGIN, MS = 10**18, 1_000_000
SUBJECT = Subject((), (), 60.0, 0.0, 1.0, 0.1, 0.5, 0.05, 0.0, markers=("marker",))


def recorded(arms: list[Pose], seen: list[Pose | None], name: str = "place") -> Trace:
    """Return the recording of an arm and a marker that stood in places, a second in each."""
    rows: list[Row] = []
    for number, (arm, marker) in enumerate(zip(arms, seen, strict=True)):
        at = BEGIN + 1000 * MS * number
        for text, when in ((name, at), (f"{name} end", at + 900 * MS)):
            rows.append(("events", when, 0, Text(json.dumps({"kind": "mark", "text": text}))))
        for step in range(1, 20):
            now = at + 20 * MS * step
            rows.append(("carrier/measured_cp", now, now, arm))
            rows.append(("marker/measured_cp", now, 0 if marker is None else now, marker or arm))
    return Trace.of(sorted(rows, key=itemgetter(1)))


def made_up(count: int = 14, seed: int = 1) -> tuple[list[Pose], list[Pose | None]]:
    arms, seen = arm_and_marker(MOUNTING, STANDS, count, np.random.default_rng(seed), 1e-5, 1e-5)
    return arms, [*seen]


def judged(arms: list[Pose], seen: list[Pose | None]) -> Findings:
    return BY_ID["K4"].analyse(recorded(arms, seen), SUBJECT)


def test_places_in_which_the_marker_is_not_seen_are_left_out_and_too_few_decide_nothing() -> None:
    arms, seen = made_up()
    assert judged(arms, [*seen[:10], None, None, None, None]).verdict is Verdict.PASS
    found = judged(arms, [*seen[:9], None, None, None, None, None])
    assert found.verdict is Verdict.INCONCLUSIVE
    assert found.reason == "marker was seen in 9 of 14 places, 10 are needed"


def test_a_marker_that_is_not_on_this_arm_fails() -> None:
    arms, _ = made_up()
    found = judged(arms, made_up(seed=2)[1])
    assert found.verdict is Verdict.FAIL
    assert {one.quantity.id for one in found.measurements} == K4


def test_an_arm_that_turns_about_one_axis_decides_nothing() -> None:
    arms = [pose((0.0, 0.0, 0.0), (0.0, 0.0, 0.1 * number)) for number in range(14)]
    seen: list[Pose | None] = [relative(STANDS, product(arm, MOUNTING)) for arm in arms]
    found = judged(arms, seen)
    assert found.verdict is Verdict.INCONCLUSIVE
    assert "about one axis only" in found.reason


def test_what_an_analysis_knows_of_markers_is_kept() -> None:
    assert Subject.from_json(SUBJECT.as_json(), {}).markers == ("marker",)


@pytest.mark.parametrize(
    ("arm", "polaris", "told"),
    [
        ("sim = true", 'markers.pointer.on = "arm"\nstands = {}', ""),
        ("sim = true", 'markers.pointer.on = "arm"', "does not see the marker on the arm"),
        ("sim = true", "", "needs a device that carries one of its tools (`markers`)"),
        (
            'settings = { host = "192.168.1.9" }',
            'markers.pointer.on = "arm"\nstands = {}',
            "does not see the marker on the arm",
        ),
    ],
)
def test_no_arm_is_moved_whose_marker_nobody_sees(
    arm: str, polaris: str, told: str, tmp_path: Path
) -> None:
    path = tmp_path / "lab.toml"
    path.write_text(
        f'[devices.arm]\nplugin = "ur"\n{arm}\n'
        f'[devices.polaris]\nplugin = "ndi"\nsim = true\n{polaris}\n'
    )
    lab = load_lab(path)
    about = replace(
        stepped_bed.about("virtual", {}), commands=("move_jp", "measured_js", "measured_cp", TOOLS)
    )
    carrier = Carrier(lab.devices["arm"], about, "")
    options = BenchOptions(Suite.FULL, (), may_move=True, out=tmp_path, may_travel=("arm",))
    why = lacking(BY_ID["K4"], about, lab.devices["polaris"], options, carrier=carrier)
    assert told in why if told else why == ""


@pytest.mark.slow
@pytest.mark.timeout(180)
def test_a_simulated_tracker_sees_the_marker_of_an_arm_in_a_real_run(tmp_path: Path) -> None:
    lab = f"""{ARM_FILE}
[devices.polaris]
plugin = "ndi"
sim = true
settings.tools = [{{ name = "marker", part_number = "SIM-MARKER" }}]
stands = {{ position = {STANDS.position.tolist()}, orientation = {STANDS.orientation.tolist()} }}
markers.marker = {{ on = "arm", mounting = {{ position = [0.02, -0.05, 0.11] }} }}
"""
    run = carried_out(tmp_path, lab, "K4")
    (found,) = [test for device, test in run.tests if device.name == "polaris"]
    assert found.verdict is Verdict.PASS, found
    assert measured(judged_again(tmp_path / "run", None)) == measured(run)

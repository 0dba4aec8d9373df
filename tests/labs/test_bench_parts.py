"""The bench over simulated grippers and trackers: its figures, and the proof that each can fail."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from crtk_drivers.device import JointLimits
from crtk_drivers.labs import load_lab
from crtk_drivers.labs.bench.acquisition import Subject, Suite
from crtk_drivers.labs.bench.allowed import BenchOptions, lacking
from crtk_drivers.labs.bench.calls import About
from crtk_drivers.labs.bench.catalogue import TESTS
from crtk_drivers.labs.bench.results import Measured, Run
from crtk_drivers.labs.bench.run import run_bench
from crtk_drivers.labs.bench.trace import Event, Row, Trace
from crtk_drivers.labs.verdicts.judging import Verdict
from crtk_drivers.samples import JointState, Pose, Wrench, vector
from crtk_drivers.status.stop_request import StopRequest
from rigs import stepped_bed
from rigs.proof_table import tell_stored

BY_ID = {test.id: test for test in TESTS}
GRIPPER = ("G1", "G3")
TRACKER = ("K1", "K2", "K3")

Tell = Callable[[str, object], None]


def carried_out(folder: Path, plugin: str, ids: tuple[str, ...], **defects: str) -> Run:
    """Test one sound device and one for each text of defects, all at once."""
    lines = ["features = { block = 0.03, bar = 0.04 }"]
    options = {"robotiq": [], "ndi": ['motion = "still"']}[plugin]
    for name, text in {"sound": "", **defects}.items():
        given = ", ".join([*options, f'defects = "{text}"'])
        lines += [f"[devices.{name}]", f'plugin = "{plugin}"', "sim = true"]
        lines += [f"sim_options = {{ {given} }}"]
    path = folder / "lab.toml"
    path.write_text("\n".join(lines))
    asked = BenchOptions(Suite.QUICK, ids, may_move=False, out=folder / "run", at_once=4)
    return run_bench(load_lab(path), asked, lambda *_: None, StopRequest())


def judged(run: Run, name: str) -> dict[str, set[str]]:
    """Return the figures of a device by verdict."""
    found: dict[str, set[str]] = {}
    for device, test in run.tests:
        for one in test.measurements if device.name == name else ():
            found.setdefault(str(one.verdict), set()).add(one.id)
    return found


def figures(run: Run, name: str) -> list[Measured]:
    return [one for device, test in run.tests if device.name == name for one in test.measurements]


@pytest.mark.slow
@pytest.mark.timeout(180)
def test_a_gripper_that_is_wrong_is_found(tmp_path: Path, record_property: Tell) -> None:
    wrong = {
        "short": "short=0.002,imagines=1",
        "blind": "blind=1",
        "weak": "gives_way=0.004",
    }
    run = carried_out(tmp_path, "robotiq", GRIPPER, **wrong)
    failing = {
        "short": {"grip.stroke.error", "grip.stroke.claimed"},
        "blind": {"grip.block.known"},
        "weak": {"grip.block.kept"},
    }
    for name, defects in {"sound": "", **wrong}.items():
        tell_stored(record_property, defects, figures(run, name), failing.get(name, ()))
    told = {quantity.id for name in GRIPPER for quantity in BY_ID[name].quantities}
    assert {one.id for one in figures(run, "sound")} == told
    assert judged(run, "sound").get("FAIL", set()) == set(), run.tests
    for name, ids in failing.items():
        assert judged(run, name).get("FAIL", set()) == ids, (name, run.tests)


CELL = """
features = {{ block = 0.03, grip = {grip} }}
[devices.gripper]
plugin = "robotiq"
sim = true
settings = {{ force = 0.2 }}
sim_options = {{ defects = "{defects}" }}
[devices.cell]
plugin = "ati-netft"
sim = true
on = "gripper"
settings = {{ rate = 200 }}
"""


@pytest.mark.slow
@pytest.mark.timeout(180)
def test_a_gripper_that_presses_too_little_is_found(tmp_path: Path, record_property: Tell) -> None:
    grip = 20.0 + round(0.2 * 255) / 255 * (235.0 - 20.0)
    for name, defects in (("sound", ""), ("weak", "force_scale=0.5")):
        folder = tmp_path / name
        folder.mkdir()
        path = folder / "lab.toml"
        path.write_text(CELL.format(grip=grip, defects=defects))
        asked = BenchOptions(Suite.QUICK, ("G2",), may_move=False, out=folder / "run")
        run = run_bench(load_lab(path), asked, lambda *_: None, StopRequest())
        found = figures(run, "cell")
        tell_stored(record_property, defects, found)
        verdict = "FAIL" if defects else "PASS"
        assert [(one.id, str(one.verdict)) for one in found] == [("grip.force.error", verdict)], (
            run.tests
        )
        skipped = [test.reason for device, test in run.tests if device.name == "gripper"]
        assert skipped == ["the device does not offer measured_cf"]


@pytest.mark.slow
@pytest.mark.timeout(180)
def test_a_tracker_that_is_wrong_is_found(tmp_path: Path, record_property: Tell) -> None:
    wrong = {"other": "scale=1.01,missing=0.05", "blind": "tells_covered=1"}
    run = carried_out(tmp_path, "ndi", TRACKER, **wrong)
    failing = {
        "other": {"tracking.scale.error", "tracking.view.valid"},
        "blind": {"tracking.cover.restamped"},
    }
    for name, defects in {"sound": "", **wrong}.items():
        tell_stored(record_property, defects, figures(run, name), failing.get(name, ()))
    told = {quantity.id for name in TRACKER for quantity in BY_ID[name].quantities}
    assert {one.id for one in figures(run, "sound")} == told
    assert judged(run, "sound").get("FAIL", set()) == set(), run.tests
    for name, ids in failing.items():
        assert judged(run, name).get("FAIL", set()) == ids, (name, run.tests)


# ---------------------------------------------------------------------------------- judged from what is kept

SUBJECT = Subject((), (), 60.0, 0.0, 1.0, 0.1, 0.5, 0.05, 0.0)
GRIPPED = replace(
    SUBJECT, joints=("opening",), limits=(JointLimits(0.0, 0.085, 0.15, 3.0, 150.0, 0.0),)
)


def poses(name: str, *, hidden: tuple[float, float] = (9.0, 9.0), at: float = 0.0) -> list[Row]:
    """Return what a tool told at 60 Hz for 4 s, not valid within `hidden`."""
    rows: list[Row] = []
    for number in range(240):
        now = 1_000_000_000 + round(number / 60.0 * 1e9)
        seen = not hidden[0] <= number / 60.0 < hidden[1]
        pose = Pose(vector((at, 0.0, 0.0)), vector((0.0, 0.0, 0.0, 1.0)), "polaris")
        rows.append((f"{name}/measured_cp", now, now if seen else 0, pose))
    return rows


def marked(rows: list[Row], **marks: float) -> Trace:
    trace = Trace.of(sorted(rows, key=lambda row: row[1]))
    return replace(trace, events=tuple(Event(at, "mark", text) for text, at in marks.items()))


@pytest.mark.parametrize(
    ("hidden", "verdict", "reason"),
    [
        ((1.0, 2.0), Verdict.PASS, ""),
        ((9.0, 9.0), Verdict.FAIL, "restamped"),
        ((1.0, 1.6), Verdict.FAIL, "restamped"),
        ((1.0, 9.0), Verdict.FAIL, "not told again"),
        ((1.0, 2.5), Verdict.FAIL, "tracking.cover.return"),
    ],
)
def test_what_is_told_of_a_covered_tool_is_judged(
    hidden: tuple[float, float], verdict: Verdict, reason: str
) -> None:
    rows = [*poses("pointer", hidden=hidden), *poses("other")]
    trace = marked(rows, covered=1.0, uncovered=2.0, end=3.0)
    found = BY_ID["K3"].analyse(trace, SUBJECT)
    assert found.verdict is verdict, found
    if reason:
        failing = {one.quantity.id for one in found.measurements if one.verdict is Verdict.FAIL}
        assert reason in " ".join((*found.violations, *failing))


GRASPS = {"width": 0.03, "stroke": 0.085, "grips": [(True, 0.0295)] * 10, "after": 0.0295}


@pytest.mark.parametrize(
    ("kept", "failing"),
    [
        ({}, set()),
        ({"grips": [(False, 0.0295), *[(True, 0.0295)] * 9]}, {"grip.block.known"}),
        ({"grips": [(True, 0.0275)] * 10, "after": 0.0275}, {"grip.block.width"}),
        ({"after": 0.032}, {"grip.block.kept"}),
    ],
    ids=["sound", "unknown", "width", "lost"],
)
def test_what_a_gripper_did_with_a_block_is_judged(kept: dict[str, Any], failing: set[str]) -> None:
    subject = replace(GRIPPED, kept={"held_open": False, **GRASPS, **kept})
    found = BY_ID["G3"].analyse(Trace.of([]), subject)
    assert {one.quantity.id for one in found.measurements if one.verdict is Verdict.FAIL} == failing
    assert found.verdict is (Verdict.FAIL if failing else Verdict.PASS)


def test_a_block_that_is_held_with_open_fingers_fails() -> None:
    subject = replace(GRIPPED, kept={"held_open": True, **GRASPS})
    found = BY_ID["G3"].analyse(Trace.of([]), subject)
    assert found.violations == ("it holds the block with its fingers open",)


def test_a_block_that_no_finger_can_reach_is_told() -> None:
    subject = replace(GRIPPED, kept={"width": 0.09, "grips": [], "stroke": 0.085})
    found = BY_ID["G3"].analyse(Trace.of([]), subject)
    assert found.verdict is Verdict.INCONCLUSIVE
    assert "0 of 10 grips of 90 mm were carried out: its fingers go from 0 to 85 mm" in found.reason


def squeezed(force: float, bias: float = 3.0) -> Trace:
    """Return five grips of a cell, each after it was apart, half a second each."""
    rows: list[Row] = []
    marks: list[Event] = []
    for number in range(10):
        name, pressed = (("apart", 0.0), ("grip", force))[number % 2]
        begin = 0.5 * number
        marks += [Event(begin, "mark", name), Event(begin + 0.4, "mark", f"{name} end")]
        for step in range(100):
            now = 1_000_000_000 + round(1e9 * (begin + 0.005 * step))
            wrench = Wrench(vector((0.0, bias, -pressed)), vector((0.0, 0.0, 0.0)))
            rows.append(("measured_cf", now, now, wrench))
    return replace(Trace.of(rows), events=tuple(marks))


@pytest.mark.parametrize(
    ("force", "verdict"),
    [
        (40.0, Verdict.PASS),
        (46.0, Verdict.PASS),
        (50.0, Verdict.FAIL),
        (30.0, Verdict.FAIL),
        (0.0, Verdict.FAIL),
    ],
)
def test_the_force_of_a_grip_is_judged_whatever_the_cell_told_before(
    force: float, verdict: Verdict
) -> None:
    subject = replace(SUBJECT, kept={"done": 5, "known": 40.0})
    found = BY_ID["G2"].analyse(squeezed(force), subject)
    assert found.verdict is verdict, found


def test_grips_that_were_not_carried_out_decide_nothing() -> None:
    subject = replace(SUBJECT, kept={"done": 0, "known": 40.0})
    found = BY_ID["G2"].analyse(Trace.of([]), subject)
    assert (found.verdict, found.reason) == (
        Verdict.INCONCLUSIVE,
        "0 of 5 grips were carried out",
    )


@pytest.mark.parametrize(
    ("off", "failing"),
    [((0.0, 0.0), set()), ((0.0, 0.002), {"grip.stroke.error", "grip.stroke.spread"})],
    ids=["sound", "loose"],
)
def test_what_a_gripper_did_is_judged(off: tuple[float, float], failing: set[str]) -> None:
    """Strokes of 2 s each, of which every second one ends off."""
    rows: list[Row] = []
    marks: dict[str, float] = {}
    for number in range(10):
        name, end = (("open", 0.085), ("close", 0.0))[number % 2]
        begin = 1.0 + 2.0 * number
        marks |= {f"{name} {number // 2}": begin, f"{name} {number // 2} end": begin + 1.9}
        for step in range(190):
            share = min(1.0, step / 100.0)
            way = end if end else 0.085
            at = share * end + (1.0 - share) * (way - end) + off[number // 2 % 2]
            now = 1_000_000_000 + round(1e9 * (begin + 0.01 * step))
            rows.append(("measured_js", now, now, JointState(position=vector((at,)))))
    subject = replace(GRIPPED, kept={"held": False, "claimed": 0, "done": True})
    trace = marked(rows, **{text: at - 1.0 for text, at in marks.items()})
    found = BY_ID["G1"].analyse(trace, subject)
    assert {one.quantity.id for one in found.measurements if one.verdict is Verdict.FAIL} == failing
    assert found.verdict is (Verdict.FAIL if failing else Verdict.PASS)


@pytest.mark.parametrize("tools", [1, 3])
def test_a_bar_has_two_tools(tools: int) -> None:
    rows = [row for number in range(tools) for row in poses(f"tool_{number}", at=0.1 * number)]
    subject = replace(SUBJECT, kept={"bar": 0.1})
    found = BY_ID["K2"].analyse(marked(rows, begin=0.0, end=4.0), subject)
    assert found.verdict is Verdict.INCONCLUSIVE
    assert f"it has {tools} tools" in found.reason


def test_nothing_is_gripped_where_nothing_is_known_to_lie(tmp_path: Path) -> None:
    about = replace(
        stepped_bed.about("virtual", {}),
        commands=("move_jp", "measured_js", "state/holds", "*/measured_cp"),
    )

    def why(test: str, device: str, head: str = "", told: About = about) -> str:
        path = tmp_path / "lab.toml"
        path.write_text(f"{head}\n[devices.one]\n{device}\n")
        lab = load_lab(path)
        options = BenchOptions(Suite.FULL, (), may_move=True, out=tmp_path, may_travel=("one",))
        given = lab.settings.features
        return lacking(BY_ID[test], told, lab.devices["one"], options, features=given)

    space = "space = { joints = [{ lower = 0.0, upper = 0.085 }], speed = 0.5 }\n"
    real = f'plugin = "robotiq"\nsettings = {{ port = "/dev/ttyUSB9" }}\n{space}'
    sim = 'plugin = "robotiq"\nsim = true'
    there = "features = { block = 0.03 }"
    assert why("G1", real) == ""
    assert "has the feature block" in why("G1", real, there)
    assert why("G3", real, there) == ""
    for head in ("", "features = { block = true }", "features = { block = -1.0 }"):
        assert "block = ..." in why("G3", real, head)
        assert "block = ..." in why("G3", sim, head)
    assert why("G1", sim, there) == why("G3", sim, there) == ""
    assert why("J8", sim) == "its positions count without homing"
    homes = replace(
        about, capabilities=replace(about.capabilities, needs_homing=True), is_homed=True
    )
    may = "features = { homing = true }"
    assert why("J8", sim, told=homes) == why("J8", real, may, homes) == ""
    assert why("J8", real, told=homes).startswith(f"needs `{may}`")
    unhomed = replace(homes, is_homed=False)
    assert why("J8", real, may, unhomed).startswith("needs to be homed")
    assert "bar = ..." in why("K2", 'plugin = "ndi"\nsim = true')
    assert why("K3", 'plugin = "ndi"\nsim = true') == ""
    assert "simulators only" in why("K3", 'plugin = "ndi"\nsettings = { host = "192.168.1.9" }')

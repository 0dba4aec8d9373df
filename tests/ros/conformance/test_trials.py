"""Faults that are found by commanding a device are caught by their clauses, and by no other.

Device and tool are the real ones, their messages too; their time is stepped.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from typing import Any

import pytest

from crtk_drivers.client.conformance.clauses import chosen
from crtk_drivers.client.conformance.findings import Verdict
from crtk_drivers.client.conformance.observed import Graph, Observation
from crtk_drivers.client.conformance.outcome import Outcome
from crtk_drivers.client.conformance.probe import ears as hearing
from crtk_drivers.client.conformance.probe import ros_probe
from crtk_drivers.client.conformance.probe.ears import Ears
from crtk_drivers.client.conformance.probe.examining import try_out
from crtk_drivers.client.conformance.rounds import judge
from crtk_drivers.client.conformance.trial import Leave, Opening, Told
from rigs import student_device, student_gantry
from rigs.examined_student import QUICK, check, clauses_of, names_of
from rigs.stepped_ros import Node, Wire
from rigs.stepped_time import Steps
from rigs.student_device import StudentDevice
from rigs.student_gantry import PLACE

LISTEN = 1.5
PERIOD, FINE, COARSE = 0.02, 0.01, 0.1
"""Seconds of a step: the device in real time has the fine one. Most of what is reckoned are messages."""
SERVICES = {"STA-4", "DAT-19", "DAT-20", "DAT-21", "CLI-2"}
"""Clauses that a device at rest is asked about, over ROS."""

CHANGES = {
    "STA-11",
    "QOS-5",
    "INP-7",
    "MOV-15",
    "MOV-20",
    "MOV-21",
    "MOV-24",
    "MOV-25",
    "SPT-4",
    "HOM-2",
}
"""Clauses of the trials that come last, none of which decides another."""

BY_HAND = {"MOV-3", "MOV-23"}
"""Clauses of the trials in which somebody pushes, for which it is given half a minute: only places count."""

ACTIVE: list[Mapping[str, str]] = [
    {"never_enabled": "STA-5"},
    {"gripper_in_disabled": "SUB-2"},
    {"busy_after_home": "HOM-2"},
    {"ignores_home": "HOM-2"},
    {"resume_faults": "STA-6 STA-10"},
    {"moves_disabled": "MOV-1"},
    {"fault_resumes": "STA-9"},
    {
        "late_enabled": "STA-11",
        "queues": "QOS-5 INP-7",
        "any_step": "MOV-15",
        "drops_goals": "MOV-20",
        "jumps_between": "MOV-21",
        "ignores_ratio": "MOV-24",
        "alternates": "MOV-25",
        "effort_and_place": "SPT-4",
        "homes_idle": "HOM-2",
    },
    {"enable_moves": "MOV-2"},
    {
        "resume_enables": "STA-6",
        "resume_disables": "STA-7",
        "enable_out_of_paused": "STA-8",
        "any_case": "STA-12",
        "silent_disabled": "RAT-2",
        "silent_states": "STA-14",
        "nan": "INP-1",
    },
    {
        "any_size": "INP-2",
        "zero_quaternion": "INP-3",
        "any_frame": "INP-5",
        "tells_nothing": "INP-8 STA-14",
        "zero_effort": "DAT-2",
        "fast_velocity": "DAT-13",
        "own_time": "SPT-8",
        "busy_servo": "BSY-4",
        "by_place": "MOV-7",
        "drops_increments": "QOS-6",
        "velocity_sign": "MOV-12",
        "valid_setpoint_cp": "SPT-5 DAT-11",
        "body_twist": "SUB-1",
        "late_stop": "MOV-14",
        "turned_frame": "MOV-8",
        "other_axes": "MOV-10",
        "scale": "DAT-15 MOV-19",
        "busy_after_hold": "BSY-5",
        "disable_goes_on": "STA-13",
        "dead_topic": "SET-1",
    },
    {
        "angular_first": "DAT-22 DAT-18",
        "adds_to_measured": "MOV-11 QOS-6",
        "stream_goes_on": "MOV-13",
        "short_move": "MOV-16 MOV-19",
        "still_setpoint": "SPT-6",
        "never_busy": "BSY-2 BSY-3",
        "not_pre_emptive": "MOV-18",
        "any_goal": "GOL-2",
    },
]
"""Faults that are found by commanding it. Some break two clauses at once."""


class SteppedEars(Ears):
    """Ears that step the time in which they wait.

    Args:
        node, graph: as those of `Ears`.
        steps: of it.
    """

    def __init__(self, node: Any, graph: Graph, steps: Steps) -> None:
        super().__init__(node, graph)
        self._steps = steps

    def wait(self, condition: Callable[[], bool], timeout: float) -> bool:
        return self._steps.wait(condition, timeout)


def examined(
    ids: Collection[str],
    *faults: str,
    may_home: bool = True,
    homing: bool | None = None,
    push: float | None = None,
    client: Callable[[Opening], Told] | None = None,
) -> tuple[Outcome, StudentDevice]:
    """Examine a device as `crtk-driver conform --may-move` does; return what is found, and the device.

    Args:
        ids: of the clauses.
        faults: of the device.
        may_home: as `--may-home` says.
        homing: what its manifest says of that, if it has one.
        push: by how much somebody moves it when asked to; None: nobody is there.
        client: what comes of an opening with a client.
    """
    period = FINE if CHANGES.issuperset(ids) else PERIOD
    if BY_HAND.issuperset(ids) and "holds_in_free" not in faults:  # which is back sooner
        period = COARSE
    steps, wire = Steps(period), Wire()
    with steps.instead_of_time(hearing, ros_probe, student_device, student_gantry):
        own, node = Node(wire, "gantry", "/student"), Node(wire, "crtk_conform")
        device = StudentDevice(own, *faults)
        graph = own.graph()
        ears = SteppedEars(node, graph, steps)
        steps.step = lambda: device.step(period)
        began = steps.monotonic()
        steps.sleep(LISTEN)
        manifest = {} if homing is None else {"homing": homing}
        seen = Observation(graph, ears.trace(began), manifest=manifest)
        ask = None if push is None else lambda _: device.gantry.push(1, push)
        leave = Leave(may_home, ask)
        tried, why = try_out(node, ears, seen, tuple(ids), QUICK, lambda _: None, leave, client)
    return Outcome("/student", 0.0, judge(seen, tuple(ids), tried, why), {}, 0.0, why), device


def tried_for(clauses: set[str]) -> list[str]:
    """Return the clauses to try. Long ones, and STA-10, which needs all trials, only if they are meant."""
    long = {"SET-1", "STA-10"} - clauses
    rest = set(chosen([])) - CHANGES
    wanted = CHANGES if clauses <= CHANGES else rest - long
    return [each for each in chosen([]) if each in wanted]


def test_a_sound_device_diverges_nowhere_and_is_left_as_it_was_found() -> None:
    outcome, device = examined(chosen([]))
    assert outcome.ended == ""
    check(outcome, {})
    assert len(outcome.of(Verdict.CONFORMS)) >= 90 - len(SERVICES)
    assert device.gantry.state == "DISABLED"
    assert device.gantry.measured == pytest.approx(PLACE, abs=5e-3)


@pytest.mark.sweep(5)
@pytest.mark.parametrize("faults", ACTIVE, ids=names_of)
def test_what_must_be_tried_is_caught(faults: Mapping[str, str]) -> None:
    outcome, _ = examined(tried_for(clauses_of(faults)), *faults)
    check(outcome, faults)


@pytest.mark.parametrize(
    ("may_home", "homing", "verdict", "told"),
    [
        (True, None, Verdict.UNDETERMINED, "whether it needs homing is not declared"),
        (True, True, Verdict.DIVERGES, "it stays homed after unhome"),
        (True, False, Verdict.NOT_OFFERED, "needs no homing"),
        (False, True, Verdict.UNDETERMINED, "needs --may-home"),
    ],
)
def test_what_unhome_must_do_is_as_declared(
    may_home: bool, homing: bool | None, verdict: Verdict, told: str
) -> None:
    outcome, _ = examined(["HOM-2"], "ignores_unhome", may_home=may_home, homing=homing)
    (found,) = outcome.results
    assert found.finding.verdict is verdict
    assert told in found.finding.text


@pytest.mark.sweep(2)
@pytest.mark.parametrize("clause", ["INP-9", "STA-8", "SUB-2", "HOM-2"])
def test_what_is_tried_alone_brings_the_device_to_where_it_begins(clause: str) -> None:
    outcome, device = examined([clause])
    (found,) = outcome.results
    assert (outcome.ended, found.finding.verdict) == ("", Verdict.CONFORMS), found.finding
    assert device.gantry.state == "DISABLED"


@pytest.mark.parametrize(
    ("speed", "verdict"), [(0.25, Verdict.DIVERGES), (1.0, Verdict.UNDETERMINED)]
)
def test_a_move_that_is_over_before_a_stop_can_have_come_decides_nothing(
    monkeypatch: pytest.MonkeyPatch, speed: float, verdict: Verdict
) -> None:
    monkeypatch.setattr(student_gantry, "SPEED", speed)
    outcome, _ = examined(["STA-13"], "disable_goes_on")
    (found,) = outcome.results
    assert found.finding.verdict is verdict, found.finding


@pytest.mark.sweep(3)
@pytest.mark.parametrize(
    ("fault", "push", "verdicts"),
    [
        ("", 0.1, {"MOV-3": Verdict.CONFORMS, "MOV-23": Verdict.CONFORMS}),
        ("enabled_where_it_was", 0.1, {"MOV-3": Verdict.DIVERGES, "MOV-23": Verdict.CONFORMS}),
        ("holds_in_free", 0.1, {"MOV-3": Verdict.CONFORMS, "MOV-23": Verdict.DIVERGES}),
        ("", 0.0, {"MOV-3": Verdict.UNDETERMINED, "MOV-23": Verdict.UNDETERMINED}),
        ("", None, {"MOV-3": Verdict.UNDETERMINED, "MOV-23": Verdict.UNDETERMINED}),
    ],
)
def test_what_is_done_by_hand_stays_done(
    fault: str, push: float | None, verdicts: Mapping[str, Verdict]
) -> None:
    outcome, device = examined(["MOV-3", "MOV-23"], fault, push=push)
    found = {each.clause.id: each.finding for each in outcome.results}
    assert {clause: each.verdict for clause, each in found.items()} == verdicts, found
    if not push:
        told = "needs somebody" if push is None else "nobody moved it"
        assert all(told in each.text for each in found.values()), found
    assert device.gantry.state == "DISABLED"


def test_brakes_that_hold_leave_it_to_free(monkeypatch: pytest.MonkeyPatch) -> None:
    loose = student_gantry.Gantry.push

    def held(gantry: student_gantry.Gantry, joint: int, by: float) -> None:
        if gantry.is_free:
            loose(gantry, joint, by)

    monkeypatch.setattr(student_gantry.Gantry, "push", held)
    outcome, _ = examined(["MOV-3"], push=0.1)
    (found,) = outcome.results
    assert found.finding.verdict is Verdict.CONFORMS, found.finding


def test_who_still_has_it_in_hand_decides_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """It would be told to have moved when it was enabled."""
    held: list[student_gantry.Gantry] = []
    push, step = student_gantry.Gantry.push, StudentDevice.step

    def take(gantry: student_gantry.Gantry, joint: int, by: float) -> None:
        held.append(gantry)
        push(gantry, joint, by)

    def go_on(device: StudentDevice, seconds: float) -> None:
        if device.gantry in held and device.gantry.state == "DISABLED":
            push(device.gantry, 1, 0.1 * seconds)
        step(device, seconds)

    monkeypatch.setattr(student_gantry.Gantry, "push", take)
    monkeypatch.setattr(StudentDevice, "step", go_on)
    outcome, device = examined(["MOV-3"], push=0.1)
    (found,) = outcome.results
    assert found.finding.verdict is Verdict.UNDETERMINED, found.finding
    assert "not let go" in found.finding.text
    assert device.gantry.state == "DISABLED"


def test_joints_that_are_no_numbers_are_not_where_they_were(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    command = student_gantry.Gantry.command

    def lose(gantry: student_gantry.Gantry, word: str) -> None:
        command(gantry, word)
        if gantry.state == "ENABLED":
            gantry.measured[2] = math.nan

    monkeypatch.setattr(student_gantry.Gantry, "command", lose)
    outcome, _ = examined(["MOV-3"], push=0.1)
    (found,) = outcome.results
    assert found.finding.verdict is Verdict.UNDETERMINED, found.finding
    assert "no numbers" in outcome.ended


@pytest.mark.parametrize(
    ("told", "verdict", "words"),
    [
        (Told(True, ("enable", "home"), ""), Verdict.CONFORMS, "enable, home worked"),
        (Told(True, (), "enable did not succeed"), Verdict.DIVERGES, "nothing worked; enable did"),
        (Told(False, ("enable",), ""), Verdict.UNDETERMINED, "is not installed here"),
        (Told(False, (), "enable did not"), Verdict.UNDETERMINED, "nothing worked; enable did"),
    ],
)
def test_the_official_client_alone_decides(told: Told, verdict: Verdict, words: str) -> None:
    openings: list[Opening] = []

    def client(opening: Opening) -> Told:
        openings.append(opening)
        return told

    outcome, device = examined(["CLI-1"], client=client)
    (found,) = outcome.results
    assert found.finding.verdict is verdict
    assert words in found.finding.text
    (opening,) = openings
    assert opening.begin == pytest.approx(PLACE, abs=5e-3)
    assert opening.goal != opening.begin
    assert device.gantry.state == "DISABLED"

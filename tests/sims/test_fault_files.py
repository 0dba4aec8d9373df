"""Fault files: what is accepted, what is refused with which words, and when faults are due."""

import pytest

from crtk_sim_backends.faults import (
    Action,
    Fault,
    FaultError,
    FaultKind,
    Parameter,
    Timeline,
    check_fault,
    parse_faults,
    read_faults,
)

KINDS = {
    kind.name: kind
    for kind in (
        FaultKind(
            "silence",
            "nothing is sent",
            {"port": Parameter(str, choices=("rtde", "dashboard"))},
            lasting=True,
        ),
        FaultKind("push", "a force", {"wrench": Parameter(list, length=3)}),
        FaultKind("split", "pieces", {"size": Parameter(int, 1, minimum=1)}, lasting=True),
        FaultKind("stop", "a stop"),
    )
}
EVENTS = ("started", "moved")


def test_a_complete_entry_is_read_with_its_defaults():
    (fault,) = parse_faults([{"at": 2, "kind": "split", "duration": 0.5}], KINDS, EVENTS)
    assert fault == Fault("split", {"size": 1}, at=2.0, when=None, duration=0.5)


@pytest.mark.parametrize(
    ("entry", "complaint"),
    [
        ({"at": 1, "kind": "silense", "port": "rtde"}, "did you mean 'silence'"),
        ({"at": 1, "kind": "silence", "port": "rtd"}, "did you mean 'rtde'"),
        ({"at": 1, "kind": "silence", "prot": "rtde"}, "did you mean 'port'"),
        ({"at": 1, "kind": "silence"}, "needs the parameter 'port'"),
        ({"at": 1, "kind": "stop", "duration": 1}, "unknown parameter of stop 'duration'"),
        ({"at": 1, "kind": "split", "size": 0}, "size must lie in [1, inf]"),
        ({"at": 1, "kind": "split", "size": 1.5}, "whole number"),
        ({"at": 1, "kind": "split", "size": True}, "must be a number"),
        ({"at": 1, "kind": "split", "size": "1"}, "must be a number"),
        ({"at": float("nan"), "kind": "stop"}, "at must lie in"),
        ({"at": -1, "kind": "stop"}, "at must lie in"),
        ({"at": 1, "kind": "push", "wrench": [1, 2]}, "a list of 3 numbers"),
        ({"at": 1, "kind": "push", "wrench": [1, 2, "x"]}, "wrench[2] must be a number"),
        ({"kind": "stop"}, "either 'at' (seconds) or 'when'"),
        ({"at": 1, "when": "moved", "kind": "stop"}, "either 'at' (seconds) or 'when'"),
        ({"when": "move", "kind": "stop"}, "did you mean 'moved'"),
        ({"at": 1, "after": 1, "kind": "stop"}, "'after' goes with 'when'"),
        ({"at": 1}, "needs a 'kind'"),
        ("stop", "needs a 'kind'"),
    ],
)
def test_a_wrong_entry_is_refused_with_its_number_and_what_to_write_instead(entry, complaint):
    with pytest.raises(FaultError) as caught:
        parse_faults([{"at": 0, "kind": "stop"}, entry], KINDS, EVENTS)
    assert complaint in str(caught.value)
    assert str(caught.value).startswith("entry 2: ")


def test_a_wrong_file_is_refused_with_its_line(tmp_path):
    path = tmp_path / "faults.yaml"
    path.write_text("# a comment\n- {at: 1, kind: stop}\n- at: 2\n  kind: stopp\n")
    with pytest.raises(FaultError, match=r"faults.yaml, line 3: unknown kind of fault 'stopp'"):
        read_faults(path, KINDS, EVENTS)


@pytest.mark.parametrize("text", ["kind: stop", "- {", "", "just words", "\x00"])
def test_a_file_that_is_no_list_is_refused(tmp_path, text):
    path = tmp_path / "faults.yaml"
    path.write_text(text)
    with pytest.raises(FaultError, match=r"faults\.yaml"):
        read_faults(path, KINDS, EVENTS)


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(FaultError, match="cannot read the fault file"):
        read_faults(tmp_path / "none.yaml", KINDS, EVENTS)


def test_faults_are_due_at_their_times_and_end_after_their_durations():
    entries = [
        {"at": 2, "kind": "stop"},
        {"at": 1, "kind": "split", "size": 3, "duration": 2},
    ]
    stop, split = parse_faults(entries, KINDS, EVENTS)
    timeline = Timeline([stop, split])
    assert timeline.due(0.9) == []
    assert timeline.due(1.0) == [Action(split, begin=True)]
    assert timeline.due(3.0) == [Action(stop, begin=True), Action(split, begin=False)]
    assert timeline.due(100.0) == []


def test_faults_wait_for_their_event_once_each():
    entries = [
        {"when": "moved", "kind": "stop"},
        {"when": "moved", "after": 0.5, "kind": "split"},
    ]
    stop, split = parse_faults(entries, KINDS, EVENTS)
    timeline = Timeline([stop, split])
    timeline.event("started", 0.0)
    assert timeline.due(10.0) == []
    timeline.event("moved", 10.0)
    assert timeline.due(10.0) == [Action(stop, begin=True)]
    timeline.event("moved", 11.0)
    assert timeline.due(11.4) == []
    assert timeline.due(11.5) == [Action(split, begin=True)]
    timeline.event("moved", 12.0)
    assert timeline.due(20.0) == []


def test_an_injected_fault_begins_at_once_and_its_end_can_be_forgotten():
    timeline = Timeline()
    fault = check_fault(KINDS, "split", {"duration": 1.0}, "inject")
    timeline.begin(fault, 5.0)
    assert timeline.due(5.0) == [Action(fault, begin=True)]
    timeline.forget(fault)
    assert timeline.due(10.0) == []

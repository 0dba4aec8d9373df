"""Clauses as data, verdicts of several trials, exit codes, the statement and the files of a report."""

from __future__ import annotations

import json
import re
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import pytest
from typing_extensions import override

from crtk_drivers.client.conformance.clause_rows import Level, Needs
from crtk_drivers.client.conformance.clauses import CLAUSES, chosen
from crtk_drivers.client.conformance.findings import (
    Finding,
    Verdict,
    conforms,
    diverges,
    exit_code,
    judged,
    not_offered,
    together,
    undetermined,
)
from crtk_drivers.client.conformance.observed import Graph, Observation
from crtk_drivers.client.conformance.outcome import Outcome, plain_data, statement
from crtk_drivers.client.conformance.report_files import html, junit, write_report
from crtk_drivers.client.conformance.rounds import (
    BY_HAND,
    JUDGES,
    NOT_PERMITTED,
    judge,
)
from crtk_drivers.client.conformance.trials import STEPS, TRIED, chosen_steps, excuse
from crtk_drivers.commands import ROS_TYPES
from crtk_drivers.errors import ConfigError
from crtk_drivers.ros.manifest import type_name
from crtk_drivers.ros.messages import TYPES

SOURCES = {"RM", "OS", "SL", "MSG", "PC", "RI", "dVRK", "HZ", "OURS"}
BEGAN = 1_769_817_600.0  # 2026-01-31


def outcome(**findings: Finding) -> Outcome:
    named = {name.replace("_", "-"): [finding] for name, finding in findings.items()}
    manifest = {"device": {"name": "student <one>"}}
    return Outcome("/arm", BEGAN, judged(named, named), manifest, seconds=12.0)


def test_there_are_the_clauses_and_each_is_complete() -> None:
    assert len(CLAUSES) == 113
    for clause in CLAUSES.values():
        assert re.fullmatch(r"[A-Z]{3}-\d+", clause.id)
        assert clause.text
        assert clause.test
        assert set(clause.source.split(", ")) <= SOURCES


def test_every_clause_has_a_judge_or_a_trial_that_needs_what_it_says() -> None:
    assert TRIED | set(JUDGES) == set(CLAUSES)
    for step in STEPS:
        for clause in step.clauses:
            needs = CLAUSES[clause].needs
            assert needs is not Needs.PASSIVE, clause
            at_rest = needs in (Needs.STATES, Needs.OPERATOR) or clause in ("MOV-1", "MOV-2")
            assert step.is_motion or at_rest, clause


def test_types_are_those_that_the_node_has() -> None:
    assert {payload: type_name(kind) for payload, kind in TYPES.items()} == dict(ROS_TYPES)


@pytest.mark.parametrize(
    ("given", "ids"),
    [
        (["QOS-1"], ["QOS-1"]),
        (["qos-2", " NAM-2 "], ["NAM-2", "QOS-2"]),
        (["RAT"], ["RAT-1", "RAT-2"]),
    ],
)
def test_clauses_are_chosen_by_id_or_kind(given: list[str], ids: list[str]) -> None:
    assert list(chosen(given)) == ids


def test_an_unknown_clause_is_refused_with_the_nearest() -> None:
    with pytest.raises(ConfigError) as caught:
        chosen(["QOS-99"])
    assert "QOS-9" in str(caught.value)
    assert "Did you mean QOS?" in caught.value.remedy


def test_only_the_trials_that_are_needed_are_made() -> None:
    assert [step.clauses for step in chosen_steps({"BSY-3"})] == [("BSY-3",)]
    assert chosen_steps({"NAM-1"}) == ()
    assert chosen_steps({"STA-10"}) == STEPS


def test_of_several_trials_one_that_diverges_counts() -> None:
    both = together([conforms("a"), diverges("b", ["x"]), diverges("b", ["y"]), undetermined("c")])
    assert (both.verdict, both.text, both.evidence) == (Verdict.DIVERGES, "b", ("x", "y"))
    assert together([undetermined("c"), conforms("a")]).verdict is Verdict.CONFORMS
    assert together([not_offered("d"), undetermined("c")]).verdict is Verdict.UNDETERMINED


@pytest.mark.parametrize(
    ("findings", "code"),
    [
        ({"NAM_1": conforms(""), "QOS_4": diverges("")}, 0),
        ({"NAM_1": diverges(""), "QOS_4": conforms("")}, 1),
        ({"NAM_1": undetermined(""), "QOS_4": not_offered("")}, 3),
        ({}, 3),
    ],
)
def test_exit_codes(findings: dict[str, Finding], code: int) -> None:
    assert exit_code(outcome(**findings).results) == code


def test_what_diverges_in_a_motion_is_left_open_where_this_tool_was_late_itself() -> None:
    before = diverges("before")
    trial: Any = SimpleNamespace(
        found={"MOV-1": [before], "MOV-4": [diverges("late"), conforms("x")]}
    )
    excuse(trial, {"MOV-1": 1}, 0.01)
    assert trial.found["MOV-4"][0].verdict is Verdict.DIVERGES
    excuse(trial, {"MOV-1": 1}, 0.03)
    assert trial.found["MOV-1"] == [before]
    assert trial.found["MOV-4"] == [
        undetermined("this machine was late by 30 ms: late"),
        conforms("x"),
    ]


def test_what_was_not_judged_says_why() -> None:
    seen = Observation(Graph("/arm"))
    results = judge(seen, ("MOV-4", "MOV-3"), {}, NOT_PERMITTED)
    assert {each.clause.id: each.finding.text for each in results} == {
        "MOV-4": NOT_PERMITTED,
        "MOV-3": BY_HAND,
    }
    (result,) = judge(seen, ("MOV-4",), {}, "enable moved it")
    assert result.finding.text == "not tried: enable moved it"
    (result,) = judge(seen, ("MOV-4",), {"MOV-4": [conforms("it follows")]}, "")
    assert result.finding.verdict is Verdict.CONFORMS


def test_the_statement_says_what_and_except_what() -> None:
    assert statement(outcome(NAM_1=conforms(""), QOS_4=diverges(""), MOV_4=undetermined(""))) == (
        "student <one> at /arm conforms to CRTK 1.3, names, transport and data, except QOS-4 (SHOULD): "
        "1 clauses conform, 1 undetermined (2026-01-31)."
    )
    assert "does not conform to CRTK 1.3, names, transport and data because of NAM-1:" in statement(
        outcome(NAM_1=diverges(""))
    )
    assert "names, transport, data, states and motion" in statement(outcome(MOV_4=conforms("")))
    assert "names, transport, data and states:" in statement(outcome(STA_6=conforms("")))
    assert statement(outcome(NAM_1=undetermined(""))) == (
        "Nothing could be judged of student <one> at /arm."
    )


class _Page(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.links: list[str] = []
        self.text = ""

    @override
    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.links += [value or "" for name, value in attrs if name in ("src", "href")]

    @override
    def handle_data(self, data: str) -> None:
        self.text += data


def test_the_page_is_one_file_without_scripts_and_escapes_what_devices_say(tmp_path: Path) -> None:
    told = outcome(
        NAM_1=diverges("not in CRTK: <b>x</b>", ["a & b"]),
        MOV_4=undetermined("x"),
        SET_4=conforms(""),
    )
    page = _Page()
    page.feed(html(told))
    assert "script" not in page.tags
    assert "b" not in page.tags
    assert page.links == []
    for text in (
        "student <one>",
        "not in CRTK: <b>x</b>",
        "a & b",
        statement(told),
        "What diverges",
    ):
        assert text in page.text, text

    paths = write_report(told, tmp_path / "report")
    assert [path.name for path in paths] == ["conformance.html", "conformance.json", "junit.xml"]
    data = json.loads(paths[1].read_text())
    assert data == plain_data(told)
    assert data["results"][0]["verdict"] == "DIVERGES"
    assert data["schema"] == "crtk_conformance/1"


def test_a_report_that_cannot_be_written_is_an_error_of_use(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="the report cannot be written"):
        write_report(outcome(NAM_1=conforms("")), tmp_path / "file")


def test_in_junit_only_a_must_fails() -> None:
    told = outcome(
        NAM_1=diverges("a"), QOS_4=diverges("b"), MOV_4=undetermined("c"), SET_4=conforms("")
    )
    suite = ElementTree.fromstring(junit(told)).find("testsuite")
    assert suite is not None
    assert (suite.get("tests"), suite.get("failures"), suite.get("skipped")) == ("4", "1", "1")
    levels = [CLAUSES[each].level for each in ("NAM-1", "QOS-4")]
    assert levels == [Level.MUST, Level.SHOULD]

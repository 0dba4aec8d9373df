"""JUnit XML that strict parsers take: figures in `system-out`, properties of suites only."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final
from xml.etree import ElementTree

from crtk_drivers.labs.verdicts.judging import Verdict


@dataclass(frozen=True, slots=True)
class Case:
    """A test.

    Attributes:
        name, group: of the test; the group is its `classname`.
        seconds: that it took.
        verdict: of it.
        reason: why it did not pass, in one line.
        output: its figures, in lines.
    """

    name: str
    group: str
    seconds: float
    verdict: Verdict
    reason: str = ""
    output: str = ""


@dataclass(frozen=True, slots=True)
class Suite:
    """Tests that belong together, such as those of one device."""

    name: str
    cases: tuple[Case, ...]
    properties: Mapping[str, str]
    timestamp: str = ""


_FORBIDDEN: Final = re.compile("[^\t\n\r -\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")

_ELEMENTS: Mapping[Verdict, tuple[str, str]] = {
    Verdict.FAIL: ("failure", "beyond its bound"),
    Verdict.INCONCLUSIVE: ("error", "inconclusive"),
    Verdict.SKIPPED: ("skipped", ""),
}


def junit_xml(suites: Iterable[Suite]) -> str:
    """Return the document."""
    root = ElementTree.Element("testsuites")
    for suite in suites:
        counts = {
            "tests": len(suite.cases),
            "failures": sum(case.verdict is Verdict.FAIL for case in suite.cases),
            "errors": sum(case.verdict is Verdict.INCONCLUSIVE for case in suite.cases),
            "skipped": sum(case.verdict is Verdict.SKIPPED for case in suite.cases),
        }
        attributes = {"name": suite.name, **{key: str(value) for key, value in counts.items()}}
        attributes["time"] = f"{sum(case.seconds for case in suite.cases):.3f}"
        if suite.timestamp:
            attributes["timestamp"] = suite.timestamp
        element = ElementTree.SubElement(root, "testsuite", attributes)
        properties = ElementTree.SubElement(element, "properties")
        for name, value in suite.properties.items():
            ElementTree.SubElement(properties, "property", name=name, value=value)
        for case in suite.cases:
            _add(element, case)
    for element in root.iter():
        element.attrib = {key: _allowed(value) for key, value in element.attrib.items()}
        element.text = _allowed(element.text or "")
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, "unicode") + "\n"


def _add(suite: ElementTree.Element, case: Case) -> None:
    attributes = {"name": case.name, "classname": case.group, "time": f"{case.seconds:.3f}"}
    element = ElementTree.SubElement(suite, "testcase", attributes)
    if case.verdict in _ELEMENTS:
        tag, kind = _ELEMENTS[case.verdict]
        told = {"message": case.reason, **({"type": kind} if kind else {})}
        ElementTree.SubElement(element, tag, told)
    if case.output:
        ElementTree.SubElement(element, "system-out").text = case.output


def _allowed(text: str) -> str:
    """Return a text without what XML 1.0 cannot hold: control characters and halves of surrogates."""
    return _FORBIDDEN.sub("�", text)

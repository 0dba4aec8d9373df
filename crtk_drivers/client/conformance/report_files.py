"""The report of an examination: JSON for programs, JUnit for CI, one HTML file for people."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import Final

from crtk_drivers.client.conformance.findings import Judged, Verdict
from crtk_drivers.client.conformance.outcome import Outcome, plain_data, statement
from crtk_drivers.errors import ConfigError
from crtk_drivers.labs.verdicts import judging
from crtk_drivers.labs.verdicts.html_page import Cell, badge, page, table, text
from crtk_drivers.labs.verdicts.junit import Case, Suite, junit_xml

KINDS: Final = {
    Verdict.CONFORMS: "good",
    Verdict.DIVERGES: "bad",
    Verdict.UNDETERMINED: "open",
    Verdict.NOT_OFFERED: "none",
}
_IN_JUNIT: Final = {
    Verdict.CONFORMS: judging.Verdict.PASS,
    Verdict.DIVERGES: judging.Verdict.FAIL,
    Verdict.UNDETERMINED: judging.Verdict.SKIPPED,
    Verdict.NOT_OFFERED: judging.Verdict.SKIPPED,
}
_ORDER: Final = (
    Verdict.DIVERGES,
    Verdict.CONFORMS,
    Verdict.UNDETERMINED,
    Verdict.NOT_OFFERED,
)


def write_report(outcome: Outcome, folder: Path) -> list[Path]:
    """Write the three files into a folder, which is made, and return their paths.

    Raises:
        ConfigError: they cannot be written there.
    """
    files = {
        "conformance.html": html(outcome),
        "conformance.json": json.dumps(plain_data(outcome), indent=1, ensure_ascii=False) + "\n",
        "junit.xml": junit(outcome),
    }
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in files.items():
            (folder / name).write_text(content, encoding="utf-8")
    except OSError as error:
        raise ConfigError(
            f"the report cannot be written: {error}", where=f"--out {folder}"
        ) from error
    return [folder / name for name in files]


def junit(outcome: Outcome) -> str:
    """Return a JUnit document; only a MUST that diverges is a failure, a SHOULD is told in its case."""
    cases = []
    for each in outcome.results:
        finding, clause = each.finding, each.clause
        verdict = _IN_JUNIT[finding.verdict]
        if verdict is judging.Verdict.FAIL and not each.is_violated:
            verdict = judging.Verdict.PASS
        output = "\n".join((finding.verdict, clause.text, finding.text, *finding.evidence))
        reason = f"{finding.verdict}: {finding.text}"
        cases.append(Case(clause.id, clause.group, 0.0, verdict, reason, output))
    properties = {"statement": statement(outcome), "began": outcome.when}
    return junit_xml([Suite(f"CRTK {outcome.namespace}", tuple(cases), properties)])


def html(outcome: Outcome) -> str:
    """Return the page: the statement, how many, what diverges first, then all by heading."""
    count = Counter(each.finding.verdict for each in outcome.results)
    figures = " ".join(
        f"{badge(each, KINDS[each])} {count[each]}" for each in _ORDER if count[each]
    )
    parts = [
        f"<h1>CRTK conformance of {text(outcome.device)}</h1>",
        f"<p><strong>{text(statement(outcome))}</strong></p>",
        f"<p>{figures}</p>",
        f"<p>{text(outcome.when)}, {outcome.seconds:.0f} s, {text(_how(outcome))}</p>",
    ]
    if outcome.ended:
        parts.append(f"<p>The trials ended early: {text(outcome.ended)}.</p>")
    faults = outcome.of(Verdict.DIVERGES)
    if faults:
        parts += ["<h2>What diverges</h2>", _rows(faults)]
    for group in dict.fromkeys(each.clause.group for each in outcome.results):
        own = [each for each in outcome.results if each.clause.group == group]
        parts += [f"<h2>{text(group)}</h2>", _rows(own)]
    return page(f"CRTK conformance of {outcome.device}", "\n".join(parts))


def _how(outcome: Outcome) -> str:
    return f"needed {outcome.reach.value}"


def _rows(results: list[Judged]) -> Cell:
    def seen(each: Judged) -> Cell:
        lines = (each.finding.text, *each.finding.evidence)
        return Cell("<br>".join(text(line) for line in lines))

    return table(
        ("Clause", "Level", "Verdict", "What is asked", "What was seen"),
        [
            (
                each.clause.id,
                each.clause.level,
                badge(each.finding.verdict, KINDS[each.finding.verdict]),
                each.clause.text,
                seen(each),
            )
            for each in results
        ],
    )

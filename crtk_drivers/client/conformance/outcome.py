"""The outcome of an examination, and how it is told: as plain data, and in one statement."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any, Final

from crtk_drivers.client.conformance.clause_rows import Level, Needs
from crtk_drivers.client.conformance.findings import Judged, Verdict

SCHEMA: Final = "crtk_conformance/1"
CRTK_VERSION: Final = "1.3"


@dataclass(frozen=True)
class Outcome:
    """What was found of a device.

    Attributes:
        namespace: of the device.
        began: seconds since the epoch.
        results: one for each clause that was asked for.
        manifest: of the device, empty without one.
        seconds: that it took.
        ended: why the trials ended early, empty if they did not.
    """

    namespace: str
    began: float
    results: tuple[Judged, ...]
    manifest: Mapping[str, Any] = field(default_factory=dict)
    seconds: float = 0.0
    ended: str = ""

    @property
    def device(self) -> str:
        """What the device calls itself; its namespace if it does not."""
        told = self.manifest.get("device")
        name = told.get("name") if isinstance(told, Mapping) else None
        return f"{name} at {self.namespace}" if name else self.namespace

    @property
    def when(self) -> str:
        """The date and time, UTC."""
        return datetime.fromtimestamp(self.began, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")

    @property
    def reach(self) -> Needs:
        """The most that was needed for what was judged."""
        said = (Verdict.CONFORMS, Verdict.DIVERGES)
        needed = {each.clause.needs for each in self.results if each.finding.verdict in said}
        return next(
            (each for each in (Needs.MOTION, Needs.STATES) if each in needed), Needs.PASSIVE
        )

    def of(self, verdict: Verdict, level: Level | None = None) -> list[Judged]:
        """Return the results with a verdict, and of a level."""
        return [
            each
            for each in self.results
            if each.finding.verdict is verdict and level in (None, each.clause.level)
        ]


def statement(outcome: Outcome) -> str:
    """Return what can be said of the device in public."""
    conform = outcome.of(Verdict.CONFORMS)
    if not conform and not outcome.of(Verdict.DIVERGES):
        return f"Nothing could be judged of {outcome.device}."
    musts = [each.clause.id for each in outcome.of(Verdict.DIVERGES, Level.MUST)]
    shoulds = [each.clause.id for each in outcome.of(Verdict.DIVERGES, Level.SHOULD)]
    levels = {
        Needs.PASSIVE: "names, transport and data",
        Needs.STATES: "names, transport, data and states",
        Needs.MOTION: "names, transport, data, states and motion",
        Needs.OPERATOR: "all levels",
    }[outcome.reach]
    does = "does not conform" if musts else "conforms"
    because = f" because of {', '.join(musts)}" if musts else ""
    but = f", except {', '.join(shoulds)} (SHOULD)" if shoulds else ""
    open_ones = len(outcome.of(Verdict.UNDETERMINED))
    left = f", {open_ones} undetermined" if open_ones else ""
    return (
        f"{outcome.device} {does} to CRTK {CRTK_VERSION}, {levels}{because}{but}: "
        f"{len(conform)} clauses conform{left} ({outcome.when[:10]})."
    )


def plain_data(outcome: Outcome) -> dict[str, Any]:
    """Return the outcome as it goes into a JSON file.

    Schema ``crtk_conformance/1``: namespace, device, began, seconds, reach, statement, and for each of
    ``results`` id, level, source, clause, verdict, seen, evidence.
    """
    return {
        "schema": SCHEMA,
        "namespace": outcome.namespace,
        "device": outcome.device,
        "began": outcome.when,
        "seconds": round(outcome.seconds, 3),
        "reach": outcome.reach.name.lower(),
        "statement": statement(outcome),
        "results": [
            {
                "id": each.clause.id,
                "level": each.clause.level.value,
                "source": each.clause.source,
                "clause": each.clause.text,
                "verdict": each.finding.verdict.value,
                "seen": each.finding.text,
                "evidence": list(each.finding.evidence),
            }
            for each in outcome.results
        ],
    }

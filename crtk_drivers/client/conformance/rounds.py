"""Which judge has which clause, and what is said of those that were not judged."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Final

from crtk_drivers.client.conformance.clause_rows import Needs
from crtk_drivers.client.conformance.clauses import CLAUSES
from crtk_drivers.client.conformance.data_judges import DATA_JUDGES
from crtk_drivers.client.conformance.findings import Finding, Judged, judged, undetermined
from crtk_drivers.client.conformance.graph_judges import GRAPH_JUDGES
from crtk_drivers.client.conformance.observed import Observation
from crtk_drivers.client.conformance.state_judges import STATE_JUDGES

JUDGES: Final[Mapping[str, Callable[[Observation], Finding]]] = MappingProxyType(
    {**GRAPH_JUDGES, **DATA_JUDGES, **STATE_JUDGES}
)
"""Of what is seen of a device that nobody moves."""

BY_HAND: Final = "needs somebody at the device, and --may-move --by-hand"
NOT_PERMITTED: Final = "needs --may-move"


def judge(
    seen: Observation,
    ids: Iterable[str],
    tried: Mapping[str, Sequence[Finding]],
    why_not: str,
) -> tuple[Judged, ...]:
    """Return the clauses `ids` with their findings.

    Args:
        seen: of the device at rest.
        ids: of clauses.
        tried: findings of what was done with the device.
        why_not: why not all was done that could be.
    """
    wanted = tuple(ids)
    findings: dict[str, list[Finding]] = {}
    for each in wanted:
        found = list(tried.get(each, ()))
        if each in JUDGES:
            found.append(JUDGES[each](seen))
        findings[each] = found or [_unjudged(each, why_not)]
    return judged(findings, wanted)


def _unjudged(clause: str, why_not: str) -> Finding:
    if CLAUSES[clause].needs is Needs.OPERATOR and why_not in ("", NOT_PERMITTED):
        return undetermined(BY_HAND)
    if why_not == NOT_PERMITTED:
        return undetermined(NOT_PERMITTED)
    return undetermined(f"not tried: {why_not or 'what comes before it did not succeed'}")

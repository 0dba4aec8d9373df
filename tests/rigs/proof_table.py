"""The table at the end of a test run: each figure of the bench without a defect, and with the one for it."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator

import pytest

from crtk_drivers.labs.bench.results import Measured
from crtk_drivers.labs.verdicts.judging import Comparison, Measurement, Verdict

PROPERTY = "bench_proof"


def tell_proof(
    record_property: Callable[[str, object], None],
    defects: str,
    measurements: Iterable[Measurement],
    quantities: Collection[str] = (),
) -> None:
    """Keep what was found of an arm with these defects (none: it is sound), of some quantities or of all."""
    worst: dict[str, Measurement] = {}
    for one in measurements:
        found = one.quantity.id
        is_told = one.quantity.comparison is Comparison.TOLD
        if is_told or (quantities and found not in quantities):
            continue
        if found not in worst or (
            one.verdict is Verdict.FAIL and worst[found].verdict is not Verdict.FAIL
        ):
            worst[found] = one
    rows = [(figure, defects, str(one.verdict), one.told) for figure, one in worst.items()]
    record_property(PROPERTY, json.dumps(rows))


def tell_stored(
    record_property: Callable[[str, object], None],
    defects: str,
    measurements: Iterable[Measured],
    quantities: Collection[str] = (),
) -> None:
    """The same of what a whole run has kept."""
    rows = [
        (one.id, defects, str(one.verdict), one.told)
        for one in measurements
        if one.comparison != "told" and (not quantities or one.id in quantities)
    ]
    record_property(PROPERTY, json.dumps(rows))


def proof_table(reports: Iterable[pytest.TestReport]) -> Iterator[str]:
    """Yield the lines of the table: nothing where none of its tests was run."""
    sound: dict[str, str] = {}
    proofs: dict[str, list[tuple[str, str, str]]] = defaultdict(list)
    for report in reports:
        for name, value in report.user_properties:
            if name != PROPERTY or report.when != "call":
                continue
            for figure, defects, verdict, told in json.loads(str(value)):
                if defects:
                    proofs[figure].append((defects, verdict, told))
                else:
                    sound[figure] = verdict
    for figure, found in sorted(proofs.items()):
        for defects, verdict, told in found:
            yield f"{figure:32} {sound.get(figure, '-'):12} {defects[:36]:36} {verdict:6} {told}"

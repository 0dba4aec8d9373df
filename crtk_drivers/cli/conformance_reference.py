"""The tables of a page of the documentation, made of the clauses and of what can be expected.

The page holds them between ``<!-- clauses -->`` or ``<!-- expectations -->`` and ``<!-- end -->``.

python -m crtk_drivers.cli.conformance_reference docs/conformance.md            # writes it
python -m crtk_drivers.cli.conformance_reference --check docs/conformance.md    # 1 if it is out of date
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

from crtk_drivers.cli.config_reference import table_of
from crtk_drivers.cli.written_files import out_of_date
from crtk_drivers.client.conformance.clause_rows import ROWS, Needs
from crtk_drivers.client.conformance.clauses import CLAUSES
from crtk_drivers.client.conformance.expectations import Expectations

_MARKED: Final = re.compile(
    r"(?P<begin><!-- (?P<what>clauses|expectations) -->\n).*?(?=<!-- end -->)", re.DOTALL
)
_HEAD: Final = "| Id | Level | Clause | Source | Test | Needs |\n|---|---|---|---|---|---|\n"
_NEEDS: Final = {
    Needs.PASSIVE: "",
    Needs.STATES: "states",
    Needs.MOTION: "motion",
    Needs.OPERATOR: "operator",
}


def _lines() -> Iterator[str]:
    for group, rows in ROWS.items():
        yield f"\n### {group}\n\n{_HEAD}"
        for row in rows:
            clause = CLAUSES[row[0]]
            needs = _NEEDS[clause.needs]
            cells = (clause.id, clause.level, clause.text, clause.source, clause.test, needs)
            yield f"| {' | '.join(str(cell).replace('|', '/') for cell in cells)} |\n"


def updated(page: str) -> str:
    """Return a page with its tables as they are now."""
    tables = {"clauses": "".join(_lines()), "expectations": f"\n{table_of(Expectations)}"}
    return _MARKED.sub(lambda found: f"{found['begin']}{tables[found['what']]}\n", page)


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the tables of a page, or check them; return the exit code."""
    parser = argparse.ArgumentParser(description="The tables of the page on conformance.")
    parser.add_argument("page", type=Path)
    parser.add_argument("--check", action="store_true", help="write nothing; 1 if out of date")
    given = parser.parse_args(arguments)
    text = updated(given.page.read_text(encoding="utf-8"))
    if out_of_date({given.page: text}, given.check) and given.check:
        sys.stderr.write(f"out of date; run: python -m {__spec__.name} {given.page}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())

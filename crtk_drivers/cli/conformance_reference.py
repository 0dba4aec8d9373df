"""The tables of a page of the documentation, made of the clauses and of what can be expected.

The page holds them between ``<!-- clauses -->`` or ``<!-- expectations -->`` and ``<!-- end -->``.

python -m crtk_drivers.cli.conformance_reference docs/conformance.md            # writes it
python -m crtk_drivers.cli.conformance_reference --check docs/conformance.md    # 1 if it is out of date
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

from crtk_drivers.cli.config_reference import table_of
from crtk_drivers.cli.written_files import write_or_check, writer_parser
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
    module = __spec__.name
    parser = writer_parser(module, "The tables of the page on conformance.")
    parser.add_argument("page", type=Path)
    options = parser.parse_args(arguments)
    texts = {options.page: updated(options.page.read_text(encoding="utf-8"))}
    return write_or_check(texts, only_check=options.check, module=module, given=texts)


if __name__ == "__main__":
    sys.exit(main())

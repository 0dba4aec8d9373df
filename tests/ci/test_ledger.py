"""The ledger of unsteady tests names tests that exist, and none comes a third time unmended."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from unittest.mock import patch

import pytest

TESTS = Path(__file__).parents[1]

with patch.object(sys, "path", [str(TESTS.parent / ".ci"), *sys.path]):
    import ledger

ROWS = ledger.read(ledger.LEDGER.read_text())
AT_MOST_OPEN = 50
ONCE = ledger.Row("wire/test_a.py::test_b", ("2026-11-29, load 5, waited 40%",), "open", "")
TWICE = ledger.Row("wire/test_a.py::test_c", ("2026-11-28", "2026-11-29"), "open", "")


def test_it_has_a_row_for_each_line() -> None:
    table = [line for line in ledger.LEDGER.read_text().splitlines() if line.startswith("|")]
    assert len(table) == 2 + len(ROWS)
    assert len({row.test for row in ROWS}) == len(ROWS), "one row a test"


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.test)
def test_each_row_names_a_test_that_exists(row: ledger.Row) -> None:
    file, _, function = row.test.partition("::")
    assert re.search(rf"^def {function}\(", (TESTS / file).read_text(), re.MULTILINE)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.test)
def test_each_row_says_when_and_why(row: ledger.Row) -> None:
    for sighting in row.seen:
        assert re.match(r"20\d\d-\d\d(-\d\d)?, ", sighting)
    assert row.cause
    assert row.cause != "open" or not row.mended


def test_no_third_time_without_a_mend() -> None:
    assert not [row.test for row in ROWS if len(row.seen) > ledger.AT_MOST and not row.mended]


def test_few_rows_are_open() -> None:
    assert sum(row.cause == "open" for row in ROWS) <= AT_MOST_OPEN


@pytest.mark.parametrize(
    ("test", "said"),
    [
        (
            "tests/wire/test_a.py::test_new",
            "add to tests/UNSTEADY.md: | `wire/test_a.py::test_new` | NOW | open | |",
        ),
        (
            "tests/wire/test_a.py::test_b[case-3]",
            "add to its row in tests/UNSTEADY.md: <br>NOW, case-3",
        ),
        (
            "tests/wire/test_a.py::test_c",
            "mend it or mark it slow, it came 2 times before; "
            "then add to its row in tests/UNSTEADY.md: <br>NOW",
        ),
    ],
)
def test_an_unsteady_test_is_counted(test: str, said: str) -> None:
    assert ledger.advice(test, "NOW", [ONCE, TWICE]) == said

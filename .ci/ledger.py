"""Read the ledger of unsteady tests, tests/UNSTEADY.md, and say what an unsteady test adds to it."""

from dataclasses import dataclass
from pathlib import Path

LEDGER = Path(__file__).parents[1] / "tests" / "UNSTEADY.md"
AT_MOST = 2
"""Times that a test may be unsteady before it is mended or marked slow."""


@dataclass(frozen=True)
class Row:
    """What the ledger knows of one test function.

    Attributes:
        test: its file, below tests/, and its name, without parameters.
        seen: when it was unsteady, and on what machine: one entry each time.
        cause: what made it fail; "open" while nobody knows.
        mended: what was changed; empty while nothing was.
    """

    test: str
    seen: tuple[str, ...]
    cause: str
    mended: str


def read(text: str) -> list[Row]:
    """Return the rows of the ledger's table.

    Raises:
        ValueError: a row of the table does not have four cells.
    """
    lines = [line for line in text.splitlines() if line.startswith("| `")]
    return [row(line) for line in lines]


def row(line: str) -> Row:
    """Return one row of the table."""
    test, seen, cause, mended = (cell.strip() for cell in line.strip("|").split("|"))
    return Row(test.strip("`"), tuple(seen.split("<br>")), cause, mended)


def advice(test: str, sighting: str, rows: list[Row]) -> str:
    """Return what to do in the ledger after a test, given by its node id, was unsteady once more."""
    function, _, case = test.removeprefix("tests/").partition("[")
    entry = f"{sighting}, {case.removesuffix(']')}" if case else sighting
    known = next((row for row in rows if row.test == function), None)
    if known is None:
        return f"add to tests/UNSTEADY.md: | `{function}` | {entry} | open | |"
    add = f"add to its row in tests/UNSTEADY.md: <br>{entry}"
    times = len(known.seen)
    if times < AT_MOST:
        return add
    return f"mend it or mark it slow, it came {times} times before; then {add}"

"""The table of faults F1 to F20 by each driver that has a rig, at its simulator: met, judged, measured.

Runs every way in which a driver meets a fault in everything that its arm can do; with --part, what CI runs.
Prints each cell and a summary; with --write the sections of docs/reliability.md of the drivers that were run.
"""

from __future__ import annotations

import argparse
import logging
import sys
import time
from collections import defaultdict
from datetime import UTC, datetime

from bench.reliability import page
from bench.reliability.page import Tally
from bench.reliability.procedures import Result, run
from bench.reliability.rig import Rig
from bench.reliability.rigs import RIGS
from bench.reliability.table import FAULTS, Cell, covering, full
from bench.report import machine


class Session:
    """Runs cells of one driver, with another simulator after one that failed."""

    def __init__(self, rig: type[Rig]) -> None:
        self._make = rig
        self._rig: Rig | None = None

    def run(self, cell: Cell) -> Result:
        """Run one cell; see `bench.reliability.procedures.run`."""
        if self._rig is None:
            self._rig = self._make().__enter__()
        try:
            return run(self._rig, cell)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """End driver and simulator."""
        rig, self._rig = self._rig, None
        if rig is not None:
            try:
                rig.__exit__(None, None, None)
            except Exception as error:
                print(f"    closing it: {error}")


def options() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--driver", action="append", choices=list(RIGS), help="only this one; may be repeated"
    )
    parser.add_argument(
        "--fault",
        action="append",
        choices=[fault.number for fault in FAULTS],
        help="only this one; may be repeated",
    )
    parser.add_argument("--activity", action="append", help="only this one; may be repeated")
    parser.add_argument(
        "--rounds", type=int, default=1, help="how often each cell is run (default: 1)"
    )
    parser.add_argument("--part", action="store_true", help="the part that CI runs")
    parser.add_argument("--write", action="store_true", help=f"write {page.PAGE.name}")
    return parser.parse_args()


def measure(rig: type[Rig], given: argparse.Namespace) -> dict[tuple[str, str], Tally]:
    """Run the cells of one driver, print each, and return what came of each way."""
    table = (rig.name, rig.ways, rig.activities)
    cells = covering(*table, thorough=rig.thorough) if given.part else full(*table)
    wanted = [
        cell
        for cell in cells
        if (not given.fault or cell.way.fault in given.fault)
        and (not given.activity or cell.activity in given.activity)
    ]
    tallies: dict[tuple[str, str], Tally] = defaultdict(Tally)
    session = Session(rig)
    try:
        for cell in wanted * given.rounds:
            tally = tallies[cell.way.fault, cell.way.name]
            tally.ran += 1
            try:
                result = session.run(cell)
            except Exception as error:
                tally.failed.append(f"{cell.activity}: {error}")
                known = cell.way.finding(cell.activity)
                why = f"known: {known}" if known else type(error).__name__
                print(f"FAILED  {cell.name} ({why}): {error}", flush=True)
                continue
            for kept, value in (
                (tally.told, result.told),
                (tally.stood, result.stood),
                (tally.way, result.way),
            ):
                if value is not None:
                    kept.append(value)
            print(f"ok      {cell.name}: {_told(result)}", flush=True)
    finally:
        session.close()
    return tallies


def _told(result: Result) -> str:
    parts = [result.state]
    if result.told is not None:
        parts.append(f"told after {1000 * result.told:.0f} ms")
    if result.stood is not None:
        parts.append(f"stands after {1000 * result.stood:.0f} ms")
    if result.way is not None:
        parts.append(f"went {result.way:.3f}")
    return ", ".join(parts)


def main() -> int:
    """Run, print, write; 1 if a cell failed that no finding explains."""
    given = options()
    logging.disable(logging.CRITICAL)
    measured: dict[str, str] = {}
    failed = 0
    for name in given.driver or list(RIGS):
        began = time.monotonic()
        tallies = measure(RIGS[name], given)
        ran = sum(tally.ran for tally in tallies.values())
        lost = sum(len(tally.failed) for tally in tallies.values())
        failed += lost
        which = "the part that CI runs" if given.part else "every cell"
        how = (
            f"{ran} faults injected on {datetime.now(UTC):%Y-%m-%d} ({which}, {given.rounds} rounds), "
            f"{lost} cells failed, {(time.monotonic() - began) / 60.0:.0f} min. {machine()}."
        )
        measured[name] = page.section(RIGS[name], tallies, how)
        print(f"\n{measured[name]}\n", flush=True)
    if given.write:
        old = page.PAGE.read_text() if page.PAGE.exists() else ""
        page.PAGE.write_text(page.compose(old, measured))
        print(f"written: {page.PAGE}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())

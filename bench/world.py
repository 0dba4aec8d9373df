"""Searches for faults of drivers: thousands of seeds, each a device at its simulator in a simulated world.

A seed decides all that happens in its world: what the user does, which fault comes when, and which thread
goes on. Time is virtual, so a world takes a fraction of its time, and a seed always ends in the same way.
Judges look at where the simulator's joints really are. What they find is a broken promise of the driver,
of its simulator or of the judges; it is reduced to the troubles that it needs, and printed as a story with
the command that runs it again.

    python -m bench.world                                  every device and scenario, for a minute
    python -m bench.world --hours 8 --write                over night; then the table in docs/reliability.md
    python -m bench.world --device ur --scenario die --seeds 1:1000
    python -m bench.world --replay ur die 17               what happens in that seed
    python -m bench.world --replay ur die 17 --without 0-3,7 --trace /tmp/17.txt

The search goes on after a finding. Ctrl-C ends it with the summary. The exit code is 1 if anything was found.
"""

from __future__ import annotations

import argparse
import itertools
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from bench.reliability import page, world_table
from bench.reliability.world_table import Tally
from bench.reliability.worlds import DEVICES, FILE, SCENARIOS, Case, Runner, shrunk, story
from bench.report import machine, show
from crtk_drivers.testing.world import Outcome, WorldError
from crtk_drivers.testing.world.world_outcome import numbers

A_MINUTE: Final = 1.0 / 60.0
_REWRITTEN: Final = 0.5
_LINE_EVERY: Final = 60.0
_NOT_RUN: Final = "no outcome"
"""Kind of what is found where a world hangs or its process dies."""


@dataclass(frozen=True)
class Result:
    """What came of a case: an outcome, or why there is none; and its story, of the first of its kind."""

    case: Case
    outcome: Outcome | None
    why: str = ""
    story: str = ""


class Searcher:
    """Runs cases in several processes, and reduces the first finding of each kind.

    Args:
        cases: what to run, in this order.
        workers: how many at a time.
        file: that has the scenarios.
    """

    def __init__(self, cases: Iterable[Case], workers: int, file: Path = FILE) -> None:
        self._results: queue.SimpleQueue[Result] = queue.SimpleQueue()
        self._cases = iter(cases)
        self._lock = threading.Lock()
        self._known: set[tuple[str, str, str]] = set()
        self._stopping = threading.Event()
        self._runners = [Runner(file=file) for _ in range(workers)]
        self._threads = [
            threading.Thread(target=self._work, args=(each,), daemon=True) for each in self._runners
        ]
        for thread in self._threads:
            thread.start()

    @property
    def running(self) -> bool:
        """Whether anything may still come."""
        return any(thread.is_alive() for thread in self._threads) or not self._results.empty()

    def next(self, timeout: float) -> Result | None:
        """Return what came next, None if nothing came within `timeout` s."""
        try:
            return self._results.get(timeout=timeout)
        except queue.Empty:
            return None

    def finish(self) -> None:
        """Begin no more cases; what runs comes to its end."""
        self._stopping.set()

    def abort(self) -> None:
        """End at once."""
        self._stopping.set()
        for runner in self._runners:
            runner.kill()
        for thread in self._threads:
            thread.join(5.0)

    def _draw(self) -> Case | None:
        with self._lock:
            return None if self._stopping.is_set() else next(self._cases, None)

    def _is_new(self, case: Case, kinds: Iterable[str]) -> bool:
        found = {(case.device, case.scenario, kind) for kind in kinds}
        with self._lock:
            is_new = not found <= self._known
            self._known |= found
        return is_new

    def _work(self, runner: Runner) -> None:
        with runner:
            while (case := self._draw()) is not None:
                try:
                    outcome = runner.run(case)
                except WorldError as error:
                    if not self._stopping.is_set():
                        self._results.put(Result(case, None, str(error)))
                    continue
                told = ""
                if outcome.findings and self._is_new(case, outcome.kinds):
                    told = self._reduced(runner, case, outcome)
                self._results.put(Result(case, outcome, story=told))

    @staticmethod
    def _reduced(runner: Runner, case: Case, outcome: Outcome) -> str:
        try:
            return story(case, shrunk(runner, case, outcome))
        except WorldError:  # without some of its troubles it hangs
            return story(case, outcome)


@dataclass
class Search:
    """What a search has found by now, of each device."""

    began: float = field(default_factory=time.monotonic)
    tallies: dict[str, Tally] = field(default_factory=dict)
    found: Counter[tuple[str, str, str]] = field(default_factory=Counter)
    first: dict[tuple[str, str, str], str] = field(default_factory=dict)

    def add(self, result: Result) -> str:
        """Count a result; return what is to be printed of it."""
        case, outcome = result.case, result.outcome
        tally = self.tallies.setdefault(case.device, Tally())
        tally.worlds += 1
        if outcome is not None:
            tally.virtual += outcome.virtual
            tally.cpu += outcome.cpu
            tally.struck += Counter(outcome.struck)
        kinds = outcome.kinds if outcome is not None else {_NOT_RUN}
        for kind in kinds:
            key = (case.device, case.scenario, kind)
            self.found[key] += 1
            self.first.setdefault(key, case.command())
            tally.kinds.add((case.scenario, kind))
        if outcome is None:
            return f"NO OUTCOME {case}: {result.why}\n{case.command()}"
        if result.story:
            return f"FOUND {result.story}\n"
        return f"again {', '.join(sorted(kinds))}: {case.command()}" if kinds else ""

    def line(self) -> str:
        """Return the progress in one line."""
        real = time.monotonic() - self.began
        worlds = sum(tally.worlds for tally in self.tallies.values())
        virtual = sum(tally.virtual for tally in self.tallies.values())
        return (
            f"{real / 60.0:.1f} min: {worlds} worlds, {virtual / 3600.0:.2f} h virtual "
            f"({virtual / max(real, 1e-9):.1f} times real time), {len(self.found)} kinds of findings in "
            f"{sum(self.found.values())} worlds"
        )

    def summary(self) -> None:
        """Print what came of it."""
        rows = [
            [
                name,
                str(tally.worlds),
                f"{tally.virtual / 3600.0:.3f}",
                f"{tally.cpu / 3600.0:.3f}",
                str(tally.faults),
                str(len(tally.kinds)),
            ]
            for name, tally in sorted(self.tallies.items())
        ]
        notes = [self.line()]
        notes += [
            f"{count} x {device} {scenario}, {kind}: {self.first[device, scenario, kind]}"
            for (device, scenario, kind), count in sorted(self.found.items())
        ]
        show(
            "Simulated worlds",
            ("device", "worlds", "virtual h", "CPU h", "faults", "kinds of findings"),
            rows,
            notes,
        )


class Progress:
    """One line that is rewritten in a terminal, or a line a minute elsewhere."""

    def __init__(self) -> None:
        self._rewrites = sys.stdout.isatty()
        self._due = time.monotonic()

    def show(self, text: str) -> None:
        """Show how far it is, if it is time."""
        if time.monotonic() < self._due:
            return
        self._due = time.monotonic() + (_REWRITTEN if self._rewrites else _LINE_EVERY)
        if self._rewrites:
            width = max(1, os.get_terminal_size().columns - 1)
            print(f"\r\x1b[K{text[:width]}", end="", flush=True)
        else:
            print(text, flush=True)

    def print(self, text: str) -> None:
        """Print something that stays."""
        self.clear()
        print(text, flush=True)

    def clear(self) -> None:
        """Remove the line."""
        if self._rewrites:
            print("\r\x1b[K", end="", flush=True)


def options(words: Sequence[str] | None = None) -> argparse.Namespace:
    """Parse the command line, or `words` in its place."""
    parser = argparse.ArgumentParser(
        prog="python -m bench.world",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    search = parser.add_argument_group("the search")
    search.add_argument(
        "--hours",
        type=float,
        help="how long, in real time (default: a minute; with --seeds, until they are done)",
    )
    search.add_argument(
        "--device", action="append", choices=DEVICES, help="only this one; may be repeated"
    )
    search.add_argument(
        "--scenario", action="append", choices=SCENARIOS, help="only this one; may be repeated"
    )
    search.add_argument(
        "--seeds",
        type=_seeds,
        metavar="FIRST:COUNT",
        help="of each device and scenario (default: new ones, from the time of day, without end)",
    )
    search.add_argument(
        "--workers",
        type=_at_least_one,
        default=len(os.sched_getaffinity(0)),
        help="worlds at a time (default: one for each core)",
    )
    search.add_argument(
        "--write", action="store_true", help=f"write the result into docs/{page.PAGE.name}"
    )
    replay = parser.add_argument_group("one seed")
    replay.add_argument(
        "--replay", nargs=3, metavar=("DEVICE", "SCENARIO", "SEED"), help="print its whole story"
    )
    replay.add_argument(
        "--without",
        type=numbers,
        default=[],
        metavar="NUMBERS",
        help="of troubles that are left out, as 0-3,7",
    )
    replay.add_argument(
        "--trace",
        type=Path,
        metavar="FILE",
        help="write each choice of the scheduler and each packet there, to compare two runs",
    )
    both = parser.add_argument_group("both")
    both.add_argument("--fair", action="store_true", help="no bad weather and no faults")
    both.add_argument(
        "--bug",
        default="",
        metavar="NAME",
        help="plant a mistake first, a function of tests/world/planted.py",
    )
    given = parser.parse_args(words)
    if given.write and (given.replay or given.bug or given.fair):
        parser.error("--write is for a search, without --bug and --fair")
    if (given.without or given.trace) and not given.replay:
        parser.error("--without and --trace belong to --replay")
    if given.replay:
        device, scenario, seed = given.replay
        if device not in DEVICES:
            parser.error(f"--replay: there is no device {device}; there are {', '.join(DEVICES)}")
        if scenario not in SCENARIOS:
            parser.error(f"--replay: there is no scenario {scenario}: {', '.join(SCENARIOS)}")
        if device not in SCENARIOS[scenario]:
            parser.error(f"--replay: {scenario} is for {', '.join(SCENARIOS[scenario])}")
        if not seed.isdecimal():
            parser.error(f"--replay: a seed is a number, not {seed}")
    return given


def _seeds(text: str) -> range:
    first, _, count = text.partition(":")
    return range(int(first), int(first) + int(count or 1))


def _at_least_one(text: str) -> int:
    if (number := int(text)) < 1:
        raise ValueError
    return number


def cases(given: argparse.Namespace) -> Iterator[Case]:
    """Return what to run: each seed with each device and scenario, before the next seed."""
    seeds: Iterable[int] = given.seeds or itertools.count(int(time.time()))
    for seed in seeds:
        for device in given.device or DEVICES:
            for scenario in given.scenario or SCENARIOS:
                if device not in SCENARIOS[scenario]:
                    continue
                yield Case(device, scenario, seed, not given.fair, given.bug)


def replay(given: argparse.Namespace) -> int:
    """Run one seed, and print its story; 1 if something was found."""
    device, scenario, seed = given.replay
    case = Case(device, scenario, int(seed), not given.fair, given.bug)
    log = str(given.trace.resolve()) if given.trace else ""
    with Runner() as runner:
        try:
            outcome = runner.run(case, given.without, log)
        except WorldError as error:
            print(f"{case}: {error}")
            return 1
    print(f"{case}\n{outcome.told(len(outcome.story))}")
    return 1 if outcome.findings else 0


def look(given: argparse.Namespace) -> int:
    """Search, print what is found and a summary, and write; 1 if something was found."""
    hours = A_MINUTE if given.hours is None and given.seeds is None else given.hours
    end = float("inf") if hours is None else time.monotonic() + 3600.0 * hours
    search, progress, commit = Search(), Progress(), _commit()
    searcher = Searcher(cases(given), given.workers)
    try:
        while searcher.running:
            result = searcher.next(_REWRITTEN)
            if result is not None and (text := search.add(result)):
                progress.print(text)
            progress.show(search.line())
            if time.monotonic() > end:
                searcher.finish()
    except KeyboardInterrupt:
        progress.print("interrupted")
    finally:
        searcher.abort()
        progress.clear()
    search.summary()
    if given.write:
        told = world_table.section(
            page.PAGE.read_text(),
            search.tallies,
            f"{datetime.now(UTC):%Y-%m-%d}",
            commit,
            machine(),
        )
        page.PAGE.write_text(page.with_worlds(page.PAGE.read_text(), told))
        print(f"written: {page.PAGE}")
    return 1 if search.found else 0


def _commit() -> str:
    """Return the commit that is searched."""
    told = ["git", "-C", str(page.PAGE.parent), "describe", "--always", "--dirty"]
    return subprocess.run(told, check=True, capture_output=True, text=True).stdout.strip()


def main() -> int:
    """Search, or run one seed."""
    given = options()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    return replay(given) if given.replay else look(given)


if __name__ == "__main__":
    sys.exit(main())

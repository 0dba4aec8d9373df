"""A search runs cases on several processes, goes on after findings, and writes what came of it."""

from __future__ import annotations

import time
from collections import Counter
from pathlib import Path

import pytest
from world import toys

from bench.reliability import page, world_table
from bench.reliability.world_table import Tally
from bench.reliability.worlds import Case
from bench.world import Search, Searcher, cases, options, replay

FILE = Path(toys.__file__)
LONG = 30.0


def searched(*cases: Case, workers: int = 2) -> tuple[Search, list[str]]:
    """Search the cases; return what it counts, and what it prints."""
    search, printed = Search(), []
    searcher = Searcher(cases, workers, FILE)
    while searcher.running:
        if (result := searcher.next(0.1)) is not None:
            printed.append(search.add(result))
    return search, [text for text in printed if text]


def test_search_goes_on_after_findings() -> None:
    search, printed = searched(*(Case("toy", "broken", seed, wild=False) for seed in range(20)))
    assert search.tallies["toy"].worlds == 20
    assert set(search.found) == {("toy", "broken", "the toy is lost")}
    assert 20 > search.found.total() > 1
    told = next(text for text in printed if text.startswith("FOUND toy broken"))
    assert "2 of 10 troubles" in told
    assert "python -m bench.world --replay toy broken" in told
    assert "--fair --without " in told
    others = [text.partition(":")[0] for text in printed if text != told]
    assert others == ["again the toy is lost"] * (search.found.total() - 1)
    assert search.tallies["toy"].faults > 5


def test_search_goes_on_where_a_world_cannot_run() -> None:
    search, printed = searched(Case("toy", "unknown", 1), Case("toy", "quiet", 1), workers=1)
    assert search.found == {("toy", "unknown", "no outcome"): 1}
    assert search.tallies["toy"].worlds == 2
    assert "NO OUTCOME toy unknown 1" in printed[0]
    assert "has no function 'unknown'" in printed[0]


def test_search_is_aborted_in_a_hung_world() -> None:
    searcher = Searcher([Case("toy", "quiet", 1), Case("toy", "hangs", 1)], 1, FILE)
    assert searcher.next(LONG) is not None
    began = time.monotonic()
    searcher.abort()
    assert not searcher.running
    assert time.monotonic() - began < 5.0


def test_replay_is_the_command_of_a_case() -> None:
    case = Case("ur", "die", 7, wild=False, bug="stop_is_lost")
    assert case.command([0, 1, 2, 9]) == (
        "python -m bench.world --replay ur die 7 --fair --bug stop_is_lost --without 0-2,9"
    )


def test_replay_prints_the_story_and_writes_the_trace(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    trace = tmp_path / "trace.txt"
    given = options(["--replay", "robotiq", "farewell", "1", "--trace", str(trace)])
    assert replay(given) == 0
    told = capsys.readouterr().out
    assert told.startswith("robotiq farewell 1\nseed 1: done after ")
    assert "driver/main" in told
    assert "is ENABLED" in told
    assert len(trace.read_text().splitlines()) > 100


@pytest.mark.parametrize(
    ("words", "why"),
    [
        ("--replay sofa die 1", "there is no device sofa"),
        ("--replay ur sleep 1", "there is no scenario sleep"),
        ("--replay ur die x", "a seed is a number"),
        ("--without 1", "belong to --replay"),
        ("--seeds x", "--seeds"),
        ("--workers 0", "--workers"),
        ("--write --fair", "--write is for a search"),
    ],
)
def test_command_says_what_is_wrong(
    words: str, why: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        options(words.split())
    assert ended.value.code == 2
    assert why in capsys.readouterr().err


def test_seeds_are_run_by_each_device_and_scenario() -> None:
    words = "--device ur --device galil --scenario die --seeds 5:2 --fair"
    given = options(words.split())
    assert list(map(str, cases(given))) == [
        "ur die 5 fair", "galil die 5 fair", "ur die 6 fair", "galil die 6 fair"
    ]  # fmt: skip


def test_table_keeps_devices_that_were_not_run() -> None:
    first = Tally(worlds=3, virtual=7200.0, struck=Counter({"block": 2, "datagrams are lost": 1}))
    old = page.with_worlds(
        page.PAGE.read_text(), world_table.section("", {"a": first}, "d1", "c1", "m")
    )
    second = Tally(worlds=4, virtual=3600.0, struck=Counter({"block": 5}), kinds={("use", "lost")})
    new = page.with_worlds(old, world_table.section(old, {"b": second}, "d2", "c2", "m"))
    rows = [line for line in page.parts(new)[page.WORLDS].splitlines() if line.startswith("| ")]
    assert rows[2].startswith("| a | d1 | c1 | 3 | 2.00 | 2 |")
    assert rows[3].startswith("| b | d2 | c2 | 4 | 1.00 | 5 |")
    assert rows[4].startswith("| **in all** |  |  | 7 | 3.00 | 7 |")
    assert rows[4].endswith("| 1 | 1 |")
    assert len(rows) == 5


def test_faults_and_worlds_keep_each_other_on_the_page() -> None:
    old = page.PAGE.read_text()
    new = page.with_worlds(old, f"{page.WORLDS}\n\nnew")
    assert page.parts(new).keys() == page.parts(old).keys()
    assert page.parts(new)[page.WORLDS].endswith("new")
    assert page.compose(new, {}) == new
    assert page.with_worlds(new, page.parts(old)[page.WORLDS]) == old

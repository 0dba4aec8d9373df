"""Findings are reduced to the troubles that they need and told as stories; a world may hang."""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import cache
from itertools import count, islice
from pathlib import Path

import pytest
from world import toys

from crtk_drivers.testing.world import Host, Outcome, WorldError, run, shrink
from crtk_drivers.testing.world.world_outcome import numbers, ranges

FAILING = 4
"""Seeds that are looked at: more than one pair of troubles may lead to the finding of one."""


@cache
def failing() -> list[Outcome]:
    """Return the first outcomes with a finding."""
    found = (run(toys.broken, seed) for seed in count())
    return list(islice((each for each in found if each.findings), FAILING))


@cache
def reduced(number: int) -> Outcome:
    outcome = failing()[number]

    def rerun(without: Sequence[int]) -> Outcome:
        return run(toys.broken, outcome.seed, without=list(without))

    return shrink(rerun, outcome)


@pytest.mark.parametrize("number", range(FAILING))
def test_ten_troubles_are_reduced_to_two(number: int) -> None:
    outcome, found = failing()[number], reduced(number)
    assert outcome.troubles == found.troubles == toys.TROUBLES
    assert len(found.kept) == 2
    assert found.kinds == outcome.kinds == {"the toy is lost"}
    assert found.struck["step clock"] == 1
    for trouble in found.kept:
        rest = sorted({*found.without, trouble})
        assert not run(toys.broken, found.seed, without=rest).findings, f"it needs no {trouble}"


def test_what_is_found_in_fair_weather_needs_none() -> None:
    def rerun(without: Sequence[int]) -> Outcome:
        return run(toys.broken, 1, before="break_at_once", without=list(without))

    assert shrink(rerun, rerun([])).kept == []


def test_troubles_that_come_instead_go_too() -> None:
    found = next(
        each for each in (run(toys.wanders, seed) for seed in count()) if each.troubles == 3
    )

    def rerun(without: Sequence[int]) -> Outcome:
        return run(toys.wanders, found.seed, without=list(without))

    assert found.findings
    assert rerun([0]).troubles == 7
    assert shrink(rerun, found).kept == [2]


def test_equal_seeds_give_equal_stories() -> None:
    first, second, *_ = failing()
    again = run(toys.broken, first.seed)
    assert (again.story, again.hash) == (first.story, first.hash)
    assert again.told() == first.told()
    assert second.told() != again.told()


def test_story_names_time_thread_and_event() -> None:
    outcome = reduced(0)
    head, left_out, *events, found, more = outcome.told().splitlines()
    assert head.startswith(f"seed {outcome.seed}: the toy is lost after {outcome.virtual:.3f} s")
    assert "2 of 10 troubles" in head
    assert left_out == f"without the troubles {ranges(outcome.without)}"
    shown = [event.split()[2:4] for event in events if "TROUBLE" in event]
    assert sorted(shown) == [["TROUBLE", f"[{number}]"] for number in outcome.kept]
    assert any(event.split()[1:4] == ["s", "main/io", "toy"] for event in events)
    assert found.startswith(f"{outcome.findings[0].at:9.4f} s  FOUND ")
    assert "the toy is lost: nothing came" in found
    assert more.index("and the clock") == found.index("the toy is lost")


def test_what_a_program_logs_is_in_the_story() -> None:
    lines = [line for line in failing()[0].story if line.text == "WARNING the clock was set"]
    assert [line.who for line in lines] == ["main/io toy"]


def test_story_begins_where_it_is_cut() -> None:
    outcome = failing()[0]
    told = outcome.told(last=1).splitlines()
    assert told[1] == f"({len(outcome.story) - 1} lines before)"
    assert told[2].startswith(f"{outcome.story[-1].at:9.4f} s")


def test_ranges_can_be_read_again() -> None:
    assert ranges([7, 3, 0, 1, 2, 9]) == "0-3,7,9"
    assert numbers("0-3,7,9") == [0, 1, 2, 3, 7, 9]
    assert numbers(ranges([])) == []
    with pytest.raises(ValueError, match="invalid"):
        numbers("all")


def test_hanging_world_is_named_and_next_runs() -> None:
    assert run(toys.quiet, 1).over == "done"
    with pytest.raises(WorldError, match=r"not done in 0\.5 s of real time: it computes for ever"):
        run(toys.hangs, 1, patience=0.5)
    assert run(toys.quiet, 2).over == "done"


@pytest.mark.timeout(30)
def test_killed_host_leaves_no_world_behind(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with Host(Path(toys.__file__)) as host:
        host.ask("hangs", 1, arguments=[str(pipe)])
        with pipe.open("w"):  # waits until the world reads it
            host.kill()
            assert os.read(host.fileno(), 1) == b"", "the world has the other end of this pipe"
        with pytest.raises(WorldError, match="has ended"):
            host.answer()

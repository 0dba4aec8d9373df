"""Ways to follow positions: the lines of each, and what they add up to."""

from __future__ import annotations

import math
import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crtk_driver_galil.record import AxisRecord, Record
from crtk_driver_galil.tracking import PositionTracking, PvtPieces, StopAndGo, by_axes
from rigs.examples import examples

FAST = [1e6, 1e6]
PIECE = re.compile(r"PV([A-H])=(-?\d+),(-?\d+),(\d+)")


def record(sample: int, *references: int, moving: bool = False, code: int = 30) -> Record:
    status = 0x8000 if moving else 0
    axes = {
        letter: AxisRecord(status, 0, code, place, place, 0, 0.0, 0.0)
        for letter, place in zip("BD", references, strict=True)
    }
    return Record(sample & 0xFFFF, 0, 0, axes)


@pytest.mark.parametrize(
    ("letters", "values", "text"),
    [("A", [5], "5"), ("BD", [10, -3], ",10,,-3"), ("DB", [1, 2], ",2,,1")],
)
def test_operands_by_axes(letters: str, values: list[int], text: str) -> None:
    assert by_axes(letters, values) == text


def test_position_tracking_begins_where_the_axes_stand() -> None:
    """An old PA would be the first goal of PT."""
    way = PositionTracking("BD")
    here = record(0, 7, 8)
    assert way.lines([10, 20], here) == ["PA ,7,,8", "PT ,1,,1", "PA ,10,,20"]
    assert way.lines([10, 20], here) == []
    assert way.lines([11, 20], here) == ["PA ,11,,20"]
    way.reset()
    assert way.lines([11, 20], here)[1] == "PT ,1,,1"


def test_stop_and_go_waits_until_the_axes_rest() -> None:
    way = StopAndGo("BD")
    assert way.lines([10, 0], record(0, 0, 0)) == ["PA ,10,,0", "BG B"]
    assert way.lines([12, 0], record(4, 0, 0)) == []  # not seen yet
    assert way.lines([12, 0], record(40, 5, 0, moving=True)) == []
    assert way.lines([12, 5], record(60, 10, 0)) == ["PA ,12,,5", "BG BD"]
    assert way.lines([12, 5], record(100, 12, 5)) == []


def streamed(cycles: list[int], lead: int = 3, start: int = 65_000) -> list[tuple[int, int, int]]:
    """Follow a sine in cycles of so many samples; the pieces of axis B."""
    way, sample = PvtPieces("BD", FAST, 16, lead), start
    pieces = []
    for cycle in cycles:
        sample += cycle
        goal = round(10_000 * math.sin((sample - start) * 0.005))
        for line in way.lines([goal, 0], record(sample, 0, 0)):
            found = PIECE.fullmatch(line)
            if found is not None and found[1] == "B":
                pieces.append((int(found[2]), int(found[3]), int(found[4])))
    assert way.restarts == 0
    return pieces


def test_pieces_begin_by_standing_and_are_started_once() -> None:
    way = PvtPieces("BD", FAST, 17, 2)
    lines = way.lines([100, 0], record(10, 0, 0))
    assert lines == ["PVB=0,0,16", "PVD=0,0,16"] * 2 + ["BT BD"]
    assert way.lines([100, 0], record(12, 0, 0)) == ["PVB=100,6250,16", "PVD=0,0,16"]


@settings(max_examples=examples(30))
@given(st.lists(st.integers(1, 14), min_size=60, max_size=60))
def test_pieces_are_on_the_way_whenever_a_cycle_comes(cycles: list[int]) -> None:
    """Each ends where the sine was when it was due, though cycles come as they like."""
    at, time = 0, -3 * 16
    for way, _, samples in streamed(cycles):
        at += way
        time += samples
        if time > 0:
            due = (
                max(0, time - 16) + cycles[0]
            )  # one piece later; the first cycle has begun the clock
            assert at == pytest.approx(10_000 * math.sin(due * 0.005), abs=10)


@settings(max_examples=examples(30))
@given(st.lists(st.integers(1, 14), min_size=50, max_size=50))
def test_so_many_pieces_wait_and_not_more(cycles: list[int]) -> None:
    sent = sum(samples for _, _, samples in streamed(cycles))
    ahead = sent - (sum(cycles) - cycles[0])
    assert 3 * 16 <= ahead < 4 * 16


def test_a_buffer_that_ran_empty_is_begun_anew() -> None:
    way = PvtPieces("BD", FAST, 16, 2)
    way.lines([0, 0], record(0, 0, 0))
    assert way.restarts == 0
    lines = way.lines([500, 0], record(60, 3, 4))
    assert way.restarts == 1
    assert lines[-1] == "BT BD"


def test_what_is_behind_after_that_catches_up_no_faster_than_it_may() -> None:
    """Else it would go in one piece where the stream is by now."""
    way, sample = PvtPieces("BD", [10_000.0, 10_000.0], 16, 2), 0
    way.lines([0, 0], record(0, 0, 0))
    at = []
    for _ in range(60):
        sample += 60 if not sample else 10
        for line in way.lines([5000, -50], record(sample, 3, 4)):
            found = PIECE.fullmatch(line)
            if found is not None and found[1] == "B":
                assert abs(int(found[2])) <= 160
                assert abs(int(found[3])) <= 10_000
                at.append(int(found[2]))
    assert way.restarts == 1
    assert sum(at) == 5000 - 3, "it arrives"


def test_a_reset_forgets() -> None:
    way = PvtPieces("BD", FAST, 16, 2)
    way.lines([0, 0], record(0, 0, 0))
    way.reset()
    assert way.lines([500, 0], record(4, 0, 0))[-1] == "BT BD"
    assert way.restarts == 0

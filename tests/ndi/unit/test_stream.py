"""Frames: told once, counted, stamped with when they were taken, asked for when they are due."""

import struct
from collections.abc import Callable

import numpy as np
import pytest

from crtk_driver_ndi.codec import Reply
from crtk_driver_ndi.stream import FrameStream
from crtk_drivers.kit import BadData

RATE = 60.0


def take(stream: FrameStream, reply: Reply, at: float, held_back: float = 0.0) -> bool:
    """Let a question be answered at once, and its reply come so much later."""
    return stream.take(reply, at, at + held_back)


def bx(number: int) -> Reply:
    return Reply(body=struct.pack("<BBBIIH", 1, 1, 2, 0x31, number, 0))


def bx2(number: int, nanoseconds: int) -> Reply:
    tool = struct.pack("<HIHI", 2, 16, 0, 1) + struct.pack("<HH", 1, 0x11F)
    seconds, rest = divmod(nanoseconds, 1_000_000_000)
    frame = struct.pack("<BBHIII", 2, 0, 0, number, seconds, rest) + struct.pack("<HH", 1, 1) + tool
    return Reply(body=struct.pack("<HHHIHI", 1, 1, 1, 12 + len(frame), 0, 1) + frame)


def test_a_frame_is_told_once_and_those_that_were_missed_are_counted() -> None:
    stream = FrameStream(RATE, "BX")
    assert [take(stream, bx(number), 1.0 + number / RATE) for number in (3, 3, 4, 7)] == [
        True,
        False,
        True,
        True,
    ]
    assert (stream.frames, stream.repeated, stream.lost) == (3, 1, 2)


@pytest.mark.parametrize("told", [0, 3])
def test_losses_are_counted_by_the_trackers_step(told: int) -> None:
    stream = FrameStream(RATE, "BX", step=told)
    for number in (0, 3, 6, 12, 15):
        assert take(stream, bx(number), 1.0 + number / RATE)
    assert stream.lost == 1


def test_one_who_asks_too_slowly_counts_losses() -> None:
    """Each second frame is missed for good: only what the tracker tells of its steps shows that."""
    stream = FrameStream(RATE, "BX", step=1)
    for number in range(0, 20, 2):
        take(stream, bx(number), 1.0 + number / RATE)
    assert stream.lost == 9


def test_the_next_is_asked_for_a_little_early_and_then_again_and_again() -> None:
    stream = FrameStream(RATE, "BX")
    take(stream, bx(0), 10.0)
    assert stream.due == pytest.approx(10.0 + 0.95 / RATE)
    take(stream, bx(0), 10.015)
    assert stream.due == pytest.approx(10.015 + 0.02 / RATE)


def test_now_and_then_one_is_asked_for_much_earlier_to_see_when_it_is_there() -> None:
    stream, early = FrameStream(RATE, "BX"), []
    for number in range(16):
        take(stream, bx(number), 10.0 + number / RATE)
        early.append(10.0 + (number + 1) / RATE - stream.due)
    assert early == pytest.approx(2 * (7 * [0.05 / RATE] + [0.5 / RATE]))


def test_after_one_that_came_late_the_next_is_asked_for_in_time() -> None:
    """By when it was taken, not by when it came."""
    stream = FrameStream(RATE, "BX")
    for number in range(60):
        take(stream, bx(number), 10.0 + number / RATE)
    take(stream, bx(60), 11.0 + 0.6 / RATE)
    assert stream.due == pytest.approx(11.0 + 0.95 / RATE)


@pytest.mark.parametrize("with_time", [False, True])
def test_stamps_are_those_of_the_frames_and_not_of_their_late_arrivals(with_time: bool) -> None:
    """The first arrivals of many are in time; a bias of a clock that runs apart is followed."""
    random = np.random.default_rng(1)
    stream, errors = FrameStream(RATE, "BX2" if with_time else "BX"), []
    for number in range(1200):
        taken = 100.0 + number / RATE * (1.0 + 50e-6)
        late = 0.0 if number % 5 == 0 else random.uniform(0.0, 0.01)
        reply = bx2(number, 5_000_000_000 + round(number / RATE * 1e9)) if with_time else bx(number)
        assert take(stream, reply, taken + late)
        errors.append(stream.stamp.monotonic - taken)
    assert np.abs(errors[600:]).max() < 0.5e-3
    assert stream.counters["jitter_p99"] > 5e-3


def test_stamps_never_go_back_nor_are_later_than_the_arrival() -> None:
    random = np.random.default_rng(2)
    stream, before = FrameStream(RATE, "BX"), -np.inf
    for number in range(300):
        arrival = 100.0 + number / RATE + random.exponential(2e-3)
        take(stream, bx(number), arrival)
        assert before <= stream.stamp.monotonic <= arrival
        before = stream.stamp.monotonic


def test_a_count_that_begins_anew_is_followed() -> None:
    """Another client has started tracking."""
    stream = FrameStream(RATE, "BX")
    for number in range(60):
        take(stream, bx(number), 1.0 + number / RATE)
    assert take(stream, bx(0), 2.0)
    assert stream.stamp.monotonic == 2.0
    assert stream.lost == 0


@pytest.mark.parametrize(("period", "believed"), [(1 / 30, 1 / 30), (1e-7, 1e-3), (5.0, 0.2)])
def test_a_tracker_slower_than_its_family_is_asked_less_often(
    period: float, believed: float
) -> None:
    stream = FrameStream(RATE, "BX2")
    for number in range(3):
        take(stream, bx2(number, 10**18 + round(number * period * 1e9)), 1.0 + number * period)
    assert stream.due == pytest.approx(1.0 + 2 * period + 0.95 * believed)


def test_what_is_no_frame_is_refused() -> None:
    with pytest.raises(BadData):
        FrameStream(RATE, "BX").take(Reply("OKAY"), 1.0, 1.0)


@pytest.mark.parametrize("begins", [0, 120])
@pytest.mark.parametrize("late", [0.1, 0.3])
def test_replies_held_back_are_not_stamped_younger(late: float, begins: int) -> None:
    """From the beginning or in mid-stream, all by the same time; one question at a time."""
    stream, at, asked = FrameStream(RATE, "BX"), 100.0, 0
    while at < 130.0:
        number = int((at - 100.0) * RATE)
        held_back = late if number >= begins else 1e-4
        take(stream, bx(number), at, held_back)
        asked += 1
        assert stream.stamp.monotonic <= at
        assert stream.stamp.monotonic - (100.0 + number / RATE) < 1.0 / RATE
        assert stream.counters["reply_time"] == pytest.approx(held_back)
        at = max(at + held_back, stream.due)
    assert asked > 90


@pytest.mark.parametrize("held", [5, 300], ids=["at first", "later"])
@pytest.mark.parametrize("reply", [bx, lambda number: bx2(number, number * 16_666_667)])
def test_a_question_held_back_makes_no_stamp_early(
    held: int, reply: Callable[[int], Reply]
) -> None:
    stream, at, late = FrameStream(RATE, "BX2" if reply is not bx else "BX"), 100.0, 0.075
    for asked in range(held + 1):
        reached = at + (late if asked == held else 1e-4)  # the tracker
        number = int((reached - 100.0) * RATE)
        stream.take(reply(number), at, reached + 1e-4)
        at = max(at, stream.due)
    taken = 100.0 + number / RATE
    assert stream.newest is not None
    assert stream.newest.number == number
    assert stream.stamp.monotonic == pytest.approx(taken, abs=1.0 / RATE)


def test_a_first_frame_that_took_long_is_not_told() -> None:
    stream, at = FrameStream(RATE, "BX"), 100.0
    assert not stream.take(bx(5), at, at + 0.075)
    assert stream.newest is None
    at = stream.due
    assert stream.take(bx(6), at, at + 1e-4)
    assert stream.stamp.monotonic == pytest.approx(at)

"""Pacing and arbitration, in simulated time: nothing here waits."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_sim_backends.can import frames
from crtk_sim_backends.can.medium import STUFFING, Load, Medium

BITRATE = 500_000


def seconds(raw):
    return frames.exact_bits(raw) / BITRATE


def everything(medium, start=0.0):
    """All transfers, each taken when its time has come."""
    done = []
    done += medium.due(start)
    while medium.next_at is not None:
        done += medium.due(medium.next_at)
    return done


def test_a_frame_is_over_after_its_bits():
    medium = Medium(BITRATE)
    raw = frames.pack(0x123, b"abcdefgh")
    medium.put("a", raw, 1.0)
    assert medium.due(1.0) == []
    assert medium.next_at == pytest.approx(1.0 + seconds(raw), abs=1e-12)
    assert medium.due(1.0 + seconds(raw) - 1e-9) == []
    (transfer,) = medium.due(1.0 + seconds(raw) + 1e-9)
    assert (transfer.sender, transfer.raw, transfer.bits) == ("a", raw, frames.exact_bits(raw))
    assert medium.next_at is None


def test_of_those_that_wait_the_lowest_identifier_is_next():
    medium = Medium(BITRATE)
    for sender, can_id in enumerate([0x300, 0x100, 0x100 << 18 | frames.EXTENDED, 0x000, 0x200]):
        medium.put(sender, frames.pack(can_id), 0.0)
    order = [transfer.sender for transfer in everything(medium)]
    assert order == [3, 1, 2, 4, 0]


def test_a_frame_that_has_begun_is_not_interrupted():
    medium = Medium(BITRATE)
    low, high, middle = (frames.pack(number) for number in (0x700, 0x001, 0x400))
    medium.put("low", low, 0.0)
    medium.due(0.0)
    medium.put("middle", middle, 1e-6)
    medium.put("high", high, 2e-6)
    assert [transfer.raw for transfer in everything(medium, 3e-6)] == [low, high, middle]


def test_the_frames_of_one_sender_keep_their_order():
    medium = Medium(BITRATE)
    for number in (5, 4, 3):
        medium.put("a", frames.pack(number), 0.0)
    medium.put("b", frames.pack(4), 0.0)
    order = [(t.sender, frames.unpack(t.raw)[0]) for t in everything(medium)]
    assert order == [("b", 4), ("a", 5), ("a", 4), ("a", 3)]


@given(
    st.lists(
        st.tuples(st.integers(0, 4), st.integers(0, 0x7FF), st.binary(max_size=8)),
        min_size=1,
        max_size=40,
    )
)
def test_back_to_back_frames_take_the_sum_of_their_bits(entries):
    medium = Medium(BITRATE)
    raws = [frames.pack(can_id, data) for _, can_id, data in entries]
    for (sender, _, _), raw in zip(entries, raws, strict=True):
        medium.put(sender, raw, 2.0)
    done = everything(medium, 2.0)
    assert sorted(transfer.raw for transfer in done) == sorted(raws)
    bits = sum(map(frames.exact_bits, raws))
    assert medium.bits == bits
    assert done[-1].end == pytest.approx(2.0 + bits / BITRATE, abs=1e-9)
    starts = [transfer.end - transfer.bits / BITRATE for transfer in done]
    for before, start in zip(done, starts[1:], strict=False):
        assert start == pytest.approx(before.end, abs=1e-9)


def test_a_late_look_does_not_lose_bus_time():
    """The loop came late: what should have been over by then is over, one after the other."""
    medium = Medium(BITRATE)
    raws = [frames.pack(number, b"12345678") for number in range(10)]
    for raw in raws:
        medium.put("a", raw, 0.0)
    medium.due(0.0)
    enough = sum(map(seconds, raws[:7])) + 1e-9
    assert [transfer.raw for transfer in medium.due(enough)] == raws[:7]
    assert medium.waiting("a") == 2


def test_a_pause_is_not_made_up_for():
    medium = Medium(BITRATE)
    raw = frames.pack(1)
    medium.put("a", raw, 0.0)
    everything(medium)
    medium.put("a", raw, 5.0)
    (transfer,) = everything(medium, 5.0)
    assert transfer.end == pytest.approx(5.0 + seconds(raw), abs=1e-9)


def test_a_sender_that_has_gone_sends_nothing_more():
    medium = Medium(BITRATE)
    for number in (1, 2):
        medium.put("gone", frames.pack(number), 0.0)
        medium.put("here", frames.pack(0x100 + number), 0.0)
    assert medium.forget("gone") == 2
    assert [transfer.sender for transfer in everything(medium)] == ["here", "here"]
    assert medium.forget("gone") == 0


@pytest.mark.parametrize("stuffing", STUFFING)
def test_stuffing_can_be_counted_in_three_ways(stuffing):
    medium = Medium(BITRATE, stuffing)
    raw = frames.pack(0, bytes(8))
    medium.put("a", raw, 0.0)
    (transfer,) = everything(medium)
    expected = {"none": 111, "worst": 135, "exact": frames.exact_bits(raw)}
    assert transfer.bits == expected[stuffing]
    assert 111 < expected["exact"] < 135


def test_the_load_is_the_busy_share_of_the_last_second():
    load = Load()
    for tenth in range(1, 31):
        load.add(tenth / 10 - 0.01, 0.025)
    assert load.last_second(2.99) == pytest.approx(0.25)
    assert load.last_second(3.45) == pytest.approx(0.125)
    assert load.last_second(10.0) == 0.0

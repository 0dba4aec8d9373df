"""Points of a stream: where, how fast, how long; and what the buffer of a drive tells of them."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crtk_driver_copley.stream import Buffer, Point, PvtStream, delay_of
from rigs.examples import examples

PERIOD = 0.03
LEAD = 4
FAST = 1e6


class Drive:
    """What a drive does with points, by a clock of its own.

    Args:
        drift: of that clock.
        counts_current: whether the point that is carried out is still in its buffer.
    """

    places = 32

    def __init__(self, drift: float = 0.0, *, counts_current: bool = False) -> None:
        self._drift = drift
        self._current = int(counts_current)
        self.points: list[tuple[float, Point]] = []  # and when each is reached
        self.began = 0.0

    def take(self, point: Point) -> None:
        """Of one more point."""
        if self.points:
            when, last = self.points[-1]
            self.points.append((when + last.time / 1000.0 * (1.0 + self._drift), point))
        else:
            self.points.append((self.began, point))

    def free(self, now: float) -> int:
        """What it tells."""
        left = sum(when > now for when, _ in self.points)
        return self.places - left - self._current * (left < len(self.points))

    def ends(self) -> float:
        """When it is at its last point."""
        return self.points[-1][0]


def goal(now: float) -> float:
    return 10_000.0 * math.sin(2.0 * math.pi * now)


def begun(*drives: Drive, now: float = 100.0) -> PvtStream:
    stream = PvtStream([FAST] * len(drives), PERIOD, LEAD)
    stream.add(now, [0.0] * len(drives))
    for row in stream.stand([0] * len(drives)):
        for drive, point in zip(drives, row, strict=True):
            drive.began = now
            drive.take(point)
    for buffer in stream.buffers:
        buffer.capacity = Drive.places
    stream.started([now] * len(drives))
    return stream


def run(
    stream: PvtStream, drives: list[Drive], seconds: float, cycle: float = 0.02, now: float = 100.0
) -> float:
    """Stream a sine; returns the time."""
    end = now + seconds
    while now < end:
        now += cycle
        stream.add(now, [goal(now - 100.0)] * len(drives))
        for row in stream.rows(now):
            for drive, point in zip(drives, row, strict=True):
                drive.take(point)
        for drive, buffer in zip(drives, stream.buffers, strict=True):
            assert drive.ends() > now, "it ran empty"
            buffer.heard(drive.free(now), 0, now)
    return now


def fastest(points: list[tuple[float, Point]]) -> float:
    """Return how fast a drive goes along cubic pieces between points, in counts/s."""
    speeds = []
    for (begin, first), (end, second) in pairwise(points):
        time = end - begin
        way = (second.position - first.position) / time
        for share in (number / 50.0 for number in range(51)):
            slow, there = 6.0 * share * (1.0 - share), 3.0 * share**2 - 2.0 * share
            back = 1.0 - 4.0 * share + 3.0 * share**2
            speeds.append(abs(slow * way + back * first.velocity + there * second.velocity))
    return max(speeds)


@pytest.mark.parametrize("far", [0.5, 1.5, 4.0, 40.0])
def test_a_stream_that_is_far_away_is_reached_within_the_limit(far: float) -> None:
    drive, limit, now = Drive(), 10_000.0, 100.0
    goal = far * limit * PERIOD
    stream = PvtStream([limit], PERIOD, LEAD)
    stream.add(now, [goal])
    drive.began = now
    for row in stream.stand([0]):
        drive.take(row[0])
    stream.buffers[0].capacity = Drive.places
    stream.started([now])
    while not stream.has_arrived(now):
        now += 0.02
        stream.add(now, [goal])
        for row in stream.rows(now):
            drive.take(row[0])
        stream.buffers[0].heard(drive.free(now), 0, now)
        assert now < 110.0
    assert drive.points[-1][1].position == round(goal)
    assert fastest(drive.points) < 1.15 * limit


def test_it_begins_by_standing() -> None:
    stream = PvtStream([FAST], PERIOD, LEAD)
    stream.add(0.0, [5.0])
    assert stream.stand([7]) == [[Point(30, 7, 0.0)]] * (LEAD + 1)
    assert not stream.is_running
    assert stream.rows(1.0) == []


def test_points_are_where_the_setpoints_were_and_as_fast() -> None:
    drive = Drive()
    run(begun(drive), [drive], 3.0)
    for when, point in drive.points[-40:]:
        due = when - delay_of(PERIOD, LEAD) - 100.0
        assert point.position == pytest.approx(goal(due), abs=30.0)
        rate = 10_000.0 * 2.0 * math.pi * math.cos(2.0 * math.pi * due)
        assert point.velocity == pytest.approx(rate, abs=1500.0)


@settings(max_examples=examples(15))
@given(st.floats(-2e-3, 2e-3), st.booleans(), st.floats(0.005, 0.028))
def test_a_clock_that_is_fast_or_slow_is_followed(
    drift: float, counts_current: bool, cycle: float
) -> None:
    """Of a drive, however it counts: its buffer neither runs empty nor fills."""
    drive = Drive(drift, counts_current=counts_current)
    now = run(begun(drive), [drive], 20.0, cycle)
    assert (LEAD - 1.6) * PERIOD < drive.ends() - now < (LEAD + 1.6) * PERIOD


def test_drives_with_clocks_of_their_own_stay_together() -> None:
    drives = [Drive(5e-4), Drive(-5e-4)]
    run(begun(*drives), drives, 30.0)
    ends = [drive.ends() for drive in drives]
    assert abs(ends[0] - ends[1]) < PERIOD


@pytest.mark.parametrize("counts_current", [False, True])
@pytest.mark.parametrize("phase", [0.0, 0.006, 0.012, 0.018, 0.024])
def test_whether_a_point_was_taken_is_told_rightly_or_not_at_all(
    phase: float, counts_current: bool
) -> None:
    drive = Drive(counts_current=counts_current)
    stream = begun(drive)
    now = run(stream, [drive], 1.0, 0.007)
    buffer = stream.buffers[0]
    assert buffer.is_sure
    while not (rows := stream.rows(now)):
        now += 0.001
        stream.add(now, [goal(now - 100.0)])
    (point,) = rows[0]
    verdicts = set()
    for look in range(20):
        at = now + phase + 0.003 * look
        if at > drive.ends() - 0.01:
            break
        verdicts.add(buffer.has_taken(drive.free(at), 0, at))
    assert False in verdicts
    assert True not in verdicts
    drive.take(point)
    verdicts = {
        buffer.has_taken(drive.free(now + 0.003 * look), 0, now + 0.003 * look)
        for look in range(20)
    }
    assert True in verdicts
    assert False not in verdicts


def test_no_point_is_faster_than_the_joint() -> None:
    """However far a setpoint is away."""
    stream = PvtStream([1000.0], PERIOD, LEAD)
    stream.add(0.0, [0.0])
    stream.stand([0])
    stream.started([0.0])
    before = 0
    for step in range(1, 100):
        stream.add(0.02 * step, [1e6])
        for ((_, position, velocity),) in stream.rows(0.02 * step):
            assert abs(position - before) <= 1000.0 * PERIOD + 1
            assert abs(velocity) <= 1000.0
            before = position


def test_after_a_gap_it_goes_on_slowly_from_where_it_was() -> None:
    drive = Drive()
    stream = begun(drive)
    now = run(stream, [drive], 1.0)
    last = drive.points[-1][1].position
    now += 0.4
    assert not stream.is_late(now - 0.38, [0])
    assert stream.is_late(now - 0.38, [LEAD + 1])
    assert stream.is_late(now, [0])
    stream.interrupt()
    stream.add(now, [goal(now - 100.0)])
    again = Drive()
    for ((_, position, _),) in [[row[0]] for row in [stream.stand([last])[0]]]:
        assert position == last
    again.began = now
    for row in stream.stand([last]):
        again.take(row[0])
    stream.started([now])
    places = [last]
    for _ in range(600):
        now += 0.02
        stream.add(now, [goal(now - 100.0)])
        for row in stream.rows(now):
            again.take(row[0])
            places.append(row[0].position)
    steps = [abs(b - a) for a, b in pairwise(places)]
    assert steps[0] < 0.15 * 2.0 * math.pi * 10_000.0 * PERIOD + 2
    assert max(steps) < 1.25 * 2.0 * math.pi * 10_000.0 * PERIOD
    when, point = again.points[-1]
    assert point.position == pytest.approx(goal(when - delay_of(PERIOD, LEAD) - 100.0), abs=60.0)


def test_it_has_arrived_when_the_drive_should_be_there() -> None:
    drive = Drive()
    stream = begun(drive)
    now = run(stream, [drive], 0.5)
    assert not stream.has_arrived(now)
    changed = now
    while not stream.has_arrived(now):
        now += 0.01
        stream.add(now, [500.0])
        stream.rows(now)
        assert now < changed + 1.0
    assert now - changed > delay_of(PERIOD, LEAD) - PERIOD
    stream.forget()
    assert stream.has_arrived(now)


def test_a_buffer_takes_small_differences_up_in_the_times_of_points() -> None:
    buffer = Buffer(PERIOD)
    buffer.begin(10.0)
    assert buffer.take(10.06) == 30
    assert buffer.take(10.0915) == 32  # late by 1.5 ms
    assert buffer.take(10.2) == 32  # no more than 2 ms at once

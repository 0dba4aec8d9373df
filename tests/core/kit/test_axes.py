"""Axes of a controller that does nothing but remember: what is the same whatever the protocol."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Generator, Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typing_extensions import override

from crtk_drivers.config import AxisJoint
from crtk_drivers.device import Mode, Setpoint, Steps
from crtk_drivers.errors import ConnectionLost, DeviceFault, TransitionFailed
from crtk_drivers.kit.axes import (
    AxesDevice,
    AxesOnClose,
    AxisTold,
    Complaint,
    Counted,
    Counting,
    Heard,
    MotionController,
    PieceEnds,
    Words,
    can_have_gone,
    is_astray,
    promises,
)
from crtk_drivers.samples import Stamp, vector
from crtk_drivers.state import OperatingState

JOINTS = {
    "a": AxisJoint(lower=-10.0, upper=10.0, velocity=2.0),
    "b": AxisJoint(lower=-10.0, upper=10.0, velocity=1.0, sign=-1, offset=0.5),
}
UNITS = [0.001, 0.01]


class Axes(MotionController):
    """Two axes, which do at once what they are told, or not at all."""

    words = Words(Complaint("they go on", "stop them"), Complaint("they have power", "take it"))
    blind = 5.0
    patience = 0.0

    def __init__(self) -> None:
        self.counting = Counting(JOINTS, UNITS, [2.0, 4.0])
        self.capabilities = promises(
            JOINTS,
            rate=100.0,
            units=UNITS,
            lag=0.1,
            runs_on=0.1,
            stops="rest",
            needs_homing=True,
            transition_timeout=1.0,
        )
        self.homes = [1]
        self.counts = [0.0, 0.0]
        self.asked: list[object] = []
        self.obeys = self.rests = True
        self.has_power = self.moves = self.link_is_lost = False
        self.next = Heard()
        self.why_not_homed: Complaint | None = None

    @property
    @override
    def where(self) -> str:
        return "axes"

    @property
    @override
    def axes(self) -> Sequence[AxisTold]:
        return [
            AxisTold(name, self.has_power, not self.has_power, self.moves, f"{name} is at an end")
            for name in JOINTS
        ]

    @override
    def open(self, deadline: float, given_up: Callable[[], bool]) -> None:
        self.asked.append("open")

    @override
    def close(self, *, power_off: bool) -> None:
        self.asked.append("power off" if power_off else "close")

    @override
    def exchange(self, deadline: float) -> Heard:
        if self.link_is_lost:
            raise ConnectionLost("gone")
        return self.next

    @override
    def lost(self) -> None:
        self.asked.append("lost")

    @property
    @override
    def here(self) -> Sequence[float]:
        return self.counts

    @override
    def follow(self, now: float, counts: Sequence[float]) -> None:
        self.counts = list(counts)

    @override
    def halt(self, *, aside: bool) -> None:
        self.asked.append("aside" if aside else "halt")
        self.moves = not self.obeys

    @property
    @override
    def has_stopped(self) -> bool:
        return self.rests and not self.moves

    @override
    def give_up(self) -> None:
        self.asked.append("give up")

    @override
    def watch(self, on: bool) -> None:
        self.asked.append(f"watch {on}")

    @override
    def prepare(self) -> Steps:
        self.asked.append("prepare")
        yield

    @override
    def switch(self, on: bool) -> Steps:
        self.asked.append(f"switch {on}")
        self.has_power = on is self.obeys
        yield

    @override
    def without_power(self) -> Complaint:
        return Complaint("no power", "give it")

    @override
    def home(self, place: int) -> Generator[None, None, Complaint | None]:
        self.asked.append(f"home {place}")
        yield
        return self.why_not_homed

    @override
    def homed(self) -> Steps:
        self.asked.append("homed")
        yield


def carried_out(steps: Steps) -> None:
    for _ in steps:
        pass


def arm(on_close: AxesOnClose = "power_off") -> tuple[Axes, AxesDevice]:
    axes = Axes()
    device = AxesDevice(axes, "here", on_close)
    device.open(0.0)
    see(axes, device)
    axes.asked.clear()
    return axes, device


def see(axes: Axes, device: AxesDevice) -> None:
    axes.next = Heard(Counted(Stamp.now(), axes.counts, [0.0, 0.0], [0.0, 0.0]))
    device.read(0.0)
    axes.next = Heard()


def test_a_stream_after_a_stop_of_another_thread_begins_where_the_axes_are() -> None:
    axes, device = arm()
    device.write(Setpoint(Mode.JOINT_POSITION, vector([5.0, 5.0])))
    aside = threading.Thread(target=device.stop)
    aside.start()
    aside.join()
    assert axes.asked == ["aside"]
    axes.counts = [1000.0, 0.0]
    device.write(Setpoint(Mode.JOINT_VELOCITY, vector([1.0, 1.0])))
    assert axes.counts == pytest.approx([1000.0, 0.0])


def test_a_setpoint_that_comes_after_the_stop_of_another_thread_is_stopped_too() -> None:
    class HeldUp(Axes):
        @override
        def follow(self, now: float, counts: Sequence[float]) -> None:
            aside = threading.Thread(target=lambda: device.stop())
            aside.start()
            aside.join()
            super().follow(now, counts)
            self.asked.append("setpoint")

    axes = HeldUp()
    device = AxesDevice(axes, "here", "hold")
    device.open(0.0)
    see(axes, device)
    device.write(Setpoint(Mode.JOINT_POSITION, vector([5.0, 5.0])))
    assert axes.asked == ["open", "aside", "setpoint", "halt"]


def test_axes_that_were_not_seen_to_rest_are_told_once_more_as_the_link_is_left() -> None:
    axes, device = arm()
    carried_out(device.enable())
    axes.rests = False
    device.close()
    assert axes.asked[-2:] == ["lost", "close"]


def test_no_axis_keeps_its_power_where_another_got_none() -> None:
    axes, device = arm()
    axes.obeys = False
    with pytest.raises(DeviceFault, match="no power"):
        carried_out(device.enable())
    assert axes.asked[-3:-1] == ["switch True", "switch False"]


def test_no_setpoint_is_sent_while_nobody_sees_what_the_axes_do() -> None:
    axes = Axes()
    device = AxesDevice(axes, "here", "hold")
    device.open(0.0)
    device.write(Setpoint(Mode.JOINT_POSITION, vector([5.0, 5.0])))
    assert axes.counts == [0.0, 0.0]
    see(axes, device)
    device.write(Setpoint(Mode.JOINT_POSITION, vector([5.0, 5.0])))
    assert axes.counts == pytest.approx([5000.0, -450.0])


def test_setpoints_are_taken_in_a_stream_and_at_rest() -> None:
    axes, device = arm()
    axes.rests = False
    assert not device.takes_setpoints
    device.write(Setpoint(Mode.JOINT_POSITION, vector([0.0, 0.0])))
    assert device.takes_setpoints
    device.stop()
    assert not device.takes_setpoints


def test_what_moves_is_stopped_before_it_gets_power() -> None:
    axes, device = arm()
    axes.moves = True
    carried_out(device.enable())
    assert axes.asked == ["watch False", "halt", "prepare", "switch True", "watch True"]


def test_what_does_not_stop_gets_no_power() -> None:
    axes, device = arm()
    axes.moves, axes.obeys = True, False
    with pytest.raises(TransitionFailed, match=r"they go on\. stop them"):
        carried_out(device.enable())
    assert "switch True" not in axes.asked


def test_power_is_believed_when_it_is_told() -> None:
    axes, device = arm()
    axes.obeys = False
    with pytest.raises(DeviceFault, match=r"no power\. give it"):
        carried_out(device.enable())
    axes.has_power = True
    with pytest.raises(TransitionFailed, match=r"they have power\. take it"):
        carried_out(device.disable())


def test_axes_that_keep_their_power_are_watched_on() -> None:
    axes, device = arm()
    carried_out(device.enable())
    axes.obeys = False
    with pytest.raises(TransitionFailed):
        carried_out(device.disable())
    assert axes.asked[-3:] == ["watch False", "switch False", "watch True"]
    axes.has_power = False
    with pytest.raises(DeviceFault):
        carried_out(device.enable())
    axes.has_power = False
    axes.obeys = True
    carried_out(device.disable())
    assert axes.asked[-1] == "switch False"


def test_it_is_closed_though_the_axes_cannot_be_told_to_stop() -> None:
    class Gone(Axes):
        @override
        def lost(self) -> None:
            raise ConnectionLost("gone")

    axes = Gone()
    device = AxesDevice(axes, "here", "power_off")
    carried_out(device.enable())
    axes.rests = False
    with pytest.raises(ConnectionLost):
        device.close()
    assert axes.asked[-1] == "close"


def test_what_was_old_when_it_came_lets_no_setpoint_out() -> None:
    axes, device = arm()
    now = Stamp.now()
    old = Stamp(now.wall_ns, now.monotonic - axes.blind)
    axes.next = Heard(Counted(old, axes.counts, [0.0, 0.0], [0.0, 0.0]))
    device.read(0.0)
    device.write(Setpoint(Mode.JOINT_POSITION, vector([5.0, 5.0])))
    assert axes.counts == [0.0, 0.0]


def test_a_fault_is_told_until_it_is_enabled_again() -> None:
    axes, device = arm()
    axes.next = Heard(None, "broken")
    device.read(0.0)
    device.read(0.0)
    assert axes.asked == ["give up"]
    axes.next = Heard()
    device.read(0.0)
    assert device.condition.allows is OperatingState.FAULT
    assert device.condition.reason == "broken"
    before = list(axes.counts)
    device.write(Setpoint(Mode.JOINT_POSITION, vector([1.0, 1.0])))
    assert axes.counts == before
    carried_out(device.enable())
    assert device.condition.allows is OperatingState.ENABLED


@pytest.mark.parametrize(
    ("on_close", "enabled", "rests", "told"),
    [
        ("power_off", True, True, "power off"),
        ("power_off", True, False, "close"),
        ("power_off", False, True, "close"),
        ("hold", True, True, "close"),
    ],
)
def test_power_that_it_gave_it_takes_from_axes_that_rest(
    on_close: AxesOnClose, enabled: bool, rests: bool, told: str
) -> None:
    axes, device = arm(on_close)
    if enabled:
        carried_out(device.enable())
    axes.rests = rests
    device.close()
    assert axes.asked[-1] == told


def test_a_link_that_is_lost_is_told_what_may_still_be_heard_while_there_is_power() -> None:
    axes, device = arm()
    axes.link_is_lost = True
    with pytest.raises(ConnectionLost):
        device.read(0.0)
    assert "lost" not in axes.asked
    carried_out(device.enable())
    with pytest.raises(ConnectionLost):
        device.read(0.0)
    assert axes.asked[-1] == "lost"


def test_an_axis_that_was_not_homed_is_stopped() -> None:
    axes, device = arm()
    carried_out(device.home())
    assert axes.asked == ["home 1", "homed"]
    axes.why_not_homed = Complaint("no switch", "look")
    with pytest.raises(TransitionFailed, match=r"joint b was not homed: no switch\. look"):
        carried_out(device.home())
    assert axes.asked[-1] == "halt"


def test_what_is_told_in_counts_is_a_joint_state() -> None:
    axes, device = arm()
    axes.next = Heard(Counted(Stamp.now(), [1000, 100], [100, 10], [1.0, 1.0]))
    sample = device.read(0.0)
    assert sample is not None
    state = sample.values["measured_js"]
    assert state.name == ("a", "b")
    assert state.position.tolist() == pytest.approx([1.0, -0.5])
    assert state.velocity.tolist() == pytest.approx([0.1, -0.1])
    assert state.effort.tolist() == pytest.approx([2.0, -4.0])
    assert [note.text for note in device.notes] == ["a is at an end", "b is at an end"]


def test_efforts_are_told_of_all_axes_or_of_none() -> None:
    state = Counting(JOINTS, UNITS, [2.0, None]).state([0, 0], [0, 0], [1.0, 1.0])
    assert state.effort.size == 0


@given(st.lists(st.floats(-10.0, 10.0), min_size=2, max_size=2))
def test_positions_are_the_same_there_and_back(places: list[float]) -> None:
    counting = Counting(JOINTS, UNITS, [None, None])
    back = counting.positions(counting.counts(vector(places)))
    assert np.allclose(back, places, atol=1e-9)


@given(st.lists(st.tuples(st.integers(-500, 500), st.integers(-500, 500)), max_size=30))
def test_no_piece_is_longer_than_an_axis_may_go_in_it(goals: list[tuple[int, int]]) -> None:
    ends = PieceEnds([100, 20])
    ends.begin([0, 0])
    for goal in goals:
        before = list(ends.at)
        ways = ends.towards(goal)
        for way, most, begin, end, wanted in zip(
            ways, (100, 20), before, ends.at, goal, strict=True
        ):
            assert abs(way) <= most
            assert end == begin + way
            assert end == wanted or abs(way) == most


def test_nothing_goes_ten_times_as_fast_as_it_may() -> None:
    assert can_have_gone(0.19, JOINTS["a"], 0.0)
    assert can_have_gone(-20.0, JOINTS["a"], 1.0)
    assert not can_have_gone(21.0, JOINTS["a"], 1.0)


COUNT = 4e-9
CIRCLE = COUNT * 2**32


@pytest.mark.parametrize(
    ("position", "astray"),
    [
        (0.0, False),
        (3.5, False),  # somebody has pushed it out of its range
        (-8.0, False),
        (3.5 - CIRCLE, True),
        (CIRCLE + 2.0, True),
        (-100.0, True),
        (math.nan, True),
    ],
)
def test_a_joint_beyond_its_counter_is_astray(position: float, astray: bool) -> None:
    for count in (COUNT, -COUNT):
        assert is_astray(position, -3.0, 3.0, count) is astray

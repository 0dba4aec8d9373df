"""Joint states from messages of anybody, in any order."""

import math
from itertools import count

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_ros2_control.joint_states import JointStates, Measured
from crtk_drivers.kit.ages import Ages
from crtk_drivers.samples import JointState

JOINTS = ("a", "b", "c")


def message(
    names: tuple[str, ...], *position: float, velocity: tuple[float, ...] = ()
) -> JointState:
    return JointState(position, velocity, (), names)


class Feed:
    """Messages with stamps and arrivals that advance by 10 ms."""

    def __init__(self) -> None:
        self.states = JointStates(JOINTS)
        self._ticks = count(1)
        self.now = 0.0

    def take(self, state: JointState, sender: str = "robot", stamp: int | None = None) -> Measured:
        tick = next(self._ticks)
        self.now = 100.0 + 0.01 * tick
        found = tick * 10_000_000 if stamp is None else stamp
        return self.states.take(state, found, sender, self.now)  # type: ignore[return-value]


@given(st.permutations([*JOINTS, "finger", "wheel"]))
def test_any_order_and_joints_of_others_are_the_same_to_us(names: list[str]) -> None:
    values = {"a": 1.0, "b": 2.0, "c": 3.0, "finger": 8.0, "wheel": 9.0}
    found = Feed().take(message(tuple(names), *(values[name] for name in names)))
    assert found.state.position.tolist() == [1.0, 2.0, 3.0]
    assert found.state.name == JOINTS


def test_velocities_with_nan_are_not_known_and_positions_with_it_are_no_sample() -> None:
    feed = Feed()
    found = feed.take(message(JOINTS, 1.0, 2.0, 3.0, velocity=(0.1, math.nan, 0.3)))
    assert found.state.velocity.size == 0
    assert feed.take(message(JOINTS, 1.0, math.nan, 3.0)) is None
    assert feed.states.trouble == "the position of b is not finite"
    assert feed.take(message(JOINTS, 1.0, math.inf, 3.0)) is None
    assert feed.states.counts["not finite"] == 2
    assert feed.take(message(JOINTS, 1.0, 2.0, 3.0, velocity=(0.1, 0.2, 0.3))).state.velocity.size
    assert feed.states.trouble == ""


def test_a_joint_of_another_device_may_be_nan() -> None:
    assert Feed().take(message(("finger", *JOINTS), math.nan, 1.0, 2.0, 3.0)) is not None


def test_a_joint_that_is_missing_is_named() -> None:
    feed = Feed()
    assert feed.take(message(JOINTS, 1.0, 2.0, 3.0)) is not None
    for _ in range(3):
        assert feed.take(message(("c", "a"), 3.0, 1.0)) is None
    assert feed.states.trouble == "no message has b"


def test_two_nodes_with_half_of_the_joints_each_make_one_state_of_the_older_stamp() -> None:
    feed = Feed()
    assert feed.take(message(("a",), 1.0), "left") is None
    found = feed.take(message(("c", "b"), 3.0, 2.0), "right")
    assert found.state.position.tolist() == [1.0, 2.0, 3.0]
    assert found.acquired == pytest.approx(found.arrived - 0.01)


def test_one_joint_twice_is_no_state() -> None:
    feed = Feed()
    assert feed.take(message(("a", "b", "c", "b"), 1.0, 2.0, 3.0, 2.5)) is None
    assert feed.states.trouble == "b is there twice"


def test_another_sender_does_not_go_on_for_one_that_falls_silent() -> None:
    feed = Feed()
    assert feed.take(message(JOINTS, 1.0, 2.0, 3.0)) is not None
    for _ in range(300):
        assert feed.take(message(JOINTS, 0.0, 0.0, 0.0), "other") is None
    assert feed.states.rival == ("other", feed.now)


def test_a_stamp_that_stands_still_or_goes_back_is_not_new() -> None:
    feed = Feed()
    assert feed.take(message(JOINTS, 1.0, 2.0, 3.0), stamp=50) is not None
    for stamp in (50, 49):
        assert feed.take(message(JOINTS, 1.0, 2.0, 3.0), stamp=stamp) is None
        assert feed.states.trouble == "its stamp does not advance"
    for stamp in (0, -5):
        assert feed.take(message(JOINTS, 1.0, 2.0, 3.0), stamp=stamp) is None
        assert feed.states.trouble == "it has no stamp"


def test_without_positions_or_names_there_is_nothing() -> None:
    feed = Feed()
    assert feed.take(JointState((), (1.0, 2.0, 3.0), (), JOINTS)) is None
    assert feed.states.trouble == "it has no positions"
    assert feed.take(JointState((1.0, 2.0, 3.0))) is None
    assert feed.states.counts["of other joints"] == 1


def test_the_memory_of_orders_is_bounded() -> None:
    feed = Feed()
    for number in range(200):
        feed.take(message((f"x{number}", *JOINTS), 0.0, 1.0, 2.0, 3.0))
    assert len(feed.states._orders) < 40


@given(
    st.lists(st.floats(0.0, 0.5), min_size=2, max_size=50),
    st.floats(-1e6, 1e6),
)
def test_an_age_is_counted_from_the_earliest_arrival_whatever_the_clocks_differ_by(
    delays: list[float], difference: float
) -> None:
    ages = Ages()
    least = math.inf
    for number, delay in enumerate(delays):
        sent = 10.0 + 0.1 * number
        arrival = sent + delay
        found = ages.acquired(int((sent + difference + 2e6) * 1e9), arrival)
        least = min(least, delay)
        assert found <= arrival
        assert arrival - found == pytest.approx(delay - least, abs=1e-5)


def test_the_earliest_arrival_is_forgotten_when_clocks_drift() -> None:
    ages = Ages()
    for number in range(400):
        sent = 0.1 * number
        found = ages.acquired(int((sent * (1.0 - 1e-3) + 1.0) * 1e9), sent)
    assert sent - found < 0.021  # of 20 s, not of 40
    assert np.isfinite(found)


def stamps_after_a_silence(begin: float, *, set_back: float = 0.0, silence: float = 5.0) -> float:
    """Return how old the first message of another connection seems, which comes 2 s late."""
    before = JointStates(JOINTS)
    for number in range(10):
        sent = 0.1 * number
        before.take(message(JOINTS, 1.0, 2.0, 3.0), int((begin + sent) * 1e9), "robot", 50.0 + sent)
    again = JointStates(JOINTS, before.lasting_ages)
    stamp = int((begin - set_back + silence) * 1e9)
    found = again.take(message(JOINTS, 1.0, 2.0, 3.0), stamp, "robot", 52.0 + silence)
    assert found is not None
    return found.arrived - found.acquired


@pytest.mark.parametrize("silence", [5.0, 50.0])
def test_the_first_state_after_a_silence_is_as_old_as_it_is(silence: float) -> None:
    assert stamps_after_a_silence(1.8e9, silence=silence) == pytest.approx(2.0, abs=1e-3)


def test_a_clock_that_was_set_back_is_another_one() -> None:
    assert stamps_after_a_silence(1.8e9, set_back=100.0) == 0.0


def test_simulated_time_may_have_been_paused_meanwhile() -> None:
    assert stamps_after_a_silence(20.0) == 0.0

"""What is sent to controllers: setpoints, the way to rest, what is held."""

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_ros2_control.braking import Braking
from crtk_driver_ros2_control.controllers import Role
from crtk_driver_ros2_control.outgoing import Outgoing
from crtk_drivers.samples import vector

NAMES = {role: f"{role}_controller" for role in Role}
PERIOD = 0.01
FASTEST, SLOWED = 2.0, 5.0


class Wire:
    """Keeps what was sent."""

    def __init__(self) -> None:
        self.sent: list[tuple[str, list[float]]] = []
        self.woken = 0

    def wake(self) -> None:
        self.woken += 1

    def command(self, controller: str, values: Sequence[float]) -> None:
        self.sent.append((controller, list(values)))

    def point(self, joints: Sequence[str], positions: Sequence[float], seconds: float) -> None:
        self.sent.append((f"{','.join(joints)} in {seconds:.3f}", list(positions)))


class Stepped:
    """Outgoing commands of two joints, and the time."""

    def __init__(self) -> None:
        self.now = 0.0
        self.wire = Wire()
        limits = vector([FASTEST, FASTEST]), vector([SLOWED, SLOWED])
        self.out = Outgoing(NAMES, ("a", "b"), *limits, PERIOD, lambda: self.now)
        self.out.wire = self.wire
        self.out.orders = {role: (0, 1) for role in Role if role is not Role.TRAJECTORY}

    def follow(self, role: Role, *values: float) -> None:
        self.out.follow(role, vector(values))
        self.out.pump()
        self.now += PERIOD

    def run(self, seconds: float) -> list[list[float]]:
        """Pump as the node does; return what was sent."""
        before, end = len(self.wire.sent), self.now + seconds
        while self.now < end:
            self.now += min(self.out.pump(), PERIOD)
        return [values for _, values in self.wire.sent[before:]]


def test_a_command_is_in_the_order_of_the_controller() -> None:
    stepped = Stepped()
    stepped.out.orders[Role.POSITION] = (1, 0)
    stepped.follow(Role.POSITION, 0.1, 0.2)
    assert stepped.wire.sent == [("position_controller", [0.2, 0.1])]


def test_a_controller_whose_order_is_not_known_gets_nothing() -> None:
    stepped = Stepped()
    stepped.out.orders = {}
    stepped.follow(Role.POSITION, 0.1, 0.2)
    assert not stepped.wire.sent


def test_positions_slow_down_within_the_limit_and_the_last_one_is_held() -> None:
    stepped = Stepped()
    for tick in range(20):
        stepped.follow(Role.POSITION, 0.01 * tick, 0.0)  # 1 rad/s
    stepped.out.stop()
    assert not stepped.out.is_at_rest
    way = np.array(stepped.run(1.0))
    speed = np.diff(np.vstack([[0.19, 0.0], way])[:, 0]) / PERIOD
    assert (np.diff(speed) <= 1e-6).all(), "it slows down, and never goes back"
    assert way[-1] == pytest.approx([0.19 + 1.0 / (2 * SLOWED), 0.0], abs=1e-3)
    assert stepped.out.is_at_rest
    assert stepped.out.held is not None
    assert stepped.out.held[1] == pytest.approx(way[-1])


def test_velocities_end_at_zero_within_the_limit() -> None:
    stepped = Stepped()
    stepped.follow(Role.VELOCITY, 1.0, -0.5)
    stepped.out.stop()
    way = np.array(stepped.run(0.5))
    assert np.abs(np.diff(way, axis=0)).max() <= SLOWED * PERIOD * 1.01
    assert way[-1].tolist() == [0.0, 0.0]
    assert stepped.out.is_at_rest


def test_efforts_end_at_once() -> None:
    stepped = Stepped()
    stepped.follow(Role.EFFORT, 3.0, 4.0)
    stepped.out.stop()
    assert stepped.run(0.02)[0] == [0.0, 0.0]
    assert stepped.out.is_at_rest


def test_a_stop_that_is_asked_for_again_is_sent_again_and_does_not_begin_anew() -> None:
    stepped = Stepped()
    for tick in range(5):
        stepped.follow(Role.POSITION, 0.01 * tick, 0.0)
    stepped.out.stop()
    stepped.run(0.05)
    stepped.out.stop()
    stepped.run(0.5)
    assert stepped.out.is_at_rest
    held = stepped.wire.sent[-1]
    stepped.out.stop()
    assert not stepped.out.is_at_rest
    stepped.run(0.02)
    assert stepped.wire.sent[-1] == held


def test_a_setpoint_that_is_old_has_no_speed_when_it_is_stopped() -> None:
    stepped = Stepped()
    for tick in range(5):
        stepped.follow(Role.POSITION, 0.01 * tick, 0.0)
    stepped.now += 1.0
    stepped.out.stop()
    assert stepped.run(0.1) == [[0.04, 0.0]]


def test_a_setpoint_ends_a_stop() -> None:
    stepped = Stepped()
    for tick in range(5):
        stepped.follow(Role.POSITION, 0.01 * tick, 0.0)
    stepped.out.stop()
    stepped.follow(Role.POSITION, 0.05, 0.0)
    assert not stepped.run(0.1)
    assert stepped.wire.sent[-1][1] == [0.05, 0.0]


def test_only_the_newest_setpoint_waits() -> None:
    stepped = Stepped()
    for value in (0.1, 0.2, 0.3):
        stepped.out.follow(Role.POSITION, vector((value, 0.0)))
    stepped.out.pump()
    assert [values for _, values in stepped.wire.sent] == [[0.3, 0.0]]


def test_positions_that_ran_ahead_during_a_switch_are_caught_up_at_the_speed_limit() -> None:
    stepped = Stepped()
    stepped.out.hold_at(Role.POSITION, vector((0.0, 0.0)))
    stepped.out.pump()
    goal, here = vector((0.2, 0.0)), vector((0.0, 0.0))
    stepped.out.follow(Role.POSITION, goal, here)
    stepped.run(0.05)
    stepped.follow(Role.POSITION, 0.21, 0.0)
    stepped.run(0.2)
    way = np.array([values[0] for _, values in stepped.wire.sent])
    assert np.diff(way).max() <= FASTEST * PERIOD * 1.001
    assert way[-1] == pytest.approx(0.21)
    stepped.follow(
        Role.POSITION, 0.5, 0.0
    )  # it has caught up: what is sent now is the gates' affair
    assert stepped.wire.sent[-1][1] == [0.5, 0.0]


def test_a_stop_ends_catching_up() -> None:
    stepped = Stepped()
    stepped.out.follow(Role.POSITION, vector((1.0, 0.0)), vector((0.0, 0.0)))
    stepped.run(0.05)
    stepped.out.stop()
    stepped.run(1.0)
    assert stepped.out.is_at_rest
    assert stepped.wire.sent[-1][1][0] < 0.6


def test_a_trajectory_of_one_point_ends_soon() -> None:
    stepped = Stepped()
    stepped.follow(Role.TRAJECTORY, 0.1, 0.2)
    assert stepped.wire.sent == [("a,b in 0.030", [0.1, 0.2])]


def test_nothing_is_sent_before_anything_was_asked_for() -> None:
    stepped = Stepped()
    stepped.out.stop()
    assert not stepped.run(0.1)
    assert stepped.out.is_at_rest


NUMBER = st.floats(-10.0, 10.0)


@given(NUMBER, NUMBER, st.floats(0.1, 100.0), st.floats(0.0, 200.0))
def test_braking_ends_where_physics_says_and_never_turns_back(
    position: float, velocity: float, deceleration: float, elapsed: float
) -> None:
    braking = Braking(vector([position]), vector([velocity]), vector([deceleration]))
    end = position + np.sign(velocity) * velocity**2 / (2.0 * deceleration)
    assert braking.position_at(braking.time) == pytest.approx(end, abs=1e-6)
    at = braking.position_at(elapsed)[0]
    assert min(position, end) - 1e-9 <= at <= max(position, end) + 1e-9
    assert abs(braking.velocity_at(elapsed)[0]) <= abs(velocity)
    assert not braking.velocity_at(braking.time + 1e-6).any()

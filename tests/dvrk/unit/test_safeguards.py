"""What must not be while an arm is driven: each row of the tables, and how long it may last."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from crtk_driver_dvrk.arm import Joints
from crtk_driver_dvrk.arm_file import read_arm
from crtk_driver_dvrk.motor_file import read_motors
from crtk_driver_dvrk.plugin import TYPICAL
from crtk_driver_dvrk.registers import BoardState
from crtk_driver_dvrk.safeguards import Safeguards, Trouble
from rigs.dvrk_bench import board_state

Change = dict[str, object]
PERIOD = 0.004


class Bench:
    """The simulated arm's two boards, as they tell themselves."""

    def __init__(self) -> None:
        arm = read_arm(TYPICAL["io"])
        motors = read_motors(TYPICAL["io"])
        self.guards = Safeguards(Joints(arm, tuple("abcdefg")), motors, 0.4)
        self.now = 10.0
        self.guards.begin()

    def sample(self, six: BoardState, seven: BoardState | None = None) -> Trouble | None:
        """Judge one sample."""
        self.now += PERIOD
        return self.guards.trouble({6: six, 7: seven or board_state(7)}, self.now)

    def lasts(
        self, six: Callable[[int], BoardState], most: int = 100
    ) -> tuple[int, Trouble | None]:
        """Judge samples until one is refused; return how many passed, and why."""
        for at in range(most):
            found = self.sample(six(at))
            if found is not None:
                return at, found
        return most, None


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_boards_that_are_in_order_are_never_refused(bench: Bench) -> None:
    assert bench.lasts(lambda _: board_state(6))[1] is None


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"timed_out": True}, "board 6: its watchdog has expired"),
        ({"relay_closed": False}, "board 6: its safety relay is open"),
        ({"supply_fault": True}, "supply of its motors has a fault"),
        ({"power": False}, "motors have lost their voltage"),
        ({"voltage_good": False}, "motors have lost their voltage"),
        ({"encoder_supply_fault": True}, "supply of its encoders"),
        ({"temperatures": (31.0, 65.5)}, "hotter than 65"),
    ],
)
def test_a_board_is_believed_at_once(bench: Bench, change: Change, words: str) -> None:
    found = bench.sample(board_state(6, **change))
    assert found is not None
    assert words in str(found)
    assert found.remedy


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"is_tripped": True}, "axis 1 of board 6: its amplifier was switched off by the board"),
        ({"has_fault": True}, "its amplifier tells a fault"),
        ({"is_on": False}, "its amplifier is off"),
        ({"overflow": True}, "beyond its range"),
    ],
)
def test_an_axis_is_believed_at_once(bench: Bench, change: Change, words: str) -> None:
    found = bench.sample(board_state(6, 1, **change))
    assert found is not None
    assert words in str(found)


def test_an_axis_that_the_arm_does_not_have_is_not_looked_at(bench: Bench) -> None:
    assert bench.sample(board_state(6), board_state(7, 3, is_on=False, overflow=True)) is None


@pytest.mark.parametrize(
    ("change", "seconds", "words"),
    [
        ({"current": 0x8000 + 2500}, 0.1, "where 0.000 A are asked for"),
        ({"command": 0x8000 + 2500}, 0.1, "0.000 A where -0.477 A are asked for"),
        ({"current": 0x8000 + 9200, "command": 0x8000 + 9200}, 0.1, "more than 1.658 A"),
        ({"jumped": True}, 0.02, "signals of its encoder"),
        ({"velocity": 1e6}, 0.02, "does not move as the velocity"),
        ({"potentiometer": 0x8000 + 1500}, 0.05, "its potentiometer says -0.1158, its encoder"),
    ],
)
def test_what_may_last_a_time_may_not_last_longer(
    bench: Bench, change: Change, seconds: float, words: str
) -> None:
    passed, found = bench.lasts(lambda _: board_state(6, 1, **change))
    assert found is not None
    assert words in str(found)
    assert passed * PERIOD == pytest.approx(seconds, abs=3 * PERIOD)


@pytest.mark.parametrize("change", [{"current": 0x9000}, {"jumped": True}, {"velocity": 1e6}])
def test_what_comes_and_goes_does_not_last(bench: Bench, change: Change) -> None:
    assert bench.lasts(lambda at: board_state(6, 1, **(change if at % 4 == 1 else {})))[1] is None


@pytest.mark.parametrize("counts", [21_000, -21_000])
def test_an_encoder_that_leaps_is_believed_at_once(bench: Bench, counts: int) -> None:
    assert bench.sample(board_state(6)) is None
    sensed = 0x8000 + counts // 10
    found = bench.sample(board_state(6, 1, counts=counts, potentiometer=sensed))
    assert found is not None
    assert "axis 1 of board 6: its encoder has leapt" in str(found)


def test_time_alone_is_no_proof(bench: Bench) -> None:
    """Two samples far apart are two samples."""
    for _ in range(2):
        bench.now += 5.0
        assert bench.sample(board_state(6, 1, current=0x9000)) is None
    assert bench.sample(board_state(6, 1, current=0x9000)) is not None


def test_an_encoder_that_moves_as_it_says_is_in_order(bench: Bench) -> None:
    speed, counts = 100_000.0, 0.0
    for _ in range(60):
        counts += speed * PERIOD
        state = board_state(
            6, 0, velocity=speed, counts=int(counts), potentiometer=0x8000 + int(counts / 10)
        )
        assert bench.sample(state) is None

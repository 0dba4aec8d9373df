"""Which packets the simulated Raven uses: the rules of its network layer, by packets packed by hand."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_sim_backends.raven.network import Network
from crtk_sim_backends.raven.robot import Robot


def packed(
    number: int, x: int = 0, *, grasp: int = 0, engaged: int = 1, checksum: int = 0
) -> bytes:
    moves = (x, 0, 0, 0, 0, 0)
    return struct.pack(
        "<3I6i8d6i", number, 0, 0, *moves, *[0.0] * 6, 1.0, 1.0, 0, 0, grasp, 0, engaged, checksum
    )


@pytest.mark.parametrize(
    ("before", "number", "fate", "then"),
    [
        (7, 8, "used", 8),
        (7, 9, "skipped", 9),
        (7, 7, "repeated", 7),
        (7, 6, "out_of_sequence", 7),
        (900, 1, "out_of_sequence", 900),
        (5000, 4001, "out_of_sequence", 5000),
        (5000, 3999, "reset", 3999),
        (7, 0, "zero", 7),
    ],
)
def test_what_becomes_of_a_number(before: int, number: int, fate: str, then: int) -> None:
    network = Network()
    network.number = before
    assert (network.take(packed(number)) is not None) is (fate == "used")
    assert network.counts[fate] == 1
    assert network.number == then


@given(st.lists(st.integers(0, 3000), max_size=40))
def test_only_the_next_one_is_used(numbers: list[int]) -> None:
    network = Network()
    for number in numbers:
        before = network.number
        assert (network.take(packed(number)) is not None) is (number == before + 1)


@given(st.binary(max_size=200).filter(lambda data: len(data) != 124))
def test_what_has_another_size_is_dropped(data: bytes) -> None:
    network = Network()
    assert network.take(data) is None
    assert network.counts["wrong_size"] == 1


def test_the_checksum_is_not_looked_at() -> None:
    network = Network()
    assert network.take(packed(1, checksum=12345)) is not None
    assert network.counts["wrong_checksum"] == 1


def test_increments_count_only_while_the_pedal_is_down() -> None:
    robot = Robot(5.0)
    robot.take(packed(1, 1000, engaged=0))
    robot.advance(0.001)
    assert robot.arms["gold"].position == (0, 0, 0)
    robot.take(packed(2))
    robot.advance(0.001)
    robot.take(packed(3, 1000, grasp=5))
    robot.advance(0.001)
    assert robot.arms["gold"].position == (0, -1000, 0), "its y is the packets' -x"
    assert robot.arms["gold"].grasp == -5


def test_without_packets_the_pedal_goes_up() -> None:
    robot = Robot(0.5)
    robot.take(packed(1))
    robot.advance(0.4)
    assert robot.status()["run_level"] == 3
    robot.advance(0.2)
    assert robot.status()["run_level"] == 2
    assert robot.timeouts == 1

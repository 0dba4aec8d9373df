"""The judge of stamps: by how much they are too young at the least, with joints that move by 0.5 rad/s."""

from __future__ import annotations

import numpy as np
import pytest

from bench.reliability.stamps import Look, held_up, too_young

VELOCITY = 0.5
LOOKS = [Look(at, np.array([VELOCITY * at]), at) for at in np.arange(0.0, 5.0, 0.01)]
NOW = 4.9


@pytest.mark.parametrize("late", [0.0, 0.004, 0.02, 0.3, 1.0])
def test_data_that_are_late_make_a_stamp_too_young(late: float) -> None:
    position = np.array([VELOCITY * (NOW - late)])
    assert too_young(LOOKS, position, NOW, 0.0) == pytest.approx(late, abs=1e-6)


def test_data_younger_than_their_stamp_are_none() -> None:
    assert too_young(LOOKS, np.array([VELOCITY * NOW]), NOW - 0.5, 0.0) == 0.0


def test_a_tolerance_counts_for_the_stamp() -> None:
    position = np.array([VELOCITY * (NOW - 0.1)])
    assert too_young(LOOKS, position, NOW, 0.1 * VELOCITY + 1e-9) == pytest.approx(0.0, abs=1e-6)


def test_between_looks_far_apart_nothing_is_known() -> None:
    few = [look for look in LOOKS if look.at < 4.0 or look.at > 4.8]
    position = np.array([VELOCITY * 4.1])
    assert too_young(few, position, 4.85, 0.0) < 0.06


@pytest.mark.parametrize("looks", [[], LOOKS[-5:]], ids=["none", "younger ones"])
def test_without_looks_before_the_stamp_nothing_shows(looks: list[Look]) -> None:
    assert too_young(looks, np.array([0.0]), NOW, 0.0) == 0.0


def test_the_joint_that_is_oldest_counts() -> None:
    looks = [Look(look.at, np.array([look.joints[0], 0.0]), look.done) for look in LOOKS]
    position = np.array([VELOCITY * (NOW - 0.2), 0.0])
    assert too_young(looks, position, NOW, 0.0) == pytest.approx(0.2, abs=1e-6)


@pytest.mark.parametrize(("gap", "found"), [(0.01, 0.0), (0.05, 0.04)])
def test_a_look_that_came_late_was_held_up(gap: float, found: float) -> None:
    times = [*np.arange(0.0, 1.0, 0.01), 1.0 + gap - 0.01]
    looks = [Look(at, np.zeros(1), at) for at in times]
    assert held_up(looks, 0.01) == pytest.approx(found, abs=1e-6)


def test_what_was_held_up_long_ago_counts_no_more() -> None:
    times = [0.0, *np.arange(1.0, 6.0, 0.01)]
    assert held_up([Look(at, np.zeros(1), at) for at in times], 0.01) == pytest.approx(
        0.0, abs=1e-6
    )

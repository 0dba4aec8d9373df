"""What is told once in a while, and what counts as the same."""

import pytest

from crtk_drivers.status.throttle import MOST_KINDS, Throttle, kind_of


def test_the_first_of_a_kind_passes_and_the_others_are_counted() -> None:
    throttle = Throttle(2.0)
    assert throttle.passes("a", 10.0)
    assert not throttle.passes("a", 11.9)
    assert throttle.passes("b", 11.9)
    assert throttle.passes("a", 12.0)
    assert throttle.left_out("a") == 1
    assert throttle.left_out("a") == 0
    assert throttle.left_out("b") == 0


def test_kinds_are_forgotten_when_their_time_is_over() -> None:
    throttle = Throttle(2.0)
    for kind in range(3 * MOST_KINDS):
        assert throttle.passes(kind, 0.1 * kind)
    assert len(throttle._passed) <= MOST_KINDS
    assert not throttle.passes(3 * MOST_KINDS - 1, 0.3 * MOST_KINDS)


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        (
            "servo_jp: elbow at 1.5 is outside [-1.0, 1]",
            "servo_jp: elbow at -2 is outside [0, 1]",
            True,
        ),
        ("servo_jp: wrist_1_joint at 1.5", "servo_jp: wrist_2_joint at 1.5", False),
        ("servo_jp: joint1 at 1e-05", "servo_jp: joint1 at 3.25", True),
        ("servo_jp: joint1 at 1.5", "servo_jv: joint1 at 1.5", False),
    ],
)
def test_numbers_make_no_other_kind_but_names_do(one: str, other: str, same: bool) -> None:
    assert (kind_of(one) == kind_of(other)) is same

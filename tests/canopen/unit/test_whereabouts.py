"""Positions that an axis cannot have come to are not believed."""

from crtk_driver_canopen.whereabouts import HASTE, Whereabouts

PERIOD = 0.01


def test_what_is_too_far_for_the_time_is_not_believed_until_the_axis_is_heard_near_again() -> None:
    where = Whereabouts(1000, velocity=100_000.0, period=PERIOD)
    assert where.take(1000, 1.0, may_be_set=False) == 1000
    far = round(1.1 * HASTE * 100_000.0 * PERIOD)
    for strange in (1, 2, 3):
        assert where.take(1000 + far, 1.0 + strange * PERIOD, may_be_set=False) == 1000
        assert where.strange == strange
        assert where.told == 1000 + far
    assert where.take(1500, 1.04, may_be_set=False) == 1500
    assert where.strange == 0


def test_what_can_be_is_believed() -> None:
    where = Whereabouts(0, velocity=100_000.0, period=PERIOD)
    where.take(0, 1.0, may_be_set=False)
    assert where.take(9_000, 1.01, may_be_set=False) == 9_000
    assert where.take(-200_000, 1.5, may_be_set=False) == -200_000, (
        "it was not heard for half a second"
    )
    assert where.take(-203_000, 1.5 + 1e-5, may_be_set=False) == -203_000, (
        "two frames come together"
    )
    assert where.take(2**31 - 1, 1.6, may_be_set=True) == 2**31 - 1, "it was given another position"


def test_an_axis_of_few_counts_may_flicker() -> None:
    where = Whereabouts(0, velocity=1.0, period=0.001)
    where.take(0, 1.0, may_be_set=False)
    assert where.take(5, 1.001, may_be_set=False) == 5


def test_an_axis_that_is_set_up_anew_may_be_anywhere_once() -> None:
    where = Whereabouts(0, velocity=1.0, period=PERIOD)
    where.take(0, 1.0, may_be_set=False)
    where.forget()
    assert where.take(10**6, 1.01, may_be_set=False) == 10**6
    assert where.take(0, 1.02, may_be_set=False) == 10**6

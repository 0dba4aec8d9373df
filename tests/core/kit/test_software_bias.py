"""A bias in software that is being measured when somebody breaks that off."""

from __future__ import annotations

import time

import numpy as np
import pytest

from crtk_drivers.errors import TransitionFailed
from crtk_drivers.kit.software_bias import SoftwareBias


def test_one_that_is_broken_off_leaves_the_bias_as_it_was() -> None:
    before = np.arange(6.0)
    bias = SoftwareBias(before, np.full(6, 100.0), "ft_sensor", "a sensor")
    steps = bias.measure()
    next(steps)
    loads, begin = np.full((2, 6), 50.0), time.monotonic()
    bias.take_off(loads, np.array((begin + 0.1, begin + 60.0)))
    next(steps)  # it is checked now
    steps.close()
    assert (bias.load == before).all()


@pytest.mark.parametrize("checked", [(5.0, 5.0), (5.0, 0.0)], ids=["then still", "again"])
def test_load_that_changes_meanwhile_is_no_noise(checked: tuple[float, float]) -> None:
    before = np.zeros(6)
    bias = SoftwareBias(before, np.full(6, 10.0), "ft_sensor", "a sensor")
    steps = bias.measure()
    next(steps)
    times = time.monotonic() + np.linspace(0.001, 0.301, 150)
    bias.take_off(np.where(times < times[100], 0.0, 5.0)[:, None] * np.ones(6), times)
    next(steps)  # it is checked now
    loads = np.repeat(checked, 25)[:, None] * np.ones(6)
    bias.take_off(loads, time.monotonic() + np.linspace(0.001, 0.101, 50))
    with pytest.raises(TransitionFailed, match="the load changed"):
        next(steps)
    assert (bias.load == before).all()

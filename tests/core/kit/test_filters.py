"""Decimation: gain at rest, cut-off, delay, and blocks of any size."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_drivers.kit.sensing.filters import LONGEST, LowPass, Mean, behind_gap

loads = st.lists(st.floats(-1e6, 1e6), min_size=6, max_size=6)
sizes = st.lists(st.integers(1, 3 * LONGEST), min_size=1, max_size=6)
lowpasses = st.tuples(st.floats(1.0, 3000.0), st.sampled_from([7000.0, 7912.0]))


@given(lowpasses, loads, sizes)
def test_the_low_pass_has_a_gain_of_exactly_one_at_rest(kind, load, blocks) -> None:
    low = LowPass(*kind)
    for size in blocks:
        assert (low.filter(np.tile(load, (size, 1))) == load).all()


@given(st.integers(1, 70), loads, sizes)
def test_the_mean_has_a_gain_of_exactly_one_at_rest(window, load, blocks) -> None:
    mean = Mean(window)
    for size in blocks:
        result = mean.take(np.tile(load, (size, 1)))
        if result is not None:
            assert (result == load).all()


@pytest.mark.parametrize(("cutoff", "rate"), [(20.0, 500.0), (100.0, 1000.0), (73.0, 7000.0)])
def test_a_step_ends_at_its_height(cutoff, rate) -> None:
    low = LowPass(cutoff, rate)
    low.filter(np.zeros((10, 6)))
    load = np.array([100.0, -3.0, 1e-3, 7.5, 0.1, -1e5])
    end = low.filter(np.tile(load, (int(20 * rate / cutoff), 1)))[-1]
    assert end == pytest.approx(load, rel=1e-12)


@pytest.mark.parametrize(("cutoff", "rate"), [(50.0, 7000.0), (838.0, 7000.0), (300.0, 1000.0)])
def test_the_cut_off_is_at_minus_3_db_and_the_slope_that_of_second_order(cutoff, rate) -> None:
    def gain(frequency: float) -> float:
        time = np.arange(int(rate)) / rate
        wave = np.exp(2j * math.pi * frequency * time)
        out = LowPass(cutoff, rate).filter(np.stack((wave.real, wave.imag), axis=1))
        settled = slice(int(rate) // 2, None)
        answer = (out[settled, 0] + 1j * out[settled, 1]) / wave[settled]
        return float(abs(answer.mean()))

    assert gain(cutoff) == pytest.approx(math.sqrt(0.5), abs=2e-3)
    assert gain(cutoff / 10.0) == pytest.approx(1.0, abs=1e-3)
    higher = 3.0 * cutoff
    if higher < rate / 2:
        warped = math.tan(math.pi * higher / rate) / math.tan(math.pi * cutoff / rate)
        assert gain(higher) == pytest.approx(1.0 / math.sqrt(1.0 + warped**4), abs=2e-3)


@pytest.mark.parametrize("make", [lambda: LowPass(20.0, 1000.0), lambda: Mean(9)])
def test_a_ramp_comes_out_later_by_the_delay(make) -> None:
    maker = make()
    ramp = np.arange(1800.0)[:, None]
    result = maker.take(ramp)
    assert result is not None
    assert ramp[-1, 0] - result[0] == pytest.approx(maker.delay, rel=1e-6)


@given(lowpasses, sizes, st.integers(0, 2**32 - 1))
def test_blocks_of_any_size_give_what_single_values_give(kind, blocks, seed) -> None:
    values = np.random.default_rng(seed).normal(size=(sum(blocks), 2))
    whole, single = LowPass(*kind), LowPass(*kind)
    cuts = np.cumsum(blocks)[:-1]
    in_blocks = np.concatenate([whole.filter(part) for part in np.split(values, cuts)])
    one_by_one = np.concatenate([single.filter(value[None]) for value in values])
    assert in_blocks == pytest.approx(one_by_one, abs=1e-9)


@given(st.integers(1, 20), sizes)
def test_windows_do_not_depend_on_blocks(window, blocks) -> None:
    values = np.arange(float(sum(blocks)))[:, None]
    mean, newest = Mean(window), None
    for part in np.split(values, np.cumsum(blocks)[:-1]):
        result = mean.take(part)
        newest = result if result is not None else newest
    whole = len(values) // window
    if whole == 0:
        assert newest is None
    else:
        assert newest == pytest.approx(values[(whole - 1) * window : whole * window].mean())


@pytest.mark.parametrize("make", [lambda: LowPass(20.0, 1000.0), lambda: Mean(9)])
def test_reset_forgets(make) -> None:
    maker, fresh = make(), make()
    maker.take(np.full((31, 6), 7.0))
    maker.reset()
    values = np.random.default_rng(0).normal(size=(40, 6))
    assert maker.take(values) == pytest.approx(fresh.take(values))


@pytest.mark.parametrize("cutoff", [0.0, -1.0, 500.0, 501.0, math.nan])
def test_a_cut_off_that_cannot_be_is_refused(cutoff) -> None:
    with pytest.raises(ValueError, match="cut-off"):
        LowPass(cutoff, 1000.0)
    with pytest.raises(ValueError, match="window"):
        Mean(0)


@pytest.mark.parametrize(
    ("times", "before", "index"),
    [
        ([1.0, 1.1, 1.2], 0.9, -1),
        ([1.0, 1.1, 1.2], math.inf, -1),
        ([1.0, 1.1, 1.2], 0.5, 0),
        ([1.0, 1.5, 2.0, 2.1], 0.9, 2),
    ],
)
def test_what_is_behind_the_last_gap_is_found(times, before, index) -> None:
    assert behind_gap(np.array(times), before, 0.2) == index

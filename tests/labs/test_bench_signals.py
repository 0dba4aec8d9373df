"""Numbers out of signals, against signals that are known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_drivers.labs.bench.limits import peak_speed
from crtk_drivers.labs.bench.reaction import SEQUENCE, delay
from crtk_drivers.labs.bench.signals import (
    fit_sine,
    largest_line,
    noise,
    resolution,
    rest_time,
    slope,
)
from crtk_drivers.labs.bench.stops import speed_before
from crtk_drivers.labs.bench.trace import JointTrack


@given(st.floats(0.001, 10.0), st.floats(-3.0, 3.0), st.floats(0.2, 8.0), st.floats(-5.0, 5.0))
def test_a_sine_is_found_beside_a_line(
    amplitude: float, phase: float, frequency: float, drift: float
) -> None:
    at = np.arange(0.0, 3.0 / frequency, 0.05 / frequency)
    values = 7.0 + drift * at + amplitude * np.sin(2.0 * math.pi * frequency * at + phase)
    found = fit_sine(at, values, frequency)
    assert found.amplitude == pytest.approx(amplitude, rel=1e-6, abs=1e-9)
    assert math.remainder(found.phase - phase, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-6)
    assert found.rms < 1e-6


def test_too_few_samples_are_no_sine() -> None:
    with pytest.raises(ValueError, match="7 samples"):
        fit_sine(np.arange(7.0), np.zeros(7), 1.0)


def test_noise_is_told_without_the_drift() -> None:
    random = np.random.default_rng(2)
    values = np.column_stack([random.normal(0.0, 0.01, 5000), np.linspace(0.0, 5.0, 5000)])
    assert noise(values) == pytest.approx([0.01, 0.0], abs=5e-4)


def test_the_step_of_an_encoder_is_found() -> None:
    counts = np.array([0, 1, 1, 3, 2, 2, 5])
    values = np.column_stack([counts * 0.0015, np.zeros(7)])
    assert resolution(values) == pytest.approx([0.0015, 0.0])


def test_the_slope_of_a_line() -> None:
    at = np.array([0.0, 1.0, 5.0, 6.0])
    assert slope(at, 3.0 - 0.5 * at) == pytest.approx(-0.5)
    assert math.isnan(slope(np.zeros(3), np.zeros(3)))


def test_it_rests_when_every_column_stays_within_its_tolerance() -> None:
    at = np.arange(0.0, 1.0, 0.01)
    moving = np.minimum(at, 0.5)
    position = np.column_stack([moving, np.zeros_like(at)])
    tolerance = np.array([0.1, 0.1])
    assert rest_time(at, position, 0.2, tolerance) == pytest.approx(0.2, abs=0.011)
    assert rest_time(at, position, 0.6, tolerance) == 0.0
    assert math.isnan(rest_time(at, position, 2.0, tolerance))


def test_a_line_in_noise_is_found_with_its_amplitude() -> None:
    random = np.random.default_rng(3)
    at = np.arange(0.0, 8.0, 0.005)
    values = 0.02 * np.sin(2.0 * math.pi * 17.0 * at) + random.normal(0.0, 0.02, at.size)
    frequency, amplitude, floor = largest_line(values, 200.0, above=5.0)
    assert frequency == pytest.approx(17.0, abs=0.5)
    assert amplitude == pytest.approx(0.02, rel=0.2)
    assert floor < 0.004
    with pytest.raises(ValueError, match="too short"):
        largest_line(values[:100], 200.0, above=5.0)


def test_speed_before_a_stop_does_not_hang_on_when_samples_arrive() -> None:
    stamp = np.arange(0.0, 1.0, 0.01)
    arrival = np.ceil(stamp / 0.09) * 0.09 + 1e-5 * np.arange(100)
    nothing = np.full((100, 2), np.nan)
    position = np.column_stack([0.3 * stamp, -0.1 * stamp])
    track = JointTrack(arrival, stamp, position, nothing, nothing)
    assert speed_before(track, 0.92) == pytest.approx([0.3, 0.1])
    invalid = JointTrack(arrival, np.full(100, np.nan), position, nothing, nothing)
    assert speed_before(invalid, 0.92) == pytest.approx([0.0, 0.0])


def test_how_late_something_is_is_found_in_noise() -> None:
    random = np.random.default_rng(5)
    sent_at = np.arange(0.0, 6.0, 0.01)
    sent = np.array([SEQUENCE[int(t / 0.1) % len(SEQUENCE)] for t in sent_at], dtype=float)
    at = np.arange(1.5, 5.0, 0.002)
    late = np.interp(at - 0.0832, sent_at, sent)
    found, alike = delay(sent_at, sent, at, late + random.normal(0.0, 0.1, at.size), 0.5)
    assert found == pytest.approx(0.0832, abs=2e-3)
    assert alike > 0.95
    _, alike = delay(sent_at, sent, at, random.normal(0.0, 0.1, at.size), 0.5)
    assert alike < 0.3


def test_a_sequence_looks_like_itself_at_no_other_delay() -> None:
    levels = 2 * np.array(SEQUENCE) - 1
    assert [int(levels @ np.roll(levels, shift)) for shift in range(15)] == [15, *[-1] * 14]


def test_the_greatest_speed_is_taken_over_some_time() -> None:
    at = np.arange(0.0, 1.0, 0.002)
    position = np.column_stack([np.where(at < 0.5, 0.0, np.minimum(2.0 * (at - 0.5), 0.2))])
    nothing = np.full((at.size, 1), np.nan)
    track = JointTrack(at, at, position, nothing, nothing)
    assert peak_speed(track, 0, 0.04) == pytest.approx(2.0)
    assert peak_speed(track, 0, 0.04, allowed=0.02) == pytest.approx(1.5, rel=0.03)
    position[100] += 1e-3  # one sample that is off
    assert peak_speed(track, 0, 0.04) == pytest.approx(2.0)
    assert math.isnan(peak_speed(track, 0, 2.0))

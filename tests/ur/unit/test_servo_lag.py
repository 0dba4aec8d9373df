"""The lag of a servo stream, of motions whose lag is known."""

import math

import pytest

from crtk_driver_ur.servo_lag import ServoLag

PERIOD = 0.002


def follow(lag: ServoLag, delay: float, speed: float, cycles: int = 500) -> None:
    for i in range(cycles):
        t = i * PERIOD
        lag.command([speed * t, -2.0 * speed * t])
        lag.measure(
            [speed * (t - delay), -2.0 * speed * (t - delay)],
            [speed, -2.0 * speed],
        )


@pytest.mark.parametrize("delay", [0.0, 0.03, 0.12])
@pytest.mark.parametrize("speed", [0.1, -0.7])
def test_a_constant_lag_is_found(delay, speed):
    lag = ServoLag()
    follow(lag, delay, speed)
    assert lag.seconds == pytest.approx(delay, abs=1e-9)


def test_a_new_lag_takes_over():
    lag = ServoLag()
    follow(lag, 0.2, 0.5)
    follow(lag, 0.05, 0.5)
    assert lag.seconds == pytest.approx(0.05, abs=1e-3)


def test_nothing_is_known_at_rest_and_without_a_stream():
    lag = ServoLag()
    follow(lag, 0.1, 0.001)
    assert math.isnan(lag.seconds)
    lag.end()
    lag.measure([0.0, 0.0], [1.0, 1.0])
    assert math.isnan(lag.seconds)

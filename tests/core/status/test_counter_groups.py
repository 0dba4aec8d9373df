"""What `crtk-driver check` makes of a device's counters."""

import math

from crtk_drivers.status.counter_groups import grouped


def test_counters_that_begin_alike_are_one_line_and_modes_are_words() -> None:
    counters = {
        "control program starts": 0.0,
        "servo lag (s)": math.nan,
        "packages lost": 12.0,
        "packages skipped": 0.0,
        "robot mode": 7.0,
        "safety mode": 1.0,
        "robot current (A)": 0.858649,
    }
    words = {"robot mode": "RUNNING", "safety mode": "NORMAL", "program": "PLAYING"}
    assert grouped(counters, words, ("elbow",), {}) == [
        "control program starts 0, servo lag (s) not known, safety mode NORMAL",
        "packages: lost 12, skipped 0",
        "robot: mode RUNNING, current (A) 0.859",
    ]


def test_what_every_joint_has_is_one_line_in_their_order() -> None:
    joints = ("shoulder", "elbow_1")
    counters = {f"{joint} temperature (°C)": 28.0 + n for n, joint in enumerate(joints)}
    counters |= {"elbow_1 current (A)": -1.5, "late": 2.0}
    assert grouped(counters, {}, joints, {}) == [
        "elbow_1 current (A) -1.5, late 2",
        "temperature (°C) by joint: 28, 29",
    ]


def test_names_with_underscores_share_as_many_words_as_they_have() -> None:
    counters = {
        "late": 0.0,
        "late_pdos": 1.0,
        "receive_buffer": 1048576.0,
        "arrival_jitter_p50": 0.0,
        "arrival_jitter_p99": 1e-5,
        "bias_fx": -0.25,
        "bias_fy": 0.0,
    }
    assert grouped(counters, {}, (), {}) == [
        "late 0, late pdos 1, receive buffer 1048576",
        "arrival jitter: p50 0, p99 1e-05",
        "bias: fx -0.25, fy 0",
    ]


def test_declared_units_are_shown() -> None:
    counters = {
        "arrival_jitter_p50": 6.9e-05,
        "arrival_jitter_p99": 0.0,
        "filter_delay": 1.5,
        "tick_rate": 7013.6,
        "bus_load": 0.112,
        "peak_of_rated": math.nan,
    }
    units = {
        "arrival_jitter_p50": "s",
        "arrival_jitter_p99": "s",
        "filter_delay": "s",
        "tick_rate": "Hz",
        "bus_load": "share",
        "peak_of_rated": "share",
    }
    assert grouped(counters, {}, (), units) == [
        "filter delay 1.5 s, tick rate 7014 Hz, bus load 11.2 %, peak of rated not known",
        "arrival jitter: p50 0.069 ms, p99 0 s",
    ]


def test_nothing_is_no_line() -> None:
    assert grouped({}, {"robot mode": "RUNNING"}, ("elbow",), {}) == []

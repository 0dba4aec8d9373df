"""The small parts between stream and device: rings, averages, what is monitored, what is configured."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_ati_netft import PLUGIN
from crtk_driver_ati_netft.blocks import MEASUREMENT, BlockRing
from crtk_driver_ati_netft.config import NetFtConfig
from crtk_driver_ati_netft.pipeline import Pipeline
from crtk_driver_ati_netft.profiles import AXIA, NETBOX
from crtk_driver_ati_netft.stream import Batch
from crtk_drivers.config import from_values, load
from crtk_drivers.errors import ConfigError
from crtk_drivers.kit.averaging import Averaging
from crtk_drivers.kit.clock_fit import WallClock
from crtk_drivers.kit.sensing.filters import LowPass, Mean
from crtk_drivers.kit.sensing.load_monitor import LATCH, LoadMonitor
from crtk_drivers.samples import vector


def block(first: int, count: int) -> np.ndarray:
    made = np.zeros(count, MEASUREMENT)
    made["ticks"] = np.arange(first, first + count)
    return made


def batch(values, status=None, first: int = 1, when: float = 10.0, rate: float = 1000.0) -> Batch:
    values = np.atleast_2d(np.asarray(values, float))
    count = len(values)
    ticks = np.arange(first, first + count)
    words = np.zeros(count, np.uint32) if status is None else np.array(status, np.uint32)
    return Batch(ticks.astype(np.uint32), ticks, words, values, when + ticks / rate)


# ---------------------------------------------------------------------------------------------- rings


@given(
    sizes=st.lists(st.integers(1, 25), max_size=20),
    reads=st.sets(st.integers(0, 20)),
    ring_size=st.integers(1, 30),
)
def test_a_reader_gets_everything_or_knows_what_it_missed(sizes, reads, ring_size) -> None:
    ring = BlockRing(ring_size)
    ring.open()
    reader = ring.reader()
    added, got = 0, []
    for i, size in enumerate(sizes):
        ring.add(block(added, size))
        added += size
        if i in reads:
            got.append(reader.read(0.0)["ticks"])
    got.append(reader.read(0.0)["ticks"])
    ticks = np.concatenate(got)
    assert (np.diff(ticks) > 0).all()
    assert len(ticks) + reader.missed == added
    newest = ring.newest(7)["ticks"].tolist()
    assert newest == list(range(max(0, added - min(7, ring_size)), added))


def test_a_reader_begins_with_what_comes_next_and_waits_for_it() -> None:
    ring = BlockRing(100)
    ring.open()
    ring.add(block(0, 10))
    reader = ring.reader()
    assert len(reader.read(0.0)) == 0
    found: list[np.ndarray] = []
    thread = threading.Thread(target=lambda: found.append(reader.read(10.0)))
    thread.start()
    ring.add(block(10, 3))
    thread.join()
    assert found[0]["ticks"].tolist() == [10, 11, 12]


def test_iterating_ends_with_the_ring() -> None:
    ring = BlockRing(100)
    ring.open()
    reader = ring.reader()
    ring.add(block(0, 3))
    ring.close()
    assert [len(some) for some in reader] == [3]
    assert list(reader) == []


# -------------------------------------------------------------------------------------------- averages


def test_an_average_takes_what_was_measured_in_its_time() -> None:
    averaging = Averaging(0.005, begin=10.0)
    averaging.take(np.full((4, 6), 9.0), vector([9.997, 9.998, 9.999, 10.0]))
    assert not averaging.done
    averaging.take(np.array([[1.0] * 6, [2.0] * 6]), vector([10.001, 10.002]))
    assert not averaging.done
    averaging.take(np.array([[3.0] * 6, [99.0] * 6]), vector([10.005, 10.006]))
    assert averaging.done
    result = averaging.result()
    assert result.count == 3
    assert result.mean == pytest.approx([2.0] * 6)
    assert result.deviation == pytest.approx([np.sqrt(2.0 / 3.0)] * 6)


def test_an_average_of_a_sensor_that_paused_begins_after_the_pause() -> None:
    averaging = Averaging(0.005, begin=10.0)
    averaging.take(np.array([[1.0] * 6, [3.0] * 6]), vector([10.1, 10.102]))
    assert not averaging.done
    averaging.take(np.array([[5.0] * 6, [99.0] * 6]), vector([10.105, 10.106]))
    assert averaging.done
    assert averaging.result().mean == pytest.approx([3.0] * 6)


# ------------------------------------------------------------------------------------------- monitored


def looked_at(values, status=None) -> tuple[np.ndarray, np.ndarray]:
    """What a monitor looks at."""
    made = batch(values, status)
    return made.status, made.values


def test_a_condition_is_told_for_a_while_after_it_is_over() -> None:
    monitor = LoadMonitor(NETBOX.status, alarm=1.0)
    monitor.take(*looked_at([[0] * 6] * 3, [0, 0x80020000, 0]), 5.0)
    monitor.take(*looked_at([[0] * 6] * 3, [0x80000004, 0, 0]), 5.1)
    assert "saturated" in monitor.saturation(5.0 + LATCH - 0.01)
    assert monitor.saturation(5.0 + LATCH + 0.01) == ""
    assert "temperature" in monitor.error(5.1 + LATCH - 0.01)
    assert monitor.error(5.1 + LATCH + 0.01) == ""
    assert (monitor.saturated_records, monitor.error_records) == (1, 1)


def test_a_value_is_as_good_as_the_worst_measurement_in_it() -> None:
    monitor = LoadMonitor(NETBOX.status, alarm=1.0, on_saturation="invalid")
    clean, bad = [0] * 3, [0, 0x80020000, 0]
    for words, rest, is_valid in (
        ([bad, clean], 0, False),  # also where those that arrived last are clean
        ([clean], 0, True),
        ([clean, bad], 1, False),
        ([clean], 0, True),
        ([bad], 2, False),
        ([clean], 0, False),  # two of those before are in it
        ([clean], 0, True),
    ):
        for word in words:
            monitor.take(*looked_at([[0] * 6] * 3, word), 5.0)
        assert monitor.is_value_valid(rest) is is_valid
    monitor.take(*looked_at([[0] * 6] * 3, bad), 5.0)
    monitor.clear()
    assert monitor.is_value_valid()


def test_notices_are_those_of_the_newest_record() -> None:
    monitor = LoadMonitor(AXIA.status, alarm=1.0)
    monitor.take(*looked_at([[0] * 6] * 2, [0, 0x10010000]), 5.0)
    assert monitor.notices == ("simulated error", "monitor condition latched")
    monitor.take(*looked_at([[0] * 6], [0]), 5.0)
    assert monitor.notices == ()
    assert monitor.error(5.0) == ""


def test_an_overload_names_the_axis() -> None:
    monitor = LoadMonitor(NETBOX.status, alarm=0.8)
    monitor.take(*looked_at([[1000] * 6]), 5.0)
    assert monitor.overload(5.0) == "", "what it is rated for is not known"
    monitor.set_rated(vector([100, 100, 200, 10, 10, 10]))
    monitor.take(*looked_at([[0, 0, -100, 0, 0, 0]]), 5.0)
    assert monitor.overload(5.0) == ""
    monitor.take(*looked_at([[0, 0, -180, 0, 7, 0]]), 5.0)
    assert monitor.overload(5.1) == "Fz bears 90% of its rated load"
    assert monitor.overload(5.0 + LATCH) == ""
    assert monitor.peak == pytest.approx(0.9)


# -------------------------------------------------------------------------------------------- pipeline


def test_values_are_stamped_with_the_newest_measurement_in_them() -> None:
    pipeline = Pipeline(100.0, None, np.eye(6))
    values = np.arange(25.0)[:, None] * np.ones(6)
    published = pipeline.take(batch(values), record_rate=1000.0)
    assert published is not None
    assert published.value == pytest.approx([14.5] * 6)
    assert published.raw == pytest.approx([19.0] * 6)
    assert published.time == pytest.approx(10.020)
    assert pipeline.delay == pytest.approx(4.5e-3)
    assert pipeline.pending == pytest.approx(5e-3)
    assert pipeline.take(batch(values[:3], first=26), 1000.0) is None
    published = pipeline.take(batch(values[:2], first=29), 1000.0)
    assert published is not None
    assert published.time == pytest.approx(10.030)


def test_the_filter_follows_the_rate_of_the_records() -> None:
    pipeline = Pipeline(100.0, None, np.eye(6))
    pipeline.take(batch([[1] * 6] * 10), 1000.0)
    pipeline.take(batch([[1] * 6] * 10), 1001.0)
    assert isinstance(pipeline._filter, Mean)
    assert pipeline._filter.window == 10
    pipeline.take(batch([[1] * 6] * 10), 7912.0)
    assert pipeline._filter.window == 79
    low = Pipeline(100.0, 30.0, np.eye(6))
    low.take(batch([[1] * 6] * 10), 1000.0)
    assert isinstance(low._filter, LowPass)
    low.take(batch([[1] * 6] * 10), 50.0)
    assert isinstance(low._filter, Mean), "a cut-off above half the rate cannot be"


def test_stamps_go_on_though_two_clocks_seem_to_differ_by_less() -> None:
    """Records that come together are stamped near each other: nearer than the two clocks can be read."""
    pipeline = Pipeline(100.0, None, np.eye(6))
    ahead = iter([0, -60_000, -90_000, 10_000, -5_000_000_000])  # ns
    pipeline._wall_clock = WallClock(lambda: 0, lambda: next(ahead))
    seen: list[np.ndarray] = []
    pipeline.add_listener(seen.append)
    for first in (1, 3, 5, 7, 9):
        pipeline.take(batch([[0] * 6] * 2, first=first, rate=100_000.0), 1000.0)
    steps = np.diff(np.concatenate(seen)["stamp"])
    assert (steps[:7] > 0).all()
    assert steps[7] == pytest.approx(-5e9, rel=1e-3), "that clock was set"


def test_blocks_hold_everything_at_the_full_rate() -> None:
    pipeline = Pipeline(100.0, None, np.eye(6))
    pipeline.ring.open()
    pipeline.set_bias(vector([1, 0, 0, 0, 0, 0]))
    seen: list[np.ndarray] = []
    pipeline.add_listener(seen.append)
    pipeline.take(batch([[3] * 6, [4] * 6], [0, 7], first=5), 1000.0)
    (some,) = seen
    assert some["raw"].tolist() == [[3] * 6, [4] * 6]
    assert some["wrench"].tolist() == [[2, 3, 3, 3, 3, 3], [3, 4, 4, 4, 4, 4]]
    assert some["status"].tolist() == [0, 7]
    assert some["sequence"].tolist() == some["ticks"].tolist() == [5, 6]
    assert np.diff(some["stamp"]) == pytest.approx([1e6], abs=1e3)
    assert not some.flags.writeable
    assert pipeline.ring.newest(9)["raw"].tolist() == some["raw"].tolist()


# --------------------------------------------------------------------------------------- configuration


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"http": False}, "scale: is needed"),
        ({"profile": "netbox", "mode": "single"}, "netbox has no single"),
        ({"profile": "onrobot", "mode": "buffered"}, "onrobot has no buffered"),
        ({"profile": "axis"}, "Did you mean 'axia'"),
        ({"rate": 5.0}, "rate"),
        ({"rate": 9000.0}, "rate"),
        ({"point": [0, 0, 0.1]}, "measuring_frame_id"),
        ({"rotation": [0, 0, 1], "measuring_frame_id": "ft_sensor"}, "measuring_frame_id"),
        ({"scale": {"counts_per_force": 0, "counts_per_torque": 1}}, "counts_per_force"),
        (
            {"scale": {"counts_per_force": 1, "counts_per_torque": 1, "force_unit": "stone"}},
            "'stone'",
        ),
        ({"tool": {"mass": -1}}, "mass"),
        ({"bias": [0, 0, 0]}, "bias"),
        ({"sensor": {"filter_code": 13}}, "filter_code"),
        ({"lowpass": 20}, "Did you mean 'low_pass'"),
        ({"low_pass": float("nan")}, "low_pass"),
    ],
)
def test_a_configuration_that_cannot_be_is_refused_with_what_is_meant(values, message) -> None:
    with pytest.raises(ConfigError) as caught:
        load(NetFtConfig, from_values(values))
    assert message in str(caught.value)


def test_a_real_sensor_needs_an_address() -> None:
    with pytest.raises(ConfigError, match="host"):
        PLUGIN.check_real(NetFtConfig())
    PLUGIN.check_real(NetFtConfig(host="192.168.1.1"))


def test_the_scale_that_is_typed_in_is_in_its_units() -> None:
    config = load(
        NetFtConfig,
        from_values(
            {
                "scale": {
                    "counts_per_force": 1e6,
                    "counts_per_torque": 1e6,
                    "torque_unit": "N-mm",
                }
            }
        ),
    )
    assert config.scale is not None
    assert config.scale.scale.factors == pytest.approx([1e-6] * 3 + [1e-9] * 3)


def test_making_a_device_touches_nothing() -> None:
    before = set(threading.enumerate())
    device = PLUGIN.create(NetFtConfig(host="192.0.2.1"))
    assert device.address == "192.0.2.1:49152"
    assert device.notes == () or all(note.text for note in device.notes)
    assert device.counters["record_rate"] == 0.0
    device.close()
    device.close()
    assert set(threading.enumerate()) == before

"""Position mode knows one turn of the encoder, whose ends lie at the homing offset: nothing turns a turn.

With torque a servo counts within that turn, wherever it counted before. The simulator says where its horn is.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from crtk_driver_dynamixel.calibration import Calibration, ServoCalibration, save_calibration
from crtk_drivers.errors import ConfigError, CrtkError
from rigs.dynamixel_bench import (
    BOOT_TIME,
    COUNT,
    LONG,
    PATIENT,
    DynamixelBench,
    driver_at,
    eventually,
    opened,
    place,
    sim_for,
)

MODELS = ("xm430-w350", "xc430-w240", "xl330-m288", "xh540-v270")
MIDDLE = 2048
HOMING_OFFSET = 20


def values(model: str, lower: int, upper: int, **more: Any) -> dict[str, Any]:
    """A joint whose range is these counts."""
    ends = {"lower": (lower - MIDDLE) * COUNT, "upper": (upper - MIDDLE) * COUNT}
    return {**PATIENT, "joints": {"a": {"id": 1, "model": model, **ends}}, **more}


def put(sim: Any, count: int, homing: int) -> None:
    """Turn the joint by hand to where it counts so."""
    place(sim, 1, (count - homing - MIDDLE) * COUNT)


@contextmanager
def servo_of(config: dict[str, Any], homing: int) -> Iterator[Any]:
    """A simulated servo with a homing offset in its EEPROM."""
    with sim_for(config) as sim:
        write_homing(sim, homing)
        yield sim


def write_homing(sim: Any, homing: int) -> None:
    """As another program would."""
    data = homing.to_bytes(4, "little", signed=True).hex()
    sim.control.call("write", id=1, address=HOMING_OFFSET, data=data)


def switch_off_and_on(sim: Any) -> None:
    sim.control.inject("power_off")
    sim.control.clear()
    started = sim.control.status()["time"]
    eventually(lambda: sim.control.status()["time"] > started + BOOT_TIME, "it starts")


def measured(bench: DynamixelBench) -> float:
    return float(bench.arm.measured_js().position[0]) / COUNT + MIDDLE


BEYOND = [
    pytest.param(-100, 100, 3900, 4010, id="-100"),
    pytest.param(-1024, 100, 3000, 3090, id="-1024"),
    pytest.param(900, 1000, 4000, 850, id="900"),
    pytest.param(1024, 1100, 4000, 1000, id="1024"),
]
"""Homing offset, range, and a count beyond the end of the turn, to which the joint can be turned by hand."""


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(("homing", "lower", "upper", "count"), BEYOND)
def test_enable_beyond_the_turn_is_refused(model, homing, lower, upper, count):
    config = values(model, lower, upper)
    with servo_of(config, homing) as sim, driver_at(sim, config) as bench:
        put(sim, count, homing)
        bench.cycles(3)
        with bench.nothing_moves(), pytest.raises(CrtkError) as caught:
            bench.arm.enable(timeout=LONG)
        assert f"stands at count {count}, outside its own limits" in str(caught.value)
        assert "switch its supply off and on" in str(caught.value)
        assert bench.torques() == [False]
        put(sim, (lower + upper) // 2, homing)
        bench.cycles(3)
        with bench.nothing_moves():
            bench.arm.enable(timeout=LONG)
            bench.cycles(10)
        assert bench.torques() == [True]
        assert measured(bench) == pytest.approx((lower + upper) // 2, abs=3)


@pytest.mark.parametrize(("homing", "lower", "upper", "count"), BEYOND)
def test_check_names_a_joint_beyond_its_turn(homing, lower, upper, count):
    config = values("xm430-w350", lower, upper)
    with servo_of(config, homing) as sim:
        put(sim, count, homing)
        with opened(sim, config) as device:
            device.read(0.0)
            (found,) = [str(error) for error in device.obstacles]
        assert f"stands at count {count}" in found


@pytest.mark.parametrize(("homing", "lower", "upper", "count"), BEYOND)
def test_hold_beyond_the_turn_is_a_fault(homing, lower, upper, count):
    """A hand has turned the free joint over the end of its encoder's turn, and is still there."""
    config = values("xm430-w350", lower, upper)
    with servo_of(config, homing) as sim, driver_at(sim, config) as bench:
        put(sim, (lower + upper) // 2, homing)
        bench.arm.enable(timeout=LONG)
        bench.arm.free()
        eventually(lambda: bench.torques() == [False], "it is free")
        put(sim, count, homing)
        bench.cycles(3)
        with bench.nothing_moves():
            bench.arm.hold()
            bench.until_state("FAULT", f"stands at count {count}, outside its own limits")
            bench.cycles(10)
        assert bench.torques() == [False]


@pytest.mark.parametrize(
    ("homing", "lower", "upper", "end"),
    [
        pytest.param(-100, 1000, 3994, 1, id="-100"),
        pytest.param(-1024, 1000, 3070, 1, id="-1024"),
        pytest.param(900, 901, 3000, -1, id="900"),
        pytest.param(1024, 1025, 3000, -1, id="1024"),
    ],
)
def test_beside_the_end_it_stays_in_range(homing, lower, upper, end):
    """Its range ends with the turn of its encoder; it is sent there, let go there, and held there."""
    config = values("xm430-w350", lower, upper)
    last = upper if end > 0 else lower
    with servo_of(config, homing) as sim, driver_at(sim, config) as bench:

        def really() -> float:
            return float(sim.control.outputs()["bus1/1"]["angle"] / COUNT + homing + MIDDLE)

        def stands() -> bool:
            before = really()
            bench.cycles(5)
            return abs(really() - before) < 0.5

        put(sim, last - end * 300, homing)
        bench.arm.enable(timeout=LONG)
        for _ in range(60):
            bench.arm.servo_jv([end * 2.0])
            bench.cycles(1)
            assert lower - 10 < really() < upper + 10
        bench.arm.hold()
        eventually(lambda: stands() and abs(really() - last) < 40, "it stands beside the end")
        for ask in (bench.arm.free, bench.arm.hold, bench.arm.pause, bench.arm.resume):
            with bench.nothing_moves():
                ask()
                bench.cycles(5)
        bench.arm.move_jp([(last - end * 200 - MIDDLE) * COUNT]).wait(LONG)
        assert really() == pytest.approx(last - end * 200, abs=10)


@pytest.mark.parametrize(
    ("homing", "lower", "upper", "possible"),
    [
        pytest.param(-100, 100, 4090, "-2.9882 to 2.9867 rad", id="-100"),
        pytest.param(900, 200, 4000, "-1.7610 to 2.9943 rad", id="900"),
        pytest.param(1024, 0, 4095, "-1.5708 to 3.1401 rad", id="1024"),
    ],
)
def test_a_range_beyond_the_turn_is_refused(homing, lower, upper, possible):
    config = values("xc430-w240", lower, upper)
    with servo_of(config, homing) as sim, driver_at(sim, config) as bench:
        with bench.nothing_moves(), pytest.raises(CrtkError) as caught:
            bench.arm.enable(timeout=LONG)
        assert f"Narrow lower and upper to {possible}" in str(caught.value)
        assert bench.torques() == [False]
    with servo_of(config, homing) as sim, opened(sim, config) as device:
        assert any(possible in str(error) for error in device.obstacles)


@pytest.mark.parametrize(("homing", "count"), [(-100, 4050), (900, 500), (-1024, 4090)])
def test_a_restarted_joint_is_in_its_range(homing, count):
    """It counts within the encoder's turn then, and its range goes beyond it."""
    config = values("xm430-w350", 100, 4095)
    with servo_of(config, homing) as sim, driver_at(sim, config) as bench:
        put(sim, count, homing)
        bench.cycles(3)
        assert measured(bench) == pytest.approx(count, abs=2)
        switch_off_and_on(sim)
        bench.until_connected()
        eventually(lambda: abs(measured(bench) - count) < 2, "it is where it was")
        with bench.nothing_moves(), pytest.raises(CrtkError, match="its range is 100 to 4095"):
            bench.arm.enable(timeout=LONG)
        put(sim, 2000, homing)
        eventually(lambda: abs(measured(bench) - 2000) < 2, "it counts on")
        switch_off_and_on(sim)
        eventually(lambda: abs(measured(bench) - 2000) < 2, "it is where it was")
    with servo_of(config, homing) as sim:
        put(sim, count, homing)
        switch_off_and_on(sim)
        with driver_at(sim, config) as bench:
            assert measured(bench) == pytest.approx(count, abs=2)


def test_a_servo_that_counts_otherwise_with_torque_loses_it():
    """Another program has moved the encoder's turn while the joint was free."""
    config = values("xm430-w350", 100, 4000)
    with servo_of(config, 0) as sim, driver_at(sim, config) as bench:
        bench.arm.enable(timeout=LONG)
        bench.arm.free()
        eventually(lambda: bench.torques() == [False], "it is free")
        write_homing(sim, -900)
        put(sim, 3300, -900)
        bench.cycles(3)
        with bench.nothing_moves(counts=200):
            bench.arm.hold()
            bench.until_state("FAULT", "counts -796 with torque, and 3300 without")
            eventually(lambda: bench.torques() == [False], "it has no torque")
            bench.until_still()


def test_a_calibration_says_where_the_turn_ends(tmp_path):
    """A range that the servo cannot have with its homing offset is refused before anything is opened."""
    config = values("xm430-w350", 100, 4000, calibration=str(tmp_path / "calibration.yaml"))
    servo = ServoCalibration(joint="a", bus="main", id=1, model="xm430-w350", homing_offset=-100)
    save_calibration(config["calibration"], Calibration(servos=(servo,)))
    with (
        sim_for(config) as sim,
        pytest.raises(ConfigError, match=r"counts 100 to 4000, of which .* takes 0 to 3995"),
        opened(sim, config),
    ):
        pass

"""Homing of the simulated drive, every method from everywhere (CiA 402-2, 12)."""

import math

import pytest

from crtk_sim_backends.canopen.homing import METHODS
from crtk_sim_backends.canopen.personality import PERSONALITIES
from crtk_sim_backends.canopen.plant import MotorConfig
from rigs.canopen_drive import COUNTS, HM, Bench

LEFT, RIGHT = 0.3, 0.6  # edges of the home switch, revolutions
MOTOR = {
    "home": (LEFT, RIGHT),
    "negative_limit": -2.25,
    "positive_limit": 2.25,
    "stops": (-2.5, 2.5),
    "coulomb": 0.005,
}
STARTS = (-1.2, 0.45, 1.3)
HALT = 0x100

HOME = {
    **dict.fromkeys((19, 20, 23, 24, 29, 30), LEFT),
    **dict.fromkeys((21, 22, 25, 26, 27, 28), RIGHT),
    17: -2.25,
    18: 2.25,
    1: -2.0,
    2: 2.0,
    **dict.fromkeys((3, 6, 7, 9, 12, 14), 0.0),  # the index pulse on one side of the switch
    **dict.fromkeys((4, 5, 8, 10, 11, 13), 1.0),
    -1: 2.0,
    -2: -2.0,
    -3: 2.5,
    -4: -2.5,
}


def home(bench, method, offset=0):
    """Run a method to its end; bits 13, 12 and 10 of the statusword."""
    bench.write(0x6098, 0, method, "b")
    bench.write(0x607C, 0, offset, "i")
    bench.write(0x6072, 0, 500, "H")
    bench.write(0x6099, 2, COUNTS)
    bench.enable(HM)
    bench.run(0.01)
    assert bits(bench) == (0, 0, 1)  # not started
    bench.control(0x1F)
    if method not in (35, 37):
        assert bits(bench) == (0, 0, 0)  # under way
    bench.until(lambda: bits(bench) != (0, 0, 0), 30.0)
    bench.until(lambda: bits(bench)[2], 1.0)
    bench.run(0.2)
    return bits(bench)


def bits(bench):
    word = bench.statusword
    return word >> 13 & 1, word >> 12 & 1, word >> 10 & 1


def home_position(bench, offset=0):
    """Where the motor stood (revolutions) at the position that is now the home offset."""
    return bench.axis.revolutions - (bench.axis.position - offset) / COUNTS


def test_supported_methods_are_those_that_can_be_chosen():
    bench = Bench()
    count = bench.read(0x60E3, 0, "B")
    assert {bench.read(0x60E3, n, "b") for n in range(1, count + 1)} == set(METHODS)
    for method in range(-10, 40):
        refused = bench.abort_of(bench.write, 0x6098, 0, method, "b")
        assert bool(refused) == (method not in METHODS)


@pytest.mark.sweep(3)
@pytest.mark.parametrize("method", sorted(HOME))
@pytest.mark.parametrize("start", STARTS)
def test_method(method, start):
    bench = Bench(MotorConfig(start=start, **MOTOR), step=0.01)
    assert home(bench, method) == (0, 1, 1)
    tolerance = 0.002 if method > -3 else 0.01
    assert home_position(bench) == pytest.approx(HOME[method], abs=tolerance)


@pytest.mark.parametrize("start", STARTS)
@pytest.mark.parametrize(("method", "round_"), [(33, math.floor), (34, math.ceil)])
def test_index_pulse(method, round_, start):
    bench = Bench(MotorConfig(start=start, **MOTOR))
    assert home(bench, method) == (0, 1, 1)
    assert home_position(bench) == pytest.approx(round_(start), abs=0.002)


@pytest.mark.parametrize("method", [35, 37])
def test_present_position_is_home_without_motion(method):
    bench = Bench(MotorConfig(start=1.3, **MOTOR))
    assert home(bench, method, offset=12345) == (0, 1, 1)
    assert bench.position() == pytest.approx(12345, abs=5)
    assert bench.axis.revolutions == pytest.approx(1.3, abs=0.001)


def test_home_offset_is_the_way_to_zero_for_drives_that_take_the_text_literally():
    bench = Bench(MotorConfig(**MOTOR, start=-1.2), personality=PERSONALITIES["literal"])
    assert home(bench, 24, offset=5000) == (0, 1, 1)
    assert home_position(bench, -5000) == pytest.approx(LEFT, abs=0.02)


def test_home_offset_is_the_position_at_home():
    bench = Bench(MotorConfig(start=-1.2, **MOTOR))
    assert home(bench, 24, offset=5000) == (0, 1, 1)
    assert home_position(bench, 5000) == pytest.approx(LEFT, abs=0.002)


def test_reversed_polarity_reverses_homing():
    bench = Bench(MotorConfig(start=1.2, **MOTOR))
    bench.write(0x607E, 0, 0xC0, "B")
    assert home(bench, 17) == (0, 1, 1)
    zero = bench.axis.revolutions + bench.axis.position / COUNTS
    assert zero == pytest.approx(2.25, abs=0.002)


def test_halt_interrupts():
    bench = Bench(MotorConfig(start=-1.2, **MOTOR))
    bench.write(0x6098, 0, 24, "b")
    bench.enable(HM)
    bench.control(0x1F)
    bench.run(0.1)
    bench.control(0x1F | HALT)
    bench.until(lambda: bits(bench) == (0, 0, 1), 1.0)
    bench.run(0.2)
    here = bench.position()
    bench.control(0x1F)  # no edge of bit 4
    bench.run(0.3)
    assert abs(bench.position() - here) < 20
    bench.control(0x0F)
    bench.control(0x1F)
    bench.until(lambda: bits(bench) == (0, 1, 1))


def test_start_bit_that_falls_interrupts():
    bench = Bench(MotorConfig(start=-1.2, **MOTOR))
    bench.write(0x6098, 0, 24, "b")
    bench.enable(HM)
    bench.control(0x1F)
    bench.run(0.1)
    bench.control(0x0F)
    bench.until(lambda: bits(bench) == (0, 0, 1), 1.0)


def test_switch_that_is_not_there_is_an_error():
    motor = {**MOTOR, "home": (50.0, 51.0)}
    bench = Bench(MotorConfig(start=0.5, **motor))
    assert home(bench, 24) == (1, 0, 1)
    assert bench.statusword & 0x6F == 0x27


@pytest.mark.parametrize("method", [19, 24, 26, 27])
def test_switch_that_is_passed_while_slowing_down(method):
    bench = Bench(MotorConfig(start=-1.2, **{**MOTOR, "home": (LEFT, LEFT + 0.04)}))
    assert home(bench, method) == (0, 1, 1)
    edge = LEFT if method < 25 else LEFT + 0.04
    assert home_position(bench) == pytest.approx(edge, abs=0.002)


def test_method_is_repeatable():
    bench = Bench(MotorConfig(start=0.0, **MOTOR))
    homes = []
    for _ in range(3):
        assert home(bench, 27) == (0, 1, 1)
        homes.append(home_position(bench))
        bench.control(0x0F)
    assert max(homes) - min(homes) < 1e-6


@pytest.mark.parametrize("way", [0, -600, -1500])
def test_an_epos4_goes_on_after_homing_and_counts_its_home_position_there(way):
    bench = Bench(MotorConfig(**MOTOR, start=1.0), personality=PERSONALITIES["epos4"])
    bench.write(0x6098, 0, 18, "b")
    bench.write(0x30B0, 0, 700, "i")
    bench.write(0x30B1, 0, way, "i")
    bench.enable(HM)
    bench.run(0.05)
    bench.control(0x1F)
    bench.until(lambda: bits(bench) == (0, 1, 1))
    assert bench.axis.position == pytest.approx(700, abs=5)
    assert bench.axis.revolutions == pytest.approx(2.25 + way / 2000, abs=5e-3)

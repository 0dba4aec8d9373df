"""Which turn a joint is in: what a file may be believed."""

from pathlib import Path

import pytest

from crtk_driver_dynamixel.models import OperatingMode, model_named
from crtk_driver_dynamixel.turns import Turns, TurnsFile, placed
from crtk_driver_dynamixel.units import Servo
from crtk_drivers.errors import ConfigError
from rigs.dynamixel_bench import COUNT
from rigs.waiting import eventually

SERVO = Servo(model_named("xm430-w350"), mode=OperatingMode.EXTENDED_POSITION)
TURN = 4096
HERE = 2048 + round(0.5 / COUNT)
"""0.5 rad, or some turns from there."""


def at(last, shift=None, *, clean=True, has_run_on=False):
    return placed(SERVO, HERE, last, shift, clean=clean, has_run_on=has_run_on)


def test_a_clean_file_is_believed():
    assert at(0.5 + 2 * TURN * COUNT) == (-2 * TURN, "")
    assert at(0.9 - TURN * COUNT) == (TURN, "")


def test_a_clean_file_that_the_servo_contradicts_is_not():
    shift, doubt = at(0.5 + 1.7 + 2 * TURN * COUNT)
    assert shift == -2 * TURN
    assert "turned" in doubt


def test_a_file_that_may_be_old_is_a_guess():
    assert at(8.998, clean=False).doubt
    assert at(8.998, 3 * TURN, clean=False).doubt


def test_a_servo_that_had_its_power_all_along_counts_on():
    assert at(55.0, 3 * TURN, clean=False, has_run_on=True) == (3 * TURN, "")
    assert at(55.0, None, clean=False, has_run_on=True).doubt


def test_the_file_keeps_the_newest(tmp_path: Path):
    file = TurnsFile(tmp_path / "turns.yaml")
    assert file.load() is None
    for number in range(20):
        file.keep(Turns(positions={"waist": float(number)}, shifts={"main/1": TURN}))
    eventually(lambda: (found := file.load()) and found.positions == {"waist": 19.0}, "the newest")
    assert file.end()
    found = file.load()
    assert found is not None
    assert found.shifts == {"main/1": TURN}
    assert not found.clean
    assert file.end(), "twice"


def test_a_file_of_an_earlier_version_is_not_clean(tmp_path: Path):
    path = tmp_path / "turns.yaml"
    path.write_text("positions: {waist: 1.0}\n")
    found = TurnsFile(path).load()
    assert found is not None
    assert not found.clean


def test_what_is_no_such_file(tmp_path: Path):
    path = tmp_path / "turns.yaml"
    path.write_text("positions: {waist: .nan}\n")
    with pytest.raises(ConfigError, match=r"positions\.waist: must be a finite number"):
        TurnsFile(path).load()
    with pytest.raises(ConfigError, match="cannot be written"):
        TurnsFile(tmp_path / "none" / "turns.yaml").save(Turns(positions={}))

"""The text of the control program: what is filled in, and which built-ins each controller is asked for."""

import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_ur.models import Limits
from crtk_driver_ur.native.program import (
    FEED,
    MOTION,
    SETTING,
    UPPER_RANGE,
    Kind,
    Phase,
    ProgramOptions,
    Setting,
    program_text,
)

NEWER = {
    "freedrive_mode": {(5, 10), (5, 23)},
    "end_freedrive_mode": {(5, 10), (5, 23)},
    "teach_mode": {(3, 5), (3, 15), (5, 0), (5, 9)},
    "end_teach_mode": {(3, 5), (3, 15), (5, 0), (5, 9)},
    "set_target_payload": {(3, 15), (5, 10), (5, 23)},
    "zero_ftsensor": {(5, 0), (5, 9), (5, 10), (5, 23)},
    "force_mode_set_gain_scaling": {(5, 0), (5, 9), (5, 10), (5, 23)},
}
"""Built-ins that not every controller has, and the versions whose program may name them."""

RANGES = Limits((-6.0,) * 6, (6.0,) * 5 + (math.inf,))
VERSIONS = ((3, 5), (3, 15), (5, 0), (5, 9), (5, 10), (5, 23))


def options(version=(5, 12), first=0) -> ProgramOptions:
    return ProgramOptions(version, first, 5.0, 0.002, 4.5, 2.5, 0.1, 4.5, (3.14,) * 6, RANGES)


@pytest.mark.parametrize("version", VERSIONS, ids=str)
def test_a_program_names_only_what_its_controller_has(version):
    calls = set(re.findall(r"(\w+)\(", program_text(options(version), 1)))
    for name, versions in NEWER.items():
        assert (name in calls) == (version in versions), name


def test_everything_is_filled_in():
    text = program_text(options(), 123456789)
    assert "$" not in text
    assert text.startswith("def crtk_control():\n")
    assert text.endswith("\nend\n")
    assert 'rtde_set_watchdog("input_int_register_0", 5.0, "stop")' in text
    assert "write_output_integer_register(0, 123456789)" in text
    assert "stopj(4.5)" in text
    assert "stopl(2.5, 4.5)" in text
    for kinds in (Kind, Phase, Setting):
        for kind in kinds:
            assert f"\n  {kind.name} = {kind.value}\n" in text


def test_the_names_of_all_kinds_differ():
    names = [kind.name for kinds in (Kind, Phase, Setting) for kind in kinds]
    assert len(set(names)) == len(names)


@pytest.mark.parametrize("first", [0, UPPER_RANGE])
def test_registers_stay_in_their_half(first):
    for registers in (FEED, MOTION, SETTING):
        numbers = [int(name.rpartition("_")[2]) for name in registers.names(first)]
        assert min(numbers) >= first
        assert max(numbers) < first + UPPER_RANGE
    text = program_text(options(first=first), 1)
    addresses = re.findall(r"register\((\d+)", text)
    assert min(map(int, addresses)) >= first
    assert f'"input_int_register_{first}"' in text


def test_no_register_belongs_to_motion_and_setting_both():
    assert not set(MOTION.doubles) & set(SETTING.doubles)
    (number_of_the_program,) = set(MOTION.ints) & set(SETTING.ints)
    assert number_of_the_program in FEED.ints


@given(st.integers(1, 2**31 - 1))
def test_every_number_is_written_as_it_is(program):
    assert program_text(options(), program).count(str(program)) >= 2

"""Configurations that cannot be are refused with the key."""

from __future__ import annotations

from typing import Any

import pytest

from crtk_driver_copley import PLUGIN
from crtk_driver_copley.config import CopleyConfig
from crtk_driver_copley.tables import ERRORS, FAULTS, error_text, fault_texts
from crtk_drivers.config import from_values, load
from crtk_drivers.device import Mode
from crtk_drivers.errors import ConfigError

JOINT = {"counts": 10_000.0, "lower": -1.0, "upper": 1.0, "velocity": 1.0}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"axis": "E"}, "axis"),
        ({"node": 128}, "node"),
        ({"counts": 0.0}, "counts"),
        ({"counts": float("nan")}, "counts"),
        ({"lower": 2.0}, "must be below upper"),
        ({"counts": 1e10}, "in the unit of the drive, which takes 2147483647"),
        ({"counts": 1e9, "velocity": 1.0}, "velocity: 1 would be"),
        ({"velocity": 0.05, "homing": {"method": "index_positive"}}, "homing: speed"),
        ({"homing": {"method": "limit"}}, "method"),
        ({"scale": 5}, "scale"),
    ],
)
def test_a_joint_that_cannot_be(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        load(CopleyConfig, from_values({"joints": {"a": {**JOINT, **changes}}}))


def test_two_joints_cannot_have_one_axis() -> None:
    with pytest.raises(
        ConfigError, match=r"joints\.b: node 0, axis the only one is also that of a"
    ):
        load(CopleyConfig, from_values({"joints": {"a": JOINT, "b": JOINT}}))
    load(CopleyConfig, from_values({"joints": {"a": JOINT, "b": {**JOINT, "axis": "B"}}}))


@pytest.mark.parametrize("baud", [4800, 250_000])
def test_a_rate_that_no_drive_has(baud: int) -> None:
    with pytest.raises(ConfigError, match="baud"):
        load(CopleyConfig, from_values({"baud": baud}))


@pytest.mark.parametrize(
    ("axes", "baud", "least"), [(1, 9600, "0.044"), (6, 115200, "0.036"), (16, 115200, "0.096")]
)
def test_points_that_the_line_does_not_carry(axes: int, baud: int, least: str) -> None:
    keys = {f"j{node}": {**JOINT, "node": node} for node in range(axes)}
    with pytest.raises(
        ConfigError, match=f"pvt_period: 0.03 s is too short .* give {least} or more"
    ):
        load(CopleyConfig, from_values({"joints": keys, "baud": baud}))
    load(CopleyConfig, from_values({"joints": keys, "baud": baud, "pvt_period": 0.1}))
    load(CopleyConfig, from_values({"joints": keys, "baud": baud, "tracking": "profile"}))


def test_what_real_hardware_needs() -> None:
    with pytest.raises(ConfigError, match="port"):
        PLUGIN.check_real(CopleyConfig())
    with pytest.raises(ConfigError, match="joints"):
        PLUGIN.check_real(CopleyConfig(port="/dev/ttyUSB0"))


def test_what_it_offers() -> None:
    config = load(CopleyConfig, from_values({"joints": {"a": JOINT}}))
    capabilities = PLUGIN.create(config).capabilities
    assert capabilities.modes == {Mode.JOINT_POSITION, Mode.JOINT_VELOCITY}
    assert not capabilities.needs_homing
    homed = {**JOINT, "homing": {"method": "here"}}
    config = load(CopleyConfig, from_values({"joints": {"a": homed}}))
    assert PLUGIN.create(config).capabilities.needs_homing


def test_every_error_and_fault_has_words_and_what_is_not_known_too() -> None:
    for code, meaning in ERRORS.items():
        assert error_text(code) is meaning
        assert meaning.text
    assert all(meaning.text and meaning.remedy for meaning in FAULTS.values())
    assert "not known" in error_text(200).text
    assert [meaning.text for meaning in fault_texts(1 << 7 | 1 << 9 | 1 << 20)] == [
        "encoder error",
        "following error",
        "latched fault 20",
    ]

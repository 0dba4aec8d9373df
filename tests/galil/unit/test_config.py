"""Configurations that cannot be are refused with the key."""

from __future__ import annotations

from typing import Any

import pytest

from crtk_driver_galil import PLUGIN
from crtk_driver_galil.config import GalilConfig
from crtk_drivers.config import from_values, load
from crtk_drivers.device import Mode
from crtk_drivers.errors import ConfigError

JOINT = {"axis": "B", "scale": 1e-4, "lower": -1.0, "upper": 1.0, "velocity": 1.0}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"axis": "I"}, "axis"),
        ({"scale": 0.0}, "scale"),
        ({"scale": float("nan")}, "scale"),
        ({"lower": 2.0}, "must be below upper"),
        ({"scale": 1e-12}, "more than PA takes"),
        ({"scale": 1e-9, "velocity": 900.0}, "more than SP takes"),
        ({"scale": 1e-9, "velocity": 0.02, "acceleration": 2.0}, "more than AC takes"),
        (
            {"velocity": 0.05, "homing": {"method": "index"}},
            r"homing.speed: 0.1 is more than velocity",
        ),
        ({"homing": {"method": "limit"}}, "method"),
        ({"gear": 5}, "gear"),
    ],
)
def test_a_joint_that_cannot_be(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        load(GalilConfig, from_values({"joints": {"a": {**JOINT, **changes}}}))


def test_two_joints_cannot_have_one_axis() -> None:
    with pytest.raises(ConfigError, match=r"joints\.b\.axis: B is also that of a"):
        load(GalilConfig, from_values({"joints": {"a": JOINT, "b": JOINT}}))


def test_what_real_hardware_needs() -> None:
    with pytest.raises(ConfigError, match="host"):
        PLUGIN.check_real(GalilConfig())
    with pytest.raises(ConfigError, match="joints"):
        PLUGIN.check_real(GalilConfig(host="192.168.1.20"))


def test_what_it_offers() -> None:
    config = load(GalilConfig, from_values({"joints": {"a": JOINT}}))
    capabilities = PLUGIN.create(config).capabilities
    assert capabilities.modes == {Mode.JOINT_POSITION, Mode.JOINT_VELOCITY}
    assert not capabilities.needs_homing
    homed = {**JOINT, "homing": {"method": "home"}}
    config = load(GalilConfig, from_values({"joints": {"a": homed}}))
    assert PLUGIN.create(config).capabilities.needs_homing

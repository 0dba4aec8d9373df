"""A device that may go nowhere but where its user allows: its gates refuse the rest."""

from __future__ import annotations

import pytest

import crtk_drivers
from crtk_drivers.errors import CommandRefused, ConfigError
from crtk_drivers.testing.loopback import LINEAR, LoopbackConfig, LoopbackDevice
from crtk_drivers.wrappers.confined import ConfinedDevice
from rigs.waiting import LONG

SPACE = {
    "joints": [
        {"lower": -0.1, "upper": 0.2},
        {"lower": -0.1, "upper": 0.1},
        {"lower": -0.1, "upper": 0.1},
        {"lower": -9.0, "upper": 9.0},
    ],
    "speed": 0.5,
}


def test_what_it_declares_is_narrower_and_never_wider() -> None:
    config = LoopbackConfig.model_validate({"space": SPACE})
    assert config.space is not None
    limits = ConfinedDevice(LoopbackDevice(), config.space.joints, 0.5).capabilities.limits
    assert (limits[0].lower, limits[0].upper) == (-0.1, 0.2)
    assert limits[0].velocity == 0.5 * LINEAR.velocity
    assert (limits[3].lower, limits[3].upper) == (-3.1, 3.1)


def test_the_driver_refuses_what_is_beyond_it() -> None:
    with crtk_drivers.connect("loopback", space=SPACE) as arm:
        arm.enable()
        with pytest.raises(CommandRefused, match=r"out_of_range.*0\.2"):
            arm.move_jp([0.25, 0.0, 0.0, 0.0])
        arm.move_jp([0.19, 0.0, 0.0, 0.0]).wait(timeout=LONG)
        assert arm.measured_js().position[0] == pytest.approx(0.19, abs=0.005)


@pytest.mark.parametrize(
    ("space", "message"),
    [
        ({"joints": [{"lower": 0.0, "upper": 0.1}]}, "1 ranges for 4 joints"),
        ({"joints": [{"lower": 5.0, "upper": 6.0}] * 4}, "x cannot be within 5 to 6"),
        ({"speed": 0.0}, "speed"),
        ({"tool_box": {"lower": [0, 0, 0], "upper": [1, 0, 1]}}, "must be below"),
    ],
)
def test_a_space_that_cannot_be_is_refused(space: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        crtk_drivers.connect("loopback", space=space)

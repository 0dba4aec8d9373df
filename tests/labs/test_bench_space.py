"""What the lab file allows goes together with what a device's own settings allow: the narrower counts."""

from __future__ import annotations

import pytest

from crtk_drivers.config import SpaceConfig
from crtk_drivers.errors import ConfigError


def space(**keys: object) -> SpaceConfig:
    return SpaceConfig.model_validate(keys)


def ranges(*ends: tuple[float, float]) -> list[dict[str, float]]:
    return [{"lower": lower, "upper": upper} for lower, upper in ends]


def test_the_slower_speed_counts_whichever_has_it() -> None:
    assert space(joints=ranges((-1, 1))).within(space(speed=0.1)).speed == 0.1
    assert space(speed=0.1).within(space(joints=ranges((-1, 1)))).speed == 0.1
    assert space(speed=0.3).within(None) == space(speed=0.3)


def test_ranges_that_only_one_has_stay() -> None:
    own = space(joints=ranges((-1, 1)))
    assert space(speed=0.1).within(own).joints == own.joints
    assert own.within(space(speed=0.1)).joints == own.joints


def test_of_two_ranges_and_boxes_what_both_have_counts() -> None:
    box, other = (
        {"lower": [0, 0, 0], "upper": [2, 2, 2]},
        {"lower": [-1, 1, 0.5], "upper": [1, 3, 3]},
    )
    one = space(joints=ranges((-1, 1), (0, 2)), tool_box=box)
    found = one.within(space(joints=ranges((-2, 0.5), (1, 3)), tool_box=other))
    assert found.joints == space(joints=ranges((-1, 0.5), (1, 2))).joints
    assert found.tool_box is not None
    assert (found.tool_box.lower, found.tool_box.upper) == ((0, 1, 0.5), (1, 2, 2))


@pytest.mark.parametrize("joints", [ranges((2, 3)), ranges((-1, 1), (-1, 1))])
def test_two_that_do_not_fit_are_refused(joints: list[dict[str, float]]) -> None:
    with pytest.raises(ConfigError, match="nothing in common"):
        space(joints=ranges((-1, 1))).within(space(joints=joints))

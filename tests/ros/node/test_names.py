"""`--ns` (bad input I18) and frame names."""

from __future__ import annotations

import pytest
import rclpy.validate_namespace
from hypothesis import given
from hypothesis import strategies as st
from rclpy.exceptions import InvalidNamespaceException

from crtk_drivers.errors import ConfigError
from crtk_drivers.ros.names import (
    MAX_LENGTH,
    Frames,
    checked_namespace,
    default_frame_prefix,
    suggestion,
)

REFUSED = [
    ("ur5", "/ur5"),
    ("", "/robot"),
    ("/ur5/", "/ur5"),
    ("/ur 5", "/ur_5"),
    ("/lab/../ur5", "/lab/ur5"),
    ("/lab//ur5", "/lab/ur5"),
    ("~/ur5", "/ur5"),
    ("/5ur", "/r5ur"),
    ("/ur-5", "/ur_5"),
    ("/ur__5", "/ur_5"),
    ("/ür5", "/_r5"),
    ("/ur5.left", "/ur5_left"),
    ("/ur5[0]", "/ur5_0"),
    ("/ur5\n", "/ur5"),
    ("/" + "a" * MAX_LENGTH, "/" + "a" * (MAX_LENGTH - 1)),
]


@pytest.mark.parametrize(("text", "better"), REFUSED)
def test_refused_with_a_better_one(text: str, better: str) -> None:
    with pytest.raises(ConfigError) as caught:
        checked_namespace(text)
    assert caught.value.remedy == f"Try: --ns {better}"
    assert checked_namespace(better) == better


@pytest.mark.parametrize("text", ["/", "/ur5", "/lab/left_arm", "/_hidden", "/" + "a" * 179])
def test_accepted_as_it_is(text: str) -> None:
    assert checked_namespace(text) == text


@given(st.text(alphabet=st.sampled_from("ab5_/ .-~ü[]"), max_size=30))
def test_never_more_lenient_than_ros(text: str) -> None:
    try:
        checked_namespace(text)
    except ConfigError:
        assert checked_namespace(suggestion(text)) == suggestion(text)
        return
    try:
        rclpy.validate_namespace.validate_namespace(text)
    except InvalidNamespaceException as error:
        raise AssertionError("ROS refuses it") from error


def test_frames() -> None:
    frames = Frames(default_frame_prefix("/lab/ur5"), "base")
    assert frames.outgoing("") == "lab/ur5/base"
    assert frames.outgoing("tool") == "lab/ur5/tool"
    assert frames.incoming("lab/ur5/tool") == "tool"
    assert frames.incoming("tool") == "tool"
    assert frames.incoming("") == ""
    assert default_frame_prefix("/") == ""

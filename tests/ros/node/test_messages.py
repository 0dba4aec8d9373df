"""What is put into messages: no number may change on the way."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message

from crtk_drivers.commands import Payload
from crtk_drivers.ros.messages import TYPES, fill_status, set_pose, set_stamp, stamp_ns
from crtk_drivers.samples import Pose
from crtk_drivers.state import OperatingState, Status


def over_the_wire(message: Any) -> Any:
    return deserialize_message(serialize_message(message), type(message))


@pytest.mark.parametrize("kind", [np.int64, np.float32, np.int8, np.bool_])
def test_numpy_kinds_are_not_corrupted(kind: Any) -> None:
    """Unconverted, an int 1 in a float64 field is sent as 5e-324."""
    ones = np.ones(4, dtype=kind)
    pose = PoseStamped()
    set_pose(pose.pose, Pose(ones[:3], ones))
    back = over_the_wire(pose).pose
    assert (back.position.x, back.orientation.w) == (1.0, 1.0)


def test_status_with_numpy_flags_is_not_corrupted() -> None:
    message = TYPES[Payload.OPERATING_STATE]()
    status = Status(OperatingState.ENABLED, np.bool_(True), np.bool_(True))  # type: ignore[arg-type]
    fill_status(message, status, 1)
    back = over_the_wire(message)
    assert (back.state, back.is_homed, back.is_busy) == ("ENABLED", True, True)


@given(st.integers(min_value=0, max_value=2**31 * 10**9 - 1))
def test_stamps(nanoseconds: int) -> None:
    message = PoseStamped()
    set_stamp(message.header.stamp, nanoseconds)
    assert stamp_ns(over_the_wire(message).header.stamp) == nanoseconds


def test_every_payload_has_a_type() -> None:
    assert set(TYPES) == set(Payload)

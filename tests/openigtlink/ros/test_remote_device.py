"""A device on the far side of ROS behind the bridge: nothing that one peer asks keeps a stop waiting."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy")
pytestmark = pytest.mark.ros

from crtk_drivers.samples import JointState, Number  # noqa: E402
from rigs.igtl_peer import IgtlPeer, sensor, served, string  # noqa: E402
from rigs.loopback_client import Far, far_device  # noqa: E402
from rigs.waiting import eventually  # noqa: E402

GOAL = 0.9


def position(far: Far) -> float:
    found = far.engine.feedback("measured_js")
    assert found is not None
    assert isinstance(found[0], JointState)
    return float(found[0].position[0])


def test_a_hold_is_not_kept_waiting_by_the_move_before_it() -> None:
    with far_device("/igtl_far") as far, served({"arm": far.arm}) as (_, server):
        far.arm.enable()
        far.engine.submit("trajectory_j/set_ratio", Number(0.5))
        peer = IgtlPeer.connected(server.port)
        peer.send("SENSOR", "arm/move_jp", sensor(-GOAL, 0.0, 0.0, 0.0))
        eventually(lambda: far.engine.status.is_busy, "it moves")
        peer.send("SENSOR", "arm/move_jp", sensor(99.0, 0.0, 0.0, 0.0))
        assert "out_of_range" in peer.until("STRING", "arm/error").text
        # After a refusal it takes the client seconds to be sure that this one is accepted.
        peer.send("SENSOR", "arm/move_jp", sensor(GOAL, 0.0, 0.0, 0.0))
        peer.send("STRING", "arm/hold", string(""))
        eventually(lambda: not far.engine.status.is_busy, "it is held")
        assert position(far) < 0.9 * GOAL
        peer.close()

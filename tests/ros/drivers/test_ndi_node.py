"""A simulated tracker on ROS: its tools in namespaces below, and in which frames."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy")

from crtk_driver_ndi import PLUGIN
from crtk_drivers.client import connect
from rigs.loopback_node import serve, until
from rigs.ndi_bench import configuration, simulated
from rigs.waiting import LONG

WIRED = [
    {"name": "pointer", "part_number": "SIM-POINTER"},
    {"name": "bone", "part_number": "SIM-REFERENCE"},
]


@pytest.mark.ros
def test_tools_are_in_namespaces_below_and_their_frames_among_those_of_the_tracker() -> None:
    with (
        simulated(motion="still", noise=0.0) as sim,
        serve(
            configuration(sim, tools=WIRED, reference="bone"), "/ndi_node", [], plugin=PLUGIN
        ) as (session, _),
        connect("/ndi_node", timeout=LONG) as tracker,
    ):
        until(lambda: all(engine.has_sample for engine in session.engines), "connected")
        tracker.enable(LONG)
        pointer, bone = tracker.child("pointer", LONG), tracker.child("bone", LONG)
        pose = pointer.measured_cp(wait=LONG)
        assert pose.frame_id == "ndi_node/bone"
        assert abs(float((pose.position**2).sum()) - 0.04**2) < 1e-9
        assert bone.measured_cp(wait=LONG).frame_id == "ndi_node/tracker"

"""A simulated tracker on ROS: its tools in namespaces below, and in which frames."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from crtk_driver_ndi import PLUGIN
from crtk_drivers.cli import main
from crtk_drivers.client import connect
from rigs.loopback_node import serve
from rigs.ndi_bench import configuration, simulated
from rigs.waiting import LONG, eventually

WIRED = [
    {"name": "pointer", "part_number": "SIM-POINTER"},
    {"name": "bone", "part_number": "SIM-REFERENCE"},
]


@pytest.mark.ros
def test_tools_are_in_namespaces_below_and_their_frames_among_those_of_the_tracker() -> None:
    with (
        simulated(motion="still", noise=0.0) as sim,
        serve(configuration(sim, tools=WIRED, reference="bone"), "/ndi_node", [], plugin=PLUGIN),
        connect("/ndi_node", timeout=LONG) as tracker,
    ):
        tracker.enable(LONG)
        pointer, bone = tracker.child("pointer", LONG), tracker.child("bone", LONG)
        pose = pointer.measured_cp(wait=LONG)
        assert pose.frame_id == "ndi_node/bone"
        assert abs(float((pose.position**2).sum()) - 0.04**2) < 1e-9
        assert bone.measured_cp(wait=LONG).frame_id == "ndi_node/tracker"


@pytest.mark.ros
def test_a_tip_is_calibrated_from_what_a_tracker_tells_and_a_place_where_it_stands(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    with (
        simulated(motion="pivot", noise=0.0) as sim,
        serve(configuration(sim, tools=WIRED), "/ndi_pivot", [], plugin=PLUGIN) as (session, _),
    ):
        session.engine.state_command("enable")
        eventually(lambda: session.engine.transition_ended, "it tracks")
        kept = tmp_path / "pivot.csv"
        # Four seconds of this path may turn the tool about nearly one axis only.
        arguments = ["calibrate", "pivot", "/ndi_pivot/pointer", "--seconds", "6"]
        assert main([*arguments, "--save", str(kept)]) == 0
        told = capfd.readouterr().out
        assert "tip = { position = [0.018000, -0.003000, -0.157000] }" in told
        assert main(["calibrate", "pivot", "--file", str(kept)]) == 0
        assert capfd.readouterr().out in told

"""A walk itself: it sends what it begins, and bounds how long hardware goes on that no stop reaches."""

import time
from dataclasses import replace

import pytest

from bench.reliability import walk
from bench.reliability.rig import PATIENCE, BrokenPromiseError
from bench.reliability.rig_memory import VirtualRig
from bench.reliability.rig_robotiq import RobotiqRig
from bench.reliability.walk import Walk

STREAM = "servo_jv"
ON_THE_WAY = 3.5
"""Seconds: shorter than the fingers' way to where they were sent."""


def test_a_walk_streams_after_a_held_stream() -> None:
    with VirtualRig() as rig:
        rig.ready()
        rig.begin_activity(STREAM)
        rig.pause_stream()
        rig.until_still()
        walked = Walk(rig)
        walked.recovers()
        start = rig.look().joints
        walked.begin(STREAM)
        walked.go_on(0.3)
        assert abs(rig.look().joints - start).max() > 10.0 * rig.tolerance


def _cut_off_in_a_move(stands: float | None = None) -> None:
    """Let a walk see fingers whose link is silent, as if they must stand `stands` s from then on."""
    silent = next(way for way in RobotiqRig.ways if way.runs_on and way.kind == "silence")
    with RobotiqRig() as rig:
        walked = Walk(rig)
        walked.recovers()
        walked.begin("move_jp")
        try:
            walked.begin_fault(silent if stands is None else replace(silent, stands=stands))
            walked.go_on(ON_THE_WAY)
        finally:
            rig.stop_activity()
            rig.end_fault()


@pytest.mark.slow  # it takes seconds: what it judges takes so long
def test_hardware_alone_must_end_in_its_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(walk, "LATE", 0.0)
    with pytest.raises(BrokenPromiseError, match="after the last reason to"):
        _cut_off_in_a_move(stands=0.0)


@pytest.mark.slow
def test_hardware_alone_may_take_its_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(walk, "LATE", 0.0)
    _cut_off_in_a_move()


@pytest.mark.slow
def test_hardware_alone_may_outlast_its_driver(monkeypatch: pytest.MonkeyPatch) -> None:
    """The next driver stops nothing as it connects."""
    monkeypatch.setattr(walk, "LATE", 0.0)
    closed = next(way for way in RobotiqRig.ways if way.runs_on and way.kind == "disconnect")
    with RobotiqRig() as rig:
        walked = Walk(rig)
        walked.recovers()
        walked.begin("move_jp")
        walked.begin_fault(closed)
        rig.stop_activity()
        deadline = time.monotonic() + PATIENCE
        while rig.engine.connected and time.monotonic() < deadline:
            walked.go_on(0.02)
        walked.restart()
        moving = rig.look().joints
        walked.go_on(1.2)
        assert abs(rig.look().joints - moving).max() > 10.0 * rig.tolerance

"""A sound device diverges nowhere; faults are caught by their clauses, and by no other."""

from __future__ import annotations

import os
from collections.abc import Mapping

import pytest

from crtk_drivers.client.conformance_probe.examining import examine
from crtk_drivers.testing.conformance.clauses import chosen
from crtk_drivers.testing.conformance.expectations import Expectations
from crtk_drivers.testing.conformance.findings import Verdict
from crtk_drivers.testing.conformance.outcome import Outcome
from rigs.student_device import StudentDevice
from rigs.student_gantry import PLACE

LISTEN = 1.5
FIND = 10.0
QUICK = Expectations(wait=0.15, transition_time=2.0, move_time=5.0)
TIMED = {"RAT-1", "STA-3", "QOS-3", "CLI-2"}
"""Clauses about time, which a busy machine breaks for the device."""

QUICKER = [each for each in chosen([]) if each not in ("SET-1", "STA-10")]
"""STA-10 is decided by all trials, and so would need them all."""

PASSIVE: list[Mapping[str, str]] = [
    {
        "unknown_name": "NAM-1",
        "joints_of_body": "NAM-3",
        "forward_trigger": "TYP-3",
        "no_goal": "SET-4",
        "two_publishers": "QOS-7",
        "no_joint_frame": "DAT-4",
        "title_case": "STA-1",
    },
    {
        "text_command": "TYP-2",
        "no_setpoint_cp": "SET-3",
        "best_effort": "QOS-1",
        "no_twist_frame": "DAT-5",
        "no_tf": "DAT-16",
        "wrong_forward": "DAT-19",
        "constant_stamps": "STA-2",
    },
    {
        "no_state_command": "SET-2",
        "volatile_state": "QOS-4",
        "sizes": "DAT-1",
        "own_stamps": "DAT-6",
        "scaled_quaternion": "DAT-7",
        "wrong_jacobian": "DAT-21",
        "slow_heartbeat": "STA-3",
        "service_lies": "STA-4",
    },
    {
        "latched_command": "QOS-2",
        "no_names": "DAT-3",
        "nan_velocity": "DAT-8",
        "stamps_go_back": "DAT-9",
        "endless_inverse": "DAT-20",
        "busy_disabled": "BSY-1",
        "slow_service": "CLI-2",
    },
    {
        "old_payload": "TYP-1",
        "no_heartbeat": "QOS-3",
        "slow_feedback": "RAT-1",
        "since_boot": "DAT-10",
    },
]
"""Faults that are seen without moving it; those of one device do not hide each other."""

ACTIVE: list[Mapping[str, str]] = [
    {"never_enabled": "STA-5"},
    {"resume_faults": "STA-6 STA-10"},
    {"moves_disabled": "MOV-1"},
    {"enable_moves": "MOV-2"},
    {
        "resume_enables": "STA-6",
        "resume_disables": "STA-7",
        "enable_out_of_paused": "STA-8",
        "any_case": "STA-12",
        "silent_disabled": "RAT-2",
        "nan": "INP-1",
    },
    {
        "any_size": "INP-2",
        "zero_quaternion": "INP-3",
        "any_frame": "INP-5",
        "tells_nothing": "INP-8",
        "zero_effort": "DAT-2",
        "fast_velocity": "DAT-13",
        "own_time": "SPT-8",
        "busy_servo": "BSY-4",
        "by_place": "MOV-7",
        "drops_increments": "QOS-6",
        "velocity_sign": "MOV-12",
        "valid_setpoint_cp": "SPT-5",
        "turned_frame": "MOV-8",
        "scale": "DAT-15 MOV-19",
        "busy_after_hold": "BSY-5",
        "disable_goes_on": "STA-13",
        "dead_topic": "SET-1",
    },
    {
        "angular_first": "DAT-22",
        "adds_to_measured": "MOV-11 QOS-6",
        "stream_goes_on": "MOV-13",
        "short_move": "MOV-16",
        "still_setpoint": "SPT-6",
        "never_busy": "BSY-2 BSY-3",
        "not_pre_emptive": "MOV-18",
        "any_goal": "GOL-2",
    },
]
"""Faults that are found by commanding it. Some break two clauses at once."""

MAY = {"drops_increments": {"MOV-11"}, "adds_to_measured": {"MOV-19"}}
"""What a fault breaks too when this machine is slow."""


def diverging(outcome: Outcome) -> set[str]:
    return {each.clause.id for each in outcome.of(Verdict.DIVERGES)}


def clauses_of(faults: Mapping[str, str]) -> set[str]:
    return {clause for each in faults.values() for clause in each.split()}


def names_of(faults: Mapping[str, str]) -> str:
    return next(iter(faults))


def left_open(outcome: Outcome) -> set[str]:
    """Return what could not be judged because this machine is busy."""
    slow = outcome.of(Verdict.UNDETERMINED)
    return TIMED | {e.clause.id for e in slow if "this machine" in e.finding.text}


def check(outcome: Outcome, faults: Mapping[str, str]) -> None:
    found, expected = diverging(outcome), clauses_of(faults)
    also = TIMED.union(*(MAY.get(fault, set()) for fault in faults))
    missed = expected - found - left_open(outcome)
    assert missed == set(), [e for e in outcome.results if e.clause.id in missed]
    assert found - expected - also == set(), outcome.of(Verdict.DIVERGES)


@pytest.mark.slow  # the test of the loopback driver is its quick brother
@pytest.mark.timeout(180)
def test_a_sound_device_diverges_nowhere_and_is_left_as_it_was_found() -> None:
    where = f"/sound_{os.getpid()}"
    with StudentDevice(where) as device:
        outcome = examine(where, chosen([]), LISTEN, FIND, may_move=True, expected=QUICK)
        assert device.gantry.state == "DISABLED"
        assert device.gantry.measured == pytest.approx(PLACE, abs=5e-3)
    assert outcome.ended == ""
    check(outcome, {})
    assert len(outcome.of(Verdict.CONFORMS)) + len(left_open(outcome)) >= 75


@pytest.mark.sweep(5)
@pytest.mark.parametrize("faults", PASSIVE, ids=names_of)
def test_what_can_be_heard_is_caught(faults: Mapping[str, str]) -> None:
    where = f"/heard_{os.getpid()}"
    with StudentDevice(where, *faults):
        outcome = examine(where, chosen([]), LISTEN, FIND)
    check(outcome, faults)


@pytest.mark.timeout(180)
@pytest.mark.sweep(8)
@pytest.mark.parametrize("faults", ACTIVE, ids=names_of)
def test_what_must_be_tried_is_caught(faults: Mapping[str, str]) -> None:
    where = f"/tried_{os.getpid()}"
    with StudentDevice(where, *faults):
        ids = chosen([]) if {"SET-1", "STA-10"} & clauses_of(faults) else QUICKER
        outcome = examine(where, ids, LISTEN, FIND, may_move=True, expected=QUICK)
    check(outcome, faults)

"""Over ROS: a sound device diverges nowhere, faults that are heard are caught by their clauses alone."""

from __future__ import annotations

import os
from collections.abc import Mapping

import pytest

from crtk_drivers.client.conformance.clause_rows import Needs
from crtk_drivers.client.conformance.clauses import CLAUSES, chosen
from crtk_drivers.client.conformance.findings import Verdict
from crtk_drivers.client.conformance.probe.examining import examine
from rigs.examined_student import QUICK, check, left_open, names_of
from rigs.student_device import StudentNode
from rigs.student_gantry import PLACE

LISTEN = 1.5
FIND = 10.0
CARRIED = ("INP-8", "STA-11", "QOS-5", "INP-7", "MOV-25")
"""Of the trials those in which ROS itself has a part: the log, when topics find each other, queues, two
clients. All trials are in `test_trials`, with real messages."""
IDS = [each for each in CLAUSES if CLAUSES[each].needs is Needs.PASSIVE or each in CARRIED]

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


@pytest.mark.slow  # that in test_trials.py is its quick brother
@pytest.mark.timeout(180)
def test_a_sound_device_diverges_nowhere_and_is_left_as_it_was_found() -> None:
    where = f"/sound_{os.getpid()}"
    with StudentNode(where) as device:
        outcome = examine(where, IDS, LISTEN, FIND, may_move=True, expected=QUICK)
        assert device.gantry.state == "DISABLED"
        assert device.gantry.measured == pytest.approx(PLACE, abs=5e-3)
    assert outcome.ended == ""
    check(outcome, {})
    assert len(outcome.of(Verdict.CONFORMS)) + len(left_open(outcome)) >= 40


@pytest.mark.slow  # test_passive_judges.py has it without ROS
@pytest.mark.parametrize("faults", PASSIVE, ids=names_of)
def test_what_can_be_heard_is_caught(faults: Mapping[str, str]) -> None:
    where = f"/heard_{os.getpid()}"
    with StudentNode(where, *faults):
        outcome = examine(where, chosen([]), LISTEN, FIND)
    check(outcome, faults)

"""What an examination of the student's device must find, and what a busy machine may leave open."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from crtk_drivers.client.conformance.expectations import Expectations, JointRange
from crtk_drivers.client.conformance.findings import Verdict
from crtk_drivers.client.conformance.outcome import Outcome
from rigs.student_gantry import PLACE, RANGE, SERVO_SPEED

RANGES = (JointRange(lower=-RANGE, upper=RANGE, velocity=1.5 * SERVO_SPEED),) * len(PLACE)
QUICK: Final = Expectations(
    wait=0.15,
    transition_time=2.0,
    home_time=2.0,
    move_time=5.0,
    flood_time=0.5,
    stream_stop=1.0,
    ranges=RANGES,
)
TIMED: Final = {"RAT-1", "STA-3", "QOS-3", "CLI-2"}
"""Clauses about time, which a busy machine breaks for the device."""


def clauses_of(faults: Mapping[str, str]) -> set[str]:
    return {clause for each in faults.values() for clause in each.split()}


def names_of(faults: Mapping[str, str]) -> str:
    return next(iter(faults))


def left_open(outcome: Outcome) -> set[str]:
    """Return what could not be judged because this machine is busy."""
    slow = outcome.of(Verdict.UNDETERMINED)
    return TIMED | {e.clause.id for e in slow if "this machine" in e.finding.text}


def check(outcome: Outcome, faults: Mapping[str, str]) -> None:
    """Make sure that these faults were found by their clauses, and that no other clause is broken."""
    found, expected = {e.clause.id for e in outcome.of(Verdict.DIVERGES)}, clauses_of(faults)
    missed = expected - found - left_open(outcome)
    assert missed == set(), [e for e in outcome.results if e.clause.id in missed]
    assert found - expected - TIMED == set(), outcome.of(Verdict.DIVERGES)

"""The order of motions in the control process, with a library that says no."""

from __future__ import annotations

from itertools import pairwise

import pytest

from crtk_driver_ur.control_options import MotionOptions
from crtk_driver_ur.library.calls import LibraryCalls
from crtk_driver_ur.library.packets import Event, EventKind, MotionCommand, MotionKind
from crtk_driver_ur.library.sequencer import CATCH_UP, LONGEST_STEP, MotionSequencer

LONG = 10.0


class Library:
    """The vendor's, as far as a stream needs it; `refused` are methods that return False."""

    def __init__(self) -> None:
        self.called: list[str] = []
        self.positions: list[float] = []
        self.refused: set[str] = set()
        self.runs = True

    def isProgramRunning(self) -> bool:  # noqa: N802 - the library's names
        return self.runs

    def servoJ(self, q: list[float], *_: object) -> bool:  # noqa: N802
        self.positions.append(q[0])
        return self._called("servoJ")

    def servoStop(self, *arguments: object) -> bool:  # noqa: N802
        return self._called("servoStop")

    def kickWatchdog(self) -> bool:  # noqa: N802
        return self._called("kickWatchdog")

    def _called(self, name: str) -> bool:
        self.called.append(name)
        return name not in self.refused


def servo(sequence: int, first: float = 0.0) -> MotionCommand:
    return MotionCommand(sequence, MotionKind.SERVO_JOINT, (first, *[0.0] * 5))


def stop(sequence: int) -> MotionCommand:
    return MotionCommand(sequence, MotionKind.STOP)


def test_a_stop_that_failed_is_answered_by_the_end_of_the_program_alone() -> None:
    library, told = Library(), list[Event]()
    calls = LibraryCalls(library, lambda name, allowed: None)
    sequencer = MotionSequencer(calls, MotionOptions(), told.append)
    sequencer.program_restarted()
    sequencer.command(servo(1), 0.0)
    library.refused.add("servoStop")
    sequencer.command(stop(2), 0.0)
    sequencer.tick(LONG)
    assert [event.kind for event in told] == [EventKind.MOTION_FAILED]

    told.clear()
    library.called.clear()
    sequencer.command(stop(3), LONG)
    assert told == []
    sequencer.command(servo(4), LONG)
    assert [(event.kind, event.sequence) for event in told] == [(EventKind.MOTION_FAILED, 4)]
    sequencer.tick(2 * LONG)
    assert library.called == []  # each would have fed the watchdog

    told.clear()
    library.runs = False
    sequencer.tick(2 * LONG)
    sequencer.command(stop(5), 2 * LONG)
    assert [event.kind for event in told] == [EventKind.PROGRAM_STOPPED, EventKind.STOPPED]


@pytest.mark.parametrize("speed", [2.0, 3.0])
def test_what_waited_is_made_up_for_with_a_margin_to_what_joints_can(speed: float) -> None:
    """At their speed itself the arm is too fast as soon as one of two packages comes late."""
    library, period, fastest = Library(), 0.01, 3.0
    options = MotionOptions(joint_speeds=(fastest,) * 6)
    sequencer = MotionSequencer(LibraryCalls(library, lambda name, allowed: None), options, print)
    sequencer.program_restarted()
    for number in range(300):
        now = period * number
        if not 0.5 < now < 0.8:  # in which it was held up
            sequencer.command(servo(number + 1, speed * now), now)
    steps = [b - a for a, b in pairwise(library.positions)]
    held_up = steps.index(max(steps))
    assert max(steps) == pytest.approx(fastest * LONGEST_STEP)
    rest = max(steps[:held_up] + steps[held_up + 1 :])
    assert rest == pytest.approx(period * max(CATCH_UP * fastest, speed))
    arrives = speed < CATCH_UP * fastest
    assert (library.positions[-1] == pytest.approx(speed * now)) is arrives

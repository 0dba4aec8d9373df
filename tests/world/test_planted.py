"""The judges and the user find mistakes that are planted; a bug that hides here hides from every world."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import date
from pathlib import Path

import pytest
from world import planted, planted_sensors

from crtk_drivers.testing.world import Host

EACH_DAY = 3
SLOW = frozenset(
    {
        "answer_to_an_earlier_question_counts",
        "hold_waits_for_a_signal_that_may_have_come",
        "move_is_carried_out_after_a_stop",
        "node_passes_over_a_hold",
        "old_position_is_stamped_fresh",
        "pause_leaves_the_motion",
        "servo_that_is_silent_counts_as_read",
        "servos_are_not_told_to_stop",
        "setpoints_are_sent_though_nothing_is_heard",
        "stop_counts_as_arrived_when_sent",
        "stop_waits_for_the_check_of_a_move",
        "two_locks_are_taken_in_two_orders",
        "upper_limit_of_a_move_is_not_checked",
        "ur_program_goes_on_without_setpoints",
    }
)
"""Those that take more than 20 s, for the night."""
NAMES = tuple(name for name in planted.PLANTED if name not in SLOW)
FIRST = EACH_DAY * date.today().toordinal()
TODAY = {NAMES[(FIRST + number) % len(NAMES)] for number in range(EACH_DAY)}
"""Mistakes that are quick today: each has its turn."""


@pytest.fixture(scope="module")
def host() -> Iterator[Host]:
    """A process that runs the worlds."""
    with Host(Path(planted_sensors.__file__)) as found:
        yield found


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name in TODAY else pytest.mark.slow)
        for name in planted.PLANTED
    ],
)
def test_planted_mistake_is_found(host: Host, name: str) -> None:
    mistake = planted.PLANTED[name]
    others = set()
    for seed in range(1, mistake.seeds + 1):
        wild = mistake.way != planted.CALM
        before = f"{mistake.plant.__module__}:{name}"
        outcome = host.run(mistake.scenario, seed, before=before, wild=wild, horizon=90)
        if outcome.kinds & mistake.kinds:
            return
        others |= outcome.kinds
    pytest.fail(
        f"{mistake.text} No judge has seen that in {mistake.seeds} seeds; found: {others or 'nothing'}"
    )

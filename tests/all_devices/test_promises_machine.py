"""Commands, faults and clocks in any order, by a stateful machine: the promises hold after each step.

The seed is printed; `CRTK_FAULT_SEED=n` repeats a run. `python -m bench.soak` goes on for hours.
"""

from __future__ import annotations

import os
from typing import ClassVar

import pytest
from hypothesis import HealthCheck, Phase, seed, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, precondition, rule, run_state_machine_as_test

from bench.reliability.rig import Rig
from bench.reliability.rigs import RIGS
from bench.reliability.walk import TURNS, Walk, walkable
from crtk_drivers.state import StateCommand

SEED = int(os.environ.get("CRTK_FAULT_SEED", "15"))
RUNS = 2
STEPS = 15


class PromiseMachine(RuleBasedStateMachine):
    """One driver; `rig` is that of the class."""

    rig: ClassVar[Rig]

    def __init__(self) -> None:
        super().__init__()
        self.walk = Walk(self.rig)
        self.walk.recovers()

    @rule(command=st.sampled_from([*StateCommand, "enable", "enable", "enable"]))
    def state_command(self, command: str) -> None:
        self.walk.state_command(command)

    @rule()
    def hold(self) -> None:
        self.walk.hold()

    @rule(data=st.data())
    def begin(self, data: st.DataObject) -> None:
        self.walk.begin(data.draw(st.sampled_from(self.rig.activities)))

    @precondition(lambda self: self.rig.services)
    @rule(data=st.data())
    def service(self, data: st.DataObject) -> None:
        self.walk.service(data.draw(st.sampled_from(self.rig.services)))

    @rule()
    def end(self) -> None:
        self.walk.end()

    @rule(data=st.data())
    def fault(self, data: st.DataObject) -> None:
        ways = walkable(type(self.rig))
        self.walk.begin_fault(ways[data.draw(st.integers(0, len(ways) - 1))])

    @rule()
    def fault_over(self) -> None:
        self.walk.end_fault()

    @rule(seconds=st.sampled_from(TURNS))
    def go_on(self, seconds: float) -> None:
        self.walk.go_on(seconds)

    @rule()
    def restart(self) -> None:
        self.walk.restart()

    def teardown(self) -> None:
        self.walk.recovers()


@pytest.mark.timeout(120)
@pytest.mark.parametrize(
    "name",
    [name if name == "loopback" else pytest.param(name, marks=pytest.mark.slow) for name in RIGS],
)
def test_the_promises_hold_whatever_happens_in_whatever_order(name: str) -> None:
    print(f"seed {SEED}: repeat with CRTK_FAULT_SEED={SEED}")  # noqa: T201 - shown with a failure
    with RIGS[name]() as rig:
        machine = seed(SEED)(type("Machine", (PromiseMachine,), {"rig": rig}))
        run_state_machine_as_test(
            machine,
            settings=settings(
                max_examples=RUNS,
                stateful_step_count=STEPS,
                deadline=None,
                database=None,
                derandomize=False,
                phases=[Phase.generate],  # the same steps take another course the next time
                suppress_health_check=list(HealthCheck),
            ),
        )

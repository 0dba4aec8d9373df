"""What is sent to the hardware goes on from what was sent before, for every pair of commands.

Promised, and judged for each setpoint that is written (`rigs.judged_arm.Judge`): nothing leaves the limits; a
move, an interpolated stream, and a twist that joints carry out begin with the velocity that the hardware has,
whatever gave it that, and change it within the limits of acceleration; an interpolated effort begins at zero
or at the effort in force, and rises within `EFFORT_RISE_TIME`.

Not promised: servo_jp, _jr, _cp, _cr and the position axes of servo_js and _cs go where the client says, in
steps of up to `max_step`; servo_jv, servo_jf, and twists, wrenches and poses that the hardware takes as they
are, are the client's, too. A cycle that comes late makes the motion late, not fast.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, rule

from crtk_drivers.commands import Level, find
from crtk_drivers.errors import CommandRefused
from crtk_drivers.samples import Number
from rigs.examples import examples
from rigs.judged_arm import CYCLE, VARIANTS, MotionRig

EVERY = {Level.SERVO: 1, Level.INTERPOLATE: 3}


def play(rig: MotionRig, name: str, cycles: int, start: float) -> None:
    """Send a command as it is usually sent."""
    every = EVERY.get(find(name).level, 1000)
    for index in range(cycles):
        if index % every == 0:
            rig.send(name, start + index * CYCLE)
        rig.cycle()


def take_over(rig: MotionRig, name: str, start: float) -> None:
    """Send a command as soon as it is accepted."""
    for index in range(12):
        if rig.send(name, start + index * CYCLE):
            rig.cycle()
            return
        rig.cycle()


PARTS = 5
"""Of all pairs, so that some of each are quick."""


@pytest.mark.sweep(9)
@pytest.mark.parametrize("every_cycle", [False, True])
@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("part", range(PARTS))
def test_every_pair_of_commands(part: int, variant: str, every_cycle: bool) -> None:
    names = MotionRig(variant).names
    pairs = list(itertools.permutations(names, 2))
    # The same setpoint again in each cycle, as a bus wants it, is the same for most pairs.
    for first, second in pairs[part :: PARTS * (5 if every_cycle else 1)]:
        rig = MotionRig(variant, every_cycle)
        play(rig, first, 12, 0.0)
        take_over(rig, second, 12 * CYCLE)
        play(rig, second, 10, 13 * CYCLE)
        for _ in range(20):
            rig.cycle()
        if find(first).is_motion:
            assert rig.judge.count > 0, f"{first} was never sent"


class AnyCommands(RuleBasedStateMachine):
    """Commands, sizes, pauses and late cycles at random."""

    variant = "positions"

    def __init__(self) -> None:
        super().__init__()
        self.rig = MotionRig(self.variant)
        self.time = 0.0

    @rule(data=st.data(), size=st.floats(0.0, 3.0), cycles=st.integers(1, 20))
    def command(self, data: st.DataObject, size: float, cycles: int) -> None:
        name = data.draw(st.sampled_from(self.rig.names))
        every = EVERY.get(find(name).level, 1000)
        for index in range(cycles):
            if index % every == 0:
                self.rig.send(name, self.time, size)
            self.turn()

    @rule(cycles=st.integers(1, 30))
    def silence(self, cycles: int) -> None:
        for _ in range(cycles):
            self.turn()

    @rule(late=st.floats(0.001, 0.05))
    def late_cycle(self, late: float) -> None:
        self.time += late
        self.rig.cycle(late)
        # What follows can be told from steps again when one of the old rhythm has passed.
        self.rig.judge.last = None
        for _ in range(2):
            self.rig.judge.steady = False
            self.time += CYCLE
            self.rig.clock.advance(CYCLE)
            self.rig.engine.cycle(np.inf)

    @rule(text=st.sampled_from(["disable", "pause", "resume", "enable"]))
    def state(self, text: str) -> None:
        try:
            self.rig.reach(text)
        except CommandRefused:
            return

    @rule(ratio=st.floats(0.05, 1.0))
    def slower(self, ratio: float) -> None:
        if "trajectory_j/set_ratio" in self.rig.engine.commands:
            self.rig.engine.submit("trajectory_j/set_ratio", Number(ratio))

    def turn(self) -> None:
        self.time += CYCLE
        self.rig.cycle()


def machine(name: str) -> type[AnyCommands]:
    kind = type("AnyCommands", (AnyCommands,), {"variant": name})
    kind.TestCase.settings = settings(
        max_examples=examples(15), stateful_step_count=12, deadline=None
    )
    return kind


TestPositions = machine("positions").TestCase
TestVelocities = machine("velocities").TestCase
TestEfforts = machine("positions, velocities and efforts").TestCase
TestTwists = machine("positions, twists and wrenches").TestCase
TestPoses = machine("poses and twists").TestCase

"""A mass that a hand pushes, at a force loop that samples it, holds its forces, and delivers them late."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from crtk_drivers.kit.haptics import ZERO, ForceLoop, Motion, Triple
from crtk_drivers.kit.haptics.triples import dot, minus, plus, times

SUBSTEPS = 4


@dataclass
class Hand:
    """One mass, without any friction of its own: the least that a device takes of energy.

    Attributes:
        mass: kg.
        position, velocity: m, m/s.
        given: J that the loop's forces have given it so far.
        acceleration: m/s², the greatest so far.
    """

    mass: float = 0.2
    position: Triple = ZERO
    velocity: Triple = ZERO
    given: float = 0.0
    acceleration: float = 0.0

    def move(self, force: Triple, pushed: Triple, seconds: float) -> None:
        """Move under a force of the loop and one of the hand, both constant for so long."""
        start, step = self.position, seconds / SUBSTEPS
        pull = times(plus(force, pushed), 1.0 / self.mass)
        self.acceleration = max(self.acceleration, dot(pull, pull) ** 0.5)
        for _ in range(SUBSTEPS):
            gone = plus(times(self.velocity, step), times(pull, 0.5 * step * step))
            self.position = plus(self.position, gone)
            self.velocity = plus(self.velocity, times(pull, step))
        self.given += dot(force, minus(self.position, start))


def driven(
    hand: Hand,
    loop: ForceLoop,
    pushes: Sequence[Triple],
    *,
    period: float = 0.001,
    delay: int = 1,
    begin: float = 100.0,
) -> Iterator[float]:
    """Run the loop, a cycle for each push, its forces `delay` cycles late; yield the time in each."""
    on_their_way = deque([ZERO] * delay)
    before = hand.position
    for cycle, push in enumerate(pushes):
        now = begin + cycle * period
        measured = times(minus(hand.position, before), 1.0 / period)
        before = hand.position
        force, _ = loop.step(Motion(hand.position, velocity=measured), now)
        on_their_way.append(force)
        hand.move(on_their_way.popleft(), push, period)
        yield now

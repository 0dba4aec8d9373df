"""What keeps the forces of fixtures from giving a hand more energy than it gave them.

A spring that is sampled and held is no spring: it pushes a little longer on the way out than on the way
in, and with a delay much longer. A tank keeps the account in the time domain, as passivity observers do
(Hannaford and Ryu 2002, Time-domain passivity control of haptic interfaces; Ryu, Preusche, Hannaford,
Hirzinger 2005, with sampled positions, where the sum is exact): a force that is held while the hand goes
a way has done their inner product of work, whatever hand and device are like. What the hand puts in is
in the tank; a force may go out only as far as what it can do at most until it is replaced is in the
tank, too. A force that is sure to take energy is never reduced.

So the energy that fixtures have given a hand, less what it gave them, is at any time at most

    allowance + `TRICKLE` · t + granted,    granted at most power · t

where `granted` is what lies in a fixture that somebody moved or switched on while the hand was in its
reach. It holds for as long as the hand does not speed up faster than `TankLimits.acceleration` and the
delay is not longer than declared; where it does, it is broken by the excess of one cycle, and paid back.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Final

from crtk_drivers.kit.haptics.triples import ZERO, Triple, Wrench6, dot, size, times

TRICKLE: Final = 0.01
"""W that an empty tank gets, so that it does not stay empty: less than the friction of any device takes."""


@dataclass(frozen=True, slots=True)
class TankLimits:
    """How much energy may go out.

    Attributes:
        allowance: J that may be given beyond what was taken.
        power: W at which the energy of a fixture that is moved is granted.
        acceleration: m/s² of the hand at most.
        turning: rad/s² of the hand at most.
        delay: cycles from a position that was read until the force that follows from it begins to act.
        period: s of a cycle.

    Raises:
        ValueError: not finite, or not above zero.
    """

    allowance: float = 0.01
    power: float = 2.0
    acceleration: float = 150.0
    turning: float = 1500.0
    delay: int = 1
    period: float = 0.001

    def __post_init__(self) -> None:
        for name in ("allowance", "power", "acceleration", "turning", "period"):
            if not 0.0 < getattr(self, name) < 1e6:
                raise ValueError(f"{name} must be above zero and finite, not {getattr(self, name)}")
        if not 0 <= self.delay <= 100:
            raise ValueError(f"delay must be 0 to 100 cycles, not {self.delay}")


class EnergyTank:
    """The account of one device. In each cycle `moved`, then `allow`, then `sent`.

    Attributes:
        energy: J in it.
        granted: J that were granted so far.
        reduced: how often a force was reduced.
    """

    def __init__(self, limits: TankLimits) -> None:
        self._limits = limits
        self._on_their_way: deque[Wrench6] = deque()
        self._step = self._turn = ZERO
        self._period = limits.period
        self._due = 0.0
        self.energy = limits.allowance
        self.granted = 0.0
        self.reduced = 0
        self.empty()

    def empty(self) -> None:
        """Nothing acts, and nothing is on its way: forces begin anew."""
        self._on_their_way = deque([(ZERO, ZERO)] * (self._limits.delay + 1))
        self._due = 0.0

    def moved(
        self, step: Triple, turn: Triple, period: float, potential: float, moved_by: float
    ) -> None:
        """The hand has gone a way while the oldest force acted.

        Args:
            step: m.
            turn: rotation vector, rad.
            period: s that it took.
            potential: J that lie in all fixtures now.
            moved_by: J of that which somebody's change of the fixtures put there.
        """
        force, torque = self._on_their_way.popleft()
        energy = self.energy - dot(force, step) - dot(torque, turn)
        if energy < self._limits.allowance:
            energy = min(self._limits.allowance, energy + TRICKLE * period)
        self._due = min(potential, self._due + max(0.0, moved_by))
        grant = min(self._due, self._limits.power * period)
        self._due -= grant
        self.granted += grant
        # More than lies in the fixtures cannot come back from them.
        self.energy = min(energy + grant, potential + self._limits.allowance)
        self._step, self._turn = step, turn
        self._period = max(period, self._limits.period)

    def allow(self, force: Triple, torque: Triple) -> Wrench6:
        """Return what of a wrench of fixtures may go out now: it, or less of it."""
        taken = sum(
            self._most(each, cycles) for cycles, each in enumerate(self._on_their_way, start=1)
        )
        needed = self._most((force, torque), self._limits.delay + 1)
        left = max(0.0, self.energy - taken)
        if needed <= left:
            return force, torque
        self.reduced += 1
        share = left / needed
        return times(force, share), times(torque, share)

    def sent(self, force: Triple, torque: Triple) -> None:
        """This much of it went out."""
        self._on_their_way.append((force, torque))

    def _most(self, wrench: Wrench6, cycles: int) -> float:
        """Return the most work, in J, that a wrench can do in the cycle so many cycles from now."""
        force, torque = wrench
        slack = cycles * self._period * self._period
        linear = dot(force, self._step) + size(force) * self._limits.acceleration * slack
        angular = dot(torque, self._turn) + size(torque) * self._limits.turning * slack
        return max(0.0, linear) + max(0.0, angular)

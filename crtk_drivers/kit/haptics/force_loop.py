"""The local force loop: fixtures, a client's wrench or pose; bounded in size, time and energy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from crtk_drivers.kit.haptics.fixtures import NOTHING, Fixture, Motion, Pull, Spring, sum_of
from crtk_drivers.kit.haptics.passivity import EnergyTank, TankLimits
from crtk_drivers.kit.haptics.triples import (
    ZERO,
    Triple,
    Wrench6,
    dot,
    is_finite,
    minus,
    plus,
    size,
    times,
    turn,
)

LONGEST_GAP: Final = 0.05
"""Seconds between two steps after which forces begin from zero again."""
LEAP: Final = 0.1
"""Of the force and the torque at most, by which other fixtures may push harder at once; then they rise."""

NONE: Final[Wrench6] = (ZERO, ZERO)


@dataclass(frozen=True, slots=True)
class ForceLimits:
    """How strong forces are, and for how long.

    Attributes:
        force: N, the length of the force at most.
        torque: N·m, the same of the torque.
        ramp: s in which forces rise after `ForceLoop.enable`.
        command_timeout: s after which a wrench or a pose of a client counts no more.

    Raises:
        ValueError: not finite, or not above zero (torque: below it).
    """

    force: float
    torque: float = 0.0
    ramp: float = 0.5
    command_timeout: float = 0.05

    def __post_init__(self) -> None:
        for name in ("force", "ramp", "command_timeout"):
            if not 0.0 < getattr(self, name) < 1e6:
                raise ValueError(f"{name} must be above zero and finite, not {getattr(self, name)}")
        if not 0.0 <= self.torque < 1e6:
            raise ValueError(f"torque must be finite and not negative, not {self.torque}")


class ForceLoop:
    """What a device is to push with, cycle by cycle. Zero until it is enabled. Belongs to one thread.

    Args:
        limits: of what goes out.
        tank: limits of the energy that fixtures give.

    Attributes:
        tank: the account of what fixtures gave and took.
    """

    def __init__(self, limits: ForceLimits, tank: TankLimits | None = None) -> None:
        self._limits = limits
        self.tank = EnergyTank(tank or TankLimits())
        self._fixtures: Mapping[str, Fixture] = {}
        self._before: Mapping[str, Fixture] | None = None
        self._is_enabled = False
        self._ramp_begins = 0.0
        self._strength = 0.0
        self._share_of_fixtures = 1.0
        self._are_new = False
        self._command = NONE
        self._commanded = 0.0
        self._followed: Spring | None = None
        self._follow_at = 0.0
        self._last: tuple[Motion, float] | None = None

    @property
    def is_enabled(self) -> bool:
        """Whether forces may go out."""
        return self._is_enabled

    @property
    def strength(self) -> float:
        """How much of what is asked for goes out by now, 0 to 1."""
        return self._strength

    def enable(self, now: float) -> None:
        """Let forces rise from now (monotonic s) on; of what was commanded before nothing is left."""
        self.disable()
        self._is_enabled = True
        self.begin_anew(now)

    def disable(self) -> None:
        """No force from the next step on: disabled, paused, at fault, at the end."""
        self._is_enabled, self._strength = False, 0.0
        self.release()
        self.tank.empty()

    def release(self) -> None:
        """Forget a client's wrench and pose: its stream has ended. Fixtures stay."""
        self._command, self._followed = NONE, None

    def use(self, fixtures: Mapping[str, Fixture]) -> None:
        """Take other fixtures in place of all. Where they push a hand much harder than those, that rises."""
        self._about_to_change()
        self._fixtures, self._are_new = dict(fixtures), True

    def command(self, force: Triple, torque: Triple, now: float) -> None:
        """Take a client's wrench; it ends a pose that was followed.

        Raises:
            ValueError: not finite.
        """
        if not is_finite((*force, *torque)):
            raise ValueError(f"no finite wrench: {force}, {torque}")
        self.release()
        self._command, self._commanded = (force, torque), now

    def follow(self, spring: Spring, now: float) -> None:
        """Draw the hand to a pose of a client; it ends a wrench. The first one of a stream rises."""
        self._command = NONE
        self._about_to_change()
        self._are_new |= self._followed is None
        self._followed, self._follow_at = spring, now

    def step(self, motion: Motion, now: float) -> Wrench6:
        """Return the force (N) and the torque (N·m), base axes, for where the hand is at monotonic seconds.

        Where a number of the motion is none that a hand may have it is zero, and forces begin anew.
        """
        if not motion.is_possible:
            self.begin_anew(now)
            self._last = None
            return NONE
        step, turned, period = ZERO, ZERO, 0.0
        if self._last is not None:
            before, at = self._last
            period = now - at
            step = minus(motion.position, before.position)
            turned = turn(motion.orientation, before.orientation)
        if not 0.0 <= period <= LONGEST_GAP:
            self.begin_anew(now)
        self._last = motion, now
        self._forget_stale(now)
        if not self._is_enabled:
            return NONE
        pull, moved_by = self._pull(motion, now, period)
        self.tank.moved(step, turned, period, pull.energy, moved_by)
        return self._bounded(pull)

    def begin_anew(self, now: float) -> None:
        """Let forces rise from zero once more: the device did not make them, or nobody saw where it went."""
        self._ramp_begins, self._strength = now, 0.0
        self._share_of_fixtures, self._are_new = 1.0, False  # all begins from zero
        self.tank.empty()

    def _forget_stale(self, now: float) -> None:
        longest = self._limits.command_timeout
        if now - self._commanded > longest:
            self._command = NONE
        if now - self._follow_at > longest:
            self._followed = None

    def _about_to_change(self) -> None:
        """Remember what acted in the last step, so that it is known what a change puts in."""
        if self._before is None:
            self._before = self._with_followed()

    def _with_followed(self) -> Mapping[str, Fixture]:
        if self._followed is None:
            return self._fixtures
        return {**self._fixtures, "": self._followed}

    def _pull(self, motion: Motion, now: float, period: float) -> tuple[Pull, float]:
        """Return what the fixtures do, as strong as they are by now, and how much of its energy is new."""
        fixtures = self._with_followed()
        whole = sum_of(fixtures, motion) if fixtures else NOTHING
        before, self._before = self._before, None
        old = whole if before is None else sum_of(before, motion)
        strength = min(1.0, (now - self._ramp_begins) / self._limits.ramp)
        share = min(1.0, self._share_of_fixtures + period / self._limits.ramp)
        if self._are_new:
            share = self._share_of(whole, old)
            self._are_new = False
        scale = strength * share
        moved_by = scale * whole.energy - self._strength * self._share_of_fixtures * old.energy
        self._strength, self._share_of_fixtures = strength, share
        # What is clipped rises, too: else a fixture far away would be at its most after a hundredth of it.
        force = _clipped(whole.force, self._limits.force)
        torque = _clipped(whole.torque, self._limits.torque)
        return Pull(scale * whole.energy, times(force, scale), times(torque, scale)), moved_by

    def _share_of(self, new: Pull, old: Pull) -> float:
        """Return how much of new fixtures goes out at once: as much as of the old ones, and a bit more."""
        found = self._share_of_fixtures if old.force != ZERO or old.torque != ZERO else 1.0
        for most, now, before in (
            (self._limits.force, new.force, old.force),
            (self._limits.torque, new.torque, old.torque),
        ):
            wanted = min(size(now), most)
            if wanted <= LEAP * most:
                continue
            kept = min(max(0.0, dot(before, now)) / size(now), most)  # of the same direction
            at_once = self._share_of_fixtures * kept + LEAP * most
            found = min(found, at_once / wanted)
        return found

    def _bounded(self, pull: Pull) -> Wrench6:
        """Return what goes out of fixtures and command, and let the tank know its share."""
        longest, most = self._limits.force, self._limits.torque
        force, torque = self.tank.allow(pull.force, pull.torque)
        command, twist = _clipped(self._command[0], longest), _clipped(self._command[1], most)
        all_force = plus(times(command, self._strength), force)
        all_torque = plus(times(twist, self._strength), torque)
        share, turn_share = _share(all_force, longest), _share(all_torque, most)
        self.tank.sent(times(force, share), times(torque, turn_share))
        return times(all_force, share), times(all_torque, turn_share)


def _share(value: Triple, most: float) -> float:
    length = size(value)
    return 1.0 if length <= most else most / length


def _clipped(value: Triple, most: float) -> Triple:
    return times(value, _share(value, most))

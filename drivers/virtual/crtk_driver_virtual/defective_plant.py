"""An arm that does not move as it should. Pure, as the plant that it is one of.

The servos follow an ideal reference. Here the joints follow what `Distortion` makes of it, with the same
response, and the velocity and acceleration of that are fed forward.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np
from typing_extensions import override

from crtk_driver_virtual.defects import mask_of
from crtk_driver_virtual.defects_config import DefectsConfig
from crtk_driver_virtual.models import Arm
from crtk_driver_virtual.plant import HOLD, LONGEST_RAMP, SERVOED, SUBSTEP, Command, Drive, Plant
from crtk_driver_virtual.servo import BRAKING
from crtk_drivers.samples import Array, Vector

CREEP: Final = 0.5
"""Share of the way of a joint in which it comes to rest beside its setpoint."""
BEGINS: Final = 1e-3
"""rad/s (m/s) of a reference from which a motion has begun."""
RIPPLE_FREQUENCY: Final = 10.0
"""Hz of `speed_ripple`."""
BOWED: Final = 0.02
"""m/s of the tool above which it is beside its path."""
DAMPED: Final = 1e-2
"""Of the Jacobian, where the tool is pushed off its path near a singularity."""
NEAR_LIMIT: Final = 0.95
"""Share of the velocity limit from which a joint is too fast."""
AHEAD: Final = 0.1
"""rad (m) by which such a joint is ahead at most."""
FALLS_BACK: Final = 0.3
"""Seconds in which it loses that again."""
IN_MOTION: Final = 0.1
"""rad/s (m/s) of a stream from which joints go on with it when nothing more comes."""
SLIDING: Final = 0.05
"""rad/s (m/s) from which dry friction is all there."""


class Distortion:
    """Where joints are sent by servos with defects. One call of `apply` each substep.

    Args:
        defects: of the arm.
        arm: its limits.
    """

    def __init__(self, defects: DefectsConfig, arm: Arm) -> None:
        count = len(arm.limits)
        self._defects = defects
        self._mask = mask_of(defects, count)
        self._random = np.random.default_rng(defects.seed)
        self._lower, self._upper, self._fastest = (
            np.array([getattr(limit, name) for limit in arm.limits])
            for name in ("lower", "upper", "velocity")
        )
        self._lag = max(1, round(defects.tracking_lag / SUBSTEP) + 1)
        self.start(arm.start)

    def start(self, q: Vector) -> None:
        """Begin from where the joints (n,) are, without an error."""
        self._begin = q.copy()
        self._past = deque([q.copy()], maxlen=self._lag)
        self._offset, self._goal, self._ahead = np.zeros((3, q.size))
        self._moved = np.zeros(q.size, dtype=bool)
        self._swinging, self._swing_speed = q.copy(), np.zeros(q.size)

    def apply(
        self, reference: Vector, velocity: Vector, time: float, jacobian: Callable[[], Array]
    ) -> Vector:
        """Return where the joints (n,) are sent.

        Args:
            reference: (n,) where they should be.
            velocity: (n,) of that.
            time: of the plant.
            jacobian: returns that (6, n) of the tool.
        """
        defects, wave = self._defects, 2.0 * math.pi * time
        ripple = defects.speed_ripple * math.sin(RIPPLE_FREQUENCY * wave)
        sent = reference + ripple / (2.0 * math.pi * RIPPLE_FREQUENCY) * velocity
        self._past.append(sent)
        sent = self._past[0]
        sent = self._begin + defects.gain * (sent - self._begin)
        sent = sent + self._resting_offset(velocity) + self._too_fast(velocity)
        if defects.resonance:
            sent = self._swung(sent)
        if defects.hunting:
            sent = sent + defects.hunting * math.sin(defects.hunting_frequency * wave)
        if defects.line_bow:
            sent = sent + self._bowed(velocity, jacobian())
        if defects.overtravel:
            sent = sent + self._beyond(reference) - self._beyond(self._begin)
        return np.where(self._mask > 0.0, sent, reference)

    def _resting_offset(self, velocity: Vector) -> Vector:
        defects = self._defects
        moves = np.abs(velocity) > BEGINS
        begun = np.flatnonzero(moves & ~self._moved)
        self._moved = moves
        spread = self._random.normal(0.0, defects.repeatability, begun.size)
        self._goal[begun] = defects.following_offset + spread
        most = CREEP * SUBSTEP * np.abs(velocity)
        self._offset += np.minimum(np.maximum(self._goal - self._offset, -most), most)
        return self._offset

    def _too_fast(self, velocity: Vector) -> Vector:
        factor = self._defects.overspeed - 1.0
        is_fast = np.abs(velocity) > NEAR_LIMIT * self._fastest
        gained = self._ahead + SUBSTEP * factor * velocity
        kept = self._ahead * (1.0 - SUBSTEP / FALLS_BACK)
        ahead = np.where(is_fast, gained, kept)
        self._ahead = np.minimum(np.maximum(ahead, -AHEAD), AHEAD)
        return self._ahead

    def _swung(self, sent: Vector) -> Vector:
        pulse = 2.0 * math.pi * self._defects.resonance
        pull = pulse**2 * (sent - self._swinging)
        self._swing_speed += SUBSTEP * (
            pull - 2.0 * self._defects.damping * pulse * self._swing_speed
        )
        self._swinging = self._swinging + SUBSTEP * self._swing_speed
        return self._swinging

    def _bowed(self, velocity: Vector, jacobian: Array) -> Vector:
        rows = jacobian[:3]
        tool = rows @ velocity
        speed = float(np.linalg.norm(tool))
        if speed < 1e-6:
            return np.zeros_like(velocity)
        aside = np.cross(tool, (0.0, 0.0, 1.0) if abs(tool[2]) < 0.9 * speed else (1.0, 0.0, 0.0))
        share = speed**2 / (speed**2 + BOWED**2)
        push = self._defects.line_bow * share * aside / np.linalg.norm(aside)
        bent: Vector = rows.T @ np.linalg.solve(rows @ rows.T + DAMPED**2 * np.eye(3), push)
        return bent

    def _beyond(self, reference: Vector) -> Vector:
        most = self._defects.overtravel
        width = 4.0 * most
        above = np.maximum(reference - (self._upper - width), 0.0) / width
        below = np.maximum(self._lower + width - reference, 0.0) / width
        return most * (above**2 - below**2)


class DefectivePlant(Plant):
    """One arm whose joints have defects.

    Args:
        defects: of the arm.
        arm: the model.
        given: the rest of what a `Plant` takes.
    """

    def __init__(self, defects: DefectsConfig, arm: Arm, **given: Any) -> None:
        super().__init__(arm, **given)
        self._defects = defects
        self._mask = mask_of(defects, len(arm.limits))
        self._distortion = Distortion(defects, arm)
        self._dry = defects.coulomb_friction * self._mask
        self._runs_on = defects.ignores_stop or defects.ignores_watchdog
        self._lower = self._lower - defects.overtravel * self._mask
        self._upper = self._upper + defects.overtravel * self._mask
        self._braking = np.array([BRAKING * limit.acceleration for limit in arm.limits])
        self._steepest = 2.0 * self._braking
        self._pace = np.zeros(len(arm.limits))
        self._ramp = 0.0
        self._held_from, self._held_since = self._pace, 0.0
        self._rest(self.position, self.velocity)

    @override
    def step(self) -> None:
        super().step()
        if self._defects.rebound and self.command is HOLD and self.is_held:
            self._go_back()

    def _go_back(self) -> None:
        """Go back a little, where this stop has ended a motion."""
        way = np.sign(self._held_from) * (np.abs(self._held_from) > BEGINS) * self._mask
        self._held_from = np.zeros_like(way)
        if way.any():
            back = self.position - self._defects.rebound * way
            self.command = Command(Drive.POSITION, back)

    def sag(self) -> None:
        """Drop, as power has gone."""
        pull = np.sign(self.dynamics.weight(self.position))
        self.move_aside(-self._defects.sag_on_disable * pull)

    def move_aside(self, way: Vector | float) -> None:
        """Be somewhere else at once: by `way` (n,) where joints have defects."""
        position = self.position + way * self._mask
        self.position = np.minimum(np.maximum(position, self._lower), self._upper)
        self._sense(np.zeros(3))

    # ------------------------------------------------------------------------------------------- inside

    def _rest(self, q: Vector, v: Vector) -> None:
        self._sent, self._speed, self._planned = q.copy(), v.copy(), v.copy()

    @override
    def _friction(self, v: Vector) -> Vector:
        return super()._friction(v) + self._dry * np.tanh(v / SLIDING)

    @override
    def _begin(self, command: Command) -> None:
        if self._following is None or self._following.drive not in SERVOED:
            self._distortion.start(self.position)
            self._rest(self.position, self.velocity)
        if command.drive is not Drive.POSITION:
            self._pace = np.zeros_like(self._pace)
        super()._begin(command)
        self._held_from = np.array([servo.velocity for servo in self._servos])
        self._held_since = self.time

    @override
    def _go_to(self, goals: Sequence[float], since: float) -> None:
        before = np.array([servo.goal for servo in self._servos])
        is_stream = since <= LONGEST_RAMP
        self._ramp = max(since, self._cycle) if is_stream else math.inf
        way = np.array(goals) - before
        self._pace = way / self._ramp if is_stream else np.zeros_like(way)
        super()._go_to(goals, since)

    @override
    def _servo_acceleration(
        self, command: Command, q: Sequence[float], v: Sequence[float]
    ) -> Vector:
        servos = self._servos
        reference = np.array([servo.reference for servo in servos])
        planned = np.array([servo.velocity for servo in servos])
        sent = self._distortion.apply(reference, planned, self.time, lambda: self.jacobian)
        speed = (sent - self._sent) / SUBSTEP
        more = ((speed - self._speed) - (planned - self._planned)) / SUBSTEP
        more = np.minimum(np.maximum(more, -self._steepest), self._steepest)
        self._sent, self._speed, self._planned = sent, speed, planned
        # As far from its reference as the joint is from where it is sent.
        near = (reference + (np.array(q) - sent)).tolist()
        drift = (planned + (np.array(v) - speed)).tolist()
        if self._goes_on(command):
            goes = Command(Drive.VELOCITY, self._pace)
            return super()._servo_acceleration(goes, near, drift) + more
        if command.drive is Drive.HOLD and self._defects.slow_stop > 1.0:
            goes = Command(Drive.VELOCITY, self._slowing())
            return super()._servo_acceleration(goes, near, drift) + more
        return super()._servo_acceleration(command, near, drift) + more

    def _goes_on(self, command: Command) -> bool:
        if not self._runs_on or command.drive is not Drive.POSITION:
            return False
        silent = self.time - self._set_at > self._ramp + self._cycle
        return silent and bool(np.abs(self._pace).max() > IN_MOTION)

    def _slowing(self) -> Vector:
        speed = np.abs(self._held_from)
        duration = np.maximum(self._defects.slow_stop * speed / self._braking, SUBSTEP)
        left = np.maximum(0.0, 1.0 - (self.time - self._held_since) / duration)
        return np.where(self._mask > 0.0, left * self._held_from, 0.0)

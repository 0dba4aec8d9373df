"""From a slow stream of goals (interpolate_*, 5 to 100 Hz) to smooth setpoints at the device's rate.

The goals are points on a reference that runs one `latency` behind the stream: in a straight line at the
stream's own velocity, so that it passes each goal `latency` seconds after the goal's time. At each goal the
setpoint is led onto this reference in the shortest time that the limits of velocity, acceleration and jerk
allow. That is an ordinary problem for ruckig, seen from the moving reference: come to rest at zero.

What holds for any stream, however jittery:

* Position, velocity and acceleration are continuous, and within the limits (hard, by construction).
* `latency` is one input period, plus the largest lateness of the last goals (at most a period), plus a
  cycle. The period is the mean of those intervals that are like the median of the last seven: lost goals
  do not change it, and a new rate is taken over after four goals. Velocities are estimated with these
  times, so that jitter of arrival hardly shows in them.
* A stream that asks for more than the limits allow is followed within the limits, late; `lag` shows it.
* When the next goal is missing `latency` seconds after the last one, the setpoint stops at the last goal.
  It goes beyond it by no more than the way in which the limits stop the velocity and acceleration it had.
  If it follows a stream of v (per axis) this is v/2 · (v/a + a/j) or less; it is nothing where v is zero.
* A position never leaves its range: towards its end, the reference is only as fast as can be stopped.
* After `stream_timeout` without a goal a velocity or an effort goes to zero; a stream
  `is_over` when it is at rest.

Compared before it was chosen (sine of 0.3 rad, 0.5 Hz, at 10 to 100 Hz, limits 2 rad/s, 10 rad/s²,
100 rad/s³): a cubic or quintic Hermite segment a period is as exact for a clean stream, but takes
11 to 900 rad/s² where the stream begins or loses a goal; with ruckig as its fallback it never gets back
to the reference at 50 Hz and more (64 ms late instead of 24). ruckig with the goal's position and velocity as
its target backs up for a run-up when the goal is near and fast, with the same result. In the moving frame
there is one method and no fallback; it is 2 mrad off (rms) at 20 Hz, and ruckig takes 11 µs a goal and 1 µs
a cycle of it for six joints. bench/motion.py has the figures.
"""

from __future__ import annotations

import logging
import math
from abc import ABC, abstractmethod
from collections import deque
from dataclasses import dataclass
from statistics import fmean, median_low
from typing import Generic, TypeVar

import numpy as np
from ruckig import ControlInterface, InputParameter, Ruckig, Synchronization, Trajectory

from crtk_drivers.samples import Vector
from crtk_drivers.trajectory.solver import solve

FIRST_PERIOD = 0.05
"""Seconds assumed between goals before two have arrived."""

_INTERVALS = 15
"""How many intervals the period is the mean of, at most."""

_NEW_INTERVALS = 7
"""Of how many the median says which are usual: a new rate is taken over when most of these are new."""

_LATENESSES = 10
"""For how many goals a late one is remembered."""

_CLOCK_GAIN = 0.2
"""How much of a goal's lateness is taken as the stream's own."""

_SLOPE_BASELINE = 0.03
"""Seconds over which a velocity is estimated at least, if there is a faster stream."""

_REFERENCE_SHARE = 0.95
"""The reference's largest share of a velocity limit; the rest is for catching up."""

_ROUNDING = 1e-12
"""rad (m) and their derivatives that are nothing but rounding."""

LONGEST_STEP = 2.0
"""Cycles that one step may advance: after a late cycle the motion goes on where it was."""

G = TypeVar("G")

_logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class Rates:
    """Limits (n,) of the interpolated values' first three derivatives, and the values' range.

    For a stream of positions they are velocity, acceleration and jerk; for velocities, acceleration,
    jerk and none. `jerk` may be infinite, as may the range.
    """

    velocity: Vector
    acceleration: Vector
    jerk: Vector
    lower: Vector
    upper: Vector


class StreamClock:
    """The times of a stream's goals, freed from the jitter of their arrival.

    Args:
        cycle: seconds; no period is estimated to be shorter.

    Attributes:
        arrival: when the last goal arrived, in the seconds of `tick`.
        period: estimated seconds between goals.
        lateness: seconds that a goal was behind its time, the largest of the last ones.
    """

    def __init__(self, cycle: float) -> None:
        self._cycle = cycle
        self._intervals: deque[float] = deque(maxlen=_INTERVALS)
        self._latenesses: deque[float] = deque((0.0,), maxlen=_LATENESSES)
        self.arrival = -math.inf
        self._time = -math.inf
        self.period = max(FIRST_PERIOD, cycle)
        self.lateness = 0.0

    def tick(self, arrival: float) -> float:
        """A goal arrived; return the time that it belongs to, which is after that of the one before."""
        interval = arrival - self.arrival
        self.arrival = arrival
        if not 0.0 <= interval < math.inf:
            self._time = arrival
            return arrival
        self._intervals.append(interval)
        self.period = max(self._cycle, self._usual_interval())
        periods = max(1, round((arrival - self._time) / self.period))
        expected = self._time + periods * self.period
        late = arrival - expected
        if abs(late) > 0.6 * self.period:  # another rhythm, or none
            self._time = max(arrival, math.nextafter(self._time, math.inf))
        else:
            self._time = expected + _CLOCK_GAIN * late
        self._latenesses.append(arrival - self._time)
        self.lateness = min(self.period, max(0.0, *self._latenesses))
        return self._time

    def _usual_interval(self) -> float:
        """Return the mean of the intervals that are like their median: their jitter cancels."""
        middle = median_low(list(self._intervals)[-_NEW_INTERVALS:])
        return fmean(i for i in self._intervals if middle / 2.0 <= i <= middle * 1.5)


class _Approach:
    """The way onto a reference that moves evenly, one ruckig problem."""

    def __init__(self, rates: Rates, synchronization: Synchronization) -> None:
        size = rates.velocity.size
        self._velocity = rates.velocity
        self._ruckig = Ruckig(size)
        self._problem = InputParameter(size)
        self._problem.synchronization = synchronization
        self._problem.max_acceleration = rates.acceleration.tolist()
        self._problem.max_jerk = rates.jerk.tolist()
        self._zeros = [0.0] * size
        self._problem.target_position = self._zeros
        self._problem.target_velocity = self._zeros
        self._problem.target_acceleration = self._zeros
        self._trajectory = Trajectory(size)
        self._reference: Vector = np.zeros(size)
        self._slope: Vector = np.zeros(size)
        self.duration = 0.0
        self.durations: Vector = np.zeros(size)

    def aim(
        self,
        state: tuple[Vector, Vector, Vector],
        reference: Vector,
        slope: Vector,
    ) -> None:
        """Go from `state` (position, velocity, acceleration) to the line reference + slope * time."""
        position, velocity, acceleration = state
        problem = self._problem
        problem.current_position = _without_rounding(position - reference)
        problem.current_velocity = _without_rounding(velocity - slope)
        problem.current_acceleration = _without_rounding(acceleration)
        problem.min_velocity = (-self._velocity - slope).tolist()
        problem.max_velocity = (self._velocity - slope).tolist()
        problem.control_interface = ControlInterface.Position
        trajectory = solve(self._ruckig, problem)
        if trajectory is None:
            _logger.warning("no way to the goals within the limits (%s): stopping", problem)
            reference, slope = position, np.zeros(position.size)
            problem.current_position = self._zeros
            problem.current_velocity = velocity.tolist()
            problem.control_interface = ControlInterface.Velocity
            trajectory = solve(self._ruckig, problem)
        if trajectory is not None:
            self._trajectory, self._reference, self._slope = trajectory, reference, slope
            self.duration = float(trajectory.duration)
            self.durations = np.array(trajectory.independent_min_durations)

    def at(self, time: float) -> tuple[Vector, Vector, Vector]:
        """Return position, velocity and acceleration (n,) `time` seconds after `aim`."""
        position, velocity, acceleration = self._trajectory.at_time(time)
        return (
            self._reference + self._slope * time + position,
            self._slope + velocity,
            np.array(acceleration),
        )

    def behind(self, time: float) -> Vector:
        """Return how far the reference is ahead `time` seconds after `aim`."""
        return -np.array(self._trajectory.at_time(time)[0])


class _Goals(Generic[G]):
    """The newest goals with their times: enough of them to estimate a velocity."""

    def __init__(self, time: float, goal: G) -> None:
        self._items: deque[tuple[float, G]] = deque(((time, goal),))

    @property
    def newest(self) -> tuple[float, G]:
        return self._items[-1]

    @property
    def base(self) -> tuple[float, G]:
        return self._items[0]

    def add(self, time: float, goal: G, spacing: float) -> None:
        items = self._items
        if len(items) > 1 and items[-1][0] - items[-2][0] < spacing:
            items.pop()
        items.append((time, goal))
        while len(items) > 2 and time - items[1][0] >= _SLOPE_BASELINE:
            items.popleft()


class Interpolator(ABC, Generic[G]):
    """One stream. Takes its clock from its caller; belongs to one thread.

    Args:
        rates: the limits.
        cycle: seconds between two calls of `step`.
        stream_timeout: seconds without a goal after which the stream is over.
        synchronization: of the axes while they get onto the reference.
        rests_at_goal: where the stream ends: at its last goal, or at zero.
    """

    def __init__(
        self,
        rates: Rates,
        cycle: float,
        stream_timeout: float,
        synchronization: Synchronization = Synchronization.No,
        rests_at_goal: bool = True,
    ) -> None:
        self._rates = rates
        self._cycle = cycle
        self._timeout = stream_timeout
        self._rests_at_goal = rests_at_goal
        self._approach = _Approach(rates, synchronization)
        self._lower, self._upper = rates.lower, rates.upper
        self._ramp = 3.0 * rates.acceleration / rates.jerk

    def _begin(self, goal: G, now: float) -> None:
        """Forget the stream that was; `goal` is where it starts."""
        self._goals: _Goals[G] = _Goals(now, goal)
        self._has_goal = False
        self._clock = StreamClock(self._cycle)
        self._fed = now
        self._now = now
        self._elapsed = 0.0
        self._run = 0.0  # seconds that the reference takes from the last plan to the goal
        self._moves = False  # whether the reference does
        self._fresh = False
        self._ended = False
        self._plan(0.0)

    # ------------------------------------------------------------------------------------- what it says

    @property
    def period(self) -> float:
        """Estimated seconds between two goals."""
        return self._clock.period

    @property
    def latency(self) -> float:
        """Seconds from a goal to the setpoint that passes it, if the limits allow; see the module."""
        return self._clock.period + self._clock.lateness + self._cycle

    @property
    def lag(self) -> Vector:
        """How far (n,) the setpoint is behind where `latency` alone would have it."""
        return self._approach.behind(self._elapsed)

    @property
    def is_over(self) -> bool:
        """Whether the stream has timed out and its motion has ended."""
        return self._ended and self._elapsed >= self._approach.duration

    # ------------------------------------------------------------------------------------ what it needs

    def _accept(self, goal: G, is_repeated: bool, now: float) -> None:
        """Take a goal that is valid. A second copy of the one before only keeps the stream alive.

        It comes within half a period of the goal that it is a copy of. One that comes later is a goal of its
        own: a stream that says the same for a minute has not slowed down to one goal a minute.
        """
        since = now - self._fed
        self._fed = now
        after = now - self._clock.arrival
        if self._has_goal and is_repeated and 0.0 <= after < self._clock.period / 2.0:
            return
        is_new = not self._has_goal or not 0.0 <= since <= max(self._timeout, 3.0 * self.period)
        if is_new:
            self._clock = StreamClock(self._cycle)
        time = self._clock.tick(now)
        if is_new:
            self._goals = _Goals(time, goal)
        else:
            self._goals.add(time, goal, self._clock.period / 2.0)
        self._has_goal = self._fresh = True
        self._ended = False

    def _advance(self, now: float) -> None:
        """Move to `now`, and plan again if there is a reason."""
        step = now - self._now
        self._now = now
        self._elapsed += min(max(0.0, step), LONGEST_STEP * self._cycle)
        self._read(*self._approach.at(self._elapsed))
        if self._fresh:
            self._fresh = False
            run = self._goals.newest[0] + self.latency - now
            self._plan(min(max(0.0, run), 2.0 * self.latency))
        elif now - self._fed > self._timeout and not self._ended:
            self._ended = True
            if not self._rests_at_goal:
                self._goals = _Goals(now, self._zero())
                self._plan(0.0)
            elif self._moves:
                self._plan(0.0)
        elif self._moves and self._elapsed >= self._run:
            self._plan(0.0)

    def _plan(self, run: float) -> None:
        """Aim at a reference that reaches the goal in `run` seconds, and rests there if that is now."""
        position, velocity, acceleration, goal, slope = self._problem()
        state = (position, velocity, acceleration)
        if run == 0.0:
            slope = np.zeros(goal.size)
        else:
            down, up = self._stoppable(goal - self._lower), self._stoppable(self._upper - goal)
            slope = np.minimum(np.maximum(slope, -_REFERENCE_SHARE * down), _REFERENCE_SHARE * up)
            # Where it begins must be in range, too.
            begin = np.minimum(np.maximum(goal - slope * run, self._lower), self._upper)
            slope = (goal - begin) / run
        self._approach.aim(state, goal - slope * run, slope)
        late = self._approach.durations - run
        if run > 0.0 and (late > 0.0).any():
            # The reference is met beyond the goal. Where it could not be stopped there, it rests at the goal.
            met = goal + slope * np.maximum(late, 0.0)
            down, up = self._stoppable(met - self._lower), self._stoppable(self._upper - met)
            keeps = (slope >= -down) & (slope <= up)
            if not keeps.all():
                slope = np.where(keeps, slope, 0.0)
                self._approach.aim(state, goal - slope * run, slope)
        self._elapsed = 0.0
        self._run = run
        self._moves = bool(slope.any())

    def _stoppable(self, room: Vector) -> Vector:
        """Return the velocity (n,) from which one can stop within `room`, even if it still grows."""
        acceleration = self._rates.acceleration
        room = np.maximum(room, 0.0)
        stoppable = (
            acceleration
            / 2.0
            * (np.sqrt(self._ramp * self._ramp + 8.0 * room / acceleration) - self._ramp)
        )
        return np.minimum(self._rates.velocity, stoppable)

    @abstractmethod
    def _read(self, position: Vector, velocity: Vector, acceleration: Vector) -> None:
        """Take what the approach says as the present setpoint."""

    @abstractmethod
    def _problem(self) -> tuple[Vector, Vector, Vector, Vector, Vector]:
        """Return position, velocity, acceleration, goal and the stream's velocity, in one chart."""

    @abstractmethod
    def _zero(self) -> G:
        """Return the goal at which a stream ends that does not rest at its last one."""


def _without_rounding(values: Vector) -> list[float]:
    """Return numbers of which those are zero that are nothing but rounding: ruckig cannot solve for them."""
    return [0.0 if abs(value) < _ROUNDING else value for value in values.tolist()]

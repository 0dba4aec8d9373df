"""ruckig, asked twice: it finds none, or a useless one, where one of its cases just turns into another."""

from __future__ import annotations

import math

from ruckig import ControlInterface, InputParameter, Result, Ruckig, RuckigError, Trajectory

_SOLVED = (Result.Working, Result.Finished)
_TIGHTER = (1.0, 1.0 - 1e-6, 1.0 - 1e-4, 1.0 - 1e-2)
"""By how much the jerk limits are lowered, one after the other."""


def solve(ruckig: Ruckig, problem: InputParameter) -> Trajectory | None:
    """Return the fastest trajectory of a problem, or None if ruckig finds none.

    ruckig 0.19 fails at a distance of exactly 2 a³/j², for example 0.1 m with 5 m/s² and 50 m/s³ from rest
    to rest. Near by, its answer may be to go on as slowly as the motion begins, for minutes. With a jerk
    limit that is lower by a millionth it is solved, within the limits. `problem` is left as it was. All
    vectors must be of the size of `ruckig`: else ruckig ends the process.
    """
    jerk = list(problem.max_jerk)
    try:
        for factor in _TIGHTER:
            problem.max_jerk = [limit * factor for limit in jerk]
            trajectory = Trajectory(problem.degrees_of_freedom)
            try:
                solved = ruckig.calculate(problem, trajectory) in _SOLVED
                if solved and trajectory.duration <= _longest(problem):
                    return trajectory
            except (RuckigError, ValueError):  # it has results that its own enumeration has not
                continue
    finally:
        problem.max_jerk = jerk
    return None


def _longest(problem: InputParameter) -> float:
    """Return seconds that no trajectory between positions takes: twice what stopping first would take."""
    if problem.control_interface is not ControlInterface.Position:
        return math.inf
    longest = 0.0
    down = problem.min_velocity or [-limit for limit in problem.max_velocity]
    for axis in range(problem.degrees_of_freedom):
        acceleration, jerk = problem.max_acceleration[axis], problem.max_jerk[axis]
        rise = acceleration / jerk if math.isfinite(jerk) else 0.0
        speed = abs(problem.current_velocity[axis]) + abs(problem.target_velocity[axis])
        changing = abs(problem.current_acceleration[axis])
        stop = 2.0 * rise + speed / acceleration + changing / min(jerk, 1e9)
        way = abs(problem.target_position[axis] - problem.current_position[axis])
        way += (speed + acceleration * stop) * stop
        slowest = min(problem.max_velocity[axis], -down[axis])
        turn = 2.0 * (slowest / acceleration + rise)
        longest = max(longest, stop + way / slowest + turn if slowest > 0.0 else math.inf)
    return 2.0 * longest

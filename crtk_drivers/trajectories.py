"""ruckig, asked twice: it finds no solution where one of its cases just turns into another."""

from __future__ import annotations

from ruckig import InputParameter, Result, Ruckig, RuckigError, Trajectory

_SOLVED = (Result.Working, Result.Finished)
_TIGHTER = (1.0, 1.0 - 1e-6, 1.0 - 1e-4, 1.0 - 1e-2)
"""By how much the jerk limits are lowered, one after the other."""


def solve(ruckig: Ruckig, problem: InputParameter) -> Trajectory | None:
    """Return the fastest trajectory of a problem, or None if ruckig finds none.

    ruckig 0.19 fails at a distance of exactly 2 a³/j², for example 0.1 m with 5 m/s² and 50 m/s³ from rest
    to rest. With a jerk limit that is lower by a millionth it is solved, within the limits. `problem` is left
    as it was. All vectors must be of the size of `ruckig`: else ruckig ends the process.
    """
    jerk = list(problem.max_jerk)
    try:
        for factor in _TIGHTER:
            problem.max_jerk = [limit * factor for limit in jerk]
            trajectory = Trajectory(problem.degrees_of_freedom)
            try:
                if ruckig.calculate(problem, trajectory) in _SOLVED:
                    return trajectory
            except (RuckigError, ValueError):  # it has results that its own enumeration has not
                continue
    finally:
        problem.max_jerk = jerk
    return None

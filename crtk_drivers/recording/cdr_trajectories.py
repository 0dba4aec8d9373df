"""Trajectories of joints from ROS 2 messages: by topic, and as goals of FollowJointTrajectory.

Types: trajectory_msgs/msg/JointTrajectory, and of control_msgs 5.8
control_msgs/action/FollowJointTrajectory_SendGoal_Request.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from crtk_drivers.recording.cdr import SLACK, Fields, Malformed
from crtk_drivers.samples import (
    EMPTY,
    MOST_POINTS,
    Array,
    JointTrajectory,
    Tolerance,
    Vector,
    vector,
)

GOAL_ID = slice(4, 20)
"""Where in a goal request its id is."""

MOST_NUMBERS = 64 * MOST_POINTS
"""Positions that a trajectory has at most, those counted that its points leave out."""

_POSE = 7
_TWIST = 6


def decode_trajectory(data: bytes) -> JointTrajectory:
    """Return what a JointTrajectory holds.

    Where a point has no positions, as what streams velocities, they are NaN. One without points is read
    whatever its texts are and whatever follows: it is a stop.

    Raises:
        Malformed: bytes that are no such message, or more than `MOST_POINTS` or `MOST_NUMBERS`.
        ValueError: vectors that do not fit together.
    """
    try:
        fields = Fields(data)
        read = _trajectory(fields)
        fields.end(_slack(read))
    except Malformed:
        if not _has_no_points(data):
            raise
        return JointTrajectory((), EMPTY, EMPTY, EMPTY, EMPTY)
    return read


def _has_no_points(data: bytes) -> bool:
    """Say whether a message can be followed to its points, and has none."""
    try:
        fields = Fields(data)
        fields.stamp()
        fields.raw_text()  # its frame
        for _ in range(fields.few("names")):
            fields.raw_text()
        return fields.count() == 0
    except Malformed:
        return False


def decode_goal(data: bytes) -> JointTrajectory:
    """Return the goal of a request, its tolerances included; see `decode_trajectory`.

    Raises:
        ValueError: it is for joints of several degrees of freedom, too.
    """
    fields = Fields(data)
    fields.bytes(16)
    trajectory = _trajectory(fields)
    is_multiple = _skip_multi_dof(fields)
    path = _tolerances(fields)
    is_multiple |= _skip_component_tolerances(fields)
    goal = _tolerances(fields)
    is_multiple |= _skip_component_tolerances(fields)
    goal_time = fields.duration()
    fields.end(_slack(trajectory))
    if is_multiple:
        raise ValueError("it is for joints of several degrees of freedom, which are not here")
    return replace(trajectory, path=path, goal=goal, goal_time=goal_time)


def _trajectory(fields: Fields) -> JointTrajectory:
    start_ns = fields.stamp()
    fields.text()  # its frame
    names = fields.texts()
    count = fields.few("points", MOST_POINTS)
    times, rows = [], []
    for _ in range(count):
        rows.append(tuple(fields.sequence() for _ in range(4)))
        times.append(fields.duration())
    if any(row[3].size for row in rows):
        raise ValueError("points have efforts, which are not followed")
    columns = [list(column) for column in zip(*rows, strict=True)] or [[], [], [], []]
    size = len(names) if not rows else max(row[0].size for row in rows) or len(names)
    if size * count > MOST_NUMBERS:
        raise Malformed(f"{count} points of {size} joints are more than {MOST_NUMBERS} numbers")
    position, velocity, acceleration = (
        _table(what, column, size)
        for what, column in zip(("positions", "velocities", "accelerations"), columns, strict=False)
    )
    return JointTrajectory(names, vector(times), position, velocity, acceleration, start_ns)


def _slack(read: JointTrajectory) -> int:
    """Return how many bytes may follow: those of each vector that a point has not."""
    return SLACK * (1 + 4 * len(read.times))


def _table(what: str, rows: list[Vector], size: int) -> Array:
    """Return rows (m, n), NaN where one is empty."""
    wrong = [index for index, row in enumerate(rows) if row.size not in (0, size)]
    if wrong:
        raise ValueError(
            f"point {wrong[0]} has {rows[wrong[0]].size} {what}, others have {size} positions"
        )
    none = np.full(size, np.nan)
    return np.array([row if row.size else none for row in rows]).reshape(len(rows), size)


def _tolerances(fields: Fields) -> tuple[Tolerance, ...]:
    read = []
    for _ in range(fields.few("tolerances")):
        name = fields.text()
        position, velocity, _ = fields.numbers(3).tolist()
        read.append(Tolerance(name, position, velocity))
    return tuple(read)


def _skip_component_tolerances(fields: Fields) -> bool:
    """Read tolerances of components; return whether there are any."""
    count = fields.few("tolerances")
    for _ in range(count):
        fields.text()
        fields.short()
        fields.numbers(3)
    return count > 0


def _skip_multi_dof(fields: Fields) -> bool:
    """Read a MultiDOFJointTrajectory; return whether it has anything in it."""
    fields.stamp()
    fields.text()
    names = fields.texts()
    count = fields.few("points", MOST_POINTS)
    for _ in range(count):
        for size in (_POSE, _TWIST, _TWIST):
            fields.numbers(size * fields.few("transforms"))
        fields.duration()
    return bool(names or count)


__all__ = ["GOAL_ID", "Malformed", "decode_goal", "decode_trajectory"]

"""What may be asked as a trajectory: its joints, its times, its numbers, where it goes and how fast.

The rules are those of joint_trajectory_controller (ros2_controllers, ``validate_trajectory_msg``); range and
speed are checked here besides, all along the way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from crtk_drivers.commands import FOLLOW
from crtk_drivers.device import Capabilities
from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.samples import MOST_POINTS, Array, JointTrajectory, Tolerance, Vector, vector
from crtk_drivers.trajectory.waypoints import HARDER, Spline

LATEST_START: Final = 60.0
"""Seconds ahead at which a trajectory may be asked to begin: later, and the clocks differ."""

_FASTER: Final = 0.01
"""By how much a trajectory may exceed a velocity limit: what plans it rounds."""

_BEYOND: Final = 1e-6
"""rad or m by which it may lie beyond a limit: of rounding."""

_LARGEST: Final = 1e6

_APART: Final = 5e-10
"""Seconds between two points at the least: half of what a message can tell."""


class TrajectoryCheck:
    """The checks of the trajectories of one device.

    Args:
        capabilities: of the device.
        where: the device, for messages.
    """

    def __init__(self, capabilities: Capabilities, where: str) -> None:
        self._joints = capabilities.joints
        self._where = where
        self._lower = np.array([limit.lower for limit in capabilities.limits])
        self._upper = np.array([limit.upper for limit in capabilities.limits])
        self._velocity = np.array([limit.velocity for limit in capabilities.limits])
        self._acceleration = np.array([limit.acceleration for limit in capabilities.limits])

    def checked(self, trajectory: JointTrajectory, now_ns: int) -> JointTrajectory:
        """Return a trajectory with its joints in declared order.

        Args:
            trajectory: as it came.
            now_ns: this machine's clock.

        Raises:
            CommandRefused: with the reason; nothing has been changed.
        """
        order = self._order(trajectory.name, trajectory.positions.shape)
        self._check_points(trajectory)
        self._check_times(trajectory, now_ns)
        self._check_tolerances(trajectory)
        velocities = trajectory.velocities[:, order]
        if np.nan_to_num(velocities[-1]).any():
            index = int(np.argmax(np.abs(velocities[-1])))
            raise self._refusal(
                Reason.OUT_OF_RANGE,
                f"it ends with {self._joints[index]} moving at {velocities[-1][index]:.4f}",
                "Let it end at rest.",
            )
        return replace(
            trajectory,
            name=self._joints,
            positions=trajectory.positions[:, order],
            velocities=velocities,
            accelerations=trajectory.accelerations[:, order],
        )

    def check_way(self, way: Spline) -> None:
        """Refuse a way that leaves the range of a joint, or is faster than one can.

        Raises:
            CommandRefused: with the joint.
        """
        lower, upper, fastest = way.extremes()
        self._check_range(lower, upper)
        self._require_at_most(
            fastest,
            self._velocity,
            _FASTER,
            "{} would move at {:.4f}, faster than {:.4f}",
            "Give it more time, or begin nearer to where the joints are.",
        )

    def check_pull(self, pull: Array) -> None:
        """Refuse a trajectory whose first point comes sooner than the joints can be there.

        Args:
            pull: (n,) the greatest accelerations of the way there.

        Raises:
            CommandRefused: with the joint.
        """
        self._require_at_most(
            pull,
            self._acceleration,
            HARDER,
            "{} would accelerate at {:.4f} to be at the first point in time, more than {:.4f}",
            "Give the first point more time, or begin nearer to where the joints are.",
        )

    def check_start(self, off: Vector, longest: float) -> None:
        """Refuse a trajectory that is not, when it is joined, where the joints are.

        Args:
            off: (n,) how far they are from it.
            longest: seconds in which they must be able to be there at full speed.

        Raises:
            CommandRefused: with the joint.
        """
        excess = np.abs(off) > longest * self._velocity
        if excess.any():
            index = int(np.argmax(excess))
            raise self._refusal(
                Reason.STEP_TOO_LARGE,
                f"{self._joints[index]} is {abs(off[index]):.4f} from where it begins, more than "
                f"{longest * self._velocity[index]:.4f}",
                "Let it begin where the joints are, or give the first point a time to get there.",
            )

    def _require_at_most(
        self, values: Array, limits: Vector, slack: float, text: str, remedy: str
    ) -> None:
        """Refuse values (n,) above limits (n,) by more than a share `slack`.

        `text` has places for the joint, its value and its limit.
        """
        excess = ~(values <= limits * (1.0 + slack))  # NaN is
        if excess.any():
            index = int(np.argmax(excess))
            told = text.format(self._joints[index], values[index], limits[index])
            raise self._refusal(Reason.OUT_OF_RANGE, told, remedy)

    def _check_range(self, lower: Array, upper: Array) -> None:
        for values, outside in (
            (lower, ~(lower >= self._lower - _BEYOND)),
            (upper, ~(upper <= self._upper + _BEYOND)),
        ):
            if outside.any():
                index = int(np.argmax(outside))
                raise self._refusal(
                    Reason.OUT_OF_RANGE,
                    f"{self._joints[index]} would come to {values[index]:.4f}, outside "
                    f"[{self._lower[index]:.4f}, {self._upper[index]:.4f}]",
                    "Stay within the limits, between the points too.",
                )

    def _order(self, names: tuple[str, ...], shape: tuple[int, ...]) -> Sequence[int]:
        if not names:
            raise self._refusal(
                Reason.EMPTY, "it names no joints", f"Name {', '.join(self._joints)}."
            )
        if sorted(names) != sorted(self._joints):
            unknown = [name for name in names if name not in self._joints]
            missing = [name for name in self._joints if name not in names]
            what = (
                f"{unknown[0]!r} is no joint of it"
                if unknown
                else f"{missing[0]!r} is missing"
                if missing
                else "it names a joint twice"
            )
            raise self._refusal(
                Reason.WRONG_NAMES, what[:200], f"Name each of {', '.join(self._joints)} once."
            )
        if not shape[0]:
            raise self._refusal(Reason.EMPTY, "it has no points", "Send at least one.")
        if shape[1] != len(names):
            raise self._refusal(
                Reason.WRONG_SIZE,
                f"{shape[1]} positions for {len(names)} joints",
                "Give each point one position for each joint.",
            )
        return [names.index(name) for name in self._joints]

    def _check_points(self, trajectory: JointTrajectory) -> None:
        if len(trajectory.times) > MOST_POINTS:
            raise self._refusal(
                Reason.WRONG_SIZE,
                f"{len(trajectory.times)} points are more than {MOST_POINTS}",
                "Send fewer points: what is between them is interpolated.",
            )
        for what, values, may_lack in (
            ("position", trajectory.positions, False),
            ("velocity", trajectory.velocities, True),
            ("acceleration", trajectory.accelerations, True),
        ):
            bad = ~(np.abs(values) <= _LARGEST)
            if may_lack:
                bad &= ~np.isnan(values).all(axis=1, keepdims=True)
            if bad.any():
                row, column = (int(index) for index in np.argwhere(bad)[0])
                raise self._refusal(
                    Reason.NOT_FINITE,
                    f"the {what} of {trajectory.name[column]} in point {row} is {values[row, column]:g}",
                    "Send numbers.",
                )

    def _check_times(self, trajectory: JointTrajectory, now_ns: int) -> None:
        times = trajectory.times
        if not np.isfinite(times).all():
            row = int(np.argmin(np.isfinite(times)))
            raise self._refusal(
                Reason.NOT_FINITE, f"the time of point {row} is {times[row]:g}", "Send numbers."
            )
        back = np.flatnonzero(np.diff(times) < _APART)
        if times[0] < 0.0 or back.size:
            row = int(back[0]) + 1 if back.size else 0
            before = f", after {times[row - 1]:g}" if row else ""
            raise self._refusal(
                Reason.OUT_OF_RANGE,
                f"the time of point {row} is {times[row]:g} s{before}",
                "Let time_from_start increase from point to point.",
            )
        if not trajectory.start_ns:
            return
        ahead = 1e-9 * (trajectory.start_ns - now_ns)
        if ahead + times[-1] < 0.0:
            raise self._refusal(
                Reason.TOO_OLD,
                f"it would have ended {-ahead - times[-1]:.3f} s ago",
                "Set header.stamp to when it begins, or to zero for now. Are the clocks synchronised?",
            )
        if ahead > LATEST_START:
            raise self._refusal(
                Reason.FROM_FUTURE,
                f"it would begin in {ahead:.0f} s",
                f"Let it begin within {LATEST_START:g} s. Are the clocks synchronised?",
            )

    def _check_tolerances(self, trajectory: JointTrajectory) -> None:
        asked: tuple[Tolerance, ...] = (*trajectory.path, *trajectory.goal)
        for each in asked:
            if each.name not in self._joints:
                raise self._refusal(
                    Reason.WRONG_NAMES,
                    f"a tolerance is for {each.name[:100]!r}, which is no joint of it",
                    f"There are {', '.join(self._joints)}.",
                )
        numbers = vector([value for each in asked for value in (each.position, each.velocity)])
        if not np.isfinite([*numbers, trajectory.goal_time]).all() or trajectory.goal_time < 0.0:
            raise self._refusal(
                Reason.NOT_FINITE,
                "a tolerance is no number, or the goal time tolerance negative",
                "Send numbers: 0 for the default, -1 for no limit.",
            )

    def _refusal(self, reason: Reason, message: str, remedy: str) -> CommandRefused:
        return CommandRefused(FOLLOW.name, reason, message, where=self._where, remedy=remedy)

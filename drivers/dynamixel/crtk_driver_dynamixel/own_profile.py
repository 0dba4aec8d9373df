"""Servos that take their own time to a goal: how fast their own profile is, and whether they are there.

A servo with a profile (`profile_velocity`, `profile_acceleration`) goes to each goal as fast as that lets
it, and one that yields stops at what is in its way. Neither is where it was sent when it was sent there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from crtk_driver_dynamixel.config import GripperConfig, ServoConfig
from crtk_driver_dynamixel.readings import Frame
from crtk_driver_dynamixel.units import Counts
from crtk_drivers.device import JointLimits

NEAR: Final = 2
"""Counts from its goal within which a servo is there."""
STANDS: Final = np.array([(NEAR, 0.25), (7, 1.0)])
"""Counts by which a servo that moves has to move on, in so many seconds; one that stands may tremble.

The slowest profile, 0.229 rpm, makes 4 counts in 0.25 s. The slowest acceleration, 0.374 rad/s², makes 30
counts in 0.5 s, so that one which turns round is not taken to stand."""


def takes_its_time(config: ServoConfig) -> bool:
    """Whether a joint is later at its goal than it is sent there, or never, without a fault."""
    own = config.profile_velocity > 0.0 or config.profile_acceleration > 0.0
    return own or config.yields or isinstance(config, GripperConfig)


def move_limits(config: ServoConfig, limits: JointLimits) -> JointLimits:
    """Return the limits of a move: those of the joint, or of the servo's own profile where that is slower."""
    velocity, acceleration = config.profile_velocity, config.profile_acceleration
    if not velocity:  # without one a servo has no profile (e-manual, X series, "Profile")
        return limits
    if isinstance(config, GripperConfig):  # a servo's profile is of its angle
        finger = config.finger.finger
        angles = abs(finger.angle(config.open) - finger.angle(config.closed))
        ratio = (config.open - config.closed) / angles
        velocity, acceleration = velocity * ratio, acceleration * ratio
    return replace(
        limits,
        velocity=min(limits.velocity, velocity),
        acceleration=min(limits.acceleration, acceleration or math.inf),
    )


class Approach:
    """Which servos are still on their way to a goal. Belongs to the I/O thread.

    Args:
        configs: of the servos of a part: those that take their time are looked at.
        places: of them in the chain.
    """

    def __init__(self, configs: Sequence[ServoConfig], places: Sequence[int]) -> None:
        slow = [at for at, config in enumerate(configs) if takes_its_time(config)]
        self._slow = np.array(slow, dtype=np.int64)
        self._places = np.array([places[at] for at in slow], dtype=np.int64)
        self._off = np.zeros(len(slow), dtype=np.int64)
        # For each way to stand: from where, and since when.
        self._from = np.zeros((len(STANDS), len(slow)), dtype=np.int64)
        self._since = np.full(self._from.shape, math.inf)
        self._stands = np.zeros(len(slow), dtype=np.bool_)
        self._goals: Counts | None = None

    def look(self, frame: Frame, goals: Counts | None) -> None:
        """Take what a cycle has read.

        Args:
            frame: of the chain.
            goals: (servos,) of the part that were in force; None: none of positions.
        """
        if not self._slow.size:
            return
        here, seen = frame.position[self._places], frame.seen[self._places]
        wanted = None if goals is None else goals[self._slow]
        begins = wanted is None or self._goals is None or wanted != self._goals
        counts, seconds = STANDS[:, :1], STANDS[:, 1:]
        moves = begins | (np.abs(here - self._from) >= counts)
        self._from = np.where(moves, here, self._from)
        self._since = np.where(moves, seen, self._since)
        self._stands = (seen - self._since >= seconds).any(axis=0)
        self._goals = wanted
        self._off = here if wanted is None else np.abs(wanted - here)

    def has_ended(self, goals: Counts | None) -> bool:
        """Whether each servo is at its goal (servos,), or stands where something holds it.

        Args:
            goals: where they were sent last; None: to no position.
        """
        if goals is None or not self._slow.size:
            return True
        if self._goals is None or not np.array_equal(goals[self._slow], self._goals):
            return False  # nothing was read since
        return bool(((self._off <= NEAR) | self._stands).all())

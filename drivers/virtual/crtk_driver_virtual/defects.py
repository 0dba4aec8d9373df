"""What is wrong with what a defective arm measures, and with when it tells. No I/O and no clock.

`Senses` changes values, `Delivery` which samples come and with which stamps. An arm without defects has
neither.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from crtk_driver_virtual.defects_config import DefectsConfig
from crtk_drivers.samples import Pose, Sample, Stamp, Vector, vector

STANDING: Final = 1e-9
"""rad (m) within which a joint is at the end of its backlash."""
SAME_TIME: Final = 1e-6
"""Seconds that two times may be apart and be meant as one."""


def mask_of(defects: DefectsConfig, count: int) -> Vector:
    """Return 1 for each joint (n,) that has the defects, 0 for others."""
    if defects.joints is None:
        return np.ones(count)
    return np.array([float(joint in defects.joints) for joint in range(count)])


class Senses:
    """Measured values, as a defective arm tells them.

    Args:
        defects: of the arm.
        count: of its joints.

    Attributes:
        zero: (n,) what positions are told too great by, since `home` found it so; the drives have it too.
    """

    def __init__(self, defects: DefectsConfig, count: int) -> None:
        self._defects = defects
        self._mask = mask_of(defects, count)
        self._random = np.random.default_rng(defects.seed)
        self._past: deque[tuple[float, Vector]] = deque()
        self._joint: Vector | None = None
        self._is_past: NDArray[np.bool_] | None = None
        self._began = 0.0
        self.zero = np.zeros(count)

    def find_zero(self) -> None:
        """Home has found where zero is, more or less."""
        self.zero = self._mask * self._random.normal(
            0.0, self._defects.homing_noise, self.zero.size
        )

    def joints(self, q: Vector, v: Vector, now: float) -> tuple[Vector, Vector]:
        """Return positions and velocities (n,) as they are told of motors at `q`, `v`, in monotonic `now`."""
        defects, mask = self._defects, self._mask
        q, v = self._behind_backlash(q, v)
        if self._is_past is None:
            self._is_past = q > defects.jump_at
            self._began = now
        crossed = (q > defects.jump_at) * 1.0 - self._is_past
        position = q + self.zero + mask * defects.position_jump * crossed
        since = now - self._began
        line = defects.position_line * self._wave(since)
        position += mask * (line + defects.position_drift * since)
        if defects.position_noise:
            position += mask * self._random.normal(0.0, defects.position_noise, q.size)
        late = self._of_before(v, now)
        return position, np.where(mask > 0.0, defects.velocity_scale * late, v)

    def effort(self, effort: Vector) -> Vector:
        """Return measured efforts (n,)."""
        factor = self._defects.effort_sign * self._defects.effort_scale
        return np.where(self._mask > 0.0, factor * effort, effort)

    def for_pose(self, position: Vector) -> Vector:
        """Return the positions (n,) that measured_cp is computed from."""
        return vector(position + self._mask * self._defects.calibration)

    def pose(self, pose: Pose) -> Pose:
        """Return measured_cp."""
        return replace(pose, position=vector(self._defects.pose_scale * pose.position))

    def twist(self, twist: Vector) -> Vector:
        """Return measured_cv (6,)."""
        return self._defects.twist_scale * twist

    def wrench(self, wrench: Vector, now: float) -> Vector:
        """Return measured_cf (6,) in monotonic `now`."""
        defects, since = self._defects, now - self._began
        off = defects.force_line * self._wave(since) + defects.force_drift * since
        noise = self._random.normal(0.0, defects.force_noise, 6) if defects.force_noise else 0.0
        return defects.force_scale * wrench + off + noise

    def _wave(self, since: float) -> float:
        return math.sin(2.0 * math.pi * self._defects.line_frequency * since)

    def _behind_backlash(self, q: Vector, v: Vector) -> tuple[Vector, Vector]:
        half = 0.5 * self._defects.backlash * self._mask
        if not self._defects.backlash:
            return q, v
        before = q if self._joint is None else self._joint
        self._joint = joint = np.minimum(np.maximum(before, q - half), q + half)
        is_carried = np.abs(joint - before) > STANDING
        return joint, np.where(is_carried | (half == 0.0), v, 0.0)

    def _of_before(self, v: Vector, now: float) -> Vector:
        past, since = self._past, now - self._defects.velocity_lag + SAME_TIME
        past.append((now, v))
        while len(past) > 1 and past[1][0] <= since:
            past.popleft()
        return past[0][1]


class Delivery:
    """Which samples come when, and what their stamps are.

    Args:
        defects: of the arm.

    Attributes:
        lost: how many samples never came.
    """

    def __init__(self, defects: DefectsConfig) -> None:
        self._defects = defects
        self._random = np.random.default_rng(defects.seed)
        self._waiting: deque[Sample] = deque()
        self._last: Sample | None = None
        self._began: float | None = None
        self._due = 0.0
        self.lost = 0

    def begin(self) -> None:
        """The link is open: nothing is under way."""
        self._waiting.clear()

    @property
    def wait(self) -> float:
        """Seconds that the next read takes longer."""
        return abs(float(self._random.normal(0.0, self._defects.jitter)))

    def take(self, sample: Sample) -> Sample | None:
        """Return what comes when `sample` has been acquired; None: nothing new."""
        defects, now = self._defects, sample.stamp
        self._due += defects.slow
        if self._due < 1.0:
            return None
        self._due -= 1.0
        if self._is_one_of(defects.lost_samples):
            self.lost += 1
            return None
        self._waiting.append(sample)
        come: Sample | None = None
        ripe = now.monotonic - defects.age + SAME_TIME
        while self._waiting and self._waiting[0].stamp.monotonic <= ripe:
            come = self._waiting.popleft()
        if come is None:
            return None
        stamp = now if defects.arrival_stamps else come.stamp
        if self._last is not None and self._is_one_of(defects.frozen_share):
            come = self._last
        self._last = come
        return replace(come, stamp=self._by_its_clock(stamp))

    def without_link(self, now: Stamp) -> Sample | None:
        """Return what is told when the link is lost; None: that it is lost."""
        if self._last is None or not self._defects.stale_stamps:
            return None
        return replace(self._last, stamp=now)

    def _is_one_of(self, share: float) -> bool:
        return bool(share) and float(self._random.random()) < share

    def _by_its_clock(self, stamp: Stamp) -> Stamp:
        if self._began is None:
            self._began = stamp.monotonic
        off = 1e-6 * self._defects.clock_drift * (stamp.monotonic - self._began)
        off += float(self._random.normal(0.0, self._defects.stamp_jitter))
        return Stamp(stamp.wall_ns + round(1e9 * off), stamp.monotonic + off)

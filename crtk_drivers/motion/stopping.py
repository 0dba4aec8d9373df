"""Stops, which are believed only when they are read back.

Every stop that the I/O thread asks the hardware for goes through here. From then on the joints are watched
until a sample that was acquired afterwards shows them standing, and the device says of itself that it was
carried out (`Device.has_stopped`). Until then the stop is sent again and again; past the time that the device
declares (`StopPolicy.time`) it counts as not carried out. Hardware that somebody has slowed down
(`Device.pace`) brakes as slowly, and gets as much more time.

What somebody else has taken (`Device.is_taken_over`) is neither stopped nor watched.

A motion that was sent counts as well, until a later sample shows the joints standing: if the link is lost
before that, nobody knows whether the hardware moves.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable

from crtk_drivers.device import Capabilities, Device
from crtk_drivers.samples import JointState, Sample, Vector

logger = logging.getLogger(__name__)

UNSEEN = "a stop could not be read back"
"""What is said of one whose end nobody saw, since the link was lost before."""

REPEAT: float = 0.05
"""Seconds after which a stop that was not carried out is sent again."""

HELD_UP: float = 0.1
"""Seconds, besides two cycles, which count at most between two looks: who was held up has not looked."""

_STILL = 0.03
"""Share of its velocity limit below which a joint stands: noise."""

_FLICKER = 1.5
"""Steps of the velocity that is measured below which a joint stands: the last one comes and goes."""

_HALF = 0.5
"""Share of the declared time after which a stop is sent again to a device that does not say if it arrived."""

SLOWEST_PACE = 0.05
"""Of real time: hardware that is slowed down further counts as standing."""

_LAG = 0.1
"""Seconds in which a motion that was sent may not show yet, where the device declares none (`Following`)."""

_SHORTEST = 1e-3
"""Seconds between two positions from which a speed can be told."""


def still_speeds(
    capabilities: Capabilities, steps: tuple[float, ...] | None = None
) -> tuple[float, ...]:
    """Return the speed of each joint, in rad/s (m/s), below which it stands.

    Args:
        capabilities: of the device.
        steps: of the velocities that it measures; None: as it declares them.
    """
    declared = capabilities.velocity_resolution if steps is None else steps
    steps = declared or (0.0,) * len(capabilities.joints)
    return tuple(
        max(_STILL * limit.velocity, _FLICKER * step)
        for limit, step in zip(capabilities.limits, steps, strict=True)
    )


class Stopping:
    """The stops of one device. Belongs to the I/O thread.

    Args:
        device: that is stopped.
        clock: monotonic seconds.

    Attributes:
        can_move: whether the device has anything that moves.
    """

    def __init__(self, device: Device, clock: Callable[[], float]) -> None:
        capabilities = device.capabilities
        self._device = device
        self._clock = clock
        self._joints = capabilities.joints
        self._still = still_speeds(capabilities)
        self._time = capabilities.stop.time
        self.can_move = bool(
            capabilities.modes
            or capabilities.native_moves
            or capabilities.has_free
            or capabilities.needs_homing
        )
        following = capabilities.following
        self._lag = _LAG if following is None else following.lag
        self._seen_from = -math.inf  # a sample that was acquired later shows what was sent last
        self._motion_sent = -math.inf
        self._asked = -math.inf
        self._resting = 2.0 / capabilities.rate  # nothing was sent for so long
        self._longest_look = HELD_UP + 2.0 / capabilities.rate
        self._passed = self._watched_for = self._counted = 0.0
        self._sent = -math.inf
        self._watches = self._was_sent = self._is_let_go = False
        self._position: tuple[float, Vector] | None = None
        self._moving = ""
        self._last_seen = ""

    @property
    def confirmed(self) -> bool:
        """Whether every stop that was asked for has been seen to be carried out."""
        return not self._watches

    @property
    def stands(self) -> bool:
        """Whether the joints stood when they were measured last, by their velocities or else positions."""
        return not self._moving

    def stop(self) -> None:
        """Stop the hardware, and watch from now on that it comes to stand, if it has anything that moves.

        Raises:
            DeviceError: it could not be told.
        """
        if self._device.is_taken_over:
            self._let_be()
            return
        now = self._clock()
        if not self._watches:
            self._begin(now)
        self._watches, self._sent = self.can_move, now
        self._device.stop()

    def left(self) -> None:
        """Tell the device that it is not ENABLED any more; `stop` follows, whatever becomes of that.

        From any thread.
        """
        try:
            self._device.left()
        except Exception:
            logger.exception("%s: what it does when ENABLED is left", self._device.address)

    def moves_again(self) -> None:
        """A motion is begun on purpose: the stop before it is not watched any more."""
        self._watches = False

    def motion_sent(self, *, lasts: bool = False) -> None:
        """A motion was sent, or goes on: the hardware counts as moving until it is seen to stand after it.

        Args:
            lasts: it has no end of its own, as a velocity or an effort; a stop that is read back ends it.
        """
        self._was_sent, self._is_let_go = self.can_move, False
        self._motion_sent = self._clock()
        self._seen_from = math.inf if lasts else self._motion_sent + self._lag

    def let_go(self) -> None:
        """It moves freely: what has no end of its own has come to one, and it is on its way to nowhere."""
        self._is_let_go = True
        if self._seen_from == math.inf:
            self._seen_from = self._clock() + self._lag

    def motion_ended(self) -> None:
        """What was sent has been carried out, as was measured: the first sample in which it stands counts."""
        self._seen_from = -math.inf
        self._was_sent = self._was_sent and bool(self._moving)

    def waits_for_lag(self, at: float) -> bool:
        """Whether a motion that was sent may not show yet in a sample of `at`, in which the joints stand.

        While a stream goes on, nobody asks.
        """
        if not self._was_sent or self._moving:
            return False
        return self._motion_sent + self._resting < at <= self._seen_from < math.inf

    def settled(self, at: float) -> None:
        """Believe the next sample in which the joints stand: they were measured where they were sent last.

        Args:
            at: monotonic seconds at which that was acquired.
        """
        self._seen_from = min(self._seen_from, at)

    def begin_anew(self) -> None:
        """Give a stop that was not read back its time once more: after a connection, or once power is off."""
        self._still = still_speeds(self._device.capabilities, self._device.velocity_steps)
        self._position = None
        self._sent = -math.inf
        self._begin(self._clock())

    def follow(self, sample: Sample | None, now: float) -> None:
        """Look at a new sample; send the stop again where it was not carried out.

        Raises:
            DeviceError: it could not be told.
        """
        if sample is not None:
            self._look(sample)
        if self._device.is_taken_over:
            self._let_be()
        if not self._watches:
            return
        self._count(now)
        is_late = self._passed > _HALF * self._time
        if (is_late or not self._device.has_stopped) and now - self._sent >= REPEAT:
            self._sent = now
            self._device.stop()

    def overdue(self, now: float) -> str:
        """Return what to say of a stop that is past its time; empty if there is none."""
        if not self._watches:
            return ""
        self._count(now)
        if self._watched_for <= self._time:
            return ""
        what = self._moving or self._device.condition.reason or "the hardware has not confirmed it"
        return f"a stop has not been carried out within {self._time:g} s: {what}"

    @property
    def unseen(self) -> str:
        """What to say if joints moved when they were last seen, or had been sent a motion; else empty."""
        if self._last_seen and (self._watches or self._was_sent):
            return f"{UNSEEN}: {self._last_seen} when it was last seen"
        return f"{UNSEEN}: it was sent a motion, and not seen since" if self._was_sent else ""

    @property
    def time(self) -> float:
        """Seconds within which the device declares to stand after a stop, at its present pace."""
        return self._time / self._pace

    @property
    def _pace(self) -> float:
        return max(self._device.pace, SLOWEST_PACE)

    def _let_be(self) -> None:
        """What moves is not ours, and no stop of ours is for it."""
        self._watches = self._was_sent = False

    def _begin(self, now: float) -> None:
        self._asked = self._counted = now
        self._passed = self._watched_for = 0.0

    def _count(self, now: float) -> None:
        """Count the seconds since the stop was asked for, of the hardware's own time, and those watched."""
        pace = self._pace
        if self._device.pace == 0.0 and self._moving:
            pace = 1.0  # nothing that was slowed down to a standstill moves
        elapsed = now - self._counted
        self._passed += pace * elapsed
        self._watched_for += pace * min(elapsed, self._longest_look)
        self._counted = now

    def _look(self, sample: Sample) -> None:
        value = sample.values.get("measured_js") if sample.stamp.wall_ns else None
        moving: str | None = ""  # where nothing is measured, the device alone can say
        if isinstance(value, JointState) and value.position.size == len(self._joints):
            moving = self._motion_of(value, sample.stamp.monotonic)
            self._last_seen = self._last_seen if moving is None else moving
        if moving is None:
            return
        self._moving = moving
        if moving or not (self._watches or self._was_sent):
            return
        at = sample.stamp.monotonic
        if self._watches and at > self._asked and self._device.has_stopped:
            self._watches = self._was_sent = False
        elif sample.stamp.wall_ns and at > self._seen_from:
            self._was_sent = not (self._is_let_go or self._device.has_arrived)

    def _motion_of(self, state: JointState, at: float) -> str | None:
        """Return what moves, in words; None if that cannot be told yet."""
        velocity, before = state.velocity, self._position
        if not velocity.size:
            if before is not None and 0.0 <= at - before[0] < _SHORTEST:
                return None
            self._position = at, state.position
            if before is None or at < before[0]:
                return None
            velocity = (state.position - before[1]) / (at - before[0])
        for name, speed, still in zip(self._joints, velocity.tolist(), self._still, strict=True):
            if not abs(speed) <= still:
                return f"{name} at {speed:.3f}"
        return ""

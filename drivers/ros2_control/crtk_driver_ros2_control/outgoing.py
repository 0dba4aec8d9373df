"""What goes out to the controllers: setpoints, the way to rest after a stop, and the value that is held.

A forward controller keeps its last command for ever, so a stop is a command too: positions and velocities
slow down within the limits of the joints, efforts end at once, and what is sent last is what is held. The
I/O thread and the watchdog say what shall be; the thread of the robot's node (`pump`) sends it.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Final, Protocol

import numpy as np

from crtk_driver_ros2_control.braking import Braking
from crtk_driver_ros2_control.controllers import Role
from crtk_drivers.samples import Vector, vector

IDLE: Final = 1.0
"""Seconds until `pump` looks again where nothing is to be sent."""
RECENT: Final = 4
"""Setpoints that say how fast the setpoint goes."""
_GO_ON: Final = frozenset({Role.VELOCITY, Role.EFFORT})
"""Controllers that move the joints on for as long as nothing else is sent."""
POSITIONS: Final = frozenset({Role.POSITION, Role.TRAJECTORY})
"""Controllers that go to a position and hold it."""
AHEAD: Final = 3.0
"""Periods in which a trajectory of one point ends."""


class Wire(Protocol):
    """What sends; see `crtk_driver_ros2_control.foreign.node.ForeignNode`."""

    def wake(self) -> None:
        """Have `Outgoing.pump` called soon."""

    def command(self, controller: str, values: Sequence[float]) -> None:
        """Send a command."""

    def point(self, joints: Sequence[str], positions: Sequence[float], seconds: float) -> None:
        """Send a trajectory of one point."""


class Outgoing:
    """The commands of one robot.

    Args:
        controllers: their names, by role.
        joints: in the order of the device.
        velocity: limits (n,), rad/s (m/s).
        deceleration: of stops (n,), rad/s² (m/s²).
        period: of setpoints, s.
        clock: monotonic seconds.

    Attributes:
        wire: that sends; None while the robot is not connected.
        orders: place of each joint of a forward controller in the order of the device, by role.
        sent: how many commands went out.
        held: the value that the last stop or seed left, and its role; None while setpoints are followed.
    """

    def __init__(
        self,
        controllers: Mapping[Role, str],
        joints: tuple[str, ...],
        velocity: Vector,
        deceleration: Vector,
        period: float,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.wire: Wire | None = None
        self.orders: dict[Role, Sequence[int]] = {}
        self.sent = 0
        self.held: tuple[Role, Vector] | None = None
        self._controllers = controllers
        self._joints = joints
        self._fastest = velocity
        self._deceleration = deceleration
        self._period = period
        self._clock = clock
        self._lock = threading.Lock()
        self._recent: deque[tuple[float, Vector]] = deque(maxlen=RECENT)
        self._role: Role | None = None
        self._due: deque[tuple[Role, Vector]] = deque()
        self._braking: Braking | None = None
        self._braked = 0.0
        self._at_rest = True
        self._chase: Vector | None = None  # what was sent of positions that catch up
        self._target = velocity
        self._chased = -np.inf
        self._is_sending = False

    # -------------------------------------------------------------------------- I/O thread, watchdog

    def follow(self, role: Role, values: Vector, here: Vector | None = None) -> None:
        """Send a setpoint.

        Args:
            role: of the controller that it is for.
            values: of the setpoint (n,).
            here: where the joints are (n,), if the setpoint may be ahead of them, since the controller was
                not active until now: positions then catch up no faster than the limits.
        """
        now = self._clock()
        with self._lock:
            self._begin(role)
            self._braking, self._at_rest, self.held = None, False, None
            if role in POSITIONS and here is not None:
                self._chase, self._target = here, values
                self._recent.append((now, here))
            elif role in POSITIONS and self._chase is not None:
                self._target = values
            else:
                self._recent.append((now, values))
                self._due = deque(((role, values),))
        self._wake()

    def stop(self) -> None:
        """Come to rest from the last setpoint, and hold. Again: send the held value once more."""
        now = self._clock()
        with self._lock:
            if self._at_rest or self._role is None:
                if self.held is not None:
                    self._due.append(self.held)
            elif self._braking is None:
                position, velocity = self._motion(now)
                self._braking = Braking(position, velocity, self._deceleration)
                self._chase = None
                self._braked = now - min(now - self._recent[-1][0], self._period)
                self._due.clear()
        self._wake()

    def hold_at(self, role: Role, values: Vector) -> None:
        """Have a controller hold a value from now on: before it is activated, and after."""
        with self._lock:
            self._begin(role)
            self._recent.clear()
            self._braking, self._at_rest, self._chase = None, True, None
            self.held = role, values
            self._due = deque((self.held,))
        self._wake()

    def forget(self) -> None:
        """Nothing has been sent: a trajectory controller holds by itself."""
        with self._lock:
            self._forget()

    def begin_anew(self) -> None:
        """Nothing has been sent on a new connection. A velocity or an effort of the one before may go on:
        `stop` sends zeros."""
        with self._lock:
            role = self._role if self.held is None else self.held[0]
            self._forget()
            if role is not None and role in _GO_ON:
                self.held = role, vector(np.zeros_like(self._fastest))

    def _forget(self) -> None:
        self._role, self._braking, self._at_rest, self._chase = None, None, True, None
        self.held = None
        self._recent.clear()
        self._due.clear()

    @property
    def is_at_rest(self) -> bool:
        """Whether what was told to stop has been sent its last value."""
        with self._lock:
            return self._at_rest and not self._due and not self._is_sending

    # ---------------------------------------------------------------------------- the node's thread

    def pump(self) -> float:
        """Send what is due; return after how many seconds there may be more."""
        wire = self.wire
        if wire is None:
            return IDLE
        now = self._clock()
        with self._lock:
            if self._role is not None and self._braking is None:
                self._catch_up(self._role, now)
            elif self._role is not None and self._braking is not None:
                self._due.append((self._role, self._slowed(self._role, self._braking, now)))
            due, self._due = self._due, deque()
            self._is_sending = bool(due)
            goes_on = self._braking is not None or self._chase is not None
        for role, values in due:
            self._send(wire, role, values)
        self._is_sending = False
        return self._period if goes_on else IDLE

    def _send(self, wire: Wire, role: Role, values: Vector) -> None:
        if role is Role.TRAJECTORY:
            wire.point(self._joints, values.tolist(), AHEAD * self._period)
        else:
            order = self.orders.get(role)
            if order is None:
                return
            wire.command(self._controllers[role], values[list(order)].tolist())
        self.sent += 1

    # -------------------------------------------------------------------------------------- inside

    def _begin(self, role: Role) -> None:
        if role is not self._role:
            self._role = role
            self._recent.clear()

    def _wake(self) -> None:
        wire = self.wire
        if wire is not None:
            wire.wake()

    def _motion(self, now: float) -> tuple[Vector, Vector]:
        """Return where the setpoint is and how fast it goes; of velocities, nothing and themselves."""
        last = self._recent[-1][1]
        if self._role is Role.VELOCITY:
            return last, last
        first_at, first = self._recent[0]
        last_at = self._recent[-1][0]
        elapsed = last_at - first_at
        if self._role is Role.EFFORT or elapsed <= 0.0 or now - last_at > AHEAD * self._period:
            return last, vector(np.zeros_like(last))
        speed = (last - first) / max(elapsed, (len(self._recent) - 1) * 0.5 * self._period)
        return last, vector(np.clip(speed, -self._fastest, self._fastest))

    def _slowed(self, role: Role, braking: Braking, now: float) -> Vector:
        """Return what is sent now on the way to rest; the last of it is held."""
        elapsed = now - self._braked
        if role is Role.EFFORT:
            values, ended = vector(np.zeros_like(braking.position)), True
        elif role is Role.VELOCITY:
            values, ended = braking.velocity_at(elapsed), elapsed >= braking.time
        else:
            values, ended = braking.position_at(elapsed), elapsed >= braking.time
        if ended:
            self._braking, self._at_rest, self._chase = None, True, None
            self.held = role, values
            self._recent.clear()
        return values

    def _catch_up(self, role: Role, now: float) -> None:
        """Go on towards the setpoint that was ahead when its controller became active."""
        if self._chase is None or now - self._chased < 0.8 * self._period:
            return
        step = self._fastest * self._period
        reached = vector(self._chase + np.clip(self._target - self._chase, -step, step))
        self._chased = now
        self._chase = None if (reached == self._target).all() else reached
        self._recent.append((now, reached))
        self._due = deque(((role, reached),))

"""Guard conditions, clocks and timers of rclpy, in a world."""

from __future__ import annotations

from typing import Any

from typing_extensions import override

from crtk_drivers.testing.world.machine.kernel import NotSimulated, here
from crtk_drivers.testing.world.middleware import rclpy_handles
from crtk_drivers.testing.world.middleware.dds import wall_ns
from crtk_drivers.testing.world.middleware.rclpy_handles import Context, Handle


class GuardCondition(Handle):
    """A flag that an executor waits for."""

    def __init__(self, _context: Context) -> None:
        super().__init__()
        self.is_triggered = False

    @property
    @override
    def ready(self) -> bool:
        """Whether it was triggered, and nobody has seen that."""
        return self.is_triggered

    def trigger_guard_condition(self) -> None:
        """As rclpy."""
        self.is_triggered = True
        self.changed()


class Clock(Handle):
    """A clock of ROS, which is the wall clock, or the monotonic one."""

    def __init__(self, kind: Any) -> None:
        super().__init__()
        self._kind = rclpy_handles.compiled.ClockType(int(kind))

    @property
    def now(self) -> int:
        """Its time, in ns; looking takes none."""
        is_steady = self._kind == rclpy_handles.compiled.ClockType.STEADY_TIME
        return here().now if is_steady else wall_ns()

    def get_now(self) -> Any:
        """As rclpy."""
        here().read_clock()
        now = self.now
        return rclpy_handles.compiled.rcl_time_point_t(now, self._kind)

    def get_ros_time_override_is_enabled(self) -> bool:
        """As rclpy: no simulator of ROS sets the time of a world."""
        return False

    def set_ros_time_override_is_enabled(self, enabled: bool) -> None:
        """Refuse a time that ROS tells.

        Raises:
            NotSimulated: it is asked for.
        """
        if enabled:
            raise NotSimulated("use_sim_time")

    def set_ros_time_override(self, _: Any) -> None:
        """As rclpy, for a clock that nobody overrides."""

    def add_clock_callback(self, *_: object) -> None:
        """As rclpy, for a clock that never jumps."""

    def remove_clock_callback(self, *_: object) -> None:
        """As rclpy, for a clock that never jumps."""


class Timer(Handle):
    """A timer. Its clock may be set: one of ROS is the wall clock."""

    def __init__(
        self, clock: Clock, _context: Context, period_ns: int, autostart: bool = True
    ) -> None:
        super().__init__()
        self._clock = clock
        self._period = period_ns
        self._is_canceled = not autostart
        self._called = clock.now
        self.due = self._called + period_ns

    @property
    @override
    def ready(self) -> bool:
        """Whether it is to be called."""
        return not self._is_canceled and self._clock.now >= self.due

    @property
    def wakes_at(self) -> int | None:
        """When it is to be called, ns; None: never."""
        return None if self._is_canceled else here().now + self.due - self._clock.now

    def is_timer_ready(self) -> bool:
        """As rclpy."""
        return self.ready

    def call_timer(self) -> None:
        """As rclpy: the next call is due a period later, or on the first of its grid that is to come."""
        now = self._clock.now
        self._called = now
        self.due += self._period
        if self.due < now and self._period:
            self.due += -(-(now - self.due) // self._period) * self._period

    def cancel_timer(self) -> None:
        """As rclpy."""
        self._is_canceled = True

    def is_timer_canceled(self) -> bool:
        """As rclpy."""
        return self._is_canceled

    def reset_timer(self) -> None:
        """As rclpy."""
        self._is_canceled = False
        self.due = self._clock.now + self._period
        self.changed()

    def get_timer_period(self) -> int:
        """As rclpy."""
        return self._period

    def change_timer_period(self, period_ns: int) -> None:
        """As rclpy."""
        self._period = period_ns

    def time_since_last_call(self) -> int:
        """As rclpy."""
        return self._clock.now - self._called

    def time_until_next_call(self) -> int | None:
        """As rclpy."""
        return None if self._is_canceled else self.due - self._clock.now

"""The gantry of `rigs.student_device` without ROS: where it is, where it goes, its state, and its faults."""

from __future__ import annotations

import math
import time
from collections.abc import Collection

JOINTS = ("x", "y", "z")
PLACE = (0.01, -0.02, 0.03)
RANGE = 0.5
SPEED = 0.25
"""m/s of its moves."""
SERVO_SPEED = 0.8
"""m/s at which the setpoint goes to what is commanded."""
FOLLOWING = 8.0
"""1/s: how fast an interpolated goal is approached."""
STREAM_TIMEOUT = 0.3
LATE_STOP = 1.2
DWELL = 0.15
"""s after a position in which no velocity is taken."""
READY_AFTER = 0.4
HOMING = 0.4
EPSILON = 1e-9
LONG = 0.09
SHORT = 0.01

Vector = list[float]


class Gantry:
    """The device without ROS: where it is, where it goes, and its state."""

    def __init__(self, faults: Collection[str]) -> None:
        self.faults = faults
        self.state = "FAULT" if "fault_resumes" in faults else "DISABLED"
        self.is_busy = False
        self.gripper = [0.02]
        self.is_homed = True
        self.homed_at = math.inf
        self.wanted: list[Vector] = []
        self.approached: Vector | None = None
        self.approached_at = -math.inf
        self.effort: Vector | None = None
        self.ratio = 1.0
        self.enabled_at = -math.inf
        self.measured = list(PLACE)
        self.setpoint = list(self.measured)
        self.rate = [0.0, 0.0, 0.0]
        self.velocity: Vector | None = None
        self.goal: Vector | None = None
        self.stream_until = 0.0
        self.changed = True
        self.is_refused = False
        self.falls_short = False
        self.is_free = False
        self.served, self.serves = 0.0, False

    def command(self, word: str) -> None:
        """Follow a state command."""
        if "any_case" in self.faults:
            word = word.strip().lower()
        if word in ("home", "unhome"):
            self._home(word)
            return
        table = {
            ("DISABLED", "enable"): "ENABLED",
            ("ENABLED", "disable"): "DISABLED",
            ("ENABLED", "pause"): "PAUSED",
            ("PAUSED", "resume"): "ENABLED",
            ("PAUSED", "disable"): "DISABLED",
            ("FAULT", "enable"): "ENABLED",
            ("FAULT", "disable"): "DISABLED",
        }
        if "never_enabled" in self.faults:
            del table["DISABLED", "enable"]
        if "resume_enables" in self.faults:
            table["DISABLED", "resume"] = "ENABLED"
        if "resume_disables" in self.faults:
            table["ENABLED", "resume"] = "DISABLED"
        if "enable_out_of_paused" in self.faults:
            table["PAUSED", "enable"] = "ENABLED"
        if "resume_faults" in self.faults:
            table["DISABLED", "resume"] = "FAULT"
        if "fault_resumes" in self.faults:
            table["FAULT", "resume"] = "ENABLED"
        after = table.get((self.state, word))
        if after is None:
            self.is_refused = "silent_states" not in self.faults
            return
        if after == "ENABLED":
            self.setpoint, self.enabled_at = list(self.measured), time.monotonic()
            if "enable_moves" in self.faults:
                self.setpoint[0] += 0.01
            if "enabled_where_it_was" in self.faults:
                self.setpoint = list(PLACE)
        elif "disable_goes_on" not in self.faults:
            self.stop()
        self.state, self.changed = after, True

    def _home(self, word: str) -> None:
        """Follow a command that it takes in ENABLED only."""
        self.is_refused = self.state != "ENABLED"
        if self.is_refused or f"ignores_{word}" in self.faults:
            return
        if word == "unhome":
            self.is_homed, self.changed = False, True
            return
        self.homed_at, self.serves = time.monotonic() + HOMING, False
        if "homes_idle" not in self.faults:
            self.set_busy(True)

    def go_on_homing(self) -> None:
        """Be homed, once that is done."""
        if time.monotonic() > self.homed_at:
            self.homed_at, self.is_homed, self.changed = math.inf, True, True
            self.set_busy("busy_after_home" in self.faults)

    def stop(self) -> None:
        self.clear()
        self.setpoint = list(self.measured)
        if "busy_after_hold" not in self.faults:
            self.set_busy(False)

    def let_go(self) -> None:
        """Hold nothing until the next command."""
        if self.accepts and "holds_in_free" not in self.faults:
            self.clear()
            self.is_free = True

    def push(self, joint: int, by: float) -> None:
        """Move it by hand; one that holds goes back."""
        self.measured[joint] += by
        if self.is_free or self.state == "DISABLED":
            self.setpoint[joint] += by

    def clear(self) -> None:
        """Forget what it goes to."""
        self.is_free = False
        self.goal = self.velocity = self.approached = self.effort = None
        self.wanted.clear()

    def set_busy(self, busy: bool) -> None:
        if busy is not self.is_busy:
            self.is_busy, self.changed = busy, True

    @property
    def accepts(self) -> bool:
        if "late_enabled" in self.faults and time.monotonic() < self.enabled_at + READY_AFTER:
            return False
        return self.state == "ENABLED" or "moves_disabled" in self.faults

    def open_gripper(self, values: Vector) -> None:
        self.is_refused = len(values) != 1 or not (
            self.state == "ENABLED" or "gripper_in_disabled" in self.faults
        )
        if not self.is_refused:
            self.gripper = values

    def is_valid(self, values: Vector, relative: bool = False) -> bool:
        """Whether a command may be followed."""
        self.is_refused = not self._is_valid(values, relative)
        return not self.is_refused

    def _is_valid(self, values: Vector, relative: bool) -> bool:
        if len(values) != 3:
            if "any_size" not in self.faults or not values:
                return False
            values += self.setpoint[len(values) :]
            del values[3:]
        if not all(map(math.isfinite, values)):
            if "nan" not in self.faults:
                return False
            values[:] = [v if math.isfinite(v) else RANGE / 10 for v in values]
        reach = (
            values if not relative else [s + v for s, v in zip(self.setpoint, values, strict=True)]
        )
        return "no_range" in self.faults or all(abs(v) <= RANGE for v in reach)

    def servo(self, values: Vector) -> None:
        if self.accepts and self.is_valid(values):
            waiting = list(self.wanted) if "queues" in self.faults else []
            self.clear()
            self.set_busy("busy_servo" in self.faults)
            self.served, self.serves = time.monotonic(), True
            self.wanted = [*waiting, values]

    def servo_relative(self, values: Vector) -> None:
        if self.accepts and self.is_valid(values, relative=True):
            self.clear()
            start = self.measured if "adds_to_measured" in self.faults else self.setpoint
            self.setpoint = [s + v for s, v in zip(start, values, strict=True)]

    def servo_velocity(self, values: Vector) -> None:
        if self.accepts and len(values) == 3 and all(map(math.isfinite, values)):
            serves = self.wanted and time.monotonic() < self.served + DWELL
            if serves and "alternates" not in self.faults:
                self.is_refused = True
                return
            if "jumps_between" in self.faults and self.velocity is None:
                self.setpoint[-1] += 0.04
            self.clear()
            self.velocity = values
            late = LATE_STOP if "late_stop" in self.faults else 0.0
            self.stream_until = time.monotonic() + STREAM_TIMEOUT + late

    def servo_effort(self, values: Vector) -> None:
        if self.accepts and len(values) == 3 and all(map(math.isfinite, values)):
            self.clear()
            self.effort = values
            self.stream_until = time.monotonic() + STREAM_TIMEOUT

    def interpolate(self, values: Vector) -> None:
        if self.accepts and self.is_valid(values):
            now = time.monotonic()
            if "drops_goals" in self.faults and now - self.approached_at < 0.15:
                return
            self.clear()
            self.approached, self.approached_at = values, now

    def move(self, values: Vector, relative: bool = False) -> bool:
        """Return whether the goal is accepted."""
        if not self.accepts or not self.is_valid(values, relative):
            return False
        if self.goal is not None and "not_pre_emptive" in self.faults:
            return False
        start = self.measured if "adds_to_measured" in self.faults else self.setpoint
        self.clear()
        self.goal = [s + v for s, v in zip(start, values, strict=True)] if relative else values
        length = math.dist(self.goal, self.setpoint)
        self.serves = False
        self.falls_short = "short_move" in self.faults and length > LONG
        self.set_busy("never_busy" not in self.faults)
        return True

    def step(self, now: float, seconds: float) -> None:
        """Go on for some time."""
        self.go_on_homing()
        if "busy_servo" in self.faults and self.serves and now - self.served > STREAM_TIMEOUT:
            self.serves = False
            self.set_busy(False)
        sign = -1.0 if "velocity_sign" in self.faults else 1.0
        if self.velocity is not None:
            if now > self.stream_until and "stream_goes_on" not in self.faults:
                self.velocity = None
                self.setpoint = list(self.measured)
            else:
                self.setpoint = [
                    max(-RANGE, min(RANGE, s + sign * v * seconds))
                    for s, v in zip(self.setpoint, self.velocity, strict=True)
                ]
        elif self.effort is not None:
            if now > self.stream_until:
                self.effort = None
        elif self.approached is not None:
            rate = 5.0 * FOLLOWING if "drops_goals" in self.faults else FOLLOWING
            share = 1.0 - math.exp(-rate * seconds)
            self.setpoint = [
                s + share * (g - s) for s, g in zip(self.setpoint, self.approached, strict=True)
            ]
        elif self.wanted:
            goal = self.wanted.pop(0) if len(self.wanted) > 1 else self.wanted[0]
            most = math.inf if "any_step" in self.faults else SERVO_SPEED * seconds
            self.setpoint = [
                s + max(-most, min(most, g - s)) for s, g in zip(self.setpoint, goal, strict=True)
            ]
        elif self.goal is not None:
            way = [g - s for g, s in zip(self.goal, self.setpoint, strict=True)]
            length = math.hypot(*way)
            if self.falls_short and length < SHORT:
                way, length = [0.0, 0.0, 0.0], 0.0
            share = 1.0 if length < EPSILON else min(1.0, self.ratio * SPEED * seconds / length)
            self.setpoint = [s + share * w for s, w in zip(self.setpoint, way, strict=True)]
            if share == 1.0:
                self.goal = None
                self.set_busy(False)
        follow = min(1.0, 30.0 * seconds)
        moved = [follow * (s - m) for s, m in zip(self.setpoint, self.measured, strict=True)]
        self.rate = [m / seconds for m in moved]
        self.measured = [m + d for m, d in zip(self.measured, moved, strict=True)]

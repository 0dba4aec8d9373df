"""The promises of every driver, judged by the simulator's own truth: one class for each.

A judge looks every 2 ms while nothing else runs. It returns what is wrong, in words. Every bound comes from
what the device declares; what a judge adds for its own looks is a constant here.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar, Final

import numpy as np
from typing_extensions import override

from crtk_drivers.engine import Engine
from crtk_drivers.engine.threads import STALL_LIMIT, WATCHDOG_PERIOD
from crtk_drivers.samples import JointState
from crtk_drivers.state import StateCommand
from crtk_drivers.testing.world.machine.kernel import EPOCH, NS, Task
from crtk_drivers.testing.world.promises.subject import PERIOD, Scene, Setting

_LOOKS: Final = 0.2
"""s that it may take until a change shows: a speed is measured over 20 ms, and cycles take time."""
SETTLED: Final = 0.7
"""s after a process stood still in which samples are old for good reason."""
_STANDS: Final = 0.4
"""s after which nothing that was sent before is on its way."""
_KEPT: Final = 0.05
"""s of setpoints that a driver sends before it knows that nothing is heard of its device."""
_OVERSPEED: Final = 1.25
_LONG: Final = 100
"""Looks over which a simulator that was held up has caught up."""
CLOCKS: Final = 0.001
"""s by which the two clocks of a stamp, read one after the other, may differ."""
_HELD: Final = NS // 5
"""ns in which a thread that stood still counts as disturbed."""


class Judge(ABC):
    """Looks after one promise.

    Attributes:
        kind: of the finding.
        promise: in words.
    """

    kind: ClassVar[str]
    promise: ClassVar[str]
    outlives: ClassVar[bool] = False
    """Whether it still looks when the driver's process is gone."""

    @abstractmethod
    def look(self, scene: Scene) -> str | None:
        """Return what is wrong, if anything is."""


class Unasked(Judge):
    """Before anyone has enabled the device."""

    kind = "moves unasked"
    promise = "Nothing moves because of a connection or a start."

    def __init__(self) -> None:
        self._is_asked = False
        self._engine: Engine | None = None

    @override
    def look(self, scene: Scene) -> str | None:
        engine = scene.engine
        if engine is not self._engine:
            self._is_asked, self._engine = False, engine  # connected again
        self._is_asked = self._is_asked or (
            engine is not None
            and (
                engine.status.state == "ENABLED"
                or not engine.transition_ended
                or scene.served == scene.now
            )
        )
        if not self._is_asked and scene.is_moving:
            return f"it moves with {scene.speed:.3g}, and nobody has enabled it"
        return None


class Rests(Judge):
    """Once the device is not ENABLED any more."""

    kind = "moves when not enabled"
    promise = "A device that is not ENABLED stands within its declared time."

    @override
    def look(self, scene: Scene) -> str | None:
        engine = scene.engine
        if engine is None or scene.closed is not None or not scene.is_moving:
            return None
        allowed = _declared(scene, engine)
        moved = max(scene.enabled, scene.served)
        if engine.capabilities.enable_moves and not engine.transition_ended:
            moved = scene.now
        if not _is_over(scene, max(moved, scene.disturbed), allowed):
            return None
        status = engine.status
        return (
            f"it moves with {scene.speed:.3g}, and is {status.state} ({status.cause}) for "
            f"{scene.now - scene.enabled:.3f} s; {allowed:.3f} s are declared"
        )


class Asked(Judge):
    """From the end of what somebody has asked for, to the next."""

    kind = "moves though nobody asks"
    promise = "Nothing moves but what somebody has asked for, and that ends."

    def __init__(self) -> None:
        self._stood_since = math.inf
        self._rests = False

    @override
    def look(self, scene: Scene) -> str | None:
        engine = scene.engine
        if engine is None or scene.closing is not None:
            return None
        is_moving = scene.is_moving
        if not engine.transition_ended:
            scene.asked = max(scene.asked, scene.now)
            is_homing = engine._transitions.running is StateCommand.HOME  # noqa: SLF001
            self._rests &= not (is_moving and (is_homing or engine.capabilities.enable_moves))
        elif scene.is_asked:
            self._rests, self._stood_since = False, math.inf
        if not is_moving:
            self._stood_since = min(self._stood_since, scene.now)
            since = max(self._stood_since, scene.asked, scene.hindered)
            is_still = engine._stopping.confirmed and scene.now > since + _STANDS  # noqa: SLF001
            self._rests |= is_still
            return None
        self._stood_since = math.inf
        if self._rests:
            return f"it stood, and moves with {scene.speed:.3g}; {self._told(scene)}"
        stop = engine.capabilities.stop
        allowed = stop.time + _LOOKS + _STANDS
        if engine.status.state != "ENABLED":
            allowed += stop.link_timeout
        if scene.now > max(scene.asked, scene.hindered) + allowed:
            return f"it moves still with {scene.speed:.3g}; {self._told(scene)}"
        return None

    @staticmethod
    def _told(scene: Scene) -> str:
        return f"the last motion was asked for until {scene.now - scene.asked:.3f} s ago"


class Limits(Judge):
    """While the driver is there."""

    kind = "beyond its limits"
    promise = "No joint is sent out of its range, or faster than it may be."

    @override
    def look(self, scene: Scene) -> str | None:
        engine = scene.engine
        if engine is None:
            return None
        fast = max(limit.velocity for limit in engine.capabilities.limits)
        speed = scene.speed_over(_LONG)
        if speed > _OVERSPEED * fast + scene.still:
            return f"it moves with {speed:.3g}, and {fast:.3g} are allowed: {scene.recent(_LONG)}"
        if scene.from_rest is not None and (text := _tool_too_fast(scene, engine)):
            return text
        if not (engine.status.is_homed and engine.transition_ended):
            return None  # nobody knows yet where its range is
        within = scene.arrival
        for limit, joint in zip(engine.capabilities.limits, scene.joints, strict=True):
            if not limit.lower - within <= joint <= limit.upper + within:
                return (
                    f"a joint is at {joint:.4g}, and goes from {limit.lower:g} to {limit.upper:g}"
                )
        return None


def _tool_too_fast(scene: Scene, engine: Engine) -> str:
    """Return what to say of a tool that is faster than it may be, where nothing but that was commanded."""
    limits = engine.capabilities.cartesian_limits
    if limits is None or scene.from_rest is None:
        return ""
    seconds, before, last = scene.over(_LONG)
    if seconds <= 0.0 or scene.now - seconds < scene.from_rest or not scene.is_asked:
        return ""
    forward = engine._context.inverse.kinematics.forward  # noqa: SLF001
    way = forward(np.array(last)).position - forward(np.array(before)).position
    speed = float(np.linalg.norm(way)) / seconds
    if speed <= _OVERSPEED * limits.linear_velocity:
        return ""
    return f"the tool moves with {speed:.3g} m/s, and {limits.linear_velocity:.3g} are allowed"


class Freed(Judge):
    """While the arm may be moved by hand."""

    kind = "free though nobody asks"
    promise = "An arm is let go only where somebody has asked for it, and until a stop or a motion."

    @override
    def look(self, scene: Scene) -> str | None:
        since = max(scene.let_go, scene.hindered)
        if scene.closing is not None or not scene.is_free or scene.now <= since + _STANDS:
            return None
        when = f"until {scene.now - scene.let_go:.3f} s ago" if scene.let_go > 0.0 else "never"
        return f"it is free, and that was asked for {when}"


class AfterDeath(Judge):
    """Once the driver's process is gone."""

    kind = "moves after its driver died"
    outlives = True
    promise = "A driver that dies leaves no motion behind, after the declared time."

    @override
    def look(self, scene: Scene) -> str | None:
        engine = scene.engine
        if engine is None or scene.died is None or not scene.is_moving:
            return None
        allowed = _declared(scene, engine)
        if not _is_over(scene, max(scene.died, scene.disturbed), allowed):
            return None
        return (
            f"it moves with {scene.speed:.3g}, {scene.now - scene.died:.3f} s after its driver died; "
            f"{allowed:.3f} s are declared"
        )


class AfterClose(Judge):
    """Once `close` has returned."""

    kind = "moves after close"
    promise = "A driver that was closed without a complaint leaves the device standing."

    @override
    def look(self, scene: Scene) -> str | None:
        if scene.closed is None or scene.now < scene.closed + 0.05 or not scene.is_moving:
            return None
        return f"it moves with {scene.speed:.3g}, {scene.now - scene.closed:.3f} s after close"


class StopBelieved(Judge):
    """From the time that a stop was asked for."""

    kind = "a stop is believed too early"
    promise = "A stop counts only once the device has come to stand."

    def __init__(self) -> None:
        self._waits = self._stood = False

    @override
    def look(self, scene: Scene) -> str | None:
        if scene.engine is None:
            return None
        if not scene.stop_counts:
            self._waits = False
            return None
        if not self._waits:
            # What is measured may be older than its stamp, and then show how it stood before.
            self._waits, self._stood = True, scene.stood_within(scene.subject.early)
        self._stood = self._stood or scene.stands_now
        is_believed = scene.engine._stopping.confirmed  # noqa: SLF001 - a judge looks where nobody else may
        if not is_believed:
            return None
        self._waits = scene.stop_counts = False
        return (
            None
            if self._stood
            else (f"a stop is believed, and it has not stood since: {scene.recent(12)}")
        )


class Fresh(Judge):
    """While the device is ENABLED, and until it is to be closed."""

    kind = "enabled with an old sample"
    promise = "A device whose samples have stopped coming is in FAULT within its declared time."

    def __init__(self) -> None:
        self._last = math.inf  # when a sample was valid last

    @override
    def look(self, scene: Setting) -> str | None:
        engine, now = scene.engine, scene.now
        is_judged = engine is not None and scene.closing is None and not _is_held_up(scene)
        if engine is None or not is_judged or engine.status.state != "ENABLED":
            self._last = now
            return None
        age = engine._feedback.sample_age(now)  # noqa: SLF001
        if age < math.inf:
            self._last = now
        else:
            age = now - self._last  # it was lost a moment ago, and FAULT is about to be announced
        age = max(age, now - scene.silent)  # whatever the driver believes
        if age <= engine.options.sample_timeout + _LOOKS + 0.05:
            return None
        return (
            f"ENABLED with a sample of {age:.3f} s; {engine.options.sample_timeout:g} s are allowed"
        )


class Stamped(Judge):
    """Whenever a position is published as valid."""

    kind = "a stamp is wrong"
    promise = "A position was where its stamp says it was; stale data is never stamped fresh."

    def __init__(self) -> None:
        self._offset, self._set_at = 0, -math.inf

    @override
    def look(self, scene: Scene) -> str | None:
        engine, kernel = scene.engine, scene.world.kernel
        if kernel.wall_offset != self._offset:
            self._offset, self._set_at = kernel.wall_offset, scene.now
        found = None if engine is None or _is_disturbed(scene) else engine.feedback("measured_js")
        if engine is None or found is None:
            return None
        value, stamp = found
        if not (isinstance(value, JointState) and stamp.wall_ns):
            return None
        position, at = value.position.tolist(), stamp.monotonic
        if not all(map(math.isfinite, [*position, *value.velocity, *value.effort])):
            return f"measured_js is {value}, and published as valid"
        if scene.now - at > engine.stale_after + CLOCKS:
            return f"measured_js is valid, and {scene.now - at:.4f} s old"
        wall = (stamp.wall_ns - EPOCH - self._offset) / NS
        was_set = scene.now < self._set_at + SETTLED
        if at > scene.now + CLOCKS or not (was_set or abs(wall - at) < CLOCKS):
            return f"the stamp is {stamp}, of two moments or to come"
        begin, end = at - scene.subject.early - PERIOD, min(scene.now, at + scene.subject.late)
        if scene.was_at(position, begin, end, scene.subject.error):
            return None
        return (
            f"measured_js is {position}, stamped {scene.now - at:.4f} s ago, and was not there then; "
            f"{scene.recent(12)}"
        )


class Stuck(Judge):
    """While an I/O thread stands still."""

    kind = "a stuck thread is no fault"
    promise = (
        "An I/O thread that is stuck puts the device in FAULT within one period of the watchdog."
    )

    def __init__(self) -> None:
        self._since: dict[tuple[int, int], float] = {}

    @override
    def look(self, scene: Setting) -> str | None:
        engine, kernel = scene.engine, scene.world.kernel
        if engine is None or any(
            _was_frozen(task, kernel.now) for task in _named(scene, "watchdog")
        ):
            return None
        allowed = STALL_LIMIT + 2.0 / engine.capabilities.rate + 2.0 * WATCHDOG_PERIOD + 0.05
        for task in _named(scene, "io "):
            if task.frozen_until <= kernel.now or task.ended:
                continue
            since = self._since.setdefault((task.number, task.frozen_until), scene.now)
            is_late = scene.now > max(since, scene.disturbed) + allowed
            if is_late and engine.connected and engine.status.state != "FAULT":
                return f"{task} stands still for {scene.now - since:.3f} s, and it is {engine.status.state}"
        return None


def _declared(scene: Scene, engine: Engine) -> float:
    """Return the s within which the device stands without its driver, and a judge sees that."""
    stop = engine.capabilities.stop
    return stop.time + stop.link_timeout + _LOOKS


def _is_over(scene: Scene, since: float, allowed: float) -> bool:
    """Return whether a device had its time to stand since it should.

    Later it moves only by the last setpoints that TCP kept while the network was blocked, and no farther than
    these lead: a driver sends none once it hears nothing.
    """
    if scene.now <= since + allowed:
        return False
    assert scene.engine is not None
    capabilities = scene.engine.capabilities
    quickest = max(limit.acceleration for limit in capabilities.limits)
    fast = scene.pace_when_blocked + quickest * _KEPT
    is_led = scene.moved_since_freed <= (_KEPT + scene.subject.lasts) * fast
    return not (is_led and scene.now <= scene.freed + capabilities.stop.time + _LOOKS)


def _named(scene: Setting, begin: str) -> list[Task]:
    return [task for task in scene.world.kernel.tasks if task.name.startswith(begin)]


def _was_frozen(task: Task, now: int) -> bool:
    return task.frozen_until > now - _HELD


def _is_disturbed(scene: Setting) -> bool:
    """Return whether a process or an I/O thread stood still a moment ago."""
    return scene.now < scene.disturbed + SETTLED or _is_held_up(scene)


def _is_held_up(scene: Setting) -> bool:
    """Return whether the driver's process, or an I/O thread of it, stood still a moment ago."""
    driver, now = scene.driver, scene.world.kernel.now
    return (driver is not None and driver.frozen_until > now - round(SETTLED * NS)) or any(
        _was_frozen(task, now) for task in _named(scene, "io ")
    )


JUDGES: Final = (
    Unasked,
    Rests,
    Asked,
    Limits,
    Freed,
    AfterDeath,
    AfterClose,
    StopBelieved,
    Fresh,
    Stamped,
    Stuck,
)
"""All of them."""


def judge(scene: Scene, kinds: Sequence[type[Judge]] = JUDGES) -> None:
    """Let judges look at a scene from now on; all, if they are not named."""
    judges = [each() for each in kinds]
    find = scene.world.find

    def look() -> None:
        scene.look()
        for each in judges:
            if scene.died is not None and not each.outlives:
                continue
            if text := each.look(scene):
                find(each.kind, text)
                return

    scene.world.every(PERIOD, look)

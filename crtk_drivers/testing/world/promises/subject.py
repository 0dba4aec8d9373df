"""A device under test: its driver, its simulator, and where its joints really are.

Scene    a device with joints, in a world
Setting  what a device of any kind has there
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Final, Protocol

from typing_extensions import override

from crtk_drivers import plugins
from crtk_drivers.engine import Engine
from crtk_drivers.front import LocalDevice, connect
from crtk_drivers.motion.stopping import still_speeds
from crtk_drivers.samples import Stamp
from crtk_drivers.session import start_sim_of
from crtk_drivers.state import OperatingState, Status
from crtk_drivers.status.board import Observer
from crtk_drivers.testing.world.machine.kernel import NS, Process
from crtk_drivers.testing.world.troubles import LATENESS
from crtk_drivers.testing.world.world import World

PERIOD: Final = 0.002
"""s between two looks at the joints."""
_SPEED_OVER: Final = 10
"""Looks over which a speed is measured."""
_PACE_OVER: Final = 100
"""Looks before the network is blocked over which it counts how fast a joint was."""
_REMEMBERED: Final = 2000
_UNDISTURBED: Final = 0.05
"""s after which a process that stood still has caught up."""
_ON_ITS_WAY: Final = max(LATENESS)
"""s that a packet is on its way at most, in bad weather."""
_PATIENCE: Final = 20.0
_STILL: Final = 0.01
"""rad/s (m/s) below which a joint stands, before the driver has said so."""
_MARGIN: Final = 1.2
"""How much faster a joint may really be than a driver measures that it stands."""


@dataclass(frozen=True, kw_only=True)
class Installed:
    """A driver and its simulator, as a user sets them up.

    Attributes:
        device: name of the driver's plugin.
        config: of the driver.
        sim_options: of the simulator, over those that suit the configuration.
    """

    device: str
    config: Mapping[str, Any] = field(default_factory=dict)
    sim_options: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Subject(Installed):
    """A device with joints, and what is true of it in its simulator.

    Attributes:
        truth: returns where the joints are, in rad (m), from the simulator's server object.
        arrival: rad (m) within which a move has reached its goal; None: as the driver declares.
        error: rad (m) by which a measured position may be off, its resolution and noise.
        early: s before its stamp at which a position may have been measured, by the device's documentation.
        late: s after its stamp at which it may have been.
        period: s between two steps of the simulator's model, if they are longer than `PERIOD`.
        lasts: s for which the hardware goes on with the last command that it got, if nobody stops it.
        step: rad (m) of the longest move.
        velocity: rad/s (m/s) of the fastest stream.
        effort: share of a joint's effort limit that a stream of efforts has at most.
        without: services that are not asked for: what they end does not come back by itself.
    """

    truth: Callable[[Any], Sequence[float]]
    arrival: float | None = None
    error: float
    early: float = 0.006
    late: float = math.inf
    period: float = PERIOD
    lasts: float = 0.0
    step: float
    velocity: float
    effort: float = 0.1
    without: Collection[str] = ()


class Busy(Protocol):
    """What may move the device until it has ended."""

    def is_busy(self) -> bool:
        """Whether it has not ended yet."""


class Setting:
    """A device in a world: the simulator runs, a driver connects, and who stands still is known.

    Args:
        world: in which it is.
        installed: what is tested.

    Attributes:
        arm: the driver, once it is connected.
        closing: when the driver began to be closed (s); None before.
        closed: when it was closed without a complaint; None before.
        died: when its process was killed; None before.
        disturbed: when a process stood still last.
        hindered: when last a process or an I/O thread stood still, or the network let nothing pass.
        silent: since when nothing new can have come: the simulator stands still, and the network has let pass
            what was on its way; infinite while something can.
        driver: the process of the driver; None before it begins.
        simulators: the processes of its simulator.
    """

    def __init__(self, world: World, installed: Installed) -> None:
        self.world = world
        self._device = installed.device
        before = list(world.kernel.processes)
        plugin = plugins.device(installed.device)
        config = plugin.load_config(None, dict(installed.config))
        self.sim = start_sim_of(plugin, config, installed.sim_options)
        assert plugin.sim is not None
        simulator: Any = plugins.simulator(plugin.sim)
        self._server = simulator.serving[-1]
        self.simulators = [each for each in world.kernel.processes if each not in before]
        self._pointed = plugin.sim_config(config, self.sim).model_dump(exclude_unset=True)
        self.arm: LocalDevice | None = None
        self.closing: float | None = None
        self.closed: float | None = None
        self.died: float | None = None
        self.disturbed = self.hindered = world.now
        self.silent = math.inf
        self.driver: Process | None = None

    def connect(self) -> LocalDevice:
        """Connect the driver, for the first time or again."""
        self.closing = self.closed = None
        arm = connect(self._device, config=self._pointed, timeout=_PATIENCE)
        self.arm = arm
        arm.engine.add_observer(_Announced(self.world, arm.operating_state()))
        return arm

    @property
    def engine(self) -> Engine | None:
        """Of the driver, once it is connected."""
        return None if self.arm is None else self.arm.engine

    @property
    def now(self) -> float:
        """Monotonic clock, s."""
        return self.world.now

    def look(self) -> None:
        """Look who stands still, and whether anything passes."""
        now, kernel = self.now, self.world.kernel
        if any(
            p.frozen_until >= kernel.now - _UNDISTURBED * NS for p in kernel.processes if p.alive
        ):
            self.disturbed = now
        held = any(task.frozen_until >= kernel.now for task in kernel.tasks if not task.ended)
        is_blocked = self.world.troubles.is_blocked
        if held or self.disturbed == now or is_blocked:
            self.hindered = now
        is_silent = not is_blocked and all(
            p.frozen_until > kernel.now or not p.alive for p in self.simulators
        )
        self.silent = min(self.silent, now + _ON_ITS_WAY) if is_silent else math.inf


class Scene(Setting):
    """A subject in a world: its joints are looked at all the time.

    Args:
        world: in which it is.
        subject: that is tested.

    Attributes:
        enabled: when it was ENABLED last.
        served: when a service that moves the device was being carried out last.
        let_go: until when somebody has asked that the arm may be moved by hand.
        from_rest: since when the tool alone is commanded, of a device that stood; None while it is not.
        still: rad/s (m/s) below which a joint stands, by what the driver declares.
        freed: when the network last let pass what it had held back, if the driver has sent anything by TCP.
        pace_when_blocked: rad/s (m/s) of the fastest joint before the network was last blocked, or meanwhile.
        stop_counts: whether a stop was begun, and no motion on purpose since.
        asked: until when somebody has asked for a motion.
    """

    def __init__(self, world: World, subject: Subject) -> None:
        super().__init__(world, subject)
        self.subject = subject
        self.still = _STILL
        self.enabled = self.asked = world.now
        self.freed = -math.inf
        self.pace_when_blocked = 0.0
        self._sends_by_tcp = False  # what was sent is delivered after a connection is closed, too
        self.stop_counts = False
        self.served = self.let_go = -math.inf
        self.from_rest: float | None = None
        self._moves: list[Busy] = []
        self._senders: Counter[Process] = Counter()
        self._looks: deque[tuple[float, tuple[float, ...]]] = deque(maxlen=_REMEMBERED)
        self._freed_at: tuple[float, ...] = ()  # where the joints were then
        self.look()

    @override
    def connect(self) -> LocalDevice:
        self.stop_counts = False
        arm = super().connect()
        stopping = arm.engine._stopping  # noqa: SLF001 - a judge looks where nobody else may
        plain_again, plain_stop = stopping.moves_again, stopping.stop

        def moves_again() -> None:
            self.stop_counts = False
            plain_again()

        def stop() -> None:
            try:
                plain_stop()
            finally:
                self.stop_counts = True  # once it is watched, and not before that

        stopping.moves_again = moves_again  # type: ignore[method-assign]
        stopping.stop = stop  # type: ignore[method-assign]
        speeds = still_speeds(arm.engine.capabilities, arm.engine.device.velocity_steps)
        self.still = _MARGIN * max(speeds, default=_STILL)
        return arm

    @property
    def arrival(self) -> float:
        """Within what a move has reached its goal, in rad (m)."""
        if self.subject.arrival is not None:
            return self.subject.arrival
        following = None if self.engine is None else self.engine.capabilities.following
        if following is None:
            raise ValueError(
                f"{self.subject.device}: it declares no arrival, so its subject gives one"
            )
        return max(following.arrival)

    # What was asked for

    @contextmanager
    def sending(self, *, silence: float = 0.0, by_tool: bool = False) -> Iterator[None]:
        """Send something within that may move the device.

        Args:
            silence: s for which a stream goes on after it.
            by_tool: whether it says where the tool is to be, or how fast.
        """
        process = self.world.kernel.process
        self._senders[process] += 1
        if not by_tool:
            self.from_rest = None
        elif self.from_rest is None and not self.is_moving:
            self.from_rest = self.now
        try:
            yield
        finally:
            self._senders[process] -= 1
            self.asked = max(self.asked, self.now + silence)

    def sent(self, move: Busy) -> None:
        """Remember a move, or what moves else: it is asked for as long as it has not ended."""
        self._moves.append(move)
        self.let_go = min(self.let_go, self.now)

    def sends_free(self, free: Callable[[], None]) -> None:
        """Ask by `free` that the arm may be moved by hand: it may move until a stop or a move.

        A stream ends that too, but not if its first setpoint is refused when it would be sent.
        """
        with self.sending():
            free()
        self.let_go = math.inf

    @property
    def is_free(self) -> bool:
        """Whether the driver lets the arm be moved by hand."""
        return self.engine is not None and self.engine._motion.is_free  # noqa: SLF001

    @contextmanager
    def stopping(self) -> Iterator[None]:
        """Send a stop within: where it is accepted, what was asked for before it is over."""
        before = list(self._moves)
        yield
        self._moves = [move for move in self._moves if move not in before]
        self.asked, self.let_go = min(self.asked, self.now), min(self.let_go, self.now)

    @property
    def is_asked(self) -> bool:
        """Whether somebody asks for a motion now: by a command that is being sent, a move or a stream."""
        self._moves = [move for move in self._moves if move.is_busy()]
        is_sending = any(count and each.alive for each, count in self._senders.items())
        if is_sending or self._moves or self.is_free:
            self.asked = max(self.asked, self.now)
        return self.asked >= self.now

    # The truth

    @override
    def look(self) -> None:
        """Look where the joints are, who is enabled, and who stands still."""
        super().look()
        now = self.now
        if self.sim.running:
            self._looks.append((now, tuple(self.subject.truth(self._server))))
        self._sends_by_tcp |= any(end.owner is self.driver for end in self.world.network.streams)
        if self.world.troubles.is_blocked and self._sends_by_tcp:
            before = self.pace_when_blocked if now - self.freed < 2.0 * PERIOD else 0.0
            self.pace_when_blocked = max(before, self.speed, self.speed_over(_PACE_OVER))
            self.freed, self._freed_at = now, self.joints
        if self.engine is not None and self.engine.status.state == "ENABLED":
            self.enabled = now
        if self.engine is not None and self.engine._requests.moves:  # noqa: SLF001
            self.served = now

    @property
    def joints(self) -> tuple[float, ...]:
        """Where they are, in rad (m)."""
        return self._looks[-1][1]

    @property
    def speed(self) -> float:
        """Of the fastest joint over the last 20 ms, in rad/s (m/s)."""
        return self.speed_over(_SPEED_OVER)

    def speed_over(self, looks: int) -> float:
        """Return the speed of the fastest joint over so many looks, in rad/s (m/s)."""
        seconds, before, last = self.over(looks)
        return _distance(last, before) / seconds if seconds > 0.0 else 0.0

    def over(self, looks: int) -> tuple[float, tuple[float, ...], tuple[float, ...]]:
        """Return the s that so many looks took, and where the joints were at their begin and end."""
        at, last = self._looks[-1]
        begin, before = self._looks[max(0, len(self._looks) - 1 - looks)]
        return at - begin, before, last

    @property
    def moved_since_freed(self) -> float:
        """How far the joints are from where they were when the network last let pass again, in rad (m)."""
        return _distance(self.joints, self._freed_at) if self._freed_at else 0.0

    @property
    def is_moving(self) -> bool:
        """Whether a joint moves, over the last 20 ms."""
        return self.speed > self.still

    @property
    def stands_now(self) -> bool:
        """Whether no joint has moved over the last step of the simulator."""
        return self.stood_within(0.0)

    def stood_within(self, seconds: float) -> bool:
        """Return whether no joint has moved over a step of the simulator, at any time in the last s."""
        looks, span = list(self._looks), max(1, round(self.subject.period / PERIOD))
        for last in range(len(looks) - 1, 0, -1):
            at, joints = looks[last]
            if at < self.now - seconds and last < len(looks) - 1:
                return False
            begin, before = looks[max(0, last - span)]
            if _distance(joints, before) <= (at - begin) * self.still:
                return True
        return len(looks) < 2

    def was_at(self, joints: Sequence[float], begin: float, end: float, within: float) -> bool:
        """Return whether the joints were somewhere between two times (s), or passed it between two looks.

        It is also true where nobody looked.
        """
        near = [found for at, found in self._looks if begin <= at <= end]
        if end >= self.now and self.sim.running:
            # A simulator that was held up goes a long way at once, and may have since the last look.
            near.append(tuple(self.subject.truth(self._server)))
        return not near or all(
            min(track) - within <= value <= max(track) + within
            for value, track in zip(joints, zip(*near, strict=True), strict=True)
        )

    def recent(self, count: int) -> str:
        """Return the last positions of the joint that has moved most, for people."""
        last = [joints for _, joints in self._looks][-count:]
        spans = [max(track) - min(track) for track in zip(*last, strict=True)]
        joint = spans.index(max(spans))
        return f"joint {joint}, every {1000 * PERIOD:g} ms: " + " ".join(
            f"{q[joint]:.5f}" for q in last
        )


class _Announced(Observer):
    """Adds each state that the driver announces to the story."""

    def __init__(self, world: World, status: Status) -> None:
        self._world = world
        self._last = ""
        self.status_changed(status)

    @override
    def status_changed(self, status: Status, stamp: Stamp | None = None) -> None:
        # Why it is in FAULT is logged, and in the story by that.
        why = f": {status.detail}" if status.detail and status.state != OperatingState.FAULT else ""
        if (text := f"is {status.state}{why}") != self._last:
            self._last = text
            self._world.say(text)


def _distance(one: Sequence[float], other: Sequence[float]) -> float:
    return max((abs(a - b) for a, b in zip(one, other, strict=True)), default=0.0)

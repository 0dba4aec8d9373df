"""What trials are made with: a probe that sends and hears, and what was found with it.

A trial commands the device; what comes of it is a `Trace`, and functions of traces say what that means.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Protocol, TypeVar

import numpy as np

from crtk_drivers.client.conformance.expectations import Expectations, JointRange
from crtk_drivers.client.conformance.findings import Finding, conforms, diverges, not_offered
from crtk_drivers.client.conformance.observed import (
    CartesianHeard,
    JointsHeard,
    Observation,
    Sent,
    StateHeard,
    Trace,
)
from crtk_drivers.commands import Command, Kind, Space

STREAM_RATE: Final = 50.0
"""Hz of the streams that are sent."""
NOISES: Final = 6.0
"""Standard deviations at rest that count as still."""
FRESH_TIME: Final = 1.5
"""Seconds in which feedback and a heartbeat come."""
STANDS_FOR: Final = 0.1
"""Seconds without motion after which a joint stands."""
LARGEST_SHARE: Final = 0.1
"""Of a range that is known: no trial goes further."""

Numbers = Sequence[float]
_Thing = TypeVar("_Thing")


class Probe(Protocol):
    """The far end of a device."""

    def now(self) -> float:
        """Return monotonic s."""

    def state(self) -> StateHeard | None:
        """Return the newest operating state."""

    def joints(self, name: str) -> JointsHeard | None:
        """Return the newest joint values of a name."""

    def cartesian(self, name: str) -> CartesianHeard | None:
        """Return the newest pose, twist or wrench of a name."""

    def number(self, name: str) -> float | None:
        """Return the newest value of a setting."""

    def send(
        self,
        name: str,
        numbers: Numbers = (),
        *,
        text: str = "",
        names: Sequence[str] = (),
        frame: str = "",
        stamped: bool = True,
        second: bool = False,
    ) -> Sent:
        """Send a command: its positions, velocities or efforts, as its name says.

        Args:
            name: of the command.
            numbers, text: of it.
            names: of the joints.
            frame: of the header.
            stamped: with the time of now.
            second: as another client.
        """

    def sleep(self, seconds: float) -> None:
        """Let time pass."""

    def wait(self, condition: Callable[[], bool], timeout: float) -> bool:
        """Wait until what is heard fulfils a condition; return whether it does."""

    def trace(self, began: float) -> Trace:
        """Return what was heard and sent since then."""

    def forget(self) -> None:
        """Forget what was heard."""

    def lateness(self) -> float:
        """Return how late it woke up, in s, in one of twenty cases since this was asked last."""


class Stopped(Exception):
    """The device moved where it must not, or cannot be brought to where trials begin."""


@dataclass(frozen=True)
class Leave:
    """What may be done with a device beside small motions.

    Attributes:
        may_home: it may be told to home, which moves it as it likes.
        ask: tells somebody beside the device what to do with it; None: nobody is there.
    """

    may_home: bool = False
    ask: Callable[[str], None] | None = None


NO_LEAVE: Final = Leave()


@dataclass(frozen=True)
class Opening:
    """What a client is to do with a device: enable, home, read, move to a goal, and back.

    Attributes:
        goal, begin: joint positions (n,).
        timeout: s that it gives each.
        home_time: s that it gives to home.
        arrival: rad or m within which a goal is reached.
    """

    goal: tuple[float, ...]
    begin: tuple[float, ...]
    timeout: float
    home_time: float
    arrival: float


@dataclass(frozen=True)
class Told:
    """How that went.

    Attributes:
        is_official: it was the official client.
        done: what worked, in its order.
        failed: what did not, in words; empty if all did.
    """

    is_official: bool
    done: tuple[str, ...]
    failed: str


class Trial:
    """A probe, what is expected, and what was found.

    Attributes:
        leave: what may be done with it beside small motions.
        needs_homing: as its manifest says; None: it says nothing.
        client: does an `Opening` with the official client, or what stands in for it; None: nothing does.
        found: findings by clause.
    """

    def __init__(
        self,
        probe: Probe,
        expected: Expectations,
        rest: Observation,
        leave: Leave = NO_LEAVE,
        client: Callable[[Opening], Told] | None = None,
    ) -> None:
        self.probe = probe
        self.leave = leave
        self.client = client
        self.needs_homing = rest.manifest.get("homing")
        self.expected = expected
        self.topics: Mapping[str, Command] = rest.graph.offered()
        self.commands: Mapping[str, Command] = {
            name: row for name, row in self.topics.items() if "/" not in name
        }
        self.found: dict[str, list[Finding]] = defaultdict(list)
        self.still = max(expected.still, NOISES * _noise(rest.trace))
        self.ranges = expected.ranges or _declared(rest.manifest)
        self.stream_stop = expected.stream_stop or _declared_stop(rest.manifest)
        self.frame = next((e.frame for e in rest.trace.cartesian.get("measured_cp", ())), "")

    def note(self, clause: str, finding: Finding) -> None:
        """Keep a finding."""
        self.found[clause].append(finding)

    def offers(self, *names: str) -> bool:
        """Whether the device has all of these."""
        return all(name in self.commands for name in names)

    def judge(self, clause: str, is_so: bool, told: str, otherwise: str = "") -> None:
        """Keep that it is as CRTK asks, or that it is not, in words that may differ."""
        self.note(clause, conforms(told) if is_so else diverges(otherwise or told))

    def lacks(self, names: Sequence[str], *clauses: str) -> bool:
        """Whether the device has not all of these; then that is what is found of the clauses."""
        if self.offers(*names):
            return False
        *most, last = names
        told = f"not all of {', '.join(most)} and {last}" if most else f"no {last}"
        for clause in clauses:
            self.note(clause, not_offered(told))
        return True

    # --------------------------------------------------------------------------------- where it is

    def here(self) -> tuple[float, ...]:
        """Return the measured joints.

        Raises:
            Stopped: none are heard, or they are no numbers.
        """
        heard = self.probe.joints("measured_js")
        if heard is None or not heard.position:
            raise Stopped("no measured joints")
        if not all(map(math.isfinite, heard.position)):
            raise Stopped("its measured joints are no numbers")
        return heard.position

    def pose(self) -> tuple[float, ...]:
        """Return the measured pose (7,).

        Raises:
            Stopped: none is heard.
        """
        heard = self.probe.cartesian("measured_cp")
        if heard is None:
            raise Stopped("no measured pose")
        return heard.numbers

    @property
    def joint(self) -> int:
        """The place of the joint that is moved."""
        return self.expected.joint % len(self.here())

    @property
    def velocity(self) -> float | None:
        """What is declared of the joint that is moved: rad/s or m/s."""
        joints = len(self.here())
        return self.ranges[self.joint].velocity if len(self.ranges) == joints else None

    def away(self, length: float) -> tuple[float, ...]:
        """Return the measured joints with one of them moved by `length`, to where there is room."""
        here, joint = list(self.here()), self.joint
        if len(self.ranges) == len(here):
            room = self.ranges[joint]
            length = min(length, LARGEST_SHARE * (room.upper - room.lower))
            if here[joint] > 0.5 * (room.lower + room.upper):
                length = -length
        here[joint] += length
        return tuple(here)

    def displaced(self, since: float, before: Numbers) -> float:
        """Return how far any joint was from `before` at most."""
        return furthest(self.probe.trace(since), before)

    def arrives(self, target: Numbers, within: float | None = None) -> bool:
        """Wait until the joints are at a position; return whether they are in time: that of a move."""
        limit = self.expected.move_time if within is None else within
        return self.probe.wait(lambda: far(self.here(), target) <= self.expected.arrival, limit)

    # -------------------------------------------------------------------------------------- states

    @property
    def is_busy(self) -> bool:
        """Whether it says so."""
        heard = self.probe.state()
        return heard is not None and heard.is_busy

    @property
    def is_homed(self) -> bool:
        """Whether it says so."""
        heard = self.probe.state()
        return heard is not None and heard.is_homed

    def word(self) -> str:
        """Return the newest operating state."""
        heard = self.probe.state()
        return "" if heard is None else heard.state

    def reach(self, command: str, state: str) -> bool:
        """Send a state command, and return whether the state comes."""
        self.probe.send("state_command", text=command)
        return self.probe.wait(lambda: self.word() == state, self.expected.transition_time)

    def said(self, command: str) -> list[str]:
        """Send a state command, wait, and return the states that were heard, the one before first."""
        before, began = self.word(), self.probe.now()
        self.probe.send("state_command", text=command)
        self.settle(self.expected.wait)
        after = [each.state for each in self.probe.trace(began).states]
        return list(dict.fromkeys((before, *after)))

    def enable(self) -> None:
        """Bring it to ENABLED.

        Raises:
            Stopped: it does not come there.
        """
        if self.word() == "PAUSED" and not self.reach("disable", "DISABLED"):
            raise Stopped("it does not leave PAUSED")
        if self.word() != "ENABLED" and not self.reach("enable", "ENABLED"):
            raise Stopped(f"it stays {self.word()} after enable")

    def settle(self, seconds: float) -> None:
        """Let time pass, and what was measured after it arrive, and the state."""
        self.probe.sleep(seconds)
        now = self.probe.now()

        def is_fresh() -> bool:
            joints, state = self.probe.joints("measured_js"), self.probe.state()
            return (joints is None or joints.at > now) and (state is None or state.at > now)

        self.probe.wait(is_fresh, FRESH_TIME)

    def at_rest(self) -> bool:
        """Wait until the joints stand, and return whether they do in time."""
        end = self.probe.now() + self.expected.stop_time + self.expected.wait
        before, heard = self.here(), self.probe.now()
        while self.probe.now() < end:
            self.probe.sleep(STANDS_FOR)
            newest = self.probe.joints("measured_js")
            if newest is None or newest.at < heard + STANDS_FOR:
                continue
            if far(newest.position, before) <= 0.2 * self.still:
                return True
            before, heard = newest.position, newest.at
        return False

    # --------------------------------------------------------------------------------------- motion

    def stream(self, name: str, points: Iterable[Numbers], **fields: object) -> list[Sent]:
        """Send a stream, and return what was sent."""
        return [
            self.probe.send(name, point, **fields)  # type: ignore[arg-type]
            for point in self.paced(points, STREAM_RATE)
        ]

    def paced(self, things: Iterable[_Thing], rate: float) -> Iterator[_Thing]:
        """Yield things, `rate` of them a second, each for its share of the time."""
        due = self.probe.now()
        for thing in things:
            yield thing
            due += 1.0 / rate
            self.probe.sleep(max(0.0, due - self.probe.now()))

    def go(self, target: Numbers) -> None:
        """Bring the joints to a position that is near, by a stream or else a move."""
        if self.offers("servo_jp"):
            self.stream("servo_jp", ramp(self.here(), target))
        elif self.offers("move_jp"):
            self.probe.send("move_jp", target)
        self.probe.wait(lambda: far(self.here(), target) <= self.still, self.expected.move_time)
        self.at_rest()

    def hold(self) -> None:
        """Stop."""
        if self.offers("hold"):
            self.probe.send("hold")

    def sample(self, row: Command, size: float) -> tuple[float, ...]:
        """Return the numbers of a small command of a row, by `size` of a step."""
        joints = len(self.here())
        linear = size * self.expected.linear_step
        if row.space is Space.JOINT:
            if row.kind is Kind.POSITION:
                here, target = self.here(), self.away(self.expected.step)
                return tuple(h + size * (t - h) for h, t in zip(here, target, strict=True))
            zeros = [0.0] * joints
            if row.kind is not Kind.EFFORT:
                step = self.away(self.expected.step)[self.joint] - self.here()[self.joint]
                zeros[self.joint] = size * step
            return tuple(zeros)
        if row.kind is Kind.POSITION:
            pose = list(self.pose())
            pose[2] += linear
            return tuple(pose)
        if row.kind is Kind.RELATIVE:
            return (0.0, 0.0, linear, 0.0, 0.0, 0.0, 1.0)
        return (0.0, 0.0, linear if row.kind is Kind.VELOCITY else 0.0, 0.0, 0.0, 0.0)

    def motions(self) -> dict[str, Command]:
        """Return the commands that move it and that can be tried: efforts and mixed ones are left out."""
        kinds = (Kind.POSITION, Kind.RELATIVE, Kind.VELOCITY)
        return {
            name: row for name, row in self.commands.items() if row.is_motion and row.kind in kinds
        }


def ramp(begin: Numbers, end: Numbers, seconds: float = 0.6) -> list[tuple[float, ...]]:
    """Return positions on the way from `begin` to `end`, which starts and stops gently."""
    count = max(2, round(seconds * STREAM_RATE))
    shares = [0.5 * (1.0 - math.cos(math.pi * index / count)) for index in range(1, count + 1)]
    return [tuple(b + s * (e - b) for b, e in zip(begin, end, strict=True)) for s in shares]


def far(one: Numbers, other: Numbers) -> float:
    """Return the largest difference of two positions; infinite if their sizes differ."""
    if len(one) != len(other):
        return math.inf
    return max((abs(a - b) for a, b in zip(one, other, strict=True)), default=0.0)


def furthest(trace: Trace, before: Numbers) -> float:
    """Return how far any joint was from `before` at most."""
    measured = [e.position for e in trace.joints.get("measured_js", ()) if e.stamp_ns]
    return max((far(each, before) for each in measured), default=0.0)


def _noise(trace: Trace) -> float:
    heard = [e.position for e in trace.joints.get("measured_js", ()) if e.stamp_ns and e.position]
    sizes = {len(each) for each in heard}
    return float(np.std(heard, axis=0).max()) if len(sizes) == 1 else 0.0


def _declared(manifest: Mapping[str, object]) -> tuple[JointRange, ...]:
    joints = manifest.get("joints")
    if not isinstance(joints, list):
        return ()
    found = []
    for each in joints:
        lower, upper = each.get("lower"), each.get("upper")
        if lower is None or upper is None or not lower < upper:
            return ()
        found.append(JointRange(lower=lower, upper=upper, velocity=each.get("velocity")))
    return tuple(found)


def _declared_stop(manifest: Mapping[str, object]) -> float | None:
    """Return within how many seconds after the last command of a stream the joints stand."""
    stop = manifest.get("stop")
    if not isinstance(stop, Mapping):
        return None
    timeout, time = stop.get("stream_timeout"), stop.get("time")
    if not (isinstance(timeout, float | int) and isinstance(time, float | int)):
        return None
    return timeout + time

"""A walk: commands, faults and clocks in any order, and the promises that must hold after each step."""

from __future__ import annotations

import math
import random
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Final

import numpy as np

from bench.reliability.activities import HOME, STREAMS, Activity
from bench.reliability.rig import STILL, BrokenPromiseError, Rig
from bench.reliability.table import Follows, Way
from crtk_drivers.engine.services import Request
from crtk_drivers.errors import CommandRefused, CrtkError
from crtk_drivers.samples import JointState, Value
from crtk_drivers.state import StateCommand

TURNS: Final = (0.02, 0.1, 0.3, 1.0, 3.0)
"""Seconds for which a step may go on."""

LATE: Final = 1.0
"""Seconds that a busy machine may add to each declared time."""

_WALKED: Final = frozenset({Follows.STOPS, Follows.GOES_ON})


def walkable(rig: type[Rig]) -> tuple[Way, ...]:
    """Return the ways that a walk may take: faults that begin and end while a driver runs.

    Left out are those that still fail, and those in which the hardware freezes: a walk judges each moment,
    and what joints do there counts only from the end.
    """
    return tuple(
        way for way in rig.ways if way.follows in _WALKED and not way.pending and not way.freezes
    )


@dataclass
class Story:
    """What a walk did, in order, and how often."""

    steps: list[str] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)

    def add(self, kind: str, detail: str = "") -> None:
        """Note a step."""
        self.counts[kind] += 1
        self.steps.append(f"{kind} {detail}".strip())


class Walk:
    """Takes steps with a rig. Each raises BrokenPromiseError if a promise does not hold after it."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self.story = Story()
        self._fault: Way | None = None
        self._asked = -math.inf
        self._reported_by = -math.inf
        self._alone_until = -math.inf
        """Until when hardware may go on by itself where no stop of ours counts."""
        self._start = np.zeros(0)
        self._far = 0.0
        self._requests: list[Request] = []

    # ------------------------------------------------------------------------------------------ steps

    def state_command(self, command: str) -> None:
        """Ask for a state; it may be refused, except for one that stops."""
        self.story.add("state_command", command)
        ask = partial(self.rig.engine.state_command, command)
        if command == StateCommand.DISABLE:
            self._never_refused(command, ask)
        else:
            self._tried(ask)
        self.go_on(0.05)

    def hold(self) -> None:
        """Ask for a stop."""
        self.story.add("hold")
        self.rig.stop_activity()
        if "hold" in self.rig.engine.commands:
            self._never_refused("hold", self.rig.arm.hold)
        self.go_on(0.05)

    def begin(self, activity: str) -> None:
        """Begin to do something; it may be refused."""
        self.story.add("begin", activity)
        self.rig.stop_activity()

        def begin() -> None:
            self._start = self.rig.look().joints
            plan = self.rig.plan_of_walk(activity)
            self._far = plan.far
            self.rig.activity = Activity(activity, self.rig.arm, plan)

        self._tried(begin)
        self.go_on(0.1)

    def service(self, name: str) -> None:
        """Ask for a service that moves what is not ENABLED; it may be refused, and is not awaited."""
        self.story.add("service", name)
        self.rig.stop_activity()
        self._tried(lambda: self._requests.append(self.rig.engine.request(name)))
        self.go_on(0.1)

    def end(self) -> None:
        """Do nothing more: a stream just ends."""
        self.story.add("end")
        self.rig.stop_activity()
        self.go_on(0.05)

    def begin_fault(self, way: Way) -> None:
        """Let a fault begin, after the one before is over."""
        self.end_fault()
        self.story.add("fault", f"{way.fault} {way.name}")
        self.rig.begin_fault(way)
        self._fault = way
        if way.runs_on:
            self._alone_until = max(self._alone_until, time.monotonic() + way.stands)
        self.go_on(0.1)

    def end_fault(self) -> None:
        """Let it end."""
        if self._fault is not None:
            self.story.add("fault over")
            self.rig.end_fault()
            if self._fault.lags:
                self._asked = time.monotonic()
            if self._fault.follows is Follows.STOPS:
                self._reported_by = time.monotonic() + self.rig.belated
            self._fault = None
            self.go_on(0.05)

    def restart(self) -> None:
        """Close the driver and start another, whatever goes on."""
        self.end_fault()
        self.story.add("restart")
        if not self.rig.engine.connected:  # the next driver stops nothing as it connects
            self._asked = max(self._asked, self._alone_until)
        self.rig.reopen()
        self.go_on(0.05)

    def go_on(self, seconds: float) -> None:
        """Let time pass, and check the promises."""
        end = time.monotonic() + seconds
        while True:
            try:
                self.rig.step()
            except BrokenPromiseError as error:
                raise self.broken(str(error)) from error
            self.check()
            if time.monotonic() >= end:
                return

    def _never_refused(self, name: str, call: Callable[[], object]) -> None:
        """Check promise 8: a stop is never refused while there is a connection."""
        connected = self.rig.engine.connected
        try:
            call()
        except CommandRefused as refusal:
            if connected and self.rig.engine.connected:
                raise self.broken(f"{name} was refused: {refusal}") from refusal

    def _tried(self, call: Callable[[], object]) -> None:
        try:
            call()
        except CommandRefused as refusal:
            if not refusal.detail or not str(refusal.reason):
                raise self.broken(f"refused without a reason: {refusal!r}") from refusal
        except CrtkError as error:
            if not str(error):
                raise self.broken(f"an error without words: {error!r}") from error

    # --------------------------------------------------------------------------------------- promises

    def check(self) -> None:
        """Check what must hold at any time.

        Raises:
            BrokenPromiseError: with the steps that led there.
        """
        self._check_rest()
        self._check_finite()
        self._check_reached()
        self._check_refusals()

    def _check_rest(self) -> None:
        """Check promises 1 to 3: nothing moves unasked, and what was stopped stands in time."""
        rig, now = self.rig, time.monotonic()
        self._requests = [request for request in self._requests if not request.has_ended]
        cut_off = self._fault is not None and self._fault.runs_on
        if self._is_asked_to_move():
            self._asked = now
            if not cut_off:
                # A drive or a controller homes by itself.
                homes = rig.activity is not None and rig.activity.name == HOME
                self._alone_until = now + rig.homes_on if homes else -math.inf
        elif now < self._alone_until and (cut_off or not rig.engine.connected):
            self._asked = now
        if now - self._asked > self._allowed() and not rig.still(STILL):
            recent = [look for look in rig.looks if look.at >= now - STILL]
            if len(recent) > 3:
                far = float(np.ptp(np.array([x.joints for x in recent]), axis=0).max(initial=0.0))
                if far > rig.tolerance:
                    raise self.broken(
                        f"a joint moves by {far:.4f} in {STILL} s, {now - self._asked:.1f} s after "
                        "the last reason to"
                    )

    def _is_asked_to_move(self) -> bool:
        """Whether a client lets the joints move: by a stream, a move, a transition or a service."""
        rig = self.rig
        streams = rig.activity is not None and rig.activity.name in STREAMS
        return (
            (rig.status.state == "ENABLED" and (rig.status.is_busy or streams))
            or not rig.engine.transition_ended
            or any(not request.broken_off_by for request in self._requests)
        )

    def _allowed(self) -> float:
        """Return the seconds after the last reason to move in which the joints must stand."""
        policy = self.rig.engine.capabilities.stop
        timeouts = self.rig.engine.options
        silent = max(timeouts.stream_timeout, timeouts.interpolate_timeout)
        if self.rig.stop_time is None:
            return max(silent, policy.link_timeout) + policy.time + LATE
        return silent + self.rig.stop_time + LATE

    def _check_finite(self) -> None:
        """Check promise 10: nothing that is not finite is published as valid."""
        found = self.rig.valid("measured_js") if self.rig.looks[-1].joints.size else None
        if found is None:
            return
        value: Value = found[0]
        if isinstance(value, JointState) and not np.isfinite(value.position).all():
            raise self.broken(f"measured_js is {value.position}")

    def _check_reached(self) -> None:
        """Check promise 9: a move that is reached is where it was to be."""
        activity = self.rig.activity
        if activity is None or activity.name != "move_jp" or activity.move is None:
            return
        if str(activity.move.outcome) != "reached":
            return
        went = self.rig.looks[-1].joints - self._start
        if abs(abs(went[0]) - abs(self._far)) > self.rig.arrival:
            raise self.broken(f"move_jp is reached, but went {went[0]:.3f} of {self._far:.3f}")
        activity.move = None

    def _check_refusals(self) -> None:
        """Check promise 5: what is refused is refused with a reason."""
        for refusal in self.rig.log.refused:
            if not refusal.detail:
                raise self.broken(f"refused without a reason: {refusal!r}")
        self.rig.log.refused.clear()
        del self.rig.looks[:-2000]
        del self.rig.log.announced[:-100]

    def recovers(self) -> None:
        """Whatever was before: without faults it connects, enables, moves, and can be stopped."""
        self.rig.stop_activity()
        self.end_fault()
        if time.monotonic() < self._reported_by:
            self.go_on(self._reported_by - time.monotonic())
        try:
            self.rig.ready()
            if self.rig.moves_joints:
                self.rig.go_home()
        except (BrokenPromiseError, CrtkError) as error:
            raise self.broken(f"it does not recover: {error}") from error
        self._asked = time.monotonic()

    def broken(self, what: str) -> BrokenPromiseError:
        """Return the error that says so, with the steps that led there."""
        done = "\n".join(f"  {number}: {step}" for number, step in enumerate(self.story.steps, 1))
        return BrokenPromiseError(f"{what}\nafter these steps of {self.rig.name}:\n{done}")


def wander(walk: Walk, generator: random.Random) -> None:
    """Take one step at random."""
    rig = walk.rig
    ways = walkable(type(rig))
    choices: dict[str, tuple[int, Callable[[], None]]] = {
        "state": (2, lambda: walk.state_command(generator.choice(list(StateCommand)))),
        "enable": (4, lambda: walk.state_command("enable")),
        "hold": (1, walk.hold),
        "begin": (6, lambda: walk.begin(generator.choice(rig.activities))),
        "end": (2, walk.end),
        "fault": (3, lambda: walk.begin_fault(generator.choice(ways))),
        "fault over": (4, walk.end_fault),
        "go on": (6, lambda: walk.go_on(generator.choice(TURNS))),
        "restart": (1, walk.restart),
    }
    if rig.services:
        choices["service"] = (3, lambda: walk.service(generator.choice(rig.services)))
    names = list(choices)
    chosen = generator.choices(names, [choices[name][0] for name in names])[0]
    choices[chosen][1]()

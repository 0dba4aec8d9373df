"""What a page may ask of one device: through the client, as any other program asks it.

A jog goes on as long as the page says so again and again: `DEADMAN` s after the last word, when the page says
that the key is up, or when its connection has ended, nothing more is sent, and the device is told to hold. A
move, or `home`, that a page began is held when its connection ends.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from crtk_drivers.client.remote import RemoteDevice
from crtk_drivers.client.state_commands import home_to_its_end
from crtk_drivers.client.view.newest_values import joints_in
from crtk_drivers.client.view.watched import WatchedDevice
from crtk_drivers.errors import ConnectionLost, CrtkError
from crtk_drivers.geometry.quaternions import quaternion_from_rotvec
from crtk_drivers.samples import Array
from crtk_drivers.status.deadman import Deadman

__all__ = ["DEADMAN", "Pilot"]

logger = logging.getLogger(__name__)

DEADMAN: Final = 0.25
"""Seconds after the last word of the page at which a jog ends."""
JOG_RATE: Final = 50.0
"""Setpoints a second while it jogs."""
TURNING: Final = 0.25
"""rad/s at full speed."""
SLIDING: Final = 0.05
"""m/s at full speed."""
INSISTS: Final = 0.1
"""Seconds after which what was begun, and has not ended, is told to hold again."""
LONGEST_NAME: Final = 40
"""Characters of the name of a pose."""
MOST_POSES: Final = 32

_JOINT_JOGS: Final = ("servo_jv", "servo_jr")
_TOOL_JOGS: Final = ("servo_cv", "servo_cr")
_STATES: Final = ("enable", "disable", "home")
_AT_ONCE: Final = "disable"  # need not wait for the others


class Refused(Exception):
    """It is not done; says why."""


@dataclass(eq=False)
class _Jog:
    """A jog of one axis, by one press of a key: when that jog has ended, the key must be pressed anew."""

    browser: int
    press: int
    name: str  # of the CRTK command
    values: Array  # rad/s or m/s, one for each joint, or linear and angular
    deadman: Deadman
    is_over: bool = False


@dataclass(eq=False)
class _Activity:
    """What takes its time, and is held when the page goes that began it.

    Attributes:
        is_lost: nothing was heard of the device any more: it may go on, though nobody waits for it.
    """

    browser: int
    name: str
    thread: threading.Thread
    is_lost: bool = False


class Pilot:
    """Commands one device for the pages. What takes time is done in threads; `do` returns at once.

    Args:
        watched: the device.
        tell: told, in words, what became of a command.
    """

    def __init__(self, watched: WatchedDevice, tell: Callable[[str], object]) -> None:
        self._watched = watched
        self._device = RemoteDevice(watched.space)
        self._tell = tell
        self._lock = threading.Lock()
        self._changed = threading.Condition(self._lock)
        self._jog: _Jog | None = None
        self._jogging: threading.Thread | None = None
        self._activity: _Activity | None = None
        self._presses: dict[int, int] = {}
        """Of each browser, the newest press that has begun a jog: an older one begins none."""
        self._poses: dict[str, Array] = {}

    @property
    def jogs(self) -> bool:
        """Whether it jogs."""
        return self._jog is not None

    @property
    def poses(self) -> tuple[str, ...]:
        """Names of the poses that are stored."""
        return tuple(self._poses)

    @property
    def actions(self) -> tuple[str, ...]:
        """What can be asked of the device now: enable, disable, home, hold, joint, tool, store, go."""
        offered = self._device.crtk_commands
        found = [*_STATES] if {"state_command", "operating_state"} <= set(offered) else []
        found += ["hold"] if "hold" in offered else []
        found += ["joint"] if set(_JOINT_JOGS) & set(offered) else []
        found += ["tool"] if set(_TOOL_JOGS) & set(offered) else []
        found += ["store", "go"] if {"move_jp", "measured_js"} <= set(offered) else []
        return tuple(found)

    def prepare(self) -> None:
        """Set up what must not be looked for when it is needed: hold, and what jogs. May wait.

        Raises:
            CrtkError: nobody listens to one of them.
        """
        offered = set(self._device.crtk_commands)
        jogs = (
            next((each for each in row if each in offered), "") for row in (_JOINT_JOGS, _TOOL_JOGS)
        )
        self._device.add(*({"hold", *jogs} & offered))

    # ------------------------------------------------------------------------------------- requests

    def do(self, what: str, browser: int, given: Mapping[str, Any]) -> None:
        """Begin what a page asks for.

        Raises:
            Refused: it is not done, and why.
        """
        if what in _STATES:
            command: Callable[[], object] = getattr(self._device, what)
            if what == "home":
                self._begin(browser, what, lambda: home_to_its_end(self._device))
            elif what == _AT_ONCE:
                self._end_jog("disable")
                self._insist(what, command)
            else:
                self._begin(browser, what, command)
        elif what == "hold":
            self.hold("hold")
        elif what == "jog":
            self._keep_jogging(browser, given)
        elif what == "release":
            self._end_jog("the key was let go", browser)
        elif what == "store":
            self._store(_text(given, "name"))
        elif what == "go":
            self._go(browser, _text(given, "name"))
        else:
            raise Refused(f"nothing is known of {what[:20]!r}")

    def hold(self, why: str) -> None:
        """Stop the device. Never refused here, in whatever state it is."""
        self._end_jog(why)
        self._insist("hold", self._device.hold)

    def gone(self, browser: int) -> None:
        """A page has gone: what it began ends."""
        self._end_jog("the page has gone", browser)
        self._presses.pop(browser, None)
        activity = self._activity
        if activity is None or activity.browser != browser:
            return
        if activity.thread.is_alive() or activity.is_lost:
            self._tell(f"{self._watched.namespace}: {activity.name} is held: the page has gone")
            self.hold("the page has gone")

    def all_gone(self) -> None:
        """All pages have gone: what they began ends."""
        for browser in {each.browser for each in (self._jog, self._activity) if each is not None}:
            self.gone(browser)

    def close(self) -> None:
        """End what runs, and wait for it."""
        self.all_gone()
        for thread in (self._jogging, self._activity.thread if self._activity else None):
            if thread is not None:
                thread.join(2.0)

    # --------------------------------------------------------------------------------- what it does

    def _begin(self, browser: int, name: str, work: Callable[[], object]) -> None:
        with self._lock:
            before = self._activity
            if before is not None and before.thread.is_alive():
                raise Refused(f"{before.name} is not over yet; hold ends it")

            def carry_out() -> None:
                try:
                    work()
                except ConnectionLost:
                    with self._lock:  # which is free when there is an activity
                        activity.is_lost = True
                    raise

            activity = self._activity = _Activity(browser, name, self._spawn(name, carry_out))

    def _insist(self, name: str, command: Callable[[], object]) -> None:
        """Command what ends an activity, and again until that has ended: it may be sent only now."""
        with self._lock:  # one that is just begun is waited for, and ended too
            activity = self._activity

        def work() -> None:
            while activity is not None and activity.thread.is_alive():
                with suppress(CrtkError):  # the last one tells
                    command()
                activity.thread.join(INSISTS)
            command()

        self._spawn(name, work)

    def _spawn(self, name: str, work: Callable[[], object]) -> threading.Thread:
        def run() -> None:
            where = self._watched.namespace
            try:
                work()
            except CrtkError as error:
                self._tell(f"{where}: {name}: {error}")
            except Exception as error:  # what a page asks for must not end the view
                logger.exception("%s: %s failed", where, name)
                self._tell(f"{where}: {name}: {type(error).__name__}: {error}")

        thread = threading.Thread(target=run, name=f"{name} {self._watched.namespace}", daemon=True)
        thread.start()
        return thread

    def _store(self, name: str) -> None:
        if len(self._poses) >= MOST_POSES and name not in self._poses:
            raise Refused(f"{MOST_POSES} poses are stored already")
        found = joints_in(self._watched.look())
        if found is None or found[1].is_old or not np.all(np.isfinite(found[0].position)):
            raise Refused("where it is, is not known now: try again in a second")
        self._poses[name] = found[0].position

    def _go(self, browser: int, name: str) -> None:
        goal = self._poses.get(name)
        if goal is None:
            raise Refused(f"there is no pose {name!r}")
        self._begin(browser, f"the move to {name}", lambda: self._device.move_jp(goal).wait())

    # ------------------------------------------------------------------------------------------ jog

    def _keep_jogging(self, browser: int, given: Mapping[str, Any]) -> None:
        name, values = self._asked(given)
        press = given.get("press")
        if not isinstance(press, int) or press < 1:
            raise Refused("each press of a key has a number, from 1 on")
        now = time.monotonic()
        with self._changed:
            jog = self._jog
            if jog is not None and jog.browser != browser:
                raise Refused("another page jogs it")
            if jog is not None and (jog.press, jog.name) == (press, name):
                jog.values = values
                jog.deadman.feed(now)
            if jog is not None or press <= self._presses.get(browser, 0):
                return  # one that ends: the key may still be held when it has; or is one of before
            self._presses[browser] = press
            self._jog = jog = _Jog(browser, press, name, values, Deadman(DEADMAN))
            jog.deadman.feed(now)
            self._jogging = self._spawn("jog", lambda: self._run_jog(jog))

    def _asked(self, given: Mapping[str, Any]) -> tuple[str, Array]:
        """Return the CRTK command of a jog and its velocities."""
        space, axis, speed = given.get("space"), given.get("axis"), given.get("speed")
        is_number = isinstance(speed, int | float) and not isinstance(speed, bool)
        if not is_number or not abs(speed) <= 1.0:  # type: ignore[arg-type]
            raise Refused("the speed is a share from -1 to 1")
        count = 6 if space == "tool" else len(self._limits())
        if not count:
            raise Refused("its joints are not known yet: try again in a second")
        if not isinstance(axis, int) or isinstance(axis, bool) or not 0 <= axis < count:
            raise Refused("there is no such axis")
        commands = {"joint": _JOINT_JOGS, "tool": _TOOL_JOGS}.get(str(space), ())
        name = next((each for each in commands if each in self._device.crtk_commands), None)
        if name is None:
            raise Refused(f"it offers none of {', '.join(commands) or 'these'}")
        values = np.zeros(count)
        full = (SLIDING if axis < 3 else TURNING) if space == "tool" else self._limits()[axis]
        values[axis] = full * float(speed)  # type: ignore[arg-type]
        return name, values

    def _limits(self) -> list[float]:
        """Return how fast each joint jogs at full speed, by the chain and the limits that are told."""
        watched = self._watched
        found = joints_in(watched.look())
        names = () if found is None else found[0].name
        told = {
            joint["name"]: joint.get("velocity") for joint in watched.manifest.get("joints", ())
        }
        slides = (
            dict(zip(watched.chain.names, watched.chain.slides, strict=True))
            if watched.chain
            else {}
        )
        return [
            min(SLIDING if slides.get(name, True) else TURNING, told.get(name) or math.inf)
            for name in (names or tuple(told))
        ]

    def _run_jog(self, jog: _Jog) -> None:
        period = 1.0 / JOG_RATE
        send = getattr(self._device, jog.name)
        is_relative = jog.name.endswith("r")
        why = ""
        try:
            due = time.monotonic()
            while not why:
                with self._changed:
                    self._changed.wait_for(lambda: jog.is_over, max(0.0, due - time.monotonic()))
                    values = jog.values
                now = time.monotonic()
                if jog.is_over:
                    break
                if jog.deadman.expired(now):
                    why = f"nothing was heard of the page for {DEADMAN:g} s"
                    break
                due = max(due + period, now)
                send(_payload(jog.name, values * period if is_relative else values))
        finally:
            if why:
                self._tell(f"{self._watched.namespace}: the jog ends: {why}")
            try:
                self._device.hold()
            finally:
                with self._changed:
                    self._jog = None

    def _end_jog(self, why: str, browser: int | None = None) -> None:
        with self._changed:
            jog = self._jog
            if jog is None or (browser is not None and jog.browser != browser):
                return
            jog.is_over = True
            self._changed.notify_all()
        logger.debug("%s: the jog ends: %s", self._watched.namespace, why)


def _payload(name: str, values: Array) -> Array:
    if name == "servo_cr":
        return np.concatenate((values[:3], quaternion_from_rotvec(values[3:])))
    return values


def _text(given: Mapping[str, Any], key: str) -> str:
    text = given.get(key)
    if not isinstance(text, str) or not 0 < len(text.strip()) <= LONGEST_NAME:
        raise Refused(f"a name has 1 to {LONGEST_NAME} characters")
    return text.strip()

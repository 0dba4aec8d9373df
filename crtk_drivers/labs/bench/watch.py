"""The watch over a device under test: it looks fifty times a second, and stops what goes wrong.

It is no safety system: it is Python on the machine that runs the bench.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Final

import numpy as np

from crtk_drivers.config import BoxConfig
from crtk_drivers.errors import CrtkError
from crtk_drivers.labs.bench.calls import About, Glance
from crtk_drivers.labs.bench.door import Door, Refused
from crtk_drivers.samples import JointState, Pose
from crtk_drivers.state import OperatingState
from crtk_drivers.status.stop_request import StopRequest

PERIOD: Final = 0.02

BEYOND: Final = 0.1
"""Share of a range by which a joint may be outside of it, and of a speed limit."""

OVERSPEED: Final = 1.5
"""Times its velocity limit that a joint may be measured at: what is measured is noisier than what moves."""

OLDEST: Final = 0.5
"""Seconds: a device whose newest sample is older is stopped."""

BLIND: Final = 0.5
"""Seconds without a look after which nothing may move: the watch itself has failed."""

CLOSING: Final = 60.0
"""Seconds for a stop that is being carried out."""

HOLD_TIME: Final = 0.5
"""Seconds between hold and disable."""

logger = logging.getLogger(__name__)


def judged(glance: Glance, about: About, box: BoxConfig | None) -> str:
    """Return what is wrong with a device that is moved, as it is seen at one moment; empty if nothing is."""
    if glance.status.state is OperatingState.FAULT:
        return f"FAULT: {glance.status.cause}"
    if glance.status.state is not OperatingState.ENABLED:
        return ""
    if glance.age > OLDEST:
        return f"its newest sample is {glance.age:.2f} s old"
    found, _ = glance.values.get("measured_js", (None, None))
    if about.capabilities.joints:
        if not (isinstance(found, JointState) and found.position.size):
            return "it tells no joints"
        wrong = _judged_joints(found, about)
        if wrong:
            return wrong
    return "" if box is None or "measured_cp" not in about.commands else _judged_tool(glance, box)


def _judged_tool(glance: Glance, box: BoxConfig) -> str:
    pose, _ = glance.values.get("measured_cp", (None, None))
    if not isinstance(pose, Pose):
        return "it does not tell where its tool is"
    lower, upper = np.array(box.lower), np.array(box.upper)
    room = BEYOND * (upper - lower)
    if ((lower - room <= pose.position) & (pose.position <= upper + room)).all():
        return ""
    at = ", ".join(f"{value:.3f}" for value in pose.position)
    return f"its tool is at {at} m, outside of its space"


def _judged_joints(found: JointState, about: About) -> str:
    capabilities = about.capabilities
    for index, (name, limit) in enumerate(
        zip(capabilities.joints, capabilities.limits, strict=True)
    ):
        room = BEYOND * (limit.upper - limit.lower)
        at = found.position[index]
        if not limit.lower - room <= at <= limit.upper + room:
            return f"{name} is at {at:.3f}, outside of {limit.lower:g} to {limit.upper:g}"
        if found.velocity.size and not abs(found.velocity[index]) <= OVERSPEED * limit.velocity:
            return f"{name} moves at {found.velocity[index]:.2f}, its limit is {limit.velocity:g}"
    return ""


def late_told(lateness: Iterable[float], allowed: float) -> tuple[str, ...]:
    """Return a doubt if one in a hundred looks was later than `allowed` s."""
    late = sorted(lateness)
    if not late:
        return ()
    found = late[min(len(late) - 1, int(0.99 * len(late)))]
    if found <= allowed:
        return ()
    return (
        f"the machine is too busy: the bench's own timer was late by {1e3 * found:.1f} ms, "
        f"at most {1e3 * allowed:.1f} ms are allowed",
    )


def let_go(door: Door, name: str, timeout: float) -> bool:
    """Hold a device, disable it once it stands, and return whether it is seen to be without power.

    Args:
        door: to it.
        name: of it, for the log.
        timeout: seconds that `disable` may take.
    """
    try:
        for step in ("hold", "disable"):
            try:
                if step == "hold":
                    door.call("hold")
                    time.sleep(HOLD_TIME)
                else:
                    door.call("state_command", "disable", timeout, within=timeout)
            except Refused as error:
                logger.info("%s: %s: %s", name, step, error)
        glance: Glance = door.call("glance")
    except CrtkError as error:
        logger.error("%s: cannot be held: %s", name, error)
        return False
    if glance.status.state is OperatingState.DISABLED and glance.connected:
        return True
    # Of FAULT nobody knows: `disable` may have failed, or the link is cut and nothing was told.
    how = str(glance.status.state) if glance.connected else "not connected"
    logger.error("%s: was to be disabled, and is %s", name, how)
    return False


class Watch:
    """Watches one device from a thread of its own, through a connection of its own.

    Args:
        door: to the device; closed by `close`.
        about: the device.
        box: for its tool.
        stop: set when the run is to end.
        lost: called when it does not answer as it is to be held, or is not seen to be disabled afterwards.
    """

    def __init__(
        self,
        door: Door,
        about: About,
        box: BoxConfig | None,
        stop: StopRequest,
        lost: Callable[[], None] = lambda: None,
    ) -> None:
        self.tripped = ""
        """Why the device was stopped; empty while it was not."""
        self.box = box
        """For the tool; None: it may be anywhere."""
        self.lateness: list[float] = []
        """By how many seconds each look was late; of the machine that runs the bench."""
        self._door = door
        self._about = about
        self._stop = stop
        self._lost = lost
        self._companion: Watch | None = None
        self._expected = 0
        self._looked = math.inf
        self._moves = True
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None

    def join(self, other: Watch) -> None:
        """Trip together with the watch of a second device from now on, whichever trips first."""
        self._companion, other._companion = other, self
        for one, second in ((self, other), (other, self)):
            if one.tripped:
                second.trip(one.tripped)

    def start(self, moves: bool = True) -> None:
        """Watch from now on.

        Args:
            moves: what goes wrong stops the device; else it only ends what is being done.
        """
        self._moves = moves
        self._ended = threading.Event()
        self._looked = time.monotonic()
        self._thread = threading.Thread(
            target=self._run, args=(self._ended,), name="bench watch", daemon=True
        )
        self._thread.start()

    def close(self) -> None:
        """End the thread, once a stop is carried out, and the connection. May be called twice."""
        self._end()
        self._door.close()

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Within, nobody looks: there is nobody who could answer."""
        self._end()
        try:
            with self.during("a pause"):
                yield
        finally:
            self.start(self._moves)

    def start_again(self, door: Door) -> None:
        """Watch through another connection: the driver was started anew. `close` came before."""
        self._door = door
        self.start()

    @property
    def trouble(self) -> str:
        """Why nothing may be moved: the device was stopped, or nobody looks. Empty if all is well."""
        return self.own_trouble or ("" if self._companion is None else self._companion.own_trouble)

    @property
    def own_trouble(self) -> str:
        """The same, of this device alone."""
        if self.tripped or self._expected:
            return self.tripped
        blind = time.monotonic() - self._looked
        return f"the watch has not looked for {blind:.1f} s" if blind > BLIND else ""

    @contextmanager
    def during(self, what: str) -> Iterator[None]:
        """Within, nothing trips: `what` leads through states that would be unexpected otherwise."""
        logger.debug("watch: %s", what)
        self._expected += 1
        try:
            yield
        finally:
            self._looked = time.monotonic()
            self._expected -= 1

    def trip(self, why: str) -> None:
        """Hold the device, disable it, and say why; the second device as well. The first reason counts."""
        if self.tripped:
            return
        self.tripped = why
        if self._moves:
            self._stop_device(why)
        if self._companion is not None:
            self._companion.trip(f"{self._about.name}: {why}")

    def _stop_device(self, why: str) -> None:
        logger.error("%s: stopped by the watch: %s", self._about.name, why)
        if not let_go(self._door, self._about.name, self._about.capabilities.transition_timeout):
            self._lost()

    def look(self) -> None:
        """Look at the device, and stop it if something is wrong.

        Raises:
            CrtkError: it cannot be looked at.
        """
        glance: Glance = self._door.call("glance")
        wrong = judged(glance, self._about, self.box)
        self._looked = time.monotonic()
        if self._stop.is_set():
            self.trip("the run was stopped")
        if wrong and not self._expected and not self.tripped:
            self.trip(wrong)

    def _end(self) -> None:
        self._ended.set()
        if self._thread is not None:
            self._thread.join(CLOSING)

    def _run(self, ended: threading.Event) -> None:
        due = time.monotonic()
        while not ended.wait(max(0.0, due - time.monotonic())):
            self.lateness.append(max(0.0, time.monotonic() - due))
            due = max(due + PERIOD, time.monotonic())
            try:
                self.look()
            except Exception as error:
                if not ended.is_set():
                    self.trip(str(error) or type(error).__name__)
                return

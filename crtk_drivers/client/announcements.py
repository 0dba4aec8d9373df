"""``operating_state`` and ``refusals`` of a device, and those who wait for them."""

from __future__ import annotations

import json
import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from crtk_drivers.client.goals import Arrival
from crtk_drivers.client.move_handle import RemoteMove
from crtk_drivers.errors import CommandRefused, ConnectionFailed, CrtkError, DataTimeout, Reason
from crtk_drivers.state import Status

if TYPE_CHECKING:
    from crtk_drivers.client.inbox import Inbox, Received
    from crtk_drivers.client.ros_link import Link

logger = logging.getLogger(__name__)

SILENCE = 5.0
"""Seconds without a heartbeat, from a device that has one, that mean that it is gone."""
HISTORY = 0.05
"""Seconds of silence after which no more refusals of before are expected: the last ten are latched."""
OUT_OF_ORDER_NS = 1_000_000_000
"""Nanoseconds by which a status may be older than one that the service told, or that an answer of the service
may be older than the topic, and be left out: one overtakes the other. One that is older still comes from a
driver whose clock was set back. On the topic alone what arrives last is the newest, also from another driver
that has taken over on a machine whose clock is behind."""
RECENT = 3.0
"""Seconds in which a driver may hold the next refusal of the same kind back."""
_MOOT_NS = 5_000_000_000
"""Nanoseconds before a stop within which what was sent is over with it. What is older comes from a clock that
was set back."""


def is_moot(stamp_ns: int, stopped_ns: int) -> bool:
    """Whether a command that was sent before a stop of the same client is over with that.

    Args:
        stamp_ns: of the command; 0: it had none.
        stopped_ns: when the client sent the stop.
    """
    return stamp_ns != 0 and 0 <= stopped_ns - stamp_ns < _MOOT_NS


class Watch:
    """Collects the statuses and refusals that arrive from its making on."""

    def __init__(self) -> None:
        self._events: deque[Status | CommandRefused] = deque()
        self._changed = threading.Condition()

    def add(self, event: Status | CommandRefused) -> None:
        """Something arrived."""
        with self._changed:
            self._events.append(event)
            self._changed.notify_all()

    def next(self, timeout: float) -> Status | CommandRefused | None:
        """Return the next event, None if there is none in time."""
        with self._changed:
            if not self._changed.wait_for(lambda: bool(self._events), timeout):
                return None
            return self._events.popleft()

    def raise_refusal(self, name: str, timeout: float) -> None:
        """Raise the refusal of the command `name` if it arrives in time."""
        deadline = time.monotonic() + timeout
        while True:
            event = self.next(max(0.0, deadline - time.monotonic()))
            if event is None:
                return
            if isinstance(event, CommandRefused) and event.command == name:
                raise event


class StatusTracker:
    """The operating state of one device as it arrives. Thread-safe; subscribes at `start`.

    Args:
        link: to ROS.
        where: the device, for messages.
        topic: full name of ``operating_state``.
        type_: ROS class of its messages.
        refusals: full name of ``refusals``; None for a device without.
        service: full name of the service ``operating_state``; None for a device without.
        heartbeat: whether the state is repeated.
        alone: whether nobody but this client sends a command, so that its refusals are ours.
        past_refusals: ask for those of before, and leave them out: none is missed while the two ends meet.
    """

    def __init__(
        self,
        link: Link,
        where: str,
        topic: str,
        type_: type,
        refusals: str | None,
        service: str | None,
        heartbeat: bool,
        alone: Callable[[str], bool],
        past_refusals: bool = True,
    ) -> None:
        self._link = link
        self._where = where
        self._topic = topic
        self._type = type_
        self._refusals = refusals
        self._service = service
        self._heartbeat = heartbeat
        self._alone = alone
        self._lock = threading.RLock()
        self._inbox: Inbox | None = None
        self._latest: Status | None = None
        self._heard = 0.0
        self._stamp_ns = 0
        self._answered_ns = 0
        self._past_refusals = past_refusals
        self._live = not past_refusals
        self._started = False
        self._watches: list[Watch] = []
        self._moves: list[RemoteMove] = []
        self._late: dict[str, CommandRefused] = {}
        self._stopped_ns = 0  # when a stop of ours was sent last
        self._refused_at: dict[str, float] = {}
        self._sent: set[str] = set()
        self._status_callbacks: list[Callable[[Status], Any]] = []
        self._refusal_callbacks: list[Callable[[CommandRefused], Any]] = []

    # ------------------------------------------------------------------------------------ lifetime

    def subscribe(self) -> list[Inbox]:
        """Subscribe, if that is not done yet, and return the subscriptions."""
        with self._lock:
            if self._inbox is None:
                latched = self._service is None and self._link.is_latched(self._topic)
                self._inbox = self._link.inbox(self._topic, self._type, latched)
                self._inbox.add_listener(self._receive)
                if self._refusals is not None:
                    box = self._link.text_inbox(self._refusals, self._past_refusals)
                    box.add_listener(self._receive_refusal)
            boxes = [self._inbox]
            if self._refusals is not None:
                boxes.append(self._link.text_inbox(self._refusals, self._past_refusals))
            return boxes

    def start(self, timeout: float) -> None:
        """Subscribe, and wait for the first status. Does nothing once that is done.

        Raises:
            ConnectionFailed: nobody publishes it.
            DataTimeout: somebody does, and nothing came.
        """
        if self._started:
            return
        from crtk_drivers.client.inbox import may_wait
        from crtk_drivers.client.ros_link import wait_connected

        deadline = time.monotonic() + timeout
        boxes = self.subscribe()
        may_wait("operating_state")
        if not wait_connected(boxes, deadline):
            missing = ", ".join(box.topic for box in boxes if not box.connected)
            raise ConnectionFailed(
                f"nobody publishes {missing}", where=self._where, remedy="Is the driver running?"
            )
        if self._latest is None:
            self.refresh(max(0.0, deadline - time.monotonic()))
        if not self.wait_for(lambda status: True, max(0.0, deadline - time.monotonic())):
            raise DataTimeout(
                f"{self._topic} is silent",
                where=self._where,
                remedy="If the node is your own, is it spun?",
            )
        self._let_history_pass(boxes[-1])

    def _let_history_pass(self, box: Inbox) -> None:
        seen = 0
        end = time.monotonic() + 10.0 * HISTORY
        while box.wait_for(partial(_newer, seen), HISTORY):
            assert box.latest is not None
            seen = box.latest.serial
            if time.monotonic() > end:
                break
        self._live = self._started = True

    def refresh(self, timeout: float) -> None:
        """Ask the service for the state as it is now, if there is that service and it answers."""
        if self._service is None:
            return
        try:
            answer = self._link.state_caller(self._service).operating_state(timeout)
            with self._lock:
                if _overtaken(answer.wall_ns, self._stamp_ns):
                    return
                self._answered_ns = answer.wall_ns
            self._receive(answer)
        except (CrtkError, ValueError) as error:  # no answer, or one that says nothing
            logger.debug("%s: %s", self._where, error)

    # ------------------------------------------------------------------ told by the spinning thread

    def _receive(self, received: Received) -> None:
        status = received.status
        with self._lock:
            if _overtaken(received.wall_ns, self._answered_ns):
                return
            self._stamp_ns = received.wall_ns
            self._heard = time.monotonic()
            changed = status != self._latest
            self._latest = status
            for watch in self._watches:
                watch.add(status)
            for move in self._moves:
                move.status_changed(status)
            callbacks = tuple(self._status_callbacks) if changed else ()
        for callback in callbacks:
            _call(callback, status)

    def _receive_refusal(self, received: Received) -> None:
        refusal = self._refusal_of(received.text)
        if refusal is None:
            return
        with self._lock:
            self._refused_at[refusal.command] = time.monotonic()
            if self._live or refusal.stamp_ns:
                self._attribute(refusal)
            if not self._live:
                return
            for watch in self._watches:
                watch.add(refusal)
            callbacks = tuple(self._refusal_callbacks)
        for callback in callbacks:
            _call(callback, refusal)

    def _refusal_of(self, text: str) -> CommandRefused | None:
        try:
            content = json.loads(text)
            stamp = content["stamp"]
            return CommandRefused(
                content["command"],
                Reason(content["reason"]),
                content["message"],
                where=self._where,
                remedy=content["remedy"],
                stamp_ns=stamp["sec"] * 1_000_000_000 + stamp["nanosec"],
                state_command=str(content.get("state_command", "")),
            )
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            logger.warning("%s: a refusal that cannot be read: %s", self._where, error)
            return None

    def _attribute(self, refusal: CommandRefused) -> None:
        """Hand a refusal to the command of ours that it is about, if it is about one of ours.

        Its stamp tells; what was sent without one is ours while nobody else sends the same.
        """
        name = refusal.command
        mine = [
            move
            for move in self._moves
            if move.name == name
            and move.stamp_ns == refusal.stamp_ns
            and not move.refusal
            and not (move.accepted and move.has_ended)
        ]
        if mine and (refusal.stamp_ns or not mine[-1].accepted or self._alone(name)):
            mine[-1].refused(refusal)
        elif refusal.reason is Reason.STREAM_ENDED:
            return  # nothing that is sent now is refused
        elif refusal.reason is Reason.TOO_OLD and is_moot(refusal.stamp_ns, self._stopped_ns):
            return  # a stop that we sent after it has overtaken it: it was to end anyway
        elif name in self._sent and self._alone(name):
            self._sent.discard(name)
            self._late[name] = refusal

    # ------------------------------------------------------------------------------ for the client

    @property
    def inbox(self) -> Inbox:
        """The subscription."""
        assert self._inbox is not None, "start comes first"
        return self._inbox

    @property
    def latest(self) -> Status:
        """The status heard last; DISABLED before there was one."""
        return self._latest or Status()

    @property
    def has_started(self) -> bool:
        """Whether a status was heard, and refusals are."""
        return self._started

    @property
    def has_status(self) -> bool:
        """Whether a status was heard."""
        return self._latest is not None

    @property
    def silence(self) -> float:
        """Seconds since a status arrived."""
        return time.monotonic() - self._heard

    def lost(self) -> str:
        """Return why the device counts as gone; empty if it does not."""
        if self._inbox is not None and not self._inbox.connected:
            return f"nobody publishes {self._topic} any more"
        silent = self.silence
        if self._heartbeat and silent > SILENCE:
            return f"{self._topic} has been silent for {silent:.1f} s"
        return ""

    def watch(self) -> Watch:
        """Return what collects from now on; to be given to `unwatch`."""
        watch = Watch()
        with self._lock:
            self._watches.append(watch)
        return watch

    def unwatch(self, watch: Watch) -> None:
        """Collect no more."""
        with self._lock:
            self._watches.remove(watch)

    def wait_for(self, test: Callable[[Status], bool], timeout: float) -> bool:
        """Wait until `test` holds for a status, also one that lasts for an instant only."""
        watch = Watch()
        with self._lock:
            if self._latest is not None and test(self._latest):
                return True
            self._watches.append(watch)
        deadline = time.monotonic() + timeout
        try:
            while True:
                event = watch.next(max(0.0, deadline - time.monotonic()))
                if event is None:
                    return False
                if isinstance(event, Status) and test(event):
                    return True
        finally:
            self.unwatch(watch)

    def _refused_lately(self, name: str) -> bool:
        return time.monotonic() - self._refused_at.get(name, -RECENT) < RECENT

    def follow(
        self,
        name: str,
        stamp_ns: int,
        arrival: Arrival,
    ) -> RemoteMove:
        """Return the handle of a move that is about to be sent; it is told what arrives from now on.

        Args: see `RemoteMove`.
        """
        move = RemoteMove(
            name,
            stamp_ns=stamp_ns,
            was_busy=self.latest.is_busy,
            refused_before=self._refused_lately(name),
            at_goal=arrival.at_goal,
            lost=self.lost,
            told_at=arrival.told_at,
        )
        with self._lock:
            self._moves = [other for other in self._moves if not other.has_ended] + [move]
        return move

    @property
    def newest(self) -> RemoteMove | None:
        """The move that was begun last and has not ended."""
        with self._lock:
            return next((move for move in reversed(self._moves) if not move.has_ended), None)

    def replace(self, name: str, *but: RemoteMove | None) -> None:
        """`name` has taken the place of every move but some."""
        with self._lock:
            for move in self._moves:
                if move not in but:
                    move.replaced(name)
            self._moves = [move for move in self._moves if move in but]

    def sending(self, name: str) -> None:
        """A command without an answer is about to be sent.

        Raises:
            CommandRefused: an earlier one was refused; this is the first chance to say so.
        """
        late = self._late.pop(name, None) if self._late else None
        if late is not None:
            raise late
        self._sent.add(name)

    def stopping(self) -> None:
        """A stop is about to be sent: what was sent before it may come after it, and is refused then."""
        self._stopped_ns = time.time_ns()

    def on_status(self, callback: Callable[[Status], Any]) -> Callable[[], None]:
        """Call `callback` with each new status; return what ends that."""
        return self._called(self._status_callbacks, callback)

    def on_refusal(self, callback: Callable[[CommandRefused], Any]) -> Callable[[], None]:
        """Call `callback` with each refusal, also those of other clients; return what ends that."""
        return self._called(self._refusal_callbacks, callback)

    def _called(
        self, callbacks: list[Callable[..., Any]], callback: Callable[..., Any]
    ) -> Callable[[], None]:
        with self._lock:
            callbacks.append(callback)

        def end() -> None:
            with self._lock:
                callbacks.remove(callback)

        return end


def _overtaken(stamp_ns: int, by_ns: int) -> bool:
    return 0 < by_ns - stamp_ns < OUT_OF_ORDER_NS


def _newer(serial: int, received: Received) -> bool:
    return received.serial > serial


def _call(callback: Callable[[Any], Any], event: object) -> None:
    try:
        callback(event)
    except Exception:
        logger.exception("a callback for the operating state failed")

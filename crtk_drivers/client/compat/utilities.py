"""``crtk.utils``: populates a class of the user's with CRTK methods, à la carte.

`add_<name>` exists for every name of the command table. It makes the topic's endpoint at once, so that
`ral.check_connections` sees it, and the method when the class does not have it yet.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from typing_extensions import override

from crtk_drivers.client.announcements import StatusTracker
from crtk_drivers.client.compat.handles import WaitMoveHandle
from crtk_drivers.client.goals import ToldGoals, arrival_of
from crtk_drivers.client.inbox import Inbox, Received
from crtk_drivers.client.ral import Ral
from crtk_drivers.client.ros_link import Caller, Outbox
from crtk_drivers.commands import COMMANDS, Command, Direction, Level, Payload
from crtk_drivers.errors import CommandRefused, DataTimeout, KinematicsError, Reason
from crtk_drivers.front.base import PARTS
from crtk_drivers.front.payloads import value_for
from crtk_drivers.geometry.conversions import as_pose, have_kdl, to_kdl
from crtk_drivers.ros.messages import TYPES
from crtk_drivers.samples import JointState, Pose, Value, vector
from crtk_drivers.state import OperatingState, Status

logger = logging.getLogger(__name__)

WAIT = 1.0
"""Seconds to wait for feedback that is new enough, unless the call says otherwise."""
SERVICE_TIMEOUT = 5.0
_TRACKER = "_crtk_status_tracker"
"""Attribute of the user's object by which another `Utils` finds its operating state."""


class NoData(DataTimeout, RuntimeWarning):
    """No feedback new enough. RuntimeWarning as in releases before 1.4, TimeoutError as since then."""


class Utils:
    """Adds CRTK methods to an object.

    Args:
        class_instance: the object that is populated.
        ral: knows node and namespace.
        expected_interval: seconds between two messages of the device: what `age` is by default.
        operating_state_instance: the object whose operating state tells when moves end.
    """

    def __init__(
        self,
        class_instance: Any,
        ral: Ral,
        expected_interval: float = 0.02,
        operating_state_instance: Any = None,
    ) -> None:
        self._instance = class_instance
        self._ral = ral
        self._age = expected_interval
        self._state_owner = operating_state_instance
        self._inboxes: dict[str, Inbox] = {}
        self._told: dict[str, ToldGoals] = {}
        self._kdl = have_kdl()

    def __getattr__(self, name: str) -> Callable[[], None]:
        """Return ``add_<name>``."""
        feature = name.removeprefix("add_")
        if feature == name or feature not in COMMANDS:
            raise AttributeError(f"crtk.utils has no {name}: there is no such CRTK command")
        return lambda: self._add(feature, COMMANDS[feature])

    def _add(self, name: str, command: Command) -> None:
        if hasattr(self._instance, name):
            raise RuntimeWarning(f"{name} already exists")
        topic = self._ral.add_namespace(name)
        kind = TYPES[command.payload]
        link = self._ral.link
        if command.direction is Direction.PUBLISHED:
            inbox = self._inboxes[name] = self._ral.track(link.inbox(topic, kind, latched=False))
            self._add_feedback(name, inbox)
        elif command.direction is Direction.SERVICE:
            caller = self._ral.track(link.caller(topic, kind))
            setattr(self._instance, name, self._query(name, caller))
        else:
            outbox = self._ral.track(link.outbox(topic, command.payload))
            setattr(self._instance, name, self._sender(name, command, outbox))

    # ------------------------------------------------------------------------------------- feedback

    def _add_feedback(self, name: str, inbox: Inbox) -> None:
        getter = self._getter(inbox, None)
        if COMMANDS[name].payload is Payload.MATRIX:
            getter = self._matrix_getter(inbox)
        setattr(self._instance, name, getter)
        for part, (whole, field) in PARTS.items():
            if whole == name:
                setattr(self._instance, part, self._getter(inbox, field))

    def _getter(self, inbox: Inbox, field: str | None) -> Callable[..., Any]:
        def getter(age: float | None = None, wait: float | None = None, extra: Any = None) -> Any:
            found = self._fresh(inbox, age, wait)
            return self._answer(self._value(found, field), found.wall_ns / 1e9, extra)

        return getter

    def _matrix_getter(self, inbox: Inbox) -> Callable[..., Any]:
        """As `_getter`, for what has no stamp."""

        def getter(age: float | None = None, wait: float | None = None) -> Any:
            return self._value(self._fresh(inbox, age, wait), None)

        return getter

    def _fresh(self, inbox: Inbox, age: float | None, wait: float | None) -> Received:
        oldest = self._age if age is None else age

        def is_new(received: Received) -> bool:
            return oldest == 0.0 or time.monotonic() - received.since <= oldest

        found = inbox.wait_for(is_new, WAIT if wait is None else wait)
        if found is None:
            heard = "it was never heard" if inbox.latest is None else f"older than {oldest:g} s"
            raise NoData(
                f"no data on {inbox.topic}: {heard}",
                remedy="Was ral.spin() called, and is the device running? "
                "ral.check_connections() says what is missing.",
            )
        return found

    def _value(self, found: Received, field: str | None) -> Any:
        value: Any = found.value
        if field is not None:
            return np.array(getattr(value, field))
        if isinstance(value, JointState):
            return [np.array(value.position), np.array(value.velocity), np.array(value.effort)]
        if isinstance(value, Pose):
            return to_kdl(value) if self._kdl else value
        return np.array(value.values if hasattr(value, "values") else value.vector)

    def _answer(self, value: Any, stamp: float, extra: Any) -> Any:
        """Return a value, or with `extra` and its stamp in s."""
        if isinstance(value, list):
            return [*value, stamp]
        return [value, stamp] if extra else value

    # ------------------------------------------------------------------------------------- commands

    def _sender(self, name: str, command: Command, outbox: Outbox) -> Callable[..., Any]:
        if command.payload is Payload.EMPTY:
            return lambda: outbox.send_message(TYPES[Payload.EMPTY]())
        if command.level is Level.MOVE:
            return lambda goal: self._move(name, command, outbox, goal)

        def send(setpoint: Any, velocity: Any = None) -> None:
            self._send(command, outbox, setpoint, velocity)

        return send

    def _send(
        self,
        command: Command,
        outbox: Outbox,
        setpoint: Any,
        velocity: Any = None,
        stamp: int = 0,
    ) -> Value | None:
        if outbox.accepts(setpoint):
            outbox.send_message(setpoint)
            return None
        value = value_for(command, setpoint, self._ral.namespace())
        if velocity is not None and isinstance(value, JointState) and np.size(velocity):
            value = JointState(value.position, vector(velocity), value.effort)
        outbox.publish(value, stamp=stamp)
        return value

    def _move(self, name: str, command: Command, outbox: Outbox, goal: Any) -> WaitMoveHandle:
        tracker = self._tracker
        if tracker is None:
            self._send(command, outbox, goal)
            return WaitMoveHandle(None)
        ready = outbox.accepts(goal)
        value = None if ready else value_for(command, goal, self._ral.namespace())
        stamp = outbox.stamp(goal)
        kind = "js" if command.payload is Payload.JOINT_STATE else "cp"
        setpoint = self._inboxes.get(f"setpoint_{kind}")
        told = self._goals(kind) if command.is_relative else None
        arrival = arrival_of(command, setpoint, value, told, stamp)
        move = tracker.follow(name, stamp, arrival)
        self._send(command, outbox, goal if ready else value, stamp=stamp)
        tracker.replace(name, move)
        return WaitMoveHandle(move)

    def _goals(self, kind: str) -> ToldGoals | None:
        inbox = self._inboxes.get(f"goal_{kind}")
        if inbox is not None and kind not in self._told:
            self._told[kind] = ToldGoals(inbox)
        return self._told.get(kind)

    def _query(self, name: str, caller: Caller) -> Callable[..., Any]:
        def forward(jp: Any, extra: Any = None) -> Any:
            try:
                pose = caller.forward_kinematics(vector(jp), SERVICE_TIMEOUT)
            except KinematicsError as error:
                if not extra:
                    raise
                return [None, False, error.message]
            answer = to_kdl(pose) if self._kdl else pose
            return [answer, True, ""] if extra else answer

        def inverse(jp: Any, cp: Any, extra: Any = None) -> Any:
            try:
                joints = caller.inverse_kinematics(as_pose(cp), vector(jp), SERVICE_TIMEOUT)
            except KinematicsError as error:
                if not extra:
                    raise
                return [np.array(jp), False, error.message]
            return [np.array(joints), True, ""] if extra else np.array(joints)

        return forward if name == "forward_kinematics" else inverse

    # ------------------------------------------------------------------------------ operating state

    @property
    def _tracker(self) -> StatusTracker | None:
        owner = self._instance if self._state_owner is None else self._state_owner
        tracker: StatusTracker | None = getattr(owner, _TRACKER, None)
        return tracker

    def add_operating_state(self) -> None:
        """Add ``operating_state``, ``state_command``, ``enable``, ``is_busy``, ``wait_for_busy``, ..."""
        if hasattr(self._instance, "operating_state"):
            raise RuntimeWarning("operating_state already exists")
        ral, link = self._ral, self._ral.link
        commands: Outbox = ral.track(link.outbox(ral.add_namespace("state_command"), Payload.TEXT))
        topic = ral.add_namespace("operating_state")
        tracker = StatusTracker(
            link,
            ral.namespace(),
            topic,
            TYPES[Payload.OPERATING_STATE],
            refusals=ral.add_namespace("refusals"),
            service=topic,  # so that the topic is taken as volatile
            heartbeat=False,
            alone=lambda name: link.publishers(ral.add_namespace(name)) <= 1,
            past_refusals=False,
        )
        ral.track(tracker.subscribe()[0])
        setattr(self._instance, _TRACKER, tracker)
        for name, method in _StateMethods(tracker, commands, ral, self._answer).table().items():
            setattr(self._instance, name, method)

    def add_state_command(self) -> None:
        """It comes with `add_operating_state`."""
        self.add_operating_state()


class UtilsWithStamps(Utils):
    """As `Utils`, with the calls of release 1.4: feedback comes with its stamp.

    Args:
        connection_timeout: seconds after which the last message is too old.
    """

    def __init__(
        self,
        class_instance: Any,
        ral: Ral,
        connection_timeout: float = 1.0,
        operating_state_instance: Any = None,
    ) -> None:
        super().__init__(class_instance, ral, connection_timeout, operating_state_instance)

    @override
    def _getter(self, inbox: Inbox, field: str | None) -> Callable[..., Any]:
        plain = super()._getter(inbox, field)

        def getter(
            wait_timeout: float | None = None,
            age: float | None = None,
            wait: float | None = None,
            extra: Any = None,
        ) -> Any:
            return plain(age, wait if wait_timeout is None else wait_timeout, extra)

        return getter

    @override
    def _answer(self, value: Any, stamp: float, extra: Any) -> Any:
        return (*value, stamp) if isinstance(value, list) else (value, stamp)


class _StateMethods:
    """What `add_operating_state` adds."""

    def __init__(
        self,
        tracker: StatusTracker,
        commands: Outbox,
        ral: Ral,
        answer: Callable[[Any, float, Any], Any],
    ) -> None:
        self._tracker = tracker
        self._commands = commands
        self._ral = ral
        self._answer = answer

    def table(self) -> dict[str, Callable[..., Any]]:
        """Return the methods by name."""
        enabled, disabled = OperatingState.ENABLED, OperatingState.DISABLED
        paused = OperatingState.PAUSED
        return {
            "operating_state": self.operating_state,
            "wait_for_operating_state": self.wait_for_operating_state,
            "state_command": self.state_command,
            "operating_state_command": self.state_command,
            "is_enabled": lambda: self._tracker.latest.state is enabled,
            "is_disabled": lambda: self._tracker.latest.state is disabled,
            "is_homed": self.is_homed,
            "is_busy": self.is_busy,
            "wait_for_busy": self.wait_for_busy,
            "enable": lambda timeout=0.0: self._reach("enable", enabled, timeout),
            "disable": lambda timeout=0.0: self._reach("disable", disabled, timeout),
            "pause": lambda timeout=0.0: self._reach("pause", paused, timeout),
            "resume": lambda timeout=0.0: self._reach("resume", enabled, timeout),
            "home": lambda timeout=0.0: self._home("home", True, timeout),
            "unhome": lambda timeout=0.0: self._home("unhome", False, timeout),
        }

    def _stamp(self) -> float:
        latest = self._tracker.inbox.latest
        return 0.0 if latest is None else latest.wall_ns / 1e9

    def operating_state(self, extra: Any = None) -> Any:
        """Return the state in words; empty before it was heard."""
        state = str(self._tracker.latest.state.value) if self._tracker.has_status else ""
        return [state, self._stamp()] if extra else state

    def is_homed(self, extra: Any = None) -> Any:
        """Return whether positions can be trusted."""
        homed = self._tracker.has_status and self._tracker.latest.is_homed
        return [homed, self._stamp()] if extra else homed

    def is_busy(self, start_time: Any = None, extra: Any = None) -> Any:
        """Return whether it is busy; True as long as nothing was heard since `start_time`."""
        busy = self._tracker.latest.is_busy if self._heard_since(start_time) else True
        return [busy, self._stamp()] if extra else busy

    def wait_for_busy(
        self, is_busy: bool = False, start_time: Any = None, timeout: float = 30.0
    ) -> bool:
        """Wait until it is busy, or has been since `start_time` (default now) and is no more."""
        watch = self._tracker.watch()
        seen = (
            start_time is not None
            and not is_busy
            and self._heard_since(start_time)
            and not self._tracker.latest.is_busy
        )
        end = time.monotonic() + timeout
        try:
            while not seen:
                event = watch.next(max(0.0, end - time.monotonic()))
                if event is None:
                    return False
                seen = isinstance(event, Status) and event.is_busy is is_busy
            return True
        finally:
            self._tracker.unwatch(watch)

    def _heard_since(self, start_time: Any) -> bool:
        """Whether a status has arrived since a time by the clock of this program, or ever if it is None.

        Not by the stamp of the status: that is of the device's machine, whose clock may be another one.
        """
        if start_time is None:
            return self._tracker.has_status
        passed: float = (self._ral.now().nanoseconds - start_time.nanoseconds) / 1e9
        return self._tracker.silence < passed

    def wait_for_operating_state(self, expected_state: str, timeout: float) -> bool:
        """Wait until the state is as asked; return whether it was in time."""
        return self._tracker.wait_for(lambda status: status.state == expected_state, timeout)

    def state_command(self, state: str) -> None:
        """Send a state command."""
        self._publish(state)

    def _publish(self, state: str) -> int:
        """Send a state command, and return its stamp (ns)."""
        stamp = time.time_ns()
        self._commands.publish(state, stamp=stamp)
        return stamp

    def _reach(self, command: str, state: OperatingState, timeout: float) -> bool:
        if self._tracker.has_status and self._tracker.latest.state is state:
            self.state_command(command)
            return True
        return self._carry_out(command, lambda status: status.state is state, timeout)

    def _home(self, command: str, homed: bool, timeout: float) -> bool:
        if self._tracker.has_status and self._tracker.latest.is_homed is homed:
            self.state_command(command)
            return True
        return self._carry_out(
            command, lambda status: status.is_homed is homed and not status.is_busy, timeout
        )

    def _carry_out(self, command: str, done: Callable[[Status], bool], timeout: float) -> bool:
        """Send a command; return whether a status that arrives in time says that it is done.

        `enable` waits for a driver that has not reached its device yet, and is then sent again: once for
        each time that it was refused so, and not after another command, which it would contradict.
        """
        watch = self._tracker.watch()
        end = time.monotonic() + timeout
        unreached: CommandRefused | None = None
        was_lost = False
        try:
            stamp = self._publish(command)
            while True:
                event = watch.next(max(0.0, end - time.monotonic()))
                if event is None:
                    is_done = self._tracker.has_status and done(self._tracker.latest)
                    if unreached is not None:
                        logger.warning("%s", unreached)
                    elif timeout > 0.0 and not is_done and _is_lost(self._tracker.latest):
                        logger.warning(
                            "%s: it is in FAULT; the topic diagnostics says why", command
                        )
                    return is_done
                if isinstance(event, Status):
                    if done(event):
                        return True
                    came_back = was_lost and not _is_lost(event)
                    was_lost = _is_lost(event)
                elif event.command == "state_command" and event.stamp_ns == stamp:
                    if command != "enable" or event.reason is not Reason.NOT_CONNECTED:
                        logger.warning("%s", event)
                        return False
                    unreached = event
                    was_lost = not self._tracker.has_status or _is_lost(self._tracker.latest)
                    came_back = not was_lost  # since then
                elif unreached is not None and _contradicts(event, command):
                    logger.warning("%s is not sent again: after it came %s", command, event)
                    return False
                else:
                    continue
                if unreached is not None and came_back:
                    # Forgotten: DISABLED that comes later may be what somebody has asked for.
                    unreached = None
                    stamp = self._publish(command)
        finally:
            self._tracker.unwatch(watch)


def _contradicts(refused: CommandRefused, command: str) -> bool:
    """Whether a refused command of whomever asks for something else than `command`: each one is told."""
    if refused.command == "hold":
        return True
    return refused.command == "state_command" and refused.state_command != command


def _is_lost(status: Status) -> bool:
    """Whether a driver may be without its device: only in FAULT is it, and DISABLED follows."""
    return status.state is OperatingState.FAULT

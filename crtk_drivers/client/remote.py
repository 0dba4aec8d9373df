"""A device on the far side of ROS 2, with the names and values of one in your own process.

Topics are subscribed to and published when they are first used (`arm.measured_js()`), or ahead of that
by `connect(..., features=[...])` and `add`. That first use waits until both ends have met: up to about three
seconds, once.

What differs from `crtk_drivers.front.LocalDevice`, because there is a network in between:

* A refused move raises from the call, like there: the call returns when the device has said yes. A refused
  servo or interpolate command raises from the *next* call of that name, so that a stream never waits.
* Frame ids are those on ROS: ``ur5/base``.
* There are no `engine`, `sim` and `health`; the last is on ``/diagnostics``.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Self

from typing_extensions import override

from crtk_drivers.client.goals import ToldGoals, arrival_of
from crtk_drivers.client.move_handle import RemoteMove
from crtk_drivers.client.space import NotOffered, Space
from crtk_drivers.client.state_commands import Transition
from crtk_drivers.commands import CHILDREN, Command, Level, Payload, find, is_name
from crtk_drivers.errors import (
    CommandRefused,
    ConnectionFailed,
    ConnectionLost,
    DataTimeout,
    StopUnconfirmed,
)
from crtk_drivers.front.base import PARTS, DeviceFront, OfferedDoc, Reader, did_you_mean
from crtk_drivers.front.method_forms import documented, form_of
from crtk_drivers.front.payloads import value_for
from crtk_drivers.ros import environment
from crtk_drivers.ros.names import checked_namespace
from crtk_drivers.samples import Value
from crtk_drivers.state import REPEATED, STOPS, Status, parse_command, target_of

if TYPE_CHECKING:
    from crtk_drivers.client.announcements import StatusTracker
    from crtk_drivers.client.inbox import Inbox, Received
    from crtk_drivers.client.ros_link import Caller, Outbox
    from crtk_drivers.front.kinds import AnyDevice
else:
    AnyDevice = object  # the methods are made at their first use

CONNECT_TIMEOUT = 10.0
"""Seconds in which a device, or the other end of a topic, must be found."""
SERVICE_TIMEOUT = 5.0
"""Seconds in which a service must answer, unless `timeout` says otherwise."""
GRACE = 0.1
"""Seconds in which the refusal of `hold` or `free` arrives: there is no other answer to them."""
CONFIRM_TIMEOUT = 2.0
"""Seconds in which those who listen confirm that a stop, or `free`, has arrived."""
REPEAT = 0.1
"""Seconds after which a stop that was not confirmed is sent again."""
ANSWER_TIMEOUT = 0.3
"""Seconds in which all who listen confirm a stop; else the device is asked whether it is there."""

logger = logging.getLogger(__name__)


class RemoteDevice(DeviceFront, AnyDevice):
    """A device in a ROS namespace. Made by `connect`; close it, or use it in a ``with`` statement.

    Thread-safe. Nothing waits for ever: what waits has a timeout, or ends when the device is gone.
    """

    if not TYPE_CHECKING:
        __doc__ = OfferedDoc(__doc__)

    def __init__(self, space: Space, prefix: str = "") -> None:
        self._space = space
        self._prefix = prefix
        self._children: dict[str, RemoteDevice] = {}

    # ----------------------------------------------------------------------------------- life cycle

    @override
    def close(self) -> None:
        """Leave ROS. The device goes on as it is: neither stopped nor disabled."""
        self._space.link.close()

    @override
    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.namespace!r} {self._space.condition}>"

    @override
    def __dir__(self) -> Iterable[str]:
        """Return the names of methods, also of those that are made at their first use."""
        offered = list(self.summaries())
        parts = [part for part, (whole, _) in PARTS.items() if whole in offered]
        return {*super().__dir__(), *(name.partition("/")[0] for name in offered), *parts}

    @property
    def namespace(self) -> str:
        """Where it is on ROS."""
        return self._space.namespace

    @property
    def manifest(self) -> Mapping[str, Any]:
        """The capability manifest as the device published it; empty for a device that has none."""
        return self._space.catalogue.manifest

    @property
    @override
    def crtk_commands(self) -> Mapping[str, Command]:
        """The CRTK names that this device offers now."""
        return {name: feature.command for name, feature in self._space.features().items()}

    @override
    def summaries(self) -> Mapping[str, str]:
        """Return what the device offers now, with one line for each name; nothing once this is closed."""
        return super().summaries() if self._space.link.is_open else {}

    # -------------------------------------------------------------------------------- à la carte

    if not TYPE_CHECKING:  # to a type checker a name that is not listed is a mistake

        def __getattr__(self, name: str) -> Any:
            """Make a CRTK method or a sub-namespace when it is first used."""
            if name.startswith("_"):
                raise AttributeError(f"{type(self).__name__} has no attribute {name!r}")
            try:
                if name in CHILDREN:
                    return self.child(name, timeout=None if self._space.tells_of(name) else 0.0)
                if name not in PARTS and not self._is_name(name):
                    meant = did_you_mean(name, {**self.summaries(), **PARTS})
                    if name in self.manifest.get("services", {}):
                        meant = f"It has a service of that name: call({name!r}). "
                    raise NotOffered(
                        f"{type(self).__name__} has no attribute {name!r}. {meant}"
                        "crtk_commands has all that it offers."
                    )
                method = self._make(name)
            except NotOffered as error:
                raise AttributeError(str(error)) from None
            except ConnectionFailed:
                if name not in CHILDREN:
                    raise
                raise AttributeError(f"{self.namespace} has nothing in {name}/") from None
            setattr(self, name, method)
            return method

    def add(self, *names: str, timeout: float | None = None) -> Self:
        """Set these CRTK names up now, instead of at their first use, and wait until all are connected.

        Args:
            names: ``measured_js``, ``servo_cp``, ``local/measured_cp``, ``operating_state``, ...
            timeout: in seconds, for all of them; None: as given to `connect`.

        Raises:
            ConnectionFailed: the device does not offer one, or its other end was not found in time.
        """
        space = self._space
        limit = space.timeout if timeout is None else timeout
        deadline = time.monotonic() + limit
        for name in names:
            sub, _, base = name.rpartition("/")
            target = space.child(sub, limit) if sub else space
            try:
                if base == "operating_state":
                    target.status()
                else:
                    target.endpoint(PARTS.get(base, (base, ""))[0])
            except NotOffered as error:
                raise ConnectionFailed(str(error)) from None
        self.check_connections(max(0.0, deadline - time.monotonic()))
        return self

    @override
    def child(self, name: str, timeout: float | None = None) -> RemoteDevice:
        """Return the device in a sub-namespace, for example ``gripper``; it need not be a CRTK word.

        It has its own operating state if it publishes one, and otherwise that of this device.

        Args:
            name: without a slash at its ends.
            timeout: in seconds; None: as given to `connect`.

        Raises:
            ConnectionFailed: there is nothing in `timeout` s; at once if the device's manifest does not list
                it, with the names that there are.
        """
        if name not in self._children:
            limit = self._space.timeout if timeout is None else timeout
            space = self._space.child(name, limit)
            self._children.setdefault(name, RemoteDevice(space, f"{name}/"))
        return self._children[name]

    def check_connections(self, timeout: float = 5.0) -> None:
        """Wait until everything used so far, sub-namespaces included, has met its other end.

        Raises:
            ConnectionFailed: what is missing on the other side.
        """
        self._space.wait_connected(self._space.all_endpoints(), timeout)

    def _is_name(self, name: str) -> bool:
        return is_name(name) or is_name(f"{self._prefix}{name}")

    def _command(self, name: str) -> Command:
        """Return the row of a name, some of which exist in a sub-namespace only."""
        return find(name if is_name(name) else f"{self._prefix}{name}")

    def _make(self, name: str) -> Callable[..., Any]:
        whole, field = PARTS.get(name, (name, ""))
        method = self._method(whole, self._command(whole), field)
        method.__name__ = name
        full = f"{self._prefix}{whole}"
        return documented(method, form_of(find(full if is_name(full) else whole), field))

    # --------------------------------------------------------------------------------- feedback

    @override
    def _reader(self, name: str) -> Reader:
        inbox: Inbox = self._space.connected(name)
        is_latched = self._command(name).level in (Level.GOAL, Level.SETTING)

        def read(oldest: float, timeout: float) -> tuple[Value, int]:
            def is_fresh(received: Received) -> bool:
                if is_latched or oldest == 0.0:
                    return True
                return received.wall_ns != 0 and time.monotonic() - received.since <= oldest

            found = inbox.wait_for(is_fresh, timeout)
            if found is None:
                raise self._no_data(name, inbox, oldest)
            return found.value, found.wall_ns

        return read

    def _no_data(self, name: str, inbox: Inbox, oldest: float) -> DataTimeout:
        latest = inbox.latest
        if not inbox.connected:
            what, remedy = "nobody publishes it", "Is the driver still running?"
        elif inbox.problem:
            what, remedy = inbox.problem, "Does its publisher have the same definition of the type?"
        elif latest is None:
            what, remedy = "no value yet", "If the node is your own, is it spun?"
        else:
            reason = "stamped as not valid" if latest.wall_ns == 0 else "too old"
            what = f"nothing valid and newer than {oldest:g} s; the last value is {reason}"
            remedy = "Pass age=0 to take the last value whatever its age."
        tracker = self._space.tracker
        state = "" if tracker is None else f"; the device is {tracker.latest.state}"
        return DataTimeout(f"{name}: {what}{state}", where=self.namespace, remedy=remedy)

    def on(self, name: str, callback: Callable[[Value, float], Any]) -> Callable[[], None]:
        """Call `callback(value, stamp)` for each value of a feedback; return what ends that.

        The stamp is in seconds, 0 for a value that is not valid. Called from the thread that spins, and once
        from here with what is latched and has come before: it must return soon, and cannot wait for other
        feedback.
        """
        inbox: Inbox = self._space.connected(name)

        def listen(received: Received) -> None:
            callback(received.value, received.wall_ns / 1e9)

        inbox.add_listener(listen)
        return lambda: inbox.remove_listener(listen)

    # ------------------------------------------------------------------------------- beyond CRTK

    def on_message(self, topic: str, callback: Callable[[Any], Any]) -> Callable[[], None]:
        """Call `callback(message)` with each ROS message of any topic; return what ends that. See `on`.

        Args:
            topic: a CRTK name, another name in this namespace, or a full name: ``/diagnostics``.
            callback: must return soon.

        Raises:
            ConnectionFailed: nobody publishes it.
            ConfigError: its type is not known here.
        """
        inbox = self._space.published(topic)

        def listen(received: Received) -> None:
            callback(received.message)

        inbox.add_listener(listen)
        return lambda: inbox.remove_listener(listen)

    def call(
        self,
        service: str,
        fields: Mapping[str, Any] = MappingProxyType({}),
        timeout: float = SERVICE_TIMEOUT,
    ) -> Any:
        """Call any service, and return the answer as plain data.

        Args:
            service: a name in this namespace, or a full one.
            fields: of the request; those of inner messages in a mapping.
            timeout: in seconds.

        Raises:
            ConnectionFailed: nobody serves it; says what is served.
            ConfigError: there is no such field, or its type is not known here.
            DataTimeout: no answer in time.
        """
        from crtk_drivers.ros.plain import plain

        return plain(self._space.service(service).call_plain(timeout, fields))

    # --------------------------------------------------------------------------------- commands

    @property
    @override
    def _named(self) -> str:
        return self.namespace

    @override
    def _sender(self, name: str, command: Command) -> Callable[..., Any]:
        outbox: Outbox = self._space.connected(name)
        if command.level is Level.MOVE:
            return self._mover(name, command, outbox)
        if name == "hold":
            return self._holder(command, outbox)
        tracker = self._tracker()
        if not command.is_motion:
            return self._plain_sender(command, outbox, tracker)

        def stream(value: Any) -> None:
            if tracker is not None:
                tracker.sending(name)
            self._send(outbox, command, value)

        return stream

    def sender(self, name: str) -> Callable[[Any], None]:
        """Return what sends a command at once and waits for no answer: refusals come by `on_refusal`.

        It takes the value of the command, and None for `hold` and `free`; it raises ConnectionLost when
        nobody listens. For loops that must go on, whatever the device says.

        Raises:
            ConnectionFailed: nobody listens to it in time.
        """
        outbox: Outbox = self._space.connected(name)
        command = self._command(name)

        def send(value: Any) -> None:
            if name == "hold":
                self._is_stopping()
            if command.payload is Payload.EMPTY:
                outbox.send(None)
            else:
                self._send(outbox, command, value)

        return send

    def _send(self, outbox: Outbox, command: Command, value: Any, stamp: int = 0) -> Value | None:
        """Send a value and return it; None if it was a ready message."""
        if outbox.accepts(value):
            outbox.send_message(value)
            return None
        payload = value_for(command, value, self.namespace)
        outbox.send(payload, getattr(payload, "frame_id", ""), stamp)
        return payload

    def _tracker(self) -> StatusTracker | None:
        try:
            return self._space.status()
        except NotOffered:
            return None  # nobody will say whether a command was accepted

    def _holder(self, command: Command, outbox: Outbox) -> Callable[[], None]:
        """Return what sends `hold`: before the state is first waited for, and again when it is heard."""
        sender: Callable[[], None] | None = None

        def hold() -> None:
            nonlocal sender
            self._is_stopping()
            if sender is None:
                if not self._space.hears_status:
                    outbox.send(None)
                    self._require_arrival(command.name, outbox)
                sender = self._plain_sender(command, outbox, self._tracker())
            sender()

        return hold

    def _is_stopping(self) -> None:
        """Note that a stop is about to be sent."""
        if (tracker := self._space.tracker) is not None:
            tracker.stopping()

    def _require_arrival(self, name: str, outbox: Outbox, stamp: int = 0) -> None:
        """Make sure that what was sent has arrived: a stop may be the last thing before a link is closed.

        A stop is sent again meanwhile: what a full socket drops, Fast DDS sends again only after 3 s.
        Somebody else who listens and stands still is no reason to fail while the device answers. Of two
        drivers in a namespace one may answer for the other, which moves.

        Args:
            name: of what was sent.
            outbox: that it was sent by.
            stamp: of a state command; the driver knows it again by that.

        Raises:
            StopUnconfirmed: nobody confirmed a stop.
            ConnectionLost: nor anything else.
        """
        is_stop = name == "hold" or name in STOPS
        deadline = time.monotonic() + CONFIRM_TIMEOUT
        asks_at = time.monotonic() + ANSWER_TIMEOUT
        while not outbox.confirmed(REPEAT):
            now, listeners = time.monotonic(), outbox.listeners
            if now >= deadline:
                break
            if listeners > 1 and now >= asks_at:
                if self._space.drivers <= 1 and self._space.answers(ANSWER_TIMEOUT):
                    logger.warning(
                        "%s: %s was sent. One of the %d who listen has not confirmed it, but the device "
                        "answers.",
                        self.namespace,
                        name,
                        listeners,
                    )
                    return
                asks_at = math.inf
            if is_stop and listeners:
                outbox.publish(None if name == "hold" else str(name), REPEATED, stamp)
        else:
            return
        drivers = self._space.drivers
        raise (StopUnconfirmed if is_stop else ConnectionLost)(
            f"{name} was sent, and "
            + ("nobody" if listeners <= 1 else f"not all of the {listeners} who listen")
            + (f" (of {drivers} drivers)" if drivers > 1 else "")
            + f" confirmed it in {CONFIRM_TIMEOUT:g} s",
            where=self.namespace,
            remedy="Is the link gone, or does the driver stand still? "
            + ("If it moves, press its emergency stop." if is_stop else "Send it again."),
        )

    def _plain_sender(
        self, command: Command, outbox: Outbox, tracker: StatusTracker | None
    ) -> Callable[..., None]:
        def carry_out(send: Callable[[], object]) -> None:
            if tracker is None:
                send()
            else:
                watch = tracker.watch()
                try:
                    send()
                    watch.raise_refusal(command.name, GRACE)
                finally:
                    tracker.unwatch(watch)
            if command.level is Level.STATE:
                self._require_arrival(command.name, outbox)
                if tracker is not None:
                    tracker.replace(command.name)

        if command.payload is Payload.EMPTY:
            return lambda: carry_out(lambda: outbox.send(None))
        return lambda value: carry_out(lambda: self._send(outbox, command, value))

    def starter(self, name: str) -> Callable[[Any], RemoteMove]:
        """Return what begins a move at once and waits for no answer: what is refused ends its handle.

        For programs that must go on reading: the next thing that they are told may be `hold`.

        Raises:
            ConnectionFailed: nobody listens to it in time.
        """
        return self._mover(name, self._command(name), self._space.connected(name), waits=False)

    def _mover(
        self, name: str, command: Command, outbox: Outbox, *, waits: bool = True
    ) -> Callable[[Any], RemoteMove]:
        tracker = self._space.status()
        setpoint, told = self._aims(command)

        def move(goal: Any) -> RemoteMove:
            ready = outbox.accepts(goal)
            value = None if ready else value_for(command, goal, self.namespace)
            stamp = outbox.stamp(goal)
            arrival = arrival_of(command, setpoint, value, told, stamp)
            before = None if waits else tracker.newest  # which goes on where this one is refused
            handle = tracker.follow(name, stamp, arrival)
            try:
                self._send(outbox, command, goal if ready else value, stamp)
                if waits:
                    handle.confirm()
            except BaseException as error:
                handle.replaced(type(error).__name__)
                raise
            tracker.replace(name, handle, before)
            return handle

        return move

    def _aims(self, command: Command) -> tuple[Inbox | None, ToldGoals | None]:
        """Return the setpoint that a move leads to its goal, and, if it is relative, the goals that are told.

        Relative moves in a frame of their own are in a sub-namespace, which has no goals.
        """
        kind = "js" if command.payload is Payload.JOINT_STATE else "cp"
        names = [f"{what}_{kind}" for what in ("setpoint", "goal")[: 1 + command.is_relative]]
        space: Space | None = self._space
        while space is not None and not set(names) <= space.features().keys():
            space = space.parent if command.is_relative else None
        if space is None:
            return None, None
        setpoint, *goals = (space.connected(each) for each in names)
        return setpoint, ToldGoals(goals[0]) if goals else None

    @override
    def _query(self, name: str, command: Command) -> Callable[..., Any]:
        caller: Caller = self._space.connected(name)
        is_forward = command.payload is Payload.FORWARD_KINEMATICS
        return caller.forward_kinematics if is_forward else caller.inverse_kinematics

    # ------------------------------------------------------------------------------ operating state

    @override
    def operating_state(self) -> Status:
        """Return state, is_homed and is_busy, as heard last.

        Raises:
            ConnectionLost: the device is not heard any more.
            ConnectionFailed, DataTimeout: at the first use, none was heard in time.
        """
        tracker = self._space.status()
        lost = tracker.lost()
        if lost:
            raise ConnectionLost(lost, where=self.namespace, remedy="Is the driver still running?")
        return tracker.latest

    @override
    def wait_for_status(self, test: Callable[[Status], bool], timeout: float) -> bool:
        """Wait until `test` holds for an announced status; return whether it did in time."""
        return self._space.status().wait_for(test, timeout)

    def on_status(self, callback: Callable[[Status], Any]) -> Callable[[], None]:
        """Call `callback(status)` whenever the status is another; return what ends that. See `on`."""
        return self._space.status().on_status(callback)

    def on_refusal(self, callback: Callable[[CommandRefused], Any]) -> Callable[[], None]:
        """Call `callback(refusal)` for each refusal that the device tells, also of other clients."""
        return self._space.status().on_refusal(callback)

    @override
    def state_command(self, command: str, timeout: float = 30.0) -> None:
        deadline = time.monotonic() + timeout
        wanted = parse_command(command)
        space = self._space
        if space.parent is not None and "state_command" not in space.features():
            space = space.parent
        try:
            outbox = space.connected("state_command")
            heard = space.tracker
            known = heard.latest.state if heard is not None and heard.has_status else None
            stamp = time.time_ns()
            if wanted in STOPS:  # at once, whatever is heard of the device, and again below
                self._is_stopping()
                outbox.send(str(wanted.value), stamp=stamp)
                self._require_arrival(wanted.value, outbox, stamp)
            tracker = space.status()
        except NotOffered as error:
            raise ConnectionFailed(str(error)) from None
        tracker.refresh(SERVICE_TIMEOUT if timeout > 0.0 else GRACE)
        before = self.operating_state()
        watch = tracker.watch()  # from here on: what was still on its way is no answer
        try:
            target = target_of(before.state, wanted)
            if wanted in STOPS and before.state is target is not known:
                return  # it has stopped since: one that tells changes only would tell no more
            if wanted in STOPS:
                outbox.send(str(wanted.value), REPEATED, stamp)
            else:
                stamp = time.time_ns()
                outbox.send(str(wanted.value), stamp=stamp)
            if wanted in STOPS or timeout <= 0.0:
                self._require_arrival(wanted.value, outbox, stamp)
            if timeout > 0.0:
                transition = Transition(wanted, before, target)
                transition.wait(watch, deadline, self.namespace, stamp)
        except CommandRefused as refusal:
            raise refusal.of(refusal.stamp_ns, self.namespace) from refusal.__cause__
        finally:
            tracker.unwatch(watch)


def connect(
    namespace: str,
    *,
    timeout: float = CONNECT_TIMEOUT,
    features: Iterable[str] = (),
    node: Any = None,
    executor: Any = None,
    ros_args: Sequence[str] = (),
) -> RemoteDevice:
    """Find the CRTK device in a ROS 2 namespace.

    Args:
        namespace: ``/ur5``; the leading slash may be left out, and one at the end does no harm.
        timeout: seconds in which it, and later each topic's other end, must be found.
        features: CRTK names to set up at once, see `RemoteDevice.add`; others follow at first use.
        node: your own rclpy node to use; you spin it, in another thread than the one that calls.
        executor: your own executor; a node is added to it, and you spin it.
        ros_args: for the client's own node: ``["--ros-args", "-r", "/ur5/servo_jp:=/filtered"]``.

    Raises:
        MissingExtra, ConfigError: ROS 2 cannot be used here, or that is no namespace.
        ConnectionFailed: there is no such device, or it lacks one of the features.
    """
    namespace = checked_namespace(f"/{namespace.strip('/')}", option="")
    environment.check()
    from crtk_drivers.client.ros_link import Link

    link = Link(node=node, executor=executor, ros_args=ros_args)
    try:
        link.start()
        space = Space(link, namespace, timeout)
        space.catalogue.wait(timeout)
        return RemoteDevice(space).add(*features)
    except BaseException:
        link.close()
        raise

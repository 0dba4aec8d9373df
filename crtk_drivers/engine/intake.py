"""What clients ask of one device, checked in their own threads.

Everything is checked at once, and nothing touches the bus: what passed lies in a mailbox, or with the state
commands, until the I/O thread (`crtk_drivers.engine.cycle`) takes it.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import replace

from crtk_drivers.commands import FOLLOW, Command, Level
from crtk_drivers.device import Device, Note, Ratios, Service
from crtk_drivers.device.offered import (
    WRENCH_AXES,
    follows_trajectories,
    missing_for,
    offered,
    without_state,
)
from crtk_drivers.engine.as_messages import Messages
from crtk_drivers.engine.checked_readings import checked_readings
from crtk_drivers.engine.newest import Newest
from crtk_drivers.engine.services import OwnService, Request, Requests
from crtk_drivers.engine.tether import Tether
from crtk_drivers.engine.transitions import Transitions
from crtk_drivers.engine.turns import Turns
from crtk_drivers.engine.waiting import Waiting, WaitingMove
from crtk_drivers.errors import (
    CommandRefused,
    KinematicsError,
    Reason,
)
from crtk_drivers.gates.command import CommandCheck
from crtk_drivers.gates.setpoint import SetpointLimiter
from crtk_drivers.geometry.frames import relative
from crtk_drivers.motion.arbiter import NOBODY, Arbiter, Client, Order
from crtk_drivers.motion.context import MotionContext
from crtk_drivers.motion.executor import MotionExecutor
from crtk_drivers.motion.feedback import Feedback
from crtk_drivers.motion.inverse import Reach
from crtk_drivers.motion.move import Move, Outcome
from crtk_drivers.motion.orders import OrderMaker
from crtk_drivers.motion.past import Moment, Past
from crtk_drivers.motion.stopping import Stopping
from crtk_drivers.motion.told import Told
from crtk_drivers.options import EngineOptions
from crtk_drivers.samples import EMPTY, Flag, Number, Pose, Stamp, Text, Value, Vector
from crtk_drivers.state import STOPS, OperatingState, StateCommand, Status, parse_command
from crtk_drivers.status.board import Observer, StatusBoard
from crtk_drivers.status.health import Health, HealthRecorder

_AT_LIMIT = 1e-6
"""rad or m by which a solution of the inverse kinematics may lie beyond a limit: of rounding."""

_CHANGES = 64
"""State commands that are remembered, to know one again that is repeated."""

_WAY_TO_ENABLED = {
    OperatingState.DISABLED: "Enable it: enable() in Python, state_command in ROS.",
    OperatingState.PAUSED: "Let it go on: resume() in Python, state_command in ROS.",
    OperatingState.FAULT: "Remove the cause, then enable it: enable() in Python, state_command in ROS.",
}


class Intake:
    """Checks and accepts what clients ask of one device, and tells them of it. From any thread.

    Args:
        device: constructed, not open.
        name: of the device, for messages.
        options: the user's choices.
        clock: monotonic seconds.
        has_state: it has an operating state of its own; otherwise it follows that of another device (see
            `crtk_drivers.engine.borrowed_state`), and offers neither ``operating_state`` nor
            ``state_command``.
    """

    def __init__(
        self,
        device: Device,
        name: str,
        options: EngineOptions | None = None,
        clock: Callable[[], float] = time.monotonic,
        *,
        has_state: bool = True,
    ) -> None:
        self.device = device
        self.name = name
        self.where = f"{name} {device.address}"
        self.capabilities = device.capabilities
        self.has_state = has_state
        self.commands = offered(device) if has_state else without_state(offered(device))
        self.options = options or EngineOptions()
        self.on_sample: Callable[[], None] | None = None
        """Called by the I/O thread at the end of each cycle that brought a sample; must return at once."""
        self.keepers: tuple[Callable[[Moment], object], ...] = ()
        """Called by the I/O thread at the end of each cycle that brought a sample; must return at once."""
        self.hearers: tuple[Callable[[str, Value | None, int], object], ...] = ()
        """Called with each command that comes, its value and stamp, before it is checked; return at once."""
        self.standing: dict[str, str] = {}
        """What a front has told of the device, and holds: manifest and description, by topic."""
        self.own_notes: tuple[Note, ...] = ()
        """What the front has to say of the device, beside its own notes; replaced as a whole."""
        self.messages = Messages(self.capabilities)
        self._clock = clock
        self._turns = Turns()
        self._connected = False
        self._period = period = 1.0 / self.capabilities.rate
        stale_after = min(max(5.0 * period, 0.02), self.options.sample_timeout)
        self._feedback = Feedback(device, stale_after)
        self._told = Told(self._feedback)
        self.services: Mapping[str, Service | OwnService] = device.services
        self.inputs = device.inputs
        self.readings = checked_readings(device.readings, self.where)
        own_names = (FOLLOW.name, *self.services, *self.inputs)
        self._health = HealthRecorder(self.capabilities.rate, 2.0 * period, own_names)
        homed = not self.capabilities.needs_homing
        begun = f"connecting to {device.address} since {time.strftime('%H:%M:%S')}"
        connecting = Status(OperatingState.FAULT, homed, detail=begun, connecting=True)
        self._board = StatusBoard(connecting, self.where, self._health, clock)
        limits, axes = self.options.limits, self._feedback.axes
        self._check = CommandCheck(self.capabilities, limits, self.where, axes)
        self._stopping = Stopping(device, clock)
        self._context = context = MotionContext(
            device=device,
            where=self.where,
            options=self.options,
            feedback=self._feedback,
            told=self._told,
            check=self._check,
            limiter=SetpointLimiter(
                self.capabilities, limits, self.where, lambda: device.kinematics
            ),
            inverse=Reach(device, self.where, self._check, self._feedback),
            stopping=self._stopping,
            board=self._board,
            health=self._health,
        )
        self._stop_asked = False
        self._stops = 0  # that were asked for, or came of themselves; under the board's lock
        self._newest = Newest()  # under the board's lock
        self._changes: deque[int] = deque(maxlen=_CHANGES)
        """Stamps of state commands, 0 for a service that moves; under the board's lock."""
        self._can_wake = False
        self._orders = OrderMaker(context)
        self._arbiter = Arbiter(self.options, self.where)
        ends = self.options.on_client_gone == "hold", self.options.free_timeout
        self._freed, self._carried = Tether(*ends), Tether(*ends)
        self._motion = MotionExecutor(context, self._arbiter)
        self._told.latch(_ratio_values(self._orders.ratios))
        timeout = self.capabilities.transition_timeout
        self._requests = Requests(device.services, self.where, timeout)
        self._transitions = Transitions(context, self._motion.end)
        self._waiting = WaitingMove(self.where, self._board, self._transitions, self._begin_waiting)

    @property
    def status(self) -> Status:
        """The operating state as last announced."""
        return self._board.status

    @property
    def connected(self) -> bool:
        """Whether the device is open."""
        return self._connected

    @property
    def time_to_stop(self) -> float:
        """Seconds within which the device declares to stand after a stop, at its present pace."""
        return self._stopping.time

    @property
    def can_move(self) -> bool:
        """Whether the device has anything that moves, whose stop has to be read back."""
        return self._stopping.can_move

    @property
    def unseen(self) -> str:
        """What to say of a motion whose end nobody has seen, if there is one; else empty."""
        return self._stopping.unseen

    @property
    def has_sample(self) -> bool:
        """Whether the device has been read since it was connected."""
        return self._feedback.sample_age(self._clock()) < math.inf

    @property
    def is_at_rest(self) -> bool:
        """Whether no motion is carried out, nor waits to be."""
        moves = self.status.is_busy or self._arbiter.streams(self._clock())
        return self._motion.rests and not moves

    @property
    def stale_after(self) -> float:
        """Seconds after which a sample is no longer valid."""
        return self._feedback.stale_after

    @property
    def transition_ended(self) -> bool:
        """Whether no state command is being carried out."""
        with self._board.lock:
            return self._transitions.running is None

    @property
    def transition_outcome(self) -> Status:
        """The status in which the last state command ended."""
        return self._transitions.outcome

    def wait_for(self, test: Callable[[], object], timeout: float) -> bool:
        """Wait until `test` holds after a cycle; return whether it did within `timeout` s."""
        return self._turns.wait_for(test, timeout)

    def break_off(self, by: str) -> None:
        """End an `enable` or `resume` that may move; from any thread.

        Args:
            by: what stops it.
        """
        self._transitions.break_off(by)

    def end_service(self, by: str) -> None:
        """End a service that moves; from any thread, also under the lock of another device's board.

        Args:
            by: what stops it.
        """
        self._requests.break_off(by)

    def lend_busy(self, busy: bool) -> None:
        """Be busy while a device is that follows the operating state of this one; from any thread."""
        self._board.lend(busy)

    def add_observer(self, observer: Observer) -> None:
        """Tell `observer` from now on."""
        self._board.add(observer)

    def remove_observer(self, observer: Observer) -> None:
        """Tell `observer` no more."""
        self._board.remove(observer)

    def after_telling(self, call: Callable[[], object]) -> None:
        """Do what takes time, as a log does, once the lock is free under which observers are told."""
        self._board.lock.afterwards(call)

    def feedback(self, name: str) -> tuple[Value, Stamp] | None:
        """Return the newest value of ``measured_*``, ``setpoint_*`` or ``jacobian`` with its stamp.

        The stamp's `wall_ns` is 0 if the value is not valid now. None: there never was one.
        """
        return self._told.get(name, self._clock(), self.status.state)

    def latched(self, name: str) -> tuple[Value, Stamp] | None:
        """Return the newest value of ``goal_*`` or ``trajectory_j/ratio``, None before the first goal."""
        return self._told.latched(name)

    def health(self) -> Health:
        """Return the counters."""
        age = self._feedback.sample_age(self._clock())
        notes = (*self.device.notes, *self.own_notes)
        return self._health.snapshot(age, self.device.counters, notes)

    def past(self) -> Past:
        """Return what tells of moments that `keepers` got, to one thread."""
        return Past(self._feedback)

    def add_services(self, services: Mapping[str, OwnService]) -> None:
        """Offer services of ours, where the device has none of that name. Before a front is made."""
        self.services = {**services, **self.services}

    def tell_frames(self, told: Callable[[str], str]) -> None:
        """Name frames in refusals and messages by `told`, called with a frame id: on ROS with a prefix."""
        self._check.told_frame = self.messages.outgoing = told

    def forward_kinematics(self, joints: Vector, name: str = "forward_kinematics") -> Pose:
        """Return the tool pose of a joint position (n,).

        Args:
            joints: position.
            name: the pose is in the base frame, or in the device's own base by
                ``local/forward_kinematics``.

        Raises:
            CommandRefused: no kinematics, wrong size or not finite.
        """
        command, base = self._require(name), self.capabilities.base_pose
        pose = self._context.inverse.kinematics.forward(self._check.check_joints(command, joints))
        if command.frame == "local" and base is not None:
            return replace(relative(base, pose), frame_id="local")
        return pose

    def inverse_kinematics(self, pose: Pose, reference: Vector = EMPTY) -> Vector:
        """Return the joint position (n,) nearest to `reference` (default: the setpoint).

        Raises:
            CommandRefused: no kinematics, or a pose or reference that is no pose or reference; or none is
                given, and the device has not said where it is.
            KinematicsError: no solution within the limits.
        """
        command = self._require("inverse_kinematics")
        checked = self._check.check_pose(command, pose)
        if reference.size:
            reference = self._check.check_joints(command, reference)
        else:
            reference = self._context.inverse.reference(command)
        joints = self._context.inverse.kinematics.inverse(checked, reference)
        for name, limit, value in zip(
            self.capabilities.joints, self.capabilities.limits, joints.tolist(), strict=True
        ):
            if not limit.lower - _AT_LIMIT <= value <= limit.upper + _AT_LIMIT:
                raise KinematicsError(
                    f"the pose is out of reach: it takes {name} at {value:.4g}, "
                    f"which goes from {limit.lower:g} to {limit.upper:g}",
                    where=self.where,
                )
        return joints

    def submit(
        self,
        name: str,
        value: Value | None = None,
        stamp_ns: int = 0,
        client: Client = NOBODY,
        sent_ns: int = 0,
    ) -> Move | None:
        """Accept a command, to be executed in the next cycle; see `crtk_drivers.engine.waiting` for moves.

        Args:
            name: ``servo_jp``, ``move_cp``, ``hold``, ...
            value: of the type that the command table names; None for hold and free.
            stamp_ns: the sender's stamp, 0 if it gave none.
            client: who asks; see `crtk_drivers.motion.arbiter`.
            sent_ns: when it was sent, in ns since the epoch by this machine's clock, if that was before now.
                A command that was sent before a stop, or a change of state, came is not carried out after
                that. Of ``hold``: when it came.

        Returns:
            the handle of a move; None otherwise.

        Raises:
            CommandRefused: nothing was sent and nothing changed. Counted, and told to the observers.
        """
        for hear in self.hearers:
            hear(name, value, stamp_ns)
        try:
            command = self._require(name)
            if name == "hold":
                self._hold(command, client, sent_ns)
                return None
            if command.level is Level.SETTING:
                self._set(command, self._check.check(command, value), client)
                return None
            if command.level is not Level.MOVE:
                self._waiting.end(f"by {name}", Outcome.PREEMPTED)
            elif self._transitions.leads_to is OperatingState.ENABLED:
                checked = self._check.check(command, value, stamp_ns, time.time_ns())
                waiting = Waiting(command, checked, stamp_ns, client, Move(name))
                with self._board.lock:
                    self._require_newest(name, sent_ns)
                    if self._waiting.put(waiting):
                        return waiting.move
            return self._carry_out(command, value, stamp_ns, client, sent_ns=sent_ns)
        except CommandRefused as refusal:
            told = refusal.of(stamp_ns)
            self._board.refused(told)
            raise told from refusal.__cause__

    def end_move(self, move: Move, reason: str, client: Client = NOBODY) -> None:
        """Stop where a move is, and hold; it ends as pre-empted.

        Nothing is done if it has ended, or if another one takes its place in the next cycle.

        Args:
            move: as `submit` returned it.
            reason: in words.
            client: who asks.
        """
        with self._board.lock:
            if move.is_busy() and self._arbiter.waiting_move in (None, move):
                self._waiting.end(reason, Outcome.PREEMPTED)
                if self.status.state is OperatingState.ENABLED:
                    self._put(Order("hold"), client)

    def state_command(
        self,
        text: str,
        stamp_ns: int = 0,
        received_ns: int = 0,
        sent_ns: int = 0,
        *,
        is_repeated: bool = False,
    ) -> None:
        """Ask for ``enable``, ``disable``, ``pause``, ``resume``, ``home`` or ``unhome``.

        Returns at once; the status tells when it is reached.

        Args:
            text: one of them.
            stamp_ns: the sender's stamp, 0 if it gave none.
            received_ns: when it came, in ns since the epoch, if that was before now.
            sent_ns: see `submit`. What sets the device going is not carried out after a stop that came
                after it was sent.
            is_repeated: it is sent again with the stamp of the first. Once that has been carried out, and
                something newer after it, it is refused.

        Raises:
            CommandRefused: unknown, invalid in this state, too old for what sets the device going, not
                connected, or another one is running.
        """
        for hear in self.hearers:
            hear("state_command", Text(text), stamp_ns)
        try:
            command = parse_command(text)
            self._check.check_state_command(command, stamp_ns, time.time_ns())
            self._require_connected("state_command", f"{command}: ")
            with self._board.lock:
                if is_repeated and self._is_overtaken(stamp_ns):
                    raise self._repeated(command)
                if command not in STOPS and self._newest.is_after_stop(sent_ns):
                    raise self._overtaken("state_command", f"came after this {command} was sent")
                self._changes.append(stamp_ns)
                if command is StateCommand.PAUSE:  # a stop, also where it is refused
                    self._waiting.end("by pause", Outcome.PREEMPTED)
                    self._transitions.break_off("pause")
                if command in STOPS:
                    self._stops += 1
                    self._newest.note(received_ns, is_stop=True)
                    self._requests.break_off(f"by {command}")
                is_new = self._transitions.running is not command
                if self._transitions.accept(command, stamp_ns):
                    if is_new:
                        self._newest.note(received_ns, is_stop=False)
                    self._waiting.end(f"by {command}", Outcome.PREEMPTED)
        except CommandRefused as refusal:
            told = refusal.of(stamp_ns, self.where, text)
            self._board.refused(told)
            self._board.announce()
            raise told from refusal.__cause__

    def request(self, name: str, sent_ns: int = 0) -> Request:
        """Ask for one of the `services`. One of ours is carried out at once, whatever the device does.

        One that is a stop takes the place of what runs.

        Args:
            name: of the service.
            sent_ns: see `submit`; of one that moves, and of a stop.

        Raises:
            CommandRefused: there is no such service, one is running, the device is not connected, or one
                that moves came before a stop.
        """
        service = self.services.get(name)
        if isinstance(service, OwnService):
            return service.carried_out(name)
        if service is not None and service.stops:
            with self._board.lock:
                self._stops += 1
                self._newest.note(sent_ns, is_stop=True)
            self._waiting.end(f"by {name}", Outcome.PREEMPTED)
            self._transitions.break_off(name)
        try:
            with self._board.lock:  # no stop comes between the two
                if service is not None and service.moves:
                    self._require_newest(name, sent_ns)
                    self._changes.append(0)
                return self._requests.ask(name)
        except CommandRefused as refusal:
            self._board.refused(refusal)
            raise

    def give(self, name: str, value: Value) -> None:
        """Hand a value to one of the device's own `inputs`.

        Raises:
            CommandRefused: the device does not take it, or not while a motion is carried out.
        """
        taken = self.inputs[name]
        for hear in self.hearers:
            hear(name, value, 0)
        try:
            if taken.at_rest:
                with self._board.lock:
                    self._require_rest(name)
                    taken.take(value)
            else:
                taken.take(value)
        except CommandRefused as refusal:
            told = refusal.of(0, self.where)
            self._board.refused(told)
            raise told from refusal.__cause__

    def report_refusal(self, refusal: CommandRefused) -> None:
        """Count and tell a refusal that a front made itself (a payload it could not convert)."""
        self._board.refused(refusal)

    def report_warning(self, text: str) -> None:
        """Tell what a front warns of; one of a kind once in a while."""
        self._board.warned(text)

    # ---------------------------------------------------------------------------------------- inside

    def _require(self, name: str) -> Command:
        if name == FOLLOW.name and follows_trajectories(self.device):
            return FOLLOW
        try:
            return self.commands[name]
        except KeyError:
            raise CommandRefused(
                name,
                Reason.UNSUPPORTED,
                "this device does not offer it",
                where=self.where,
                remedy=missing_for(name, self.device),
            ) from None

    def _require_connected(self, name: str, what: str = "") -> None:
        if not self._connected:
            raise CommandRefused(
                name,
                Reason.NOT_CONNECTED,
                f"{what}{self.status.cause or 'not connected'}",
                where=self.where,
                remedy="The driver keeps trying to connect; send it again afterwards.",
            )

    def _require_enabled(self, name: str) -> None:
        """Refuse unless ENABLED, with no state command being carried out."""
        with self._board.lock:
            running, status = self._transitions.running, self.status
        if running is not None:
            raise CommandRefused(
                name,
                Reason.TRANSITION_RUNNING,
                f"{running} is running",
                where=self.where,
                remedy="Wait until operating_state says that it is done, or send disable to end it.",
            )
        if status.state is not OperatingState.ENABLED:
            why = f" ({status.cause})" if status.cause else ""
            raise CommandRefused(
                name,
                Reason.NOT_ENABLED,
                f"the device is {status.state}{why}",
                where=self.where,
                remedy=_WAY_TO_ENABLED[status.state],
            )

    def _require_rest(self, name: str) -> None:
        """Refuse while a motion is carried out, or waits to be."""
        if not self.is_at_rest:
            raise CommandRefused(
                name,
                Reason.INVALID_TRANSITION,
                "a motion is being carried out",
                where=self.where,
                remedy="Send hold, and then it again.",
            )

    def _hold(self, command: Command, client: Client, received_ns: int) -> None:
        """End what goes on; where that has been done already, a stop that was not read back is sent again.

        One look at the state decides, so that no change of it makes this a refusal.
        """
        with self._board.lock:
            self._stops += 1
            self._newest.note(received_ns, is_stop=True)
            self._transitions.end_homing()
            self._transitions.break_off("hold")
            self._requests.break_off("by hold")
            self._waiting.end("by hold", Outcome.PREEMPTED)
            running = self._transitions.running is not None
            enabled = self.status.state is OperatingState.ENABLED
            if self._connected and (running or not enabled):
                self._stop_asked = True
                return
            self._require_connected(command.name)
            self._require_enabled(command.name)
            self._put(Order(command.name), client)

    def _put(self, order: Order, client: Client) -> None:
        replaced = self._arbiter.put(order, self._clock(), client)
        if replaced is not None:
            replaced.finish(Outcome.PREEMPTED, f"by {order.name}")
        self._waiting.replaced_by(order)
        if self._motion.hurries(order) and self.device.wake():
            self._can_wake = True

    def _begin_waiting(self, waiting: Waiting) -> None:
        """Carry out the move that waited, as if it came now."""
        self._carry_out(waiting.command, waiting.value, waiting.stamp_ns, waiting.client, waiting)

    def _carry_out(
        self,
        command: Command,
        value: Value | None,
        stamp_ns: int,
        client: Client,
        waiting: Waiting | None = None,
        sent_ns: int = 0,
    ) -> Move | None:
        stops = self._stops
        order = self._order(command, value, stamp_ns, client)
        with self._board.lock:
            self._require_enabled(command.name)
            if self._stops != stops:
                raise self._overtaken(command.name, "came while it was being judged")
            self._require_newest(command.name, sent_ns)
            if waiting is not None:
                if not self._waiting.holds(waiting):
                    return None
                order = replace(order, move=waiting.move)
            if command.name == "free":
                self._freed.tie(client, self._clock())
                if self._is_free:
                    return None
            self._put(order, client)
            if order.move is not None:
                self._context.latch(order.goals, order.stamp_ns)
                self._board.update(busy=True)
        return order.move

    def _order(self, command: Command, value: Value | None, stamp_ns: int, client: Client) -> Order:
        self._require_enabled(command.name)
        self._arbiter.admit(command.name, client, self._clock())
        if not command.is_motion:
            return Order(command.name)
        checked = self._check.check(command, value, stamp_ns, time.time_ns())
        return replace(self._orders.make(command, checked, self._clock()), stamp_ns=stamp_ns)

    def _set(self, command: Command, value: Value, client: Client) -> None:
        """Carry out a setting. It moves nothing and is possible in any state."""
        if command.name == WRENCH_AXES:
            assert isinstance(value, Flag)
            self._feedback.axes.absolute = value.value
            return
        if isinstance(value, Flag):
            if value.value:
                self._require_connected(command.name)
                self._carried.tie(client, self._clock())
            else:
                self._carried.cut()
            self._motion.use_gravity_compensation(value.value)
            return
        assert isinstance(value, Number)
        changed = {
            "trajectory_j/set_ratio": lambda ratio: Ratios(ratio, ratio),
            "trajectory_j/set_ratio_v": lambda ratio: replace(self._orders.ratios, velocity=ratio),
            "trajectory_j/set_ratio_a": lambda ratio: replace(
                self._orders.ratios, acceleration=ratio
            ),
        }[command.name](value.value)
        with self._board.lock:
            self._orders.ratios = changed
            self._context.latch(_ratio_values(changed), 0)

    def _require_newest(self, name: str, sent_ns: int) -> None:
        """Refuse what was sent before the newest stop or change of state came. Under the board's lock."""
        if self._newest.is_after(sent_ns):
            raise self._overtaken(name, "or another state came before it was carried out")

    def _is_overtaken(self, stamp_ns: int) -> bool:
        """Whether a state command of this stamp was carried out, and something newer after it."""
        return stamp_ns in self._changes and self._changes[-1] != stamp_ns

    def _repeated(self, command: StateCommand) -> CommandRefused:
        """Return what to say of a stop that is sent again, after somebody has set the device going."""
        return CommandRefused(
            "state_command",
            Reason.TOO_OLD,
            f"{command}: it was sent again, and had been carried out before another command came",
            where=self.where,
            remedy="Send it anew if it is to be carried out after that.",
        )

    def _overtaken(self, name: str, when: str) -> CommandRefused:
        """Return what to say of a command that something newer came before."""
        return CommandRefused(
            name,
            Reason.TOO_OLD,
            f"a stop {when}",
            where=self.where,
            remedy="Send it again if it is to be carried out after that.",
        )

    @property
    def _is_free(self) -> bool:
        """Whether free drive goes on, and nothing waits to end it."""
        return self._motion.is_free and not self._arbiter.streams(self._clock())


def _ratio_values(ratios: Ratios) -> dict[str, Value]:
    return {
        "trajectory_j/ratio": Number(min(ratios.velocity, ratios.acceleration)),
        "trajectory_j/ratio_v": Number(ratios.velocity),
        "trajectory_j/ratio_a": Number(ratios.acceleration),
    }

"""Mistakes that are planted into the product, each in one world, to see that judges and user find them.

Each function patches the product, which the host of a world calls before that begins. What it says of itself
is what is wrong. This file is imported in patched Python, so it imports no pytest.
"""

from __future__ import annotations

import dataclasses
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from world import planted_drivers
from world.planted_table import (
    AFTER_DEATH,
    BELIEVED,
    CALM,
    CONTRADICTS,
    DEADLOCK,
    DIE,
    DIED,
    FAREWELL,
    FAST,
    FOR_EVER,
    HORIZON,
    LEFT,
    MIXED,
    MOVES,
    NONSENSE,
    NOT_ENABLED,
    OLD,
    PLANTED,
    REASONLESS,
    REFUSED,
    SCENARIOS,
    STAMP,
    STUCK,
    TOO_EARLY,
    USE,
    WAITS,
    planted,
)
from world.promises import HAS_ROS

from crtk_driver_dynamixel import device as dynamixel_device
from crtk_driver_dynamixel import part as dynamixel_part
from crtk_driver_galil.controller import GalilController
from crtk_driver_ur.rtde.stream import RtdeStream
from crtk_drivers.device import MoveProgress
from crtk_drivers.engine import cycle as engine_cycle
from crtk_drivers.engine.intake import Intake
from crtk_drivers.engine.threads import BusThread
from crtk_drivers.engine.transitions import Transitions
from crtk_drivers.errors import CommandRefused, DeviceError, Reason
from crtk_drivers.gates.command import LARGEST, CommandCheck
from crtk_drivers.kit import MessageLink, modbus_frames
from crtk_drivers.kit.gripping.gripper_device import GripperDevice
from crtk_drivers.kit.request_worker import RequestWorker
from crtk_drivers.motion.arbiter import Arbiter
from crtk_drivers.motion.executor import MotionExecutor
from crtk_drivers.motion.move import Move, Outcome
from crtk_drivers.motion.stopping import Stopping
from crtk_drivers.samples import Sample, Stamp, vector
from crtk_drivers.state import StateCommand

if HAS_ROS:
    from world import planted_far  # noqa: F401 - it enters its mistakes into the table

__all__ = ["CALM", "PLANTED", "SCENARIOS", "planted_drivers"]


def __getattr__(name: str) -> Callable[[], None]:
    """Return the mistake of this name, in whatever file it is: the host of a world asks here."""
    if name in PLANTED:
        return PLANTED[name].plant
    raise AttributeError(name)


# ------------------------------------------------------------------------------------------------ stops


@planted("robotiq", USE, BELIEVED, seeds=10)
def stop_is_believed_at_once() -> None:
    """A stop is sent once, and believed at once."""
    plain = Stopping.stop

    def stop(self: Any) -> None:
        plain(self)
        self._watches = False

    Stopping.stop = stop


@planted("dynamixel", USE, MOVES, NOT_ENABLED, BELIEVED, seeds=10)
def servos_are_not_told_to_stop() -> None:
    """A stop of servos on their way to a position is asked for, and counts as done."""
    dynamixel_part.Part.ask_to_stop = lambda self: None


@planted("robotiq", USE, REFUSED, seeds=10)
def stop_is_refused_when_not_enabled() -> None:
    """`hold` is refused where the device is not ENABLED, or a state command is being carried out."""
    plain = Intake._hold

    def hold(self: Any, command: Any, client: Any, received_ns: int) -> None:
        self._require_enabled(command.name)
        plain(self, command, client, received_ns)

    Intake._hold = hold


@planted("robotiq", USE, WAITS, seeds=10)
def stop_waits_for_the_check_of_a_move() -> None:
    """A move is judged, which may take a second, under a lock that a stop needs."""
    plain, own = Intake.submit, threading.Lock()

    def submit(self: Any, name: str, *args: Any, **named: Any) -> Any:
        with own:
            if name == "move_jp":
                time.sleep(1.0)
            return plain(self, name, *args, **named)

    Intake.submit = submit


@planted("robotiq", USE, MOVES, seeds=40)
def move_is_carried_out_after_a_stop() -> None:
    """A move that waits in the mailbox while a stop comes is carried out after that."""
    plain = Arbiter.take

    def put(self: Any, order: Any, now: float, client: Any = None) -> Any:
        waiting = self._order
        found = plain_put(self, order, now, client)
        if order.name == "hold" and waiting is not None and waiting.move is not None:
            self._kept = waiting
            return None
        return found

    def take(self: Any, *args: Any) -> Any:
        found = plain(self, *args)
        kept = self.__dict__.pop("_kept", None) if found is None else None
        return found or kept

    plain_put = Arbiter.put
    Arbiter.put, Arbiter.take = put, take


@planted("dynamixel", USE, MOVES, NOT_ENABLED, seeds=20)
def pause_leaves_the_motion() -> None:
    """`pause` ends what the driver does, and tells the hardware nothing."""
    plain = Transitions._begin

    def begin(self: Any, running: Any, now: float) -> Any:
        if running.command is StateCommand.PAUSE and not running.stops:
            running.stops = True
            self._end_motion("pause")
        return plain(self, running, now)

    Transitions._begin = begin


# ------------------------------------------------------------------------- what moves nothing by itself


@planted("robotiq", USE, MOVES, NOT_ENABLED, seeds=20)
def connection_goes_on_with_the_old_move() -> None:
    """After a link was lost, an old move is sent again."""
    plain_move, plain_open = GripperDevice.move, GripperDevice.open

    def move(self: Any, goal: Any) -> None:
        plain_move(self, goal)
        self.__dict__.setdefault("_last_goal", self._asked)

    def open_again(self: Any, deadline: float) -> None:
        plain_open(self, deadline)
        if order := self.__dict__.get("_last_goal"):
            self._hand.go(order, at_once=True)

    GripperDevice.move, GripperDevice.open = move, open_again


@planted("galil", DIE, AFTER_DEATH, seeds=40)
def setpoints_are_sent_though_nothing_is_heard() -> None:
    """While the network is blocked, setpoints go on: TCP delivers them when the driver is gone."""
    MessageLink.unheard = property(lambda self: 0.0)
    GalilController.blind = 10.0


# --------------------------------------------------------------------------- watchdogs, and who stands still


@planted("robotiq", USE, STUCK, seeds=20)
def nobody_looks_after_the_io_thread() -> None:
    """The watchdog finds nothing wrong with an I/O thread."""
    BusThread.trouble = lambda self, now: ""


@planted("robotiq", USE, OLD, seeds=10)
def nobody_looks_at_the_age_of_samples() -> None:
    """A link that brings no samples counts as alive."""

    class Blind(engine_cycle.Deadman):
        def expired(self, now: float) -> bool:
            return False

    engine_cycle.Deadman = Blind


@planted("robotiq", USE, DIED, seeds=20)
def io_thread_ends_by_an_exception() -> None:
    """An unexpected error in a cycle ends the I/O thread."""

    def serve(self: Any, member: Any, deadline: float) -> bool:
        engine = member.engine
        try:
            if engine.connected:
                engine.cycle(deadline)
                if engine.has_sample:
                    member.reconnect.succeeded()
            elif time.monotonic() >= member.reconnect.next_try:
                self._open(member)
        except DeviceError as error:
            self._lose(member, error.statement, error.remedy)
            raise
        return True

    BusThread._serve = serve


# ------------------------------------------------------------------------------------------------ threads


@planted("ur", FAREWELL, LEFT, seeds=10)
def worker_is_never_ended() -> None:
    """A worker is told that it is to end, and is not woken."""

    def stop(self: Any) -> None:
        self._stopped = True
        self._interrupt()

    RequestWorker.stop = stop


@planted("ur", FAREWELL, LEFT, seeds=10)
def descriptor_is_left_open() -> None:
    """A stream that is closed keeps the descriptor by which it is woken."""
    plain = RtdeStream._release

    def release(self: Any) -> None:
        self._wake = -1
        plain(self)

    RtdeStream._release = release


# -------------------------------------------------------------------------------------------------- stamps


@planted("robotiq", USE, STAMP, OLD, seeds=20)
def old_position_is_stamped_fresh() -> None:
    """A cycle without an answer publishes the last position again, with a new stamp."""
    plain = GripperDevice.read

    def read(self: Any, deadline: float) -> Any:
        found = plain(self, deadline)
        last = self.__dict__.get("_last_sample")
        self._last_sample = found or last
        return found or (last and dataclasses.replace(last, stamp=Stamp.now()))

    GripperDevice.read = read


@planted("dynamixel", USE, STAMP, seeds=30)
def servo_that_is_silent_counts_as_read() -> None:
    """Joints of which nothing was heard have the stamp of those that answered."""
    chain = dynamixel_device._ChainDevice

    def acquired(self: Any, frame: Any) -> Any:
        return frame.stamp, np.ones_like(self.part.own(frame.valid)), True

    chain._acquired = acquired


@planted("robotiq", USE, STAMP, seeds=10)
def unknown_position_is_a_number() -> None:
    """A value that is not known is NaN in a sample that is valid."""
    plain = GripperDevice.read

    def read(self: Any, deadline: float) -> Any:
        found = plain(self, deadline)
        if found is None or not self._hand.is_told:
            return found
        state = found.values["measured_js"]
        unknown = dataclasses.replace(state, velocity=vector([float("nan")]))
        return dataclasses.replace(found, values={**found.values, "measured_js": unknown})

    GripperDevice.read = read
    Sample.not_finite = property(lambda self: "")


@planted("robotiq", USE, STAMP, seeds=20)
def stamp_has_the_clock_of_the_wall() -> None:
    """The age of a sample is reckoned on the wall clock, which may be set."""
    offset = time.monotonic_ns

    def now(cls: Any) -> Any:
        wall = time.time_ns()
        begin = cls.__dict__.get("_begin") or (wall, offset())
        cls._begin = begin
        return cls(wall, (wall - begin[0] + begin[1]) / 1e9)

    Stamp.now = classmethod(now)


# ---------------------------------------------------------------------------------------------------- wires


@planted("robotiq", USE, STAMP, BELIEVED, TOO_EARLY, seeds=30)
def answer_to_an_earlier_question_counts() -> None:
    """An answer is not compared with the question that waits for one."""

    def feed(self: Any, data: bytes) -> bytes | None:
        self._rest += data
        if len(self._rest) < 8 or len(self._rest) < 6 + self._rest[5]:
            return None
        frame, self._rest = self._rest[: 6 + self._rest[5]], self._rest[6 + self._rest[5] :]
        return frame[7:]

    modbus_frames.Mbap.feed = feed


@planted("robotiq", USE, STAMP, MOVES, FAST, seeds=30)
def piece_of_an_answer_counts_as_all() -> None:
    """What has come of an answer is taken for all of it; what is missing reads as 0."""
    plain = modbus_frames.Mbap.feed

    def feed(self: Any, data: bytes) -> bytes | None:
        missing = 6 + data[5] - len(data) if len(data) >= 8 else 0
        return plain(self, data + bytes(max(0, missing)))

    modbus_frames.Mbap.feed = feed


# --------------------------------------------------------------------------------------------------- moves


@planted("robotiq", USE, TOO_EARLY, seeds=10)
def move_is_reached_when_it_was_sent() -> None:
    """A move of the gripper counts as reached when it was taken, wherever the fingers are."""
    GripperDevice.move_progress = lambda self: (
        MoveProgress.DONE if self._hand.is_told else MoveProgress.RUNNING
    )
    GripperDevice.has_arrived = property(lambda self: self._hand.is_told)


@planted("robotiq", USE, MIXED, seeds=10)
def stream_has_no_owner() -> None:
    """Whoever sends a setpoint takes part in a stream."""
    Arbiter.admit = lambda self, name, client, now: None


@planted("robotiq", USE, REASONLESS, seeds=10)
def refusal_says_nothing() -> None:
    """A command that is refused because of the state does not say why."""
    plain = Intake._require_enabled

    def require(self: Any, name: str) -> None:
        try:
            plain(self, name)
        except CommandRefused as refusal:
            raise CommandRefused(name, refusal.reason, "", where=self.where) from None

    Intake._require_enabled = require


@planted("robotiq", USE, CONTRADICTS, seeds=20)
def wait_is_false_for_a_move_that_was_stopped() -> None:
    """`wait` returns False when the time is over, and also when the move was stopped."""

    def wait(self: Any, timeout: float | None = None, is_busy: bool = False) -> bool:
        return bool(self._ended.wait(timeout) and self.outcome is Outcome.REACHED)

    Move.wait = wait


@planted("robotiq", USE, NONSENSE, seeds=20)
def nan_passes_the_checks() -> None:
    """What is too large is refused by a comparison that NaN passes."""

    def check_numbers(self: Any, command: Any, values: Any, field: str) -> None:
        if (np.abs(values) > LARGEST).any():
            raise CommandRefused(command.name, Reason.OUT_OF_RANGE, f"{field} is too large")

    def check_range(self: Any, command: Any, values: Any) -> None:
        if (values < self._lower).any() or (values > self._upper).any():
            raise CommandRefused(command.name, Reason.OUT_OF_RANGE, "it is out of range")

    CommandCheck._check_numbers, CommandCheck._check_range = check_numbers, check_range


@planted("robotiq", USE, NONSENSE, FAST, seeds=40)
def upper_limit_of_a_move_is_not_checked() -> None:
    """The goal of a move is compared with the lower limits twice."""

    def check_range(self: Any, command: Any, values: Any) -> None:
        if not ((values >= self._lower) & (values >= self._lower)).all():
            raise CommandRefused(command.name, Reason.OUT_OF_RANGE, "it is out of range")

    CommandCheck._check_range = check_range


# ------------------------------------------------------------------------------------- what hangs


@planted("galil", USE, DEADLOCK, seeds=20)
def two_locks_are_taken_in_two_orders() -> None:
    """A command takes the lock of the state, then that of the mailbox; the I/O thread the other way round."""
    plain_put, plain_step, mailbox = Intake._put, MotionExecutor.step, threading.Lock()

    def put(self: Any, *args: Any) -> None:
        with self._board.lock, mailbox:
            plain_put(self, *args)

    def step(self: Any, now: float) -> str:
        with mailbox, self._board.lock:
            pass
        return plain_step(self, now)

    Intake._put, MotionExecutor.step = put, step


@planted("robotiq", USE, WAITS, HORIZON, seeds=20)
def hold_waits_for_a_signal_that_may_have_come() -> None:
    """`hold` waits to be woken when the device stands, and forgets that it has been."""
    plain_hold, plain_follow, stands = Intake._hold, Stopping.follow, threading.Event()

    def hold(self: Any, *args: Any) -> None:
        plain_hold(self, *args)
        stands.clear()
        stands.wait()

    def follow(self: Any, *args: Any) -> None:
        was_confirmed = self.confirmed
        plain_follow(self, *args)
        if self.confirmed and not was_confirmed:
            stands.set()

    Intake._hold, Stopping.follow = hold, follow


# --------------------------------------------------------------------------------------------------- close


@planted("robotiq", FAREWELL, HORIZON, FOR_EVER, seeds=30)
def close_waits_for_a_link_that_is_lost() -> None:
    """`close` waits until a stop is read back, also over a link that is lost."""

    def await_stop(self: Any, alive: Callable[[float], object]) -> str:
        while not self._stopping.confirmed:
            alive(self._clock())
            self._sleep(self._period)
            try:
                sample = self.device.read(self._clock() + self._period)
                self._stopping.follow(sample, self._clock())
            except DeviceError:
                continue
        return ""

    plain = BusThread.join
    engine_cycle.Engine._await_stop = await_stop
    BusThread.join = lambda self, deadline: plain(self, deadline + 1e6)

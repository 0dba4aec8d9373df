"""The engine of one device: where the fronts, the hardware and the watchdog meet.

Clients' threads call `submit` and `state_command`: everything is checked at once and nothing touches the
bus. The I/O thread of the bus calls `connect`, `cycle` and `lose`; it alone talks to the device. The
watchdog's thread calls `alarm` when the I/O thread is late. What happens is told to observers, in order.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable

from crtk_drivers.device import Device
from crtk_drivers.engine.intake import Intake
from crtk_drivers.errors import (
    REPORT,
    ConnectionLost,
    DeviceError,
    DeviceFault,
    StopUnconfirmed,
    unexpected,
    without_name,
)
from crtk_drivers.motion.arbiter import Order
from crtk_drivers.motion.stopping import UNSEEN
from crtk_drivers.options import EngineOptions
from crtk_drivers.samples import Sample
from crtk_drivers.state import HOMING_COMMANDS, STOPS, OperatingState, StateCommand
from crtk_drivers.status.deadman import Deadman

logger = logging.getLogger(__name__)

_SEVERITY = {
    OperatingState.ENABLED: 0,
    OperatingState.PAUSED: 1,
    OperatingState.DISABLED: 2,
    OperatingState.FAULT: 3,
}

_EXPLAINED = (OperatingState.PAUSED, OperatingState.FAULT)

TIME_TO_DISABLE = 2.0
"""Seconds, beside those for the stop, in which a `disable` may end when the driver is closed meanwhile."""

LONGEST_WAIT_FOR_A_CYCLE = 2.0
"""Periods between two whole cycles, however often the I/O thread is woken and whatever ends its reading."""

PATIENCE_TO_TELL = 0.1
"""Seconds for which an alarm waits to be told: who holds the lock may be held up himself."""

LOOK_AT_IT = "Look at the hardware, and take its power away if it moves."
"""What to do where a stop could not be read back."""

_AFTER_STREAM = {"pause": OperatingState.PAUSED, "fault": OperatingState.FAULT}


class Engine(Intake):
    """Drives one device: `Intake` for clients, and what the I/O thread and the watchdog do.

    Args:
        device: constructed, not open.
        name: of the device, for messages.
        options: the user's choices.
        clock: monotonic seconds.
        sleep: lets seconds pass on that clock.
        has_state: see `Intake`.
    """

    def __init__(
        self,
        device: Device,
        name: str,
        options: EngineOptions | None = None,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], object] = time.sleep,
        *,
        has_state: bool = True,
    ) -> None:
        super().__init__(device, name, options, clock, has_state=has_state)
        self._sleep = sleep
        self._alarm = ""
        self._overdue = ""
        self._broken_sample = ""
        self._loss = ""
        self._is_closing = False
        self._sample_deadman = Deadman(self.options.sample_timeout)
        self._listened = 0.0
        self._sampled = 0.0
        # After it was stuck: once until a sample comes, and with each that was made since it looked last.
        self._awake_since = -math.inf
        self._whole_until = -math.inf

    # ---------------------------------------------------------------- for the I/O thread of the bus

    def connect(self, deadline: float) -> None:
        """Open the device. Ends in DISABLED, whatever was before: nothing is enabled by a connection.

        After a loss the reason of DISABLED names it: FAULT, which named it before, may be over in a second.

        Raises:
            ConnectionFailed: the state is FAULT with the reason, unless it was given up to be closed.
        """
        try:
            self.device.open(deadline)
        except DeviceError as error:
            self._requests.end(error)
            if not self._is_closing:
                self._board.update(OperatingState.FAULT, error.statement, remedy=error.remedy)
            self._turns.turn()
            raise
        self._requests.begin()
        self._transitions.cancel()  # what was sent while the link was being lost
        self._motion.forget_settings()
        self._connected = True
        self._health.connected = True
        self._broken_sample = ""
        self._stopping.begin_anew()
        self._listened = self._clock()
        self._sample_deadman.feed(self._listened)
        loss, self._loss = self._loss, ""
        back = f"the link was lost ({loss}) and is back" if loss else ""
        reason = "; ".join(filter(None, (back, self.device.found)))
        self._board.update(OperatingState.DISABLED, reason)
        self._turns.turn()

    def cycle(self, deadline: float) -> None:
        """Read, follow the hardware's condition, advance transition and motion. Once a period.

        Where `Device.wake` ended the reading, only what a client has just asked for is done, unless the last
        whole cycle was long ago.

        Raises:
            DeviceError: call `lose`, close the device, and `connect` after a while.
        """
        sample = self.device.read(deadline)
        now = self._clock()
        is_woken = sample is None and self._can_wake and now < min(deadline, self._whole_until)
        was_stuck = now - self._listened > self.options.sample_timeout
        is_new = sample is not None and sample.stamp.monotonic >= self._listened
        if was_stuck and (is_new or self._awake_since < self._sampled):
            # What was made meanwhile counts as made now; newer ones follow.
            self._awake_since = now
            self._sample_deadman.feed(now)
        self._listened = now
        if sample is not None:
            self._sampled = now
            self._sample_deadman.feed(min(max(sample.stamp.monotonic, self._awake_since), now))
            sample = self._sound(sample)
            self._motion.sample_came()
        if self._sample_deadman.expired(now):
            raise ConnectionLost(
                f"the newest sample is {self._sample_deadman.age(now):.3f} s old",
                where=self.where,
                remedy="Is it on, and the network free? The driver connects again by itself.",
            )
        try:
            self._heed_alarm()
            if is_woken:
                self._hurry(now)
            else:
                self._whole_until = now + LONGEST_WAIT_FOR_A_CYCLE * self._period
                self._stopping.follow(sample, now)
                self._heed_stop()
                self._end_untied(now)
                self._motion.apply_settings()
                self._advance(now)
                self._serve(now)  # what was asked for after a stop comes after it
            self._heed_alarm()  # that came meanwhile, before something was begun
        except DeviceFault as fault:
            self._broken(fault.statement, fault.remedy)
        except DeviceError:
            raise
        except Exception as error:
            # The link is sound, and whoever shares it goes on.
            logger.exception("%s: unexpected error in its motion", self.where)
            self._broken(unexpected(error), REPORT)
        if not is_woken:
            self._health.cycle(now)
        self._turns.turn()
        if sample is not None:
            self._tell_sample(sample)

    def _tell_sample(self, sample: Sample) -> None:
        if self.keepers:
            now, state = time.time_ns(), self.status.state
            for keep in self.keepers:
                keep((now, sample, self._feedback.active, state))
        told = self.on_sample
        if told is not None:
            told()

    def _sound(self, sample: Sample) -> Sample | None:
        """Keep a sample and return it; drop it, warn and return None if a number in it is not finite."""
        broken = sample.not_finite
        if not broken:
            self._broken_sample = ""
            self._feedback.take(sample)
            self._health.samples += 1  # who saw it counted sees its values
            return sample
        self._health.broken_samples += 1
        if not self._broken_sample:
            self._board.warned(f"a sample is dropped: {broken}")
        self._broken_sample = broken
        return None

    def lose(self, reason: str, remedy: str = "") -> None:
        """Stop the device, whose link was lost; the state is FAULT until it is open again.

        To close it is left to the caller: that may take as long as a stop takes to be read back.
        """
        was_connected, self._connected = self._connected, False
        self._health.connected = False
        self._health.reconnects += was_connected
        self._health.pause()
        self._feedback.invalidate()
        told = without_name(reason, self.where)
        if was_connected:  # else an attempt to open it failed, and the loss came before that
            self._loss = told.rstrip(" .")
        self._requests.break_off(told)
        gone = ConnectionLost(told, where=self.where, remedy=remedy)
        try:
            if was_connected or not self._is_closing:  # else its opening was given up
                self._leave(OperatingState.FAULT, reason, remedy)
            self._heed_alarm()  # whose stop nobody has read back
        except DeviceError as error:
            told = without_name(str(error), self.where)
            logger.warning("%s: could not be told to stop: %s", self.where, told)
        finally:
            self._requests.end(gone)
            self._turns.turn()

    def begin_closing(self) -> None:
        """End an `open` that waits: `stop_for_good` and `shut_down` follow. From any thread.

        A link that is open stays usable: a stop is still to be sent over it and read back.
        """
        self._is_closing = True
        self.device.will_close()
        if not self._connected:
            self.device.abort_open()

    def stop_for_good(self) -> None:
        """Stop, without waiting, where something moves or may: `shut_down` follows.

        Raises:
            DeviceError: it could not be told.
        """
        if self._connected and self._transitions.running is not StateCommand.DISABLE:
            self._requests.break_off("the driver is shut down")
            self._heed_alarm()  # whose stop nobody has read back
            self._leave(OperatingState.DISABLED, "shut down")

    def shut_down(self, alive: Callable[[float], object] = lambda until: None) -> None:
        """Stop, wait until that is read back, leave the hardware as it is configured to be left, and close.

        Ends in DISABLED if nothing moves any more, else in FAULT: the last state stays latched on ROS.

        Args:
            alive: is called with the monotonic seconds now, again and again while it waits, for the watchdog;
                and with infinity once the stop was waited for, when only the link remains to be closed.

        Raises:
            StopUnconfirmed: it was not seen to stand within the time that the device declares, or moved when
                the link was lost.
            DeviceError: it could not be told.
        """
        overdue = ""
        try:
            if self._connected:
                self._requests.break_off("the driver is shut down")
                self._finish_disable(alive)
                self._heed_alarm()
                self._leave(OperatingState.DISABLED, "shut down")
                overdue = self._await_stop(alive)
            else:
                overdue = self.unseen
                if not overdue:
                    self._board.update(OperatingState.DISABLED, "shut down")
            if overdue:
                self._board.update(OperatingState.FAULT, overdue, remedy=LOOK_AT_IT)
        finally:
            self._connected = False
            self._loss = ""
            self._health.connected = False
            self._requests.end(ConnectionLost("shut down", where=self.where))
            alive(math.inf)
            self.device.abort_open()  # nothing that waits delays the end
            self.device.close()
        if overdue:
            raise StopUnconfirmed(
                overdue,
                where=self.where,
                remedy=LOOK_AT_IT,
            )

    @property
    def time_to_close(self) -> float:
        """Seconds in which `shut_down` ends, beside what closing the link takes."""
        disables = self._transitions.running is StateCommand.DISABLE
        return self.time_to_stop + (TIME_TO_DISABLE if disables else 0.0)

    def _finish_disable(self, alive: Callable[[float], object]) -> None:
        """Let a `disable` come to its end: half of one might take the power of whoever connects next."""
        deadline = self._clock() + self.time_to_close
        while self._transitions.running is StateCommand.DISABLE and self._clock() < deadline:
            alive(self._clock())
            if not self.capabilities.paced_by_stream:
                self._sleep(self._period)
            try:
                self.cycle(self._clock() + self._period)
            except DeviceError as error:
                logger.warning("%s: disable was not finished: %s", self.where, error.statement)
                return

    def _await_stop(self, alive: Callable[[float], object]) -> str:
        """Read until the stop has been carried out, and return ""; or what to say when it was not."""
        overdue = ""
        while not self._stopping.confirmed and not overdue:
            now = self._clock()
            alive(now)
            overdue = self._stopping.overdue(now)
            if not self.capabilities.paced_by_stream:
                self._sleep(self._period)
            try:
                sample = self.device.read(self._clock() + self._period)
                usable = sample if sample is not None and not sample.not_finite else None
                self._stopping.follow(usable, self._clock())
            except DeviceError as error:
                told = without_name(str(error), self.where)
                return f"{UNSEEN}: {told}"
        return "" if self._stopping.confirmed else overdue

    # -------------------------------------------------------------------- for the watchdog's thread

    def alarm(self, reason: str) -> None:
        """Stop the hardware and go to FAULT, without waiting for an I/O thread that is late or dead.

        Nor does the stop wait for whoever is held up as he tells or logs something, under the lock: then it
        is left to the I/O thread to go to FAULT, when that is back.
        """
        self._alarm = reason
        try:
            self._stopping.left()
            if self._connected:
                self.device.stop()
        finally:
            if self._board.lock.acquire(timeout=PATIENCE_TO_TELL):
                try:
                    self._waiting.end(reason)
                    self._transitions.cancel()
                    self._board.update(OperatingState.FAULT, reason, busy=False)
                finally:
                    self._board.lock.release()
            self._alarm = reason  # also of what went out in between
            self._motion.abandon(reason)

    # ---------------------------------------------------------------------------------------- inside

    def _heed_alarm(self) -> None:
        """End what goes on though the watchdog has intervened, and stop: it may have begun after that."""
        if not self._alarm:
            return
        reason, self._alarm = self._alarm, ""
        state, running = self.status.state, self._transitions.running
        if state is OperatingState.ENABLED or (state is not OperatingState.FAULT and running):
            self._leave(OperatingState.FAULT, reason)
        self._motion.end(reason)
        self._requests.break_off(reason)
        self._requests.end_broken()
        self._stopping.stop()

    def _end_untied(self, now: float) -> None:
        """End free drive, or else gravity compensation, if its client has gone or did not ask again."""
        with self._board.lock:
            if self._is_free:
                reason = self._freed.broken(now)
                if reason:
                    self._board.warned(f"free: {reason}; the device holds")
                    self._arbiter.put(Order("hold"), now)
                return
        reason = "" if self._motion.is_free else self._carried.broken(now)
        if reason:
            self._board.warned(f"use_gravity_compensation: {reason}; it is off")
            self._motion.use_gravity_compensation(False)

    def _hurry(self, now: float) -> None:
        """Between two samples: carry out what a client has just asked for, if that need not wait."""
        if self.status.state is OperatingState.ENABLED and self._transitions.running is None:
            self._motion.hurry(now)

    def _advance(self, now: float) -> None:
        running = self._transitions.running
        self._judge_stop(running, now)
        if self._broken_sample and self._feedback.sample_age(now) > self.options.sample_timeout:
            self._to_fault(f"no sample that can be used: {self._broken_sample}")
        if running is None or running in HOMING_COMMANDS:
            self._follow_condition()
        self._transitions.step(now)
        self._waiting.step()
        if self.status.state is OperatingState.ENABLED and self._transitions.running is None:
            ended = self._motion.step(now)
            after = _AFTER_STREAM.get(self.options.on_stream_timeout)
            if ended and after is not None:
                silence = self.options.silence(self.commands[ended].level)
                self._leave(after, f"{ended} stopped for more than {silence:g} s")

    def _heed_stop(self) -> None:
        """End a service that a stop has broken off; send a stop for that, or again if a client asked."""
        asked, self._stop_asked = self._stop_asked, False
        if self._requests.end_broken() or (asked and not self._stopping.confirmed):
            self._stopping.stop()

    def _serve(self, now: float) -> None:
        """Advance the service that runs. One that moves begins as a transition does: at rest."""
        if self._requests.step(now, self._may_move, self._moved_by_service):
            self._stopping.stop()
        if self._requests.moves:
            self._stopping.motion_sent()

    def _moved_by_service(self) -> None:
        """Forget what was sent before: a service moves the device now."""
        self._stopping.moves_again()
        self._motion.follow_device()

    def _may_move(self, now: float) -> bool:
        """Whether a service that moves may begin now; a motion of ours is ended before it."""
        if not self._motion.rests:
            self._motion.end("by a service that moves")
            self._stopping.stop()
        rests = self._stopping.confirmed or self._stopping.overdue(now)
        return bool(rests) and self._transitions.running not in STOPS

    def _judge_stop(self, running: StateCommand | None, now: float) -> None:
        """Go to FAULT if a stop is overdue."""
        overdue = self._stopping.overdue(now)
        if overdue and running is not StateCommand.DISABLE:
            if not self._overdue:
                logger.error("%s: %s", self.where, overdue)
                self._board.warned(overdue)
            self._to_fault(overdue)
        self._overdue = overdue

    def _to_fault(self, reason: str) -> None:
        """Go to FAULT, unless it is there for another reason."""
        if self.status.state is not OperatingState.FAULT:
            self._leave(OperatingState.FAULT, reason)

    def _broken(self, reason: str, remedy: str = "") -> None:
        """Go to FAULT and end whatever goes on. In FAULT already, the reason that was told first stays."""
        status = self.status
        if status.state is OperatingState.FAULT and status.detail:
            reason, remedy = status.detail, ""
        self._leave(OperatingState.FAULT, reason, remedy)

    def _follow_condition(self) -> None:
        condition, status = self.device.condition, self.status
        if _SEVERITY[condition.allows] > _SEVERITY[status.state]:
            self._leave(condition.allows, condition.reason)
        elif condition.allows is status.state and status.state in _EXPLAINED:
            # What came first is not always what tells the reader most.
            self._board.update(status.state, condition.reason)
        if self.capabilities.needs_homing:
            self._board.update(homed=self.device.is_homed)

    def _leave(self, state: OperatingState, reason: str, remedy: str = "") -> None:
        """End whatever goes on and go to `state`; stop the hardware if it was ENABLED, or may move otherwise.

        The state comes first: from then on no command is accepted that would not be ended here.
        """
        was_enabled = self.status.state is OperatingState.ENABLED
        if was_enabled and state is not OperatingState.DISABLED:
            self._stopping.left()
        with self._board.lock:
            self._stops += 1
            self._waiting.end(reason)
            self._transitions.cancel()
            self._board.update(state, reason, remedy=remedy, busy=False)
        may_move = self._transitions.close_cancelled()  # while the device is still open
        if was_enabled or state is OperatingState.FAULT:
            self._requests.break_off(reason)
        may_move |= self._requests.end_broken()
        self._motion.end(reason)
        if was_enabled or may_move:
            self._stopping.stop()

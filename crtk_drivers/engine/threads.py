"""Threads: one for the I/O of each bus, and one watchdog that looks after them.

An I/O thread drives every engine on its bus, one after the other, on an absolute clock (or on the
hardware's own, if it paces the stream). A cycle that comes too late is skipped and counted; nothing is
caught up. When a device is lost it is opened again, with a delay that grows until a sample arrives, and its
neighbours go on.
"""

from __future__ import annotations

import logging
import math
import sys
import threading
import time
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from crtk_drivers.device.giving_up import given_up_by
from crtk_drivers.engine.cycle import LOOK_AT_IT, Engine
from crtk_drivers.errors import REPORT, ConnectionFailed, DeviceError, StopUnconfirmed, unexpected
from crtk_drivers.status.deadman import Deadman
from crtk_drivers.status.real_time import ask_for_real_time

logger = logging.getLogger(__name__)

FIRST_RETRY = 0.25
LONGEST_RETRY = 5.0
WATCHDOG_PERIOD = 0.05
SWITCH_INTERVAL = 0.0005
"""Seconds after which a busy thread lets another one run: at Python's default, 5 ms, I/O would be late by as
much each time that it waits for something."""
REAL_TIME_PRIORITY = 10
"""Of the I/O threads, under SCHED_FIFO: above everything ordinary, below the kernel's own threads."""
STALL_LIMIT = 0.5
"""Seconds, besides two periods, after which an I/O thread that does not come back counts as stuck."""
NEIGHBOURLY_OPEN = 0.25
"""Seconds that `open` may take while another device on the same bus is connected."""


@dataclass(slots=True)
class _Reconnect:
    """When to try next, in monotonic seconds."""

    next_try: float = 0.0
    delay: float = FIRST_RETRY

    def failed(self, now: float) -> None:
        """An attempt failed: the next one comes later, and the wait after it is longer."""
        self.next_try = now + self.delay
        self.delay = min(2.0 * self.delay, LONGEST_RETRY)

    def succeeded(self) -> None:
        """An attempt succeeded: the next wait is the shortest again."""
        self.delay = FIRST_RETRY


@dataclass(slots=True)
class _Member:
    engine: Engine
    open_timeout: float
    reconnect: _Reconnect = field(default_factory=_Reconnect)


class Looking(Protocol):
    """What one device does because of another."""

    def look(self) -> None:
        """Do what there is to do now. It waits for nothing."""


class BusThread:
    """The I/O thread of one bus.

    Args:
        bus: its name.
        members: the engines on it with their time for `open`. One of them at most paces its stream; what it
            brings is there when those behind it are read, and these wait for nothing.
    """

    def __init__(self, bus: str, members: Iterable[tuple[Engine, float]]) -> None:
        self.bus = bus
        self._members = [_Member(engine, timeout) for engine, timeout in members]
        rates = [member.engine.capabilities.rate for member in self._members]
        self._period = 1.0 / max(rates)
        pacing = [m for m in self._members if m.engine.capabilities.paced_by_stream]
        if len(pacing) > 1:
            raise ValueError(f"{bus}: two devices that pace their streams cannot share a bus")
        self._pacing = pacing[0].engine if pacing else None
        self._heartbeat = Deadman(STALL_LIMIT + 2.0 * self._period)
        self._stopping = threading.Event()
        self._failures: list[DeviceError] = []
        self._is_opening = False
        self._thread = threading.Thread(target=self._run, name=f"io {bus}", daemon=True)

    @property
    def engines(self) -> list[Engine]:
        """The engines that it drives."""
        return [member.engine for member in self._members]

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def stop(self) -> None:
        """Ask the thread to shut its devices down and to end."""
        self._stopping.set()
        for engine in self.engines:
            engine.begin_closing()

    @property
    def failures(self) -> list[DeviceError]:
        """What went wrong while its devices were shut down."""
        return list(self._failures)

    @property
    def time_to_close(self) -> float:
        """Seconds within which all of its devices declare to stand after a stop, or to be disabled."""
        return sum(engine.time_to_close for engine in self.engines)

    @property
    def may_move(self) -> bool:
        """Whether one of its devices may move, as far as is known where the thread hangs.

        A device that is being opened has been sent nothing since it was last seen to stand.
        """
        return any(
            engine.can_move and (not self._is_opening or engine.connected or bool(engine.unseen))
            for engine in self.engines
        )

    def join(self, deadline: float) -> bool:
        """Wait for the end until the monotonic `deadline`; return whether it came."""
        self._thread.join(max(0.0, deadline - time.monotonic()))
        return not self._thread.is_alive()

    def trouble(self, now: float) -> str:
        """Return what is wrong with the thread, in words; empty if nothing is.

        While it is asked to end it is watched as before: what it drives may still move.
        """
        if not self._thread.is_alive():
            return "" if self._stopping.is_set() else f"the I/O thread of {self.bus} has died"
        if self._heartbeat.expired(now):
            return f"the I/O thread of {self.bus} is stuck"
        return ""

    def _run(self) -> None:
        ask_for_real_time(REAL_TIME_PRIORITY)
        try:
            due = time.monotonic()
            while not self._stopping.is_set():
                due = self._pace(due)
                begin = max(due, time.monotonic())
                deadline = begin + (2.0 if self._is_paced() else 0.5) * self._period
                lost = [member for member in self._members if not self._serve(member, deadline)]
                # All have been told to stop before the first one is waited for.
                for member in lost:
                    self._close(member)
                self._heartbeat.feed(time.monotonic())
        finally:
            # Nobody cycles the others while the first one is waited for.
            for member in self._members:
                self._heartbeat.feed(time.monotonic())
                self._stop_for_good(member)
            for member in self._members:
                self._shut_down(member)

    def _pace(self, due: float) -> float:
        """Wait for the next cycle and return when it was due; a stream is waited for by its reader."""
        now = time.monotonic()
        if not self._anyone_connected():
            # Nobody to talk to: wait for the earliest attempt, or for the end.
            self._heartbeat.disarm()
            self._stopping.wait(min(m.reconnect.next_try for m in self._members) - now)
            return time.monotonic()
        if self._is_paced():
            return now
        due += self._period
        if due < now - self._period:
            due = now
        if due > now:
            time.sleep(due - now)
        return due

    def _is_paced(self) -> bool:
        """Whether the hardware's own clock is waited for; without its device those behind it have ours."""
        return self._pacing is not None and self._pacing.connected

    def _anyone_connected(self) -> bool:
        return any(member.engine.connected for member in self._members)

    def _serve(self, member: _Member, deadline: float) -> bool:
        """Do one cycle of a device, or try to open it; return False if it was lost and is to be closed."""
        engine = member.engine
        try:
            if engine.connected:
                engine.cycle(deadline)
                if engine.has_sample:  # a link that opens and brings nothing is no success
                    member.reconnect.succeeded()
            elif time.monotonic() >= member.reconnect.next_try:
                self._open(member)
        except DeviceError as error:
            self._lose(member, error.statement, error.remedy)
        except Exception as error:
            logger.exception("%s: unexpected error in the I/O thread", engine.where)
            self._lose(member, unexpected(error), REPORT)
        else:
            return True
        return False

    def _open(self, member: _Member) -> None:
        # Those on the same bus that are connected must not be left alone for long.
        limit = NEIGHBOURLY_OPEN if self._anyone_connected() else math.inf
        deadline = time.monotonic() + min(member.open_timeout, limit)
        self._heartbeat.feed(deadline)
        engine, is_first = member.engine, member.reconnect.delay == FIRST_RETRY
        self._is_opening = True
        try:
            with given_up_by(self._stopping.is_set):
                engine.connect(deadline)
        except ConnectionFailed as error:  # the engine tells why
            member.reconnect.failed(time.monotonic())
            logger.debug("%s; next attempt in %.2g s", error.statement, member.reconnect.delay)
            if is_first:
                logger.info(
                    "%s: keeps trying to connect, in the end every %g s",
                    engine.where,
                    LONGEST_RETRY,
                )
        else:
            logger.info("%s: connected", engine.where)
        finally:
            self._is_opening = False

    def _lose(self, member: _Member, reason: str, remedy: str) -> None:
        member.reconnect.failed(time.monotonic())
        try:
            member.engine.lose(reason, remedy)
        except Exception:
            logger.exception("%s: stopping failed", member.engine.where)

    def _close(self, member: _Member) -> None:
        if not self._anyone_connected():
            # Nobody is left alone, and the loss is what is told.
            self._heartbeat.feed(time.monotonic() + member.engine.time_to_close)
        try:
            member.engine.device.close()
        except DeviceError as error:
            logger.error("closing: %s", error)
        except Exception:
            logger.exception("%s: closing failed", member.engine.where)

    @staticmethod
    def _stop_for_good(member: _Member) -> None:
        try:
            member.engine.stop_for_good()
        except Exception as error:  # it is told again, and waited for
            logger.warning("%s: could not be told to stop: %s", member.engine.where, error)

    def _shut_down(self, member: _Member) -> None:
        try:
            member.engine.shut_down(self._heartbeat.feed)
        except DeviceError as error:
            logger.error("shutting down: %s", error)
            self._failures.append(error)
        except Exception as error:
            logger.exception("%s: shutting down failed", member.engine.where)
            self._failures.append(DeviceError(f"unexpected {error}", where=member.engine.where))


class Runtime:
    """All threads of a process.

    Args:
        engines: with their time for `open`, in s.
        followers: what else is to be looked at, again and again.
    """

    def __init__(
        self, engines: Iterable[tuple[Engine, float]], followers: Sequence[Looking] = ()
    ) -> None:
        self._followers = followers
        by_bus: dict[str, list[tuple[Engine, float]]] = defaultdict(list)
        for engine, timeout in engines:
            by_bus[engine.device.bus].append((engine, timeout))
        self._buses = [BusThread(bus, members) for bus, members in by_bus.items()]
        self._stopping = threading.Event()
        self._watchdog = threading.Thread(target=self._watch, name="watchdog", daemon=True)
        self._started = False

    def start(self) -> None:
        """Start all threads, in an interpreter that passes its lock on in time; it stays so."""
        sys.setswitchinterval(min(sys.getswitchinterval(), SWITCH_INTERVAL))
        self._started = True
        for bus in self._buses:
            bus.start()
        self._watchdog.start()

    @property
    def is_open(self) -> bool:
        """Whether it was started, and not closed since."""
        return self._started

    def close(self, timeout: float = 1.5) -> None:
        """Stop and close every device, and end the threads.

        Args:
            timeout: seconds, besides those that the devices declare for stopping.

        Raises:
            StopUnconfirmed: a device that can move was not seen to stand: its stop was not read back, or its
                I/O thread did not end in time.
            DeviceError: it could not be told to stop, or the I/O thread of what does not move did not end.
        """
        if not self._started:
            return
        self._started = False
        timeout += max((bus.time_to_close for bus in self._buses), default=0.0)
        deadline = time.monotonic() + timeout
        for bus in self._buses:
            bus.stop()
        stuck = [bus for bus in self._buses if not bus.join(deadline)]
        self._stopping.set()
        self._watchdog.join(timeout)
        for bus in stuck:
            for engine in bus.engines:
                self._alarm(engine, f"the I/O thread of {bus.bus} did not end")
        if stuck:
            may_move = any(bus.may_move for bus in stuck)
            error = StopUnconfirmed if may_move else DeviceError
            raise error(
                f"the I/O thread of {', '.join(bus.bus for bus in stuck)} "
                f"did not end in {timeout:g} s"
                + (": a stop was sent, and could not be read back" if may_move else ""),
                remedy=f"{LOOK_AT_IT} {REPORT}" if may_move else REPORT,
            )
        for bus in self._buses:
            for failure in bus.failures:
                raise failure

    def _watch(self) -> None:
        alarmed: set[str] = set()
        while not self._stopping.wait(WATCHDOG_PERIOD):
            now = time.monotonic()
            for bus in self._buses:
                trouble = bus.trouble(now)
                if not trouble:
                    alarmed.discard(bus.bus)
                elif bus.bus not in alarmed:
                    alarmed.add(bus.bus)
                    for engine in bus.engines:
                        self._alarm(engine, trouble)
            for follower in self._followers:
                self._look(follower)

    @staticmethod
    def _look(follower: Looking) -> None:
        try:
            follower.look()
        except Exception:
            logger.exception("following one device with another failed")

    @staticmethod
    def _alarm(engine: Engine, trouble: str) -> None:
        try:
            engine.alarm(trouble)
        except Exception:
            logger.exception("%s: stopping after an alarm failed", engine.where)

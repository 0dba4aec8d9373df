"""The device's side of the control process: what it was told, what it said, and what became of it.

`ControlSupervisor` knows the process; this knows the vendor library in it: whether it is connected,
whether our control program runs, how the last move stands, and who has control of the robot.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Generator
from typing import Any

from crtk_driver_ur.control import ControlOptions, ControlSupervisor
from crtk_driver_ur.control_frames import Event, EventKind, Reply
from crtk_drivers.device import MoveProgress, Steps
from crtk_drivers.errors import ConnectionLost, DeviceFault, MotionAborted, TransitionFailed

__all__ = ["ControlLink"]

REMOTE_CHECK_PERIOD = 0.5
"""Seconds between two questions whether the teach pendant has control."""

RESTART_PERIOD = 1.0
"""Seconds at least between two starts of the control process."""

PROGRAM_START_ALLOWED = 6.0
"""Seconds after an upload in which the program may still start."""

_MOVE_FAILURES = {
    EventKind.INTERRUPTED: "another command took its place",
    EventKind.MOTION_FAILED: "the controller did not carry it out",
    EventKind.PROGRAM_STOPPED: "the control program was stopped on the controller",
}

logger = logging.getLogger(__name__)


class ControlLink:
    """Everything but `stop` belongs to the I/O thread. Nothing waits but `close`.

    Args:
        host: address of the controller.
        options: how to connect and to move.
        where: the device, for messages.

    Attributes:
        process: for commands of motion, through `send`.
        loss: why control was lost, in words; empty if it was not. Cleared by whoever starts anew.
        program_runs: our control program was started and not seen to stop since.
        has_local_control: the controller knows local and remote control, and is asked which it is.
        remote: whether it is in remote control; None if not known.
    """

    def __init__(self, host: str, options: ControlOptions, where: str) -> None:
        self.process = ControlSupervisor(host, options)
        self.loss = ""
        self.program_runs = False
        self.has_local_control = False
        self.remote: bool | None = None
        self._where = where
        self._awaited: set[int] = set()
        self._replies: dict[int, Reply] = {}
        self._remote_asked = 0
        self._remote_asked_at = -math.inf
        self._was_local = False
        self._interrupted_at = -math.inf
        self._started_at = -math.inf
        self._connected_process = 0
        self._motion = 0
        self._progress = MoveProgress.DONE
        self._move_failure = ""
        self._stopping = 0

    # The process

    def open(self, *, has_local_control: bool) -> None:
        """Start a process, in place of any that is left.

        Raises:
            ConnectionFailed: the operating system refuses to.
        """
        self.loss, self.remote, self.has_local_control = "", None, has_local_control
        self.restart()

    def close(self, timeout: float) -> None:
        """Let the process stop the arm and end, or kill it after `timeout` seconds."""
        self.program_runs = False
        self.process.close(timeout)

    def restart(self) -> None:
        """Kill the process and start another, at once."""
        self.process.kill()
        self._start()

    def _start(self) -> None:
        self._started_at = time.monotonic()
        try:
            self.process.start()
        except ConnectionLost as error:
            # It died as soon as it was born; `follow` will find that out.
            logger.warning("%s", error)
        self._remote_asked = self._stopping = 0
        self.program_runs = False
        self._replies.clear()

    @property
    def ready(self) -> bool:
        """Whether there is a process."""
        return self.process.status.alive

    @property
    def connected(self) -> bool:
        """Whether the present process has connected the library."""
        status = self.process.status
        return status.alive and status.starts == self._connected_process

    @property
    def connecting(self) -> bool:
        """Whether the process is busy with something before it is connected; that may take long."""
        return not self.connected and bool(self.process.status.call)

    # Following it

    def follow(self) -> None:
        """Take what the process said, replace it if it died or hangs, ask who has control."""
        for notice in self.process.poll():
            if isinstance(notice, Event):
                self._take_event(notice)
            elif notice.sequence == self._remote_asked:
                self._remote_asked = 0
                self.control_is(None if notice.error is not None else bool(notice.value))
            elif notice.sequence in self._awaited:
                self._replies[notice.sequence] = notice
        now = time.monotonic()
        self._kill_if_silent()
        if not self.process.status.alive:
            if now > self._started_at + RESTART_PERIOD:
                self._start()
        elif self.has_local_control and not self._remote_asked:
            self._ask_who_has_control(now)

    def control_is(self, remote: bool | None) -> None:
        """Take note of who has control."""
        self.remote = remote
        self._was_local |= remote is False

    def _take_event(self, event: Event) -> None:
        error = event.error
        if event.sequence == self._motion:
            if event.kind is EventKind.MOVE_DONE:
                self._progress = MoveProgress.DONE
            elif event.kind in _MOVE_FAILURES:
                self._progress = MoveProgress.FAILED
                self._move_failure = error.text or _MOVE_FAILURES[event.kind]
        if event.kind is EventKind.STOPPED and event.sequence >= self._stopping:
            self._stopping = 0
        if event.kind in (EventKind.PROCESS_DIED, EventKind.CONNECTION_LOST):
            self.loss = self.loss or f"{error.text}. {error.hint}"
            logger.error("%s: %s", self._where, error.text)
        elif event.kind is EventKind.PROGRAM_STOPPED:
            self.program_runs = False
            self._stopping = 0
            self._remote_asked_at = -math.inf
        elif event.kind in (EventKind.MOTION_FAILED, EventKind.BAD_FRAME):
            logger.warning("%s: %s: %s %s", self._where, error.call, error.text, error.hint)

    def _kill_if_silent(self) -> None:
        status = self.process.status
        if not status.alive or status.responsive:
            return
        call = f" in {status.call}" if status.call else ""
        self.loss = (
            f"the control process has been silent for {status.silent_for:.2f} s{call}. "
            "It is replaced; the arm has to be enabled again."
        )
        logger.error("%s: %s", self._where, self.loss)
        self.process.kill()

    def _ask_who_has_control(self, now: float) -> None:
        if now - self._remote_asked_at > REMOTE_CHECK_PERIOD:
            self._remote_asked_at = now
            self._remote_asked = self._try_request("is_in_remote_control")

    # Motion

    def send(self, command: Callable[..., int], *arguments: Any) -> int:
        """Call one of the commands of `process` and return its number.

        Raises:
            DeviceFault: there is no process, or it does not read.
        """
        try:
            return command(*arguments)
        except ConnectionLost as error:
            raise DeviceFault(
                error.message, where=self._where, remedy="Send enable to start again."
            ) from error

    def move(self, command: Callable[..., int], *arguments: Any) -> None:
        """Send a move, whose end `move_progress` tells."""
        self._progress, self._move_failure = MoveProgress.RUNNING, ""
        self._motion = self.send(command, *arguments)

    def move_progress(self) -> MoveProgress:
        """Say where the last move stands.

        Raises:
            MotionAborted: it failed, with the reason.
        """
        if self._progress is MoveProgress.FAILED:
            raise MotionAborted(self._move_failure, where=self._where)
        return self._progress

    def stop(self) -> None:
        """Stop any motion. From any thread."""
        try:
            self._stopping = self.process.stop()
        except ConnectionLost as error:
            logger.warning("%s; the controller's watchdog stops the arm", error)

    @property
    def stopping(self) -> bool:
        """Whether the arm has not come to rest yet after the last `stop`."""
        return self._stopping > 0

    # Requests

    def ask(self, name: str, **arguments: Any) -> Generator[None, None, Any]:
        """Send a slow request and return the value of its answer.

        Raises:
            TransitionFailed: it was refused, or the process was replaced meanwhile.
            DeviceFault: it could not be sent.
        """
        sequence = self.send(lambda: self.process.request(name, **arguments))
        return (yield from self._answer(name, sequence))

    def start_program(self) -> Steps:
        """Start our control program, through the present process if that can, or else through another.

        Raises:
            TransitionFailed: with the library's reason.
        """
        try:
            uploaded = yield from self._upload()
            if uploaded:
                return
            if self._connected_process == self.process.status.starts:
                self.restart()
            yield from self._answer("connect", self.send(self.process.connect))
        except BaseException:
            self._interrupted_at = time.monotonic()
            raise
        self._connected_process, self._was_local = self.process.status.starts, False

    @property
    def left_program(self) -> bool:
        """Whether a program of ours may run unattended: its start ended before its watchdog was armed."""
        return self._interrupted_at > -math.inf

    def program_stands(self) -> None:
        """No program is running on the controller."""
        self.program_runs = False
        if time.monotonic() > self._interrupted_at + PROGRAM_START_ALLOWED:
            self._interrupted_at = -math.inf

    def end_left_program(self) -> Steps:
        """Stop the program of which `left_program` speaks.

        Raises:
            TransitionFailed: the controller did not.
        """
        logger.warning("%s: a control program left by an interrupted start is stopped", self._where)
        yield from self.ask("stop_program")

    def stop_program(self) -> Steps:
        """Stop our control program. If the process cannot, the controller's watchdog does."""
        try:
            yield from self.ask("stop_script")
        except TransitionFailed as error:
            logger.warning("%s", error)

    def end_paused_program(self) -> None:
        """End our program instead of leaving it paused: somebody could continue a motion unasked."""
        self.program_runs = False
        self._try_request("stop_program")

    def _upload(self) -> Generator[None, None, bool]:
        # A switch to local control closes the port for programs, and the library never opens it again.
        if not self.connected or self._was_local:
            return False
        try:
            yield from self._answer("upload_script", self.send(self.process.upload_script))
        except TransitionFailed as error:
            logger.warning("%s", error)
            return False
        return True

    def _try_request(self, name: str) -> int:
        try:
            return self.process.request(name)
        except ConnectionLost as error:
            logger.warning("%s", error)
            return 0

    def _answer(self, name: str, sequence: int) -> Generator[None, None, Any]:
        """Wait for the answer to a request and return its value."""
        starts = self.process.status.starts
        self._awaited.add(sequence)
        try:
            while sequence not in self._replies:
                if self.process.status.starts != starts:
                    raise TransitionFailed(
                        f"{name}: {self.loss or 'the control process was replaced'}",
                        where=self._where,
                        remedy="Send it again.",
                    )
                yield
            reply = self._replies.pop(sequence)
        finally:
            self._awaited.discard(sequence)
            self._replies.pop(sequence, None)
        if reply.error is not None:
            raise TransitionFailed(
                f"{reply.error.call}: {reply.error.text}",
                where=self._where,
                remedy=reply.error.hint,
            )
        return reply.value

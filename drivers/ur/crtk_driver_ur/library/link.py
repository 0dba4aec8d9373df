"""Commands by ur-rtde, in the control process: what it was told, what it said, what became of it.

`ControlSupervisor` knows the process; this knows the vendor library in it: whether it is connected,
whether our control program runs, and how the last move stands.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from typing import Any

from typing_extensions import override

from crtk_driver_ur.control_link import INTERRUPTED, PROGRAM_STOPPED, ControlLink
from crtk_driver_ur.control_options import ControlOptions
from crtk_driver_ur.library.packets import Event, EventKind
from crtk_driver_ur.library.supervisor import ControlSupervisor
from crtk_driver_ur.request_worker import Controller
from crtk_driver_ur.rtde.state_sample import StateSample
from crtk_driver_ur.safety import stood
from crtk_drivers.device import MoveProgress, Steps
from crtk_drivers.errors import ConnectionLost, DeviceFault, TransitionFailed

__all__ = ["ProcessLink"]

RESTART_PERIOD = 1.0
"""Seconds at least between two starts of the control process."""

PROGRAM_START_ALLOWED = 6.0
"""Seconds after an upload in which the program may still start."""

CLOSE_TIMEOUT = 0.7
"""Seconds for the control process to stop the arm and end."""

FREEDRIVE_SINCE = (5, 10)
"""PolyScope version from which on ur_rtde's control program has freedrive; below it does nothing."""

TARGET_PAYLOAD_SINCE = (5, 10)
"""PolyScope version from which on ur_rtde's control program sets an inertia; below it does nothing."""

_MOVE_FAILURES = {
    EventKind.DRIVER_SILENT: "the control process heard nothing of the driver for a while, and stopped it",
    EventKind.INTERRUPTED: INTERRUPTED,
    EventKind.MOTION_FAILED: "the controller did not carry it out",
    EventKind.PROGRAM_STOPPED: PROGRAM_STOPPED,
}

logger = logging.getLogger(__name__)


class ProcessLink(ControlLink):
    """Control by the vendor library, in a process of its own.

    Args:
        host: address of the controller.
        options: how to connect and to move.
        where: the device, for messages.

    Attributes:
        process: the process.
    """

    def __init__(self, host: str, options: ControlOptions, where: str) -> None:
        super().__init__(where)
        self.process = ControlSupervisor(host, options)
        self._teach_mode = False
        self._has_target_payload = False
        self._interrupted_at = -math.inf
        self._started_at = -math.inf
        self._connected_process = 0
        self._motion = 0
        self._stopping = 0
        self._left_running = False
        self._is_told_gone = False

    # The process

    @override
    def open(self, version: tuple[int, int], *, has_local_control: bool) -> None:
        self.loss, self.remote, self.has_local_control = "", None, has_local_control
        self.process.version = version
        self._teach_mode = version < FREEDRIVE_SINCE
        self._has_target_payload = version >= TARGET_PAYLOAD_SINCE
        self._restart()

    @override
    def close(self, *, lost: bool) -> None:
        self.program_runs = self._left_running = False
        if lost:
            # Waiting for a library that lost its controller too would keep the caller.
            self.process.kill()
        self.process.close(CLOSE_TIMEOUT)

    @property
    @override
    def _controller(self) -> Controller:
        process = self.process
        return Controller(process.host, process.version, process.options.robot_api_port)

    def _restart(self) -> None:
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
        self._stopping = 0
        self._is_told_gone = False
        self._left_running |= self.program_runs
        self.program_runs = False
        self._forget_requests()

    @property
    @override
    def ready(self) -> bool:
        return self.process.status.alive

    @property
    @override
    def connected(self) -> bool:
        status = self.process.status
        return status.alive and status.starts == self._connected_process

    @override
    def give_up_connecting(self) -> None:
        if not self.connected and self.process.status.call:
            self._restart()

    @property
    @override
    def counters(self) -> Mapping[str, float]:
        status = self.process.status
        return {
            "control process starts": float(status.starts),
            "control process silent for (s)": status.silent_for if status.alive else math.nan,
            "longest library call (s)": status.heartbeat.longest_call,
        }

    # Following it

    @override
    def follow(self) -> None:
        """Replaces the process if it died or hangs."""
        for notice in self.process.poll():
            if isinstance(notice, Event):
                self._take_event(notice)
            else:
                self._take_reply(notice)
        self._kill_if_silent()
        if self.process.status.alive:
            self._ask_dashboard()
        elif time.monotonic() > self._started_at + RESTART_PERIOD:
            self._start()

    @override
    def take(self, state: StateSample) -> None:
        if stood(state):
            self.program_runs = self._left_running = False
            if time.monotonic() > self._interrupted_at + PROGRAM_START_ALLOWED:
                self._interrupted_at = -math.inf

    def _take_event(self, event: Event) -> None:
        error = event.error
        if event.sequence == self._motion:
            if event.kind is EventKind.MOVE_DONE:
                self._progress = MoveProgress.DONE
            elif event.kind in _MOVE_FAILURES and self._progress is not MoveProgress.FAILED:
                self._move_failed(error.text or _MOVE_FAILURES[event.kind])
        if event.kind is EventKind.STOPPED and event.sequence >= self._stopping:
            self._stopping = 0
        if event.kind in (EventKind.PROCESS_DIED, EventKind.CONNECTION_LOST):
            self._left_running |= self.program_runs
            if self._connected_process == self.process.status.starts:
                # The library may have connected and started its program anew, without the watchdog.
                self._interrupted_at = time.monotonic()
            self.loss = self.loss or f"{error.text}. {error.hint}"
            logger.error("%s: %s", self._where, error.text)
        elif event.kind is EventKind.PROGRAM_STOPPED:
            self.program_runs = False
            self._stopping = 0
            self._asks_remote.hurry()
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

    # Motion

    @override
    def servo_joint(self, q: Sequence[float]) -> None:
        self._send(self.process.send_servo_joint, q)

    @override
    def speed_joint(self, qd: Sequence[float], acceleration: float, valid_for: float) -> None:
        self._send(self.process.send_speed_joint, qd, acceleration, valid_for)

    @override
    def speed_cartesian(
        self, twist: Sequence[float], acceleration: float, valid_for: float
    ) -> None:
        self._send(self.process.send_speed_cartesian, twist, acceleration, valid_for)

    @override
    def move_joint(self, q: Sequence[float], speed: float, acceleration: float) -> None:
        self._move(self.process.move_joint, q, speed, acceleration)

    @override
    def move_linear(self, pose: Sequence[float], speed: float, acceleration: float) -> None:
        self._move(self.process.move_linear, pose, speed, acceleration)

    @override
    def freedrive(self) -> None:
        self._move(lambda: self.process.freedrive(teach_mode=self._teach_mode))

    @override
    def stop(self) -> None:
        try:
            self._stopping = self.process.stop()
        except ConnectionLost as error:
            if not self._is_told_gone:  # it is asked for again and again
                self._is_told_gone = True
                logger.warning("%s; the controller's watchdog stops the arm", error.statement)

    @property
    @override
    def stopping(self) -> bool:
        return self._stopping > 0 or self._left_running

    def _send(self, command: Callable[..., int], *arguments: Any) -> int:
        """Call one of the commands of `process` and return its number."""
        try:
            return command(*arguments)
        except ConnectionLost as error:
            raise DeviceFault(
                error.message,
                where=self._where,
                remedy="It is replaced; the arm has to be enabled again.",
            ) from error

    def _move(self, command: Callable[..., int], *arguments: Any) -> None:
        self._progress, self._move_failure = MoveProgress.RUNNING, ""
        self._motion = self._send(command, *arguments)

    # The control program

    @override
    def start_program(self) -> Steps:
        """Through the present process if that can, or else through another."""
        try:
            uploaded = yield from self._upload()
            if uploaded:
                return
            if self._connected_process == self.process.status.starts:
                self._restart()
            yield from self._answer("connect", self._send(self.process.connect))
        except BaseException:
            self._interrupted_at = time.monotonic()
            raise
        self._connected_process, self._was_local = self.process.status.starts, False
        self._left_running = False

    @property
    @override
    def left_program(self) -> bool:
        """Its start ended before its watchdog was armed, by us or by the library."""
        return self._interrupted_at > -math.inf

    @override
    def stop_program(self) -> Steps:
        try:
            yield from self.ask("stop_script")
        except TransitionFailed as error:
            logger.warning("%s", error)

    def _upload(self) -> Generator[None, None, bool]:
        # A switch to local control closes the port for programs, and the library never opens it again.
        if not self.connected or self._was_local:
            return False
        try:
            yield from self._answer("upload_script", self._send(self.process.upload_script))
        except TransitionFailed as error:
            logger.warning("%s", error)
            return False
        return True

    # Requests

    @property
    @override
    def _generation(self) -> int:
        return self.process.status.starts

    @override
    def _request(self, name: str, arguments: Mapping[str, Any]) -> int:
        if name == "set_target_payload" and not self._has_target_payload:
            without = {key: value for key, value in arguments.items() if key != "inertia"}
            return self._request("set_payload", without)
        return self._send(lambda: self.process.request(name, **arguments))

"""The driver's side of the control process: start it, tell it, watch it, replace it. Never waits."""

from __future__ import annotations

import itertools
import logging
import os
import socket
import subprocess
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from typing import Any, TypeAlias

from crtk_driver_ur.control_options import ControlOptions
from crtk_driver_ur.control_requests import CallError, Reply, Request
from crtk_driver_ur.library.packets import (
    MAX_FRAME,
    Alive,
    Calling,
    Event,
    EventKind,
    Frame,
    FrameError,
    Heartbeat,
    MotionCommand,
    MotionKind,
    decode,
    encode,
    six,
)
from crtk_drivers.errors import ConnectionLost
from crtk_drivers.kit.child_process import spawn

Notice: TypeAlias = Reply | Event

ALIVE_PERIOD = 0.1
SILENCE_ALLOWED = 0.5
"""Seconds without a heartbeat, outside of a library call, after which the process counts as hung."""
START_ALLOWED = 30.0
"""Seconds for the interpreter of the process to start; a busy machine is no reason to start it again."""
DIES = 5.0
"""Seconds in which a process that is killed is gone, unless the system is in a driver of its own with it."""
_ERROR_LINES = 20
_NO_BEAT = Heartbeat(0, MotionKind.NONE, False, False, False, 0, 0.0)

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class ControlStatus:
    """What is known of the control process.

    Attributes:
        pid: its process id, 0 if there is none.
        alive: the process exists.
        responsive: it exists and is not silent for longer than it may be.
        silent_for: seconds since it was heard.
        call: the library call that it announced last and may still be in; empty if none.
        heartbeat: what it said last of the motion, the connection and the control program.
        starts: how many processes were started so far.
        errors: the last lines that it (or the library) wrote to its standard error.
    """

    pid: int
    alive: bool
    responsive: bool
    silent_for: float
    call: str
    heartbeat: Heartbeat
    starts: int
    errors: tuple[str, ...]


class ControlSupervisor:
    """Starts, commands, watches and replaces the process that owns the vendor library.

    Commands return at once with a sequence number that replies and events carry. `poll` must be called
    regularly, at least ten times a second: it collects what the process says, and tells it that the
    driver lives. `stop` may be called from any thread; everything else belongs to one.

    Args:
        host: address of the controller.
        options: how to connect and to move.
        clock: the monotonic clock.

    Attributes:
        version: major and minor version of the controller's software; to be set before `start`.

    Raises (all commands):
        ConnectionLost: there is no process, or it does not read its commands; call `replace`.
    """

    def __init__(
        self,
        host: str,
        options: ControlOptions | None = None,
        *,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.host = host
        self.options = options or ControlOptions()
        self.version = (0, 0)
        self._clock = clock
        self._where = f"ur_rtde control {host}"
        self._sequences = itertools.count(1)
        self._process: subprocess.Popen[bytes] | None = None
        self._zombies: list[subprocess.Popen[bytes]] = []
        self._peer: socket.socket | None = None
        self._errors_fd = -1
        self._errors: deque[str] = deque(maxlen=_ERROR_LINES)
        self._error_tail = b""
        self._beat = _NO_BEAT
        self._call = ""
        self._heard_at = 0.0
        self._allowed = 0.0
        self._spoke_at = 0.0
        self._is_told_deaf = False
        self._starts = 0

    # The process

    def start(self) -> None:
        """Start the process; it connects to nothing yet.

        Raises:
            RuntimeError: one is running already.
            ConnectionFailed: the operating system refuses to start it.
        """
        if self._process is not None:
            raise RuntimeError("the control process is running; call replace")
        self._process, self._peer, self._errors_fd = spawn(
            "crtk_driver_ur.library.process",
            str(os.getpid()),
            called="the control process",
            where=self._where,
        )
        self._errors.clear()
        self._error_tail = b""
        self._beat, self._call = _NO_BEAT, "start"
        self._is_told_deaf = False
        self._heard_at, self._allowed = self._clock(), START_ALLOWED
        self._starts += 1
        self.request(
            "configure",
            host=self.host,
            version=list(self.version),
            robot_api_port=self.options.robot_api_port,
        )

    def kill(self) -> None:
        """End the process at once. The controller stops the arm when its watchdog is not fed."""
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            self._zombies.append(process)
        self._release()
        self._reap()

    def replace(self) -> None:
        """Kill the process and start another, which has to be connected anew. Does not wait."""
        self.kill()
        self.start()

    def close(self, timeout: float = 3.0) -> None:
        """Let the process stop the arm and end; kill it if it has not within `timeout` seconds."""
        process, self._process = self._process, None
        if process is not None:
            # The end of the socket is the sign to stop.
            if self._peer is not None:
                self._peer.close()
                self._peer = None
            self._zombies.append(process)
        deadline = self._clock() + timeout
        for zombie in self._zombies:
            try:
                zombie.wait(max(0.0, deadline - self._clock()))
            except subprocess.TimeoutExpired:
                zombie.kill()
        self._await_killed()
        self._release()

    def _await_killed(self) -> None:
        """Wait until those that were killed are gone; one that the system does not let go of stays."""
        deadline = self._clock() + DIES
        for zombie in self._zombies:
            with suppress(subprocess.TimeoutExpired):
                zombie.wait(max(0.0, deadline - self._clock()))
        self._reap()
        for zombie in self._zombies:
            _log.warning("%s: process %d was killed and is not gone", self._where, zombie.pid)

    @property
    def status(self) -> ControlStatus:
        """What is known now."""
        alive = self._process is not None
        silent_for = self._clock() - self._heard_at
        return ControlStatus(
            pid=self._process.pid if self._process is not None else 0,
            alive=alive,
            responsive=alive and silent_for <= self._allowed,
            silent_for=silent_for,
            call=self._call,
            heartbeat=self._beat,
            starts=self._starts,
            errors=tuple(self._errors),
        )

    # Motion

    def send_servo_joint(self, q: Sequence[float]) -> int:
        """Stream a joint position (6, rad). The arm holds the last one when the stream ends."""
        return self._motion(MotionKind.SERVO_JOINT, q)

    def send_speed_joint(self, qd: Sequence[float], acceleration: float, valid_for: float) -> int:
        """Stream joint speeds (6, rad/s), reached with `acceleration` rad/s².

        The arm is stopped when no other speed follows within `valid_for` seconds.
        """
        return self._motion(MotionKind.SPEED_JOINT, qd, acceleration, valid_for)

    def send_speed_cartesian(
        self, twist: Sequence[float], acceleration: float, valid_for: float
    ) -> int:
        """Stream a twist of the TCP (m/s, rad/s, base axes), reached with `acceleration` m/s².

        The arm is stopped when no other twist follows within `valid_for` seconds.
        """
        return self._motion(MotionKind.SPEED_CARTESIAN, twist, acceleration, valid_for)

    def move_joint(self, q: Sequence[float], speed: float, acceleration: float) -> int:
        """Move to a joint position (6, rad) by moveJ: rad/s and rad/s² of the leading axis."""
        return self._motion(MotionKind.MOVE_JOINT, q, speed, acceleration)

    def move_linear(self, pose: Sequence[float], speed: float, acceleration: float) -> int:
        """Move the TCP on a straight line to `pose` by moveL.

        Args:
            pose: x, y, z in m and a rotation vector in rad, in the base frame.
            speed, acceleration: of the tool, in m/s and m/s².
        """
        return self._motion(MotionKind.MOVE_LINEAR, pose, speed, acceleration)

    def freedrive(self, *, teach_mode: bool = False) -> int:
        """Let the arm be moved by hand, until `stop` or the next motion.

        Args:
            teach_mode: the way of controllers before PolyScope 5.10, whose control program does
                nothing in answer to ur_rtde's freedriveMode.
        """
        kind = MotionKind.TEACH_MODE if teach_mode else MotionKind.FREEDRIVE
        return self._motion(kind, (0.0,) * 6)

    def stop(self) -> int:
        """Stop any motion, smoothly, and hold. May be called from any thread."""
        return self._motion(MotionKind.STOP, (0.0,) * 6)

    def _motion(
        self, kind: MotionKind, values: Sequence[float], first: float = 0.0, second: float = 0.0
    ) -> int:
        sequence = next(self._sequences)
        self._send(MotionCommand(sequence, kind, six(values), float(first), float(second)))
        return sequence

    # Requests

    def connect(self) -> int:
        """Connect the library, upload and start the control program, arm the robot-side watchdog.

        The arm must be powered, its brakes released, and the robot in remote control. Nothing moves.
        """
        return self.request(
            "connect",
            host=self.host,
            watchdog_frequency=self.options.watchdog_frequency,
            upper_range_registers=self.options.upper_range_registers,
            require_remote_control=self.options.require_remote_control,
            **asdict(self.options.motion),
        )

    def upload_script(self) -> int:
        """Upload and start the control program again, after it was stopped by whatever."""
        return self.request("upload_script")

    def request(self, name: str, **arguments: Any) -> int:
        """Send a slow request; a `Reply` with the returned number follows.

        Control program: ``connect``, ``upload_script``, ``stop_script``,
        ``set_payload(mass, center_of_gravity)``, ``set_tcp(pose)``, ``set_gravity(direction)``,
        ``zero_ft_sensor``. Inputs and outputs: ``set_speed_slider(fraction)``,
        ``set_standard_digital_out(pin, on)``, ``set_configurable_digital_out(pin, on)``,
        ``set_tool_digital_out(pin, on)``, ``set_analog_output_voltage(pin, ratio)``,
        ``set_analog_output_current(pin, ratio)``. Dashboard: the names in
        `crtk_driver_ur.dashboard.REQUESTS`, for example ``power_on``.
        """
        sequence = next(self._sequences)
        self._send(Request(sequence, name, arguments))
        return sequence

    # Watching

    def poll(self) -> list[Notice]:
        """Return the replies and events that have come, and keep the process convinced of our life."""
        self._reap()
        notices: list[Notice] = []
        ended = self._peer is not None and self._receive(notices)
        self._read_errors()
        if ended:
            notices.append(self._died())
        elif self._peer is not None and self._clock() - self._spoke_at > ALIVE_PERIOD:
            try:
                self._send(Alive())
            except ConnectionLost as error:
                self._spoke_at = self._clock()
                if not self._is_told_deaf:
                    self._is_told_deaf = True
                    _log.warning("%s", error)
        return notices

    def _receive(self, notices: list[Notice]) -> bool:
        """Take all that has come; True if the other end is gone."""
        assert self._peer is not None
        while True:
            try:
                data = self._peer.recv(MAX_FRAME)
            except BlockingIOError:
                return False
            except OSError:
                return True
            if not data:
                return True
            try:
                frame = decode(data)
            except FrameError as error:
                bad = CallError("decode", str(error), "Report it.")
                notices.append(Event(EventKind.BAD_FRAME, 0, bad))
                continue
            self._heard_at, self._allowed, self._call = self._clock(), SILENCE_ALLOWED, ""
            if isinstance(frame, Heartbeat):
                self._beat = frame
            elif isinstance(frame, Calling):
                self._call, self._allowed = frame.call, frame.allowed + SILENCE_ALLOWED
            elif isinstance(frame, Reply | Event):
                notices.append(frame)

    def _died(self) -> Event:
        process, self._process = self._process, None
        code: int | None = None
        if process is not None:
            code = process.poll()
            self._zombies.append(process)
        how = "ended" if code is None else f"ended with status {code}"
        if code is not None and code < 0:
            how = f"was killed by signal {-code}"
        text = f"the control process {how}"
        if self._errors:
            text += f"; last words: {self._errors[-1]}"
        self._release()
        self._beat = _NO_BEAT
        hint = "It is replaced; the arm has to be enabled again."
        return Event(EventKind.PROCESS_DIED, 0, CallError("control_process", text, hint))

    def _send(self, frame: Frame) -> None:
        peer = self._peer
        if peer is None:
            raise ConnectionLost(
                "there is no control process",
                where=self._where,
                remedy="Enable the arm, which starts one.",
            )
        try:
            peer.send(encode(frame))
        except OSError as error:
            state = (
                "does not read its commands" if isinstance(error, BlockingIOError) else "is gone"
            )
            raise ConnectionLost(
                f"the control process {state}",
                where=self._where,
                remedy="It has to be replaced; the controller stops the arm meanwhile.",
            ) from error
        self._spoke_at = self._clock()

    def _read_errors(self) -> None:
        """Keep the last lines of what the process writes, and pass them to the log."""
        if self._errors_fd < 0:
            return
        try:
            data = os.read(self._errors_fd, 65536)
        except BlockingIOError:
            return
        *lines, self._error_tail = (self._error_tail + data).split(b"\n")
        for line in lines:
            text = line.decode(errors="replace").strip()
            if text:
                self._errors.append(text)
                _log.debug("%s: %s", self._where, text)
        self._error_tail = self._error_tail[-1000:]

    def _release(self) -> None:
        if self._peer is not None:
            self._peer.close()
            self._peer = None
        if self._errors_fd >= 0:
            os.close(self._errors_fd)
            self._errors_fd = -1

    def _reap(self) -> None:
        self._zombies = [zombie for zombie in self._zombies if zombie.poll() is None]

"""Commands by a control program of our own: setpoints go out from the I/O thread, over RTDE registers.

The program (`program.script`) is uploaded by `start_program`. What waits for the network (the
dashboard, outputs, connecting) is done by threads of their own.
"""

from __future__ import annotations

import itertools
import logging
import math
import secrets
import socket
import time
from collections import deque
from collections.abc import Callable, Generator, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Final, NamedTuple

from typing_extensions import override

from crtk_driver_ur.control_link import INTERRUPTED, PROGRAM_STOPPED, ControlLink
from crtk_driver_ur.control_options import ControlOptions
from crtk_driver_ur.control_requests import CallError, Reply, Request
from crtk_driver_ur.dashboard import REQUESTS
from crtk_driver_ur.dashboard_worker import DashboardWorker
from crtk_driver_ur.native.program import (
    SLOWEST_PACE,
    UPPER_RANGE,
    Kind,
    Phase,
    ProgramOptions,
    ProgramState,
    Setting,
    program_text,
)
from crtk_driver_ur.native.registers import FEED_PERIOD, ControlChannel
from crtk_driver_ur.native.upload import PROGRAM_REQUESTS, ProgramWorker
from crtk_driver_ur.output_worker import OUTPUT_REQUESTS, OutputWorker
from crtk_driver_ur.primary import MessageReader, PrimaryError
from crtk_driver_ur.request_worker import Controller, RequestWorker
from crtk_driver_ur.rtde.state_sample import StateSample
from crtk_driver_ur.safety import STANDING_PROGRAM, RuntimeState
from crtk_drivers.device import MoveProgress, Steps
from crtk_drivers.errors import ConnectionLost, DeviceFault, TransitionFailed

__all__ = ["NativeLink"]

PROGRAM_START_TIMEOUT: Final = 5.0
"""Seconds after the upload in which the program must start."""

PROGRAM_END_TIMEOUT: Final = 1.0
"""Seconds in which it must end when it is told to."""

NO_PROGRAM: Final = -1
"""In place of a program's number, which is above zero."""

REPLACED_AFTER: Final = 0.5
"""Seconds of the controller's clock without a cycle of our program after which it counts as replaced."""

STOP_TIMEOUT: Final = 0.3
"""Seconds without an answer of the program after which it is stopped another way: of our clock, and of the
controller's in the states that came. One that was read late is from before the stop."""

STOP_UNHEARD: Final = 1.0
"""The same of our clock, where no state comes that could tell of the answer."""

NEVER: Final = 2**31
"""In place of a motion's number: the program will not say that it has taken it."""

STOP_PROGRAM: Final = "def crtk_stop():\n  stopj({:g})\nend\n"

CLOSE_TIMEOUT: Final = 0.7
"""Most seconds that `close` feeds the watchdog while the arm slows down, and waits for threads to end."""

STOP_MARGIN: Final = 0.1
"""Seconds for the last of a stop to die away."""

_WORKERS: Final[Mapping[str, type[RequestWorker]]] = MappingProxyType(
    {
        **dict.fromkeys(REQUESTS, DashboardWorker),
        **dict.fromkeys(OUTPUT_REQUESTS, OutputWorker),
        **dict.fromkeys(PROGRAM_REQUESTS, ProgramWorker),
    }
)
"""Requests that are carried out by a thread of their own."""

_SETTINGS: Final[Mapping[str, tuple[Setting, Callable[..., Sequence[float]]]]] = MappingProxyType(
    {
        "set_payload": (
            Setting.PAYLOAD,
            lambda mass, center_of_gravity: (mass, *center_of_gravity),
        ),
        "set_tcp": (Setting.TCP, lambda pose: pose),
        "set_gravity": (Setting.GRAVITY, lambda direction: direction),
        "zero_ft_sensor": (Setting.ZERO_FORCE_SENSOR, lambda: ()),
        "set_target_payload": (
            Setting.TARGET_PAYLOAD,
            lambda mass, center_of_gravity, inertia: (mass, *center_of_gravity, *inertia),
        ),
        "set_free_axes": (Setting.FREE_AXES, lambda axes, of_tool: (*axes, of_tool)),
        "set_force_axes": (Setting.FORCE_AXES, lambda axes, of_tool: (*axes, of_tool)),
        "set_force_limits": (
            Setting.FORCE_LIMITS,
            lambda linear, angular: (linear,) * 3 + (angular,) * 3,
        ),
        "set_force_damping": (Setting.FORCE_DAMPING, lambda damping: (damping,)),
        "set_force_gain": (Setting.FORCE_GAIN, lambda gain: (gain,)),
    }
)
"""Requests that the control program carries out, and their values."""

logger = logging.getLogger(__name__)


class _PendingSetting(NamedTuple):
    request: int
    name: str
    setting: Setting
    values: Sequence[float]


class NativeLink(ControlLink):
    """Control by a program of our own.

    Args:
        host: address of the controller.
        options: how to connect and to move.
        where: the device, for messages.
        clock: the monotonic clock.
    """

    def __init__(
        self,
        host: str,
        options: ControlOptions,
        where: str,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(where)
        self._host = host
        self._options = options
        self._first = UPPER_RANGE if options.upper_range_registers else 0
        self._clock = clock
        self._version = (0, 0)
        self._requests = itertools.count(1)
        self._opened = 0
        self._workers: dict[type[RequestWorker], RequestWorker] = {}
        self._channel: ControlChannel | None = None
        self._primary: socket.socket | None = None
        self._messages = MessageReader()
        self._program = NO_PROGRAM
        self._reported = ProgramState()
        self._cycled_at = 0.0
        self._speed = 0.0
        self._pace = 1.0
        self._starts = 0
        self._settings: deque[_PendingSetting] = deque()
        self._setting = 0
        self._move = 0
        self._stopping = 0
        self._taken = False
        self._rests = False
        self._told_at = (-math.inf, 0.0)  # when the newest state was read, and its timestamp
        self._stop_asked_at = self._told_at
        self._replaced_at = -math.inf

    # The connection

    @override
    def open(self, version: tuple[int, int], *, has_local_control: bool) -> None:
        self.close(lost=True)
        self.loss, self.remote, self.has_local_control = "", None, has_local_control
        self._version = version
        self._program, self._reported = NO_PROGRAM, ProgramState()
        self._opened += 1
        self._workers = {kind: kind(self._controller) for kind in dict.fromkeys(_WORKERS.values())}
        for worker in self._workers.values():
            worker.start()

    @override
    def close(self, *, lost: bool) -> None:
        if self._channel is not None and self.program_runs:
            self._quit(0.0 if lost else self._stop_time())
        self._drop_channel()
        self._program_ended("the driver has closed the connection")
        workers, self._workers = self._workers.values(), {}
        for worker in workers:
            worker.stop()
        deadline = self._clock() + CLOSE_TIMEOUT
        for worker in workers:
            worker.join(deadline)
        self._opened += 1
        self._forget_requests()

    @property
    @override
    def _controller(self) -> Controller:
        return Controller(self._host, self._version, self._options.robot_api_port)

    def _stop_time(self) -> float:
        """Return how long the arm needs to come to rest, s."""
        if self._speed == 0.0:
            return 0.0
        seconds = self._speed / self._options.motion.joint_deceleration / self._pace
        return min(CLOSE_TIMEOUT, seconds + STOP_MARGIN)

    def _quit(self, seconds: float) -> None:
        """Let the program stop the arm and end, feeding its watchdog for so long."""
        assert self._channel is not None
        deadline = self._clock() + seconds
        try:
            self._channel.command(Kind.QUIT)
            while self._clock() < deadline:
                time.sleep(FEED_PERIOD)
                self._channel.feed()
        except ConnectionLost as error:
            logger.warning("%s; the controller's watchdog stops the arm", error.statement)

    def _drop_channel(self) -> None:
        channel, self._channel = self._channel, None
        if channel is not None:
            channel.close()
        primary, self._primary = self._primary, None
        if primary is not None:
            primary.close()

    @property
    @override
    def ready(self) -> bool:
        return bool(self._workers)

    @property
    @override
    def connected(self) -> bool:
        return self._channel is not None

    @property
    @override
    def counters(self) -> Mapping[str, float]:
        return {"control program starts": float(self._starts)}

    # Following

    @override
    def follow(self) -> None:
        for worker in self._workers.values():
            for reply in worker.take_replies():
                self._take_reply(reply)
        self._listen()
        if self._channel is not None:
            try:
                self._channel.check()
                self._channel.feed()
            except ConnectionLost as error:
                self._lost(error)
        self._ask_dashboard()

    @override
    def take(self, state: StateSample) -> None:
        self._told_at = state.received, state.timestamp
        self._speed = max(map(abs, state.target_qd))
        self._pace = max(SLOWEST_PACE, state.combined_speed_scaling)
        if self._channel is not None:
            self._channel.scaling = state.combined_speed_scaling
        found = state.control_registers(self._first)
        if found is not None and found[0] == self._program:
            self._follow_program(ProgramState(*found), state)
        ours = self._reported.program == self._program
        channel = self._channel if ours else None
        self.lateness = (
            0.0 if channel is None else channel.echoes.age(state.received, state.timestamp)
        )
        self.replaced = ours and state.timestamp > self._cycled_at + REPLACED_AFTER
        if self.replaced or state.runtime_state in STANDING_PROGRAM:
            if self.program_runs:
                self._asks_remote.hurry()
            if ours:
                self._program, self._reported = NO_PROGRAM, ProgramState()
            self._program_ended(PROGRAM_STOPPED)

    def _follow_program(self, found: ProgramState, state: StateSample) -> None:
        if found.cycle != self._reported.cycle or state.runtime_state != RuntimeState.PLAYING:
            self._cycled_at = state.timestamp
        self._reported = found
        if self._channel is not None:
            # Its time may be that at which the cycle began that saw the package.
            self._channel.echoes.take(found.echo, state.timestamp + self._options.motion.period)
        standing = found.phase == Phase.STANDING
        self._taken = found.sequence >= self._stopping
        if self._stopping and found.sequence >= self._stopping and standing:
            self._stopping = 0
        if self._progress is MoveProgress.RUNNING:
            if found.sequence > self._move:
                self._move_failed(INTERRUPTED)
            elif found.sequence == self._move and standing:
                self._progress = MoveProgress.DONE
        if self._settings:
            if self._setting and found.setting == self._setting:
                done = self._settings.popleft()
                self._setting = 0
                self._take_reply(Reply(done.request, done.name))
            self._send_setting()

    def _program_ended(self, reason: str) -> None:
        if self.program_runs:
            logger.info("%s: %s", self._where, reason)
        self.program_runs = False
        self._stopping = 0
        if self._progress is MoveProgress.RUNNING:
            self._move_failed(reason)
        while self._settings:
            pending = self._settings.popleft()
            hint = "Send enable, then it again."
            self._take_reply(
                Reply(pending.request, pending.name, error=CallError(pending.name, reason, hint))
            )
        self._setting = 0

    def _listen(self) -> None:
        """Take what the controller says of the program."""
        if self._primary is None:
            return
        try:
            while data := self._primary.recv(65536):
                for text in self._messages.feed(data):
                    self.complaint = text
                    logger.warning("%s: the controller says: %s", self._where, text)
            raise ConnectionResetError("closed by the controller")
        except BlockingIOError:
            return
        except (OSError, PrimaryError) as error:
            # A switch to local control closes it; the registers are another connection.
            logger.info("%s: primary interface: %s", self._where, error)
        self._primary.close()
        self._primary = None

    def _lost(self, error: ConnectionLost) -> None:
        self.loss = f"the connection for commands is lost: {error}"
        logger.error("%s: %s", self._where, self.loss)
        self._drop_channel()
        if self._progress is MoveProgress.RUNNING:
            self._move_failed(self.loss)

    # Motion

    @override
    def servo_joint(self, q: Sequence[float]) -> None:
        self._command(Kind.SERVO_JOINT, q, self._options.motion.gain)

    @override
    def speed_joint(self, qd: Sequence[float], acceleration: float, valid_for: float) -> None:
        self._command(Kind.SPEED_JOINT, qd, acceleration, valid_for)

    @override
    def speed_cartesian(
        self, twist: Sequence[float], acceleration: float, valid_for: float
    ) -> None:
        self._command(Kind.SPEED_CARTESIAN, twist, acceleration, valid_for)

    @override
    def force(self, wrench: Sequence[float]) -> None:
        self._command(Kind.FORCE, wrench)

    @override
    def move_joint(self, q: Sequence[float], speed: float, acceleration: float) -> None:
        self._begin_move(Kind.MOVE_JOINT, q, speed, acceleration)

    @override
    def move_linear(self, pose: Sequence[float], speed: float, acceleration: float) -> None:
        self._begin_move(Kind.MOVE_LINEAR, pose, speed, acceleration)

    @override
    def freedrive(self) -> None:
        self._begin_move(Kind.FREEDRIVE, (0.0,) * 6)

    @override
    def stop(self) -> None:
        now, again = self._clock(), self._rests and self._stopping > 0
        if not again:
            self._rests, self._taken = True, False
            self._stop_asked_at = now, self._told_at[1]
        channel = self._channel  # the I/O thread may drop it
        if channel is not None and not self._is_unanswered(now):
            try:
                number = channel.stop()
            except ConnectionLost as error:
                logger.warning("%s: %s", self._where, error)
            else:
                # The first one counts: those that repeat it are answered later, where the way is long.
                if not again:
                    self._stopping = number
                    self._stop_asked_at = self._clock(), self._stop_asked_at[1]  # it was held up
                return
        if self.program_runs:
            self._stopping = self._stopping or NEVER
            self._stop_otherwise()

    def _is_unanswered(self, now: float) -> bool:
        """Whether the program has had its time to take the stop, and has not."""
        if self._taken:
            return False
        asked, of_controller = self._stop_asked_at
        read, timestamp = self._told_at
        has_time = min(read - asked, timestamp - of_controller) > STOP_TIMEOUT
        return has_time or now - max(asked, read) > STOP_UNHEARD

    def _stop_otherwise(self) -> None:
        """Put a program that only stops in the place of ours, by the port for programs."""
        now, primary = self._clock(), self._primary
        if primary is None or now < self._replaced_at + STOP_TIMEOUT:
            return
        self._replaced_at = now
        text = STOP_PROGRAM.format(self._options.motion.joint_deceleration)
        try:
            primary.sendall(text.encode())
        except OSError as error:
            logger.warning("%s: %s; the controller's watchdog stops the arm", self._where, error)
        else:
            logger.warning("%s: the control program is replaced by one that stops", self._where)

    @property
    @override
    def stopping(self) -> bool:
        return self._stopping > 0

    def _command(
        self, kind: Kind, values: Sequence[float], first: float = 0.0, second: float = 0.0
    ) -> int:
        """Send a motion and return its sequence number."""
        remedy = "Send enable to start again."
        self._rests = False
        if self._channel is None:
            raise DeviceFault(
                self.loss or "the control program was not started", where=self._where, remedy=remedy
            )
        try:
            return self._channel.command(kind, values, first, second)
        except ConnectionLost as error:
            self._lost(error)
            raise DeviceFault(self.loss, where=self._where, remedy=remedy) from error

    def _begin_move(
        self, kind: Kind, values: Sequence[float], speed: float = 0.0, acceleration: float = 0.0
    ) -> None:
        self._move = self._command(kind, values, speed, acceleration)
        self._progress, self._move_failure = MoveProgress.RUNNING, ""

    # The control program

    @override
    def start_program(self) -> Steps:
        if self._channel is None or self._was_local:
            self._drop_channel()
            self._channel = yield from self.ask("connect", first=self._first)
            self._was_local = False
        self._program = secrets.randbelow(2**31 - 1) + 1
        self._reported, self._messages, self.complaint = ProgramState(), MessageReader(), ""
        options, arm = self._options, self.arm
        assert arm is not None, "whoever starts a program says for which arm"
        text = program_text(
            ProgramOptions(
                self._version,
                self._first,
                options.watchdog_frequency,
                options.motion.period,
                options.motion.joint_deceleration,
                options.motion.linear_deceleration,
                options.motion.lookahead,
                options.joint_acceleration,
                arm.velocity_limits,
                arm.position_limits,
            ),
            self._program,
        )
        try:
            self._channel.address(self._program)
        except ConnectionLost as error:
            self._lost(error)
            raise TransitionFailed(error.message, where=self._where, remedy=error.remedy) from error
        self._primary = None  # the worker closes it before it connects anew
        self._primary = yield from self.ask("upload", text=text)
        yield from self._until_started()
        self._starts += 1

    def _until_started(self) -> Generator[None, None, None]:
        deadline = self._clock() + PROGRAM_START_TIMEOUT
        while not self._has_answered:
            if self.complaint or self._clock() > deadline:
                raise TransitionFailed(
                    f"the control program does not start: {self.complaint or 'no reason is given'}",
                    where=self._where,
                    remedy="See that the arm is powered, its brakes released, no stop active and the "
                    "robot in remote control, then enable again.",
                )
            yield

    @property
    def _has_answered(self) -> bool:
        """Whether the program runs that is spoken to, and has seen a package."""
        ours = self._reported.program == self._program
        return ours and self._channel is not None and self._channel.echoes.began

    @property
    @override
    def left_program(self) -> bool:
        """Its start was given up before it was seen to run."""
        return self._reported.program == self._program and not self.program_runs

    @override
    def stop_program(self) -> Steps:
        deadline = self._clock() + PROGRAM_END_TIMEOUT
        try:
            self._command(Kind.QUIT, (0.0,) * 6)
            while self.program_runs and self._clock() < deadline:
                yield
        except DeviceFault as error:
            logger.warning("%s; the controller's watchdog ends the program", error.statement)
        self._drop_channel()

    # Requests

    @property
    @override
    def _generation(self) -> int:
        return self._opened

    @override
    def _request(self, name: str, arguments: Mapping[str, Any]) -> int:
        number = next(self._requests)
        if name in _SETTINGS:
            setting, values_of = _SETTINGS[name]
            self._settings.append(
                _PendingSetting(number, name, setting, tuple(map(float, values_of(**arguments))))
            )
            return number
        worker = self._workers.get(_WORKERS[name])
        if worker is None:
            raise DeviceFault(f"{name}: not connected", where=self._where, remedy="Wait for it.")
        worker.submit(Request(number, name, arguments))
        return number

    def _send_setting(self) -> None:
        """Send the oldest setting, if none is on its way."""
        if not self._settings or self._setting or self._channel is None:
            return
        pending = self._settings[0]
        try:
            self._setting = self._channel.set(pending.setting, pending.values)
        except ConnectionLost as error:
            self._lost(error)

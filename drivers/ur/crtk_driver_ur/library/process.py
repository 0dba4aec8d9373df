"""The child process that owns the ur_rtde library: `python -m crtk_driver_ur.library.process FD PARENT`.

The library crashes after a stall of the controller, blocks for minutes on a dead one, and holds the
interpreter lock while it connects. Here it can do so without harm: the driver watches this process,
kills it and starts another. FD is this end of the socket pair, PARENT the process id of the driver.

One thread does everything but dashboard commands and outputs. The process ends when the driver ends, when the
library has lost its connection, and when it is killed; in each case nothing feeds the robot-side
watchdog any more, and the controller stops the arm.
"""

from __future__ import annotations

import contextlib
import faulthandler
import os
import select
import signal
import socket
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import fields
from types import MappingProxyType
from typing import ClassVar, TypeAlias

from crtk_driver_ur.control_options import MotionOptions
from crtk_driver_ur.control_requests import CallError, Reply, Request, explain
from crtk_driver_ur.dashboard import REQUESTS
from crtk_driver_ur.dashboard_worker import DashboardWorker
from crtk_driver_ur.library.calls import LibraryCalls, LibraryError
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
from crtk_driver_ur.library.sequencer import MotionSequencer
from crtk_driver_ur.output_worker import OUTPUT_REQUESTS, OutputWorker
from crtk_driver_ur.request_worker import Controller, RequestWorker

HEARTBEAT_PERIOD = 0.05
MOVE_POLL_PERIOD = 0.01
CONNECT_ALLOWANCE = 15.0
"""Seconds that the constructor of the control interface may take: the library's own time-outs."""
UPLOAD_ALLOWANCE = 6.0
PROGRAM_START_TIMEOUT = 5.0
DRIVER_TIMEOUT = 1.0
"""Seconds of silence of the driver after which any motion is stopped."""
EXIT_TIMEOUT = 2.0
"""Seconds that stopping the arm may take at the end before the process is killed."""
LOST_CONNECTION_STATUS = 3
AT_FLANGE = (0.0, 0.0, 1e-9)
"""A centre of gravity in the flange: three zeros the library's control program takes for none given."""

_MISSING = CallError(
    "import", "the ur-rtde library is not installed", "pip install 'crtk-drivers[ur]'"
)


_LATER = object()
"""A handler returns this when the reply follows later."""

_WORKERS: Mapping[str, type[RequestWorker]] = MappingProxyType(
    {
        **dict.fromkeys(REQUESTS, DashboardWorker),
        **dict.fromkeys(OUTPUT_REQUESTS, OutputWorker),
    }
)
"""Requests that are carried out by a thread of their own."""

_Handler: TypeAlias = Callable[["ControlProcess", Request], object]


class ControlProcess:
    """The main loop: frames in, library calls, replies, events and heartbeats out."""

    def __init__(self, peer: socket.socket, parent: int) -> None:
        self._peer = peer
        self._parent = parent
        self._poll = select.poll()
        self._poll.register(peer, select.POLLIN)
        self._calls: LibraryCalls | None = None
        self._motion: MotionSequencer | None = None
        self._workers: dict[type[RequestWorker], RequestWorker] = {}
        self._upload: tuple[Request, float] | None = None
        self._controller = Controller("", (0, 0), 0)
        self._upper_registers = False
        self._watchdog_frequency = 0.0
        self._heard_at = time.monotonic()
        self._beat_at = 0.0
        self._driver_silent = False

    def run(self) -> None:
        """Work until the driver is gone."""
        try:
            while os.getppid() == self._parent:
                self._wait()
                if not self._take_frames():
                    break
                self._work(time.monotonic())
        except (BrokenPipeError, ConnectionResetError):
            pass
        self._halt()

    def _wait(self) -> None:
        period = HEARTBEAT_PERIOD
        if self._motion is not None:
            busy = self._motion.motion is not MotionKind.NONE
            period = MOVE_POLL_PERIOD if busy else 2 * MOVE_POLL_PERIOD
        self._poll.poll(period * 1000.0)

    def _work(self, now: float) -> None:
        for worker in self._workers.values():
            for reply in worker.take_replies():
                self._send(reply)
        if self._motion is not None and self._calls is not None:
            self._check_connection(self._calls)
            if self._upload is not None:
                self._finish_upload(self._calls, now)
            else:
                self._watch_driver(self._motion, now)
                self._motion.tick(now)
        if now - self._beat_at >= HEARTBEAT_PERIOD:
            self._beat_at = now
            self._send(self._heartbeat())

    def _heartbeat(self) -> Heartbeat:
        motion, calls = self._motion, self._calls
        if motion is None or calls is None:
            return Heartbeat(0, MotionKind.NONE, False, False, False, 0, 0.0)
        try:
            running, progress = bool(calls.read("isProgramRunning")), motion.progress
        except LibraryError:
            running, progress = False, 0
        return Heartbeat(
            motion.sequence,
            motion.motion,
            True,
            running,
            motion.settling,
            progress,
            calls.take_longest(),
        )

    def _check_connection(self, calls: LibraryCalls) -> None:
        """End the process if the library lost the controller: it cannot be trusted to reconnect."""
        try:
            connected, text = bool(calls.read("isConnected")), "the library has lost the controller"
        except LibraryError as error:
            connected, text = False, str(error)
        if not connected:
            hint = "Check the network and the controller; the driver connects again."
            self._send(Event(EventKind.CONNECTION_LOST, 0, CallError("isConnected", text, hint)))
            os._exit(LOST_CONNECTION_STATUS)

    def _watch_driver(self, motion: MotionSequencer, now: float) -> None:
        silent = now - self._heard_at > DRIVER_TIMEOUT
        if silent and not self._driver_silent and motion.motion is not MotionKind.NONE:
            self._send(Event(EventKind.DRIVER_SILENT, motion.sequence))
            motion.command(MotionCommand(motion.sequence, MotionKind.STOP), now)
        self._driver_silent = silent

    # Frames

    def _take_frames(self) -> bool:
        """Take all that has arrived; of the motion commands only the newest. False at the end."""
        newest: MotionCommand | None = None
        while True:
            try:
                data = self._peer.recv(MAX_FRAME, socket.MSG_DONTWAIT)
            except BlockingIOError:
                break
            if not data:
                return False
            self._heard_at = time.monotonic()
            try:
                frame = decode(data)
            except FrameError as error:
                self._send(Event(EventKind.BAD_FRAME, 0, CallError("decode", str(error))))
                continue
            if isinstance(frame, MotionCommand):
                newest = frame
            elif isinstance(frame, Request):
                # What was commanded before a request happens before it.
                self._carry_out_motion(newest)
                newest = None
                self._carry_out(frame)
            elif not isinstance(frame, Alive):
                text = f"{type(frame).__name__} goes the other way"
                self._send(Event(EventKind.BAD_FRAME, 0, CallError("decode", text)))
        self._carry_out_motion(newest)
        return True

    def _carry_out_motion(self, command: MotionCommand | None) -> None:
        if command is None:
            return
        if self._motion is not None and self._upload is None:
            self._motion.command(command, time.monotonic())
        elif command.kind is MotionKind.STOP:
            self._send(Event(EventKind.STOPPED, command.sequence))
        else:
            text = "the control program is not running yet"
            error = CallError(command.kind.name.lower(), text, "Enable the arm first.")
            self._send(Event(EventKind.MOTION_FAILED, command.sequence, error))

    def _carry_out(self, request: Request) -> None:
        if request.name in _WORKERS:
            self._worker(_WORKERS[request.name]).submit(request)
            return
        handler = self._REQUESTS.get(request.name)
        if handler is None:
            error = CallError(request.name, "there is no such request")
            self._send(Reply(request.sequence, request.name, error=error))
            return
        try:
            value = handler(self, request)
        except LibraryError as error:
            self._send(Reply(request.sequence, request.name, error=error.error))
        except (KeyError, TypeError, ValueError) as error:
            text = f"bad arguments {dict(request.arguments)}: {error!r}"
            bad = CallError(request.name, text[:500])
            self._send(Reply(request.sequence, request.name, error=bad))
        else:
            if value is not _LATER:
                self._send(Reply(request.sequence, request.name, value))

    def _send(self, frame: Frame) -> None:
        # A driver that does not read misses this; it counts its own silence, and ours is told later.
        with contextlib.suppress(BlockingIOError):
            self._peer.send(encode(frame), socket.MSG_DONTWAIT)

    def _announce(self, call: str, allowed: float) -> None:
        self._send(Calling(call, allowed))

    # Requests

    def _connect(self, request: Request) -> object:
        arguments = dict(request.arguments)
        host = str(arguments["host"])
        self._watchdog_frequency = float(arguments["watchdog_frequency"])
        self._upper_registers = bool(arguments["upper_range_registers"])
        names = {field.name for field in fields(MotionOptions)} - {"joint_speeds"}
        options = MotionOptions(
            **{name: float(arguments[name]) for name in names},
            joint_speeds=six(arguments["joint_speeds"]),
        )
        self._announce("RTDEControlInterface", CONNECT_ALLOWANCE)
        try:
            from rtde_control import RTDEControlInterface
        except ImportError:
            raise LibraryError(_MISSING) from None
        flags = RTDEControlInterface.FLAG_UPLOAD_SCRIPT | RTDEControlInterface.FLAG_NO_EXT_FT
        if self._upper_registers:
            flags |= RTDEControlInterface.FLAG_UPPER_RANGE_REGISTERS
        if not arguments["require_remote_control"]:
            flags |= RTDEControlInterface.FLAG_DISABLE_REMOTE_CONTROL_CHECK
        try:
            interface = RTDEControlInterface(host, -1.0, flags)
        except Exception as error:
            raise LibraryError(explain("RTDEControlInterface", error)) from error
        calls = LibraryCalls(interface, self._announce)
        calls.command("setWatchdog", self._watchdog_frequency)
        self._calls = calls
        self._motion = MotionSequencer(calls, options, self._send)
        self._motion.program_restarted()
        return None

    def _upload_script(self, request: Request) -> object:
        calls, motion = self._interface()
        motion.clear_command()
        calls.blocking("reuploadScript", allowed=UPLOAD_ALLOWANCE)
        self._upload = (request, time.monotonic() + PROGRAM_START_TIMEOUT)
        return _LATER

    def _finish_upload(self, calls: LibraryCalls, now: float) -> None:
        assert self._upload is not None
        request, deadline = self._upload
        error: CallError | None = None
        try:
            if calls.read("isProgramRunning"):
                calls.command("setWatchdog", self._watchdog_frequency)
                assert self._motion is not None
                self._motion.program_restarted()
            elif now < deadline:
                return
            else:
                text = f"no program runs {PROGRAM_START_TIMEOUT:.0f} s after the upload"
                error = explain("reuploadScript", RuntimeError(text + " (before timeout)"))
        except LibraryError as failure:
            error = failure.error
        self._upload = None
        self._send(Reply(request.sequence, request.name, error=error))

    def _stop_script(self, request: Request) -> object:
        calls, motion = self._interface()
        motion.halt()
        calls.blocking("stopScript")
        return None

    def _set_payload(self, request: Request) -> object:
        calls, _ = self._interface()
        mass = float(request.arguments["mass"])
        calls.command("setPayload", mass, _center_of_gravity(request))
        return None

    def _set_target_payload(self, request: Request) -> object:
        calls, _ = self._interface()
        mass = float(request.arguments["mass"])
        inertia = [float(value) for value in request.arguments["inertia"]]
        calls.command("setTargetPayload", mass, _center_of_gravity(request), inertia)
        return None

    def _set_tcp(self, request: Request) -> object:
        calls, _ = self._interface()
        calls.command("setTcp", list(six(request.arguments["pose"])))
        return None

    def _set_gravity(self, request: Request) -> object:
        calls, _ = self._interface()
        calls.command("setGravity", [float(value) for value in request.arguments["direction"]])
        return None

    def _zero_ft_sensor(self, request: Request) -> object:
        calls, _ = self._interface()
        calls.command("zeroFtSensor")
        return None

    def _configure(self, request: Request) -> object:
        arguments = request.arguments
        major, minor = map(int, arguments["version"])
        self._controller = Controller(
            str(arguments["host"]), (major, minor), int(arguments["robot_api_port"])
        )
        return None

    def _interface(self) -> tuple[LibraryCalls, MotionSequencer]:
        if self._calls is None or self._motion is None:
            raise LibraryError(CallError("connect", "not connected", "Enable the arm first."))
        return self._calls, self._motion

    def _worker(self, kind: type[RequestWorker]) -> RequestWorker:
        if kind not in self._workers:
            self._workers[kind] = worker = kind(self._controller)
            worker.start()
            self._poll.register(worker.wake_fd, select.POLLIN)
        return self._workers[kind]

    def _halt(self) -> None:
        """Stop the arm and the control program, but not for longer than `EXIT_TIMEOUT`."""
        signal.setitimer(signal.ITIMER_REAL, EXIT_TIMEOUT)
        if self._calls is not None and self._motion is not None:
            try:
                self._motion.halt()
                self._calls.call("stopScript")
            except LibraryError as error:
                print(error, file=sys.stderr)  # noqa: T201 (the driver reads it)

    _REQUESTS: ClassVar[Mapping[str, _Handler]] = MappingProxyType(
        {
            "configure": _configure,
            "connect": _connect,
            "upload_script": _upload_script,
            "stop_script": _stop_script,
            "set_payload": _set_payload,
            "set_target_payload": _set_target_payload,
            "set_tcp": _set_tcp,
            "set_gravity": _set_gravity,
            "zero_ft_sensor": _zero_ft_sensor,
        }
    )


def _center_of_gravity(request: Request) -> list[float]:
    center = [float(value) for value in request.arguments["center_of_gravity"]]
    return center if any(center) else list(AT_FLANGE)


def main(arguments: list[str]) -> None:
    """Run the control process on the inherited socket."""
    # The terminal and the service manager signal the whole group; the driver decides what happens.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    faulthandler.enable()
    descriptor, parent = map(int, arguments)
    ControlProcess(socket.socket(fileno=descriptor), parent).run()
    # The library's destructors may block for ever on a dead controller.
    os._exit(0)


if __name__ == "__main__":
    main(sys.argv[1:])

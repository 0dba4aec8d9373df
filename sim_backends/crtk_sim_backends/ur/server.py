"""The simulated controller on its ports: one thread, one control period after the other.

Everything happens in :meth:`UrServer.run`: received data is handled as it arrives, and at every
control period the controller advances and its packages go out. No socket ever blocks the loop: a
client that does not read loses packages, and one that sends nonsense loses its connection.
"""

from __future__ import annotations

import gc
import logging
import select
import socket
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from crtk_sim_backends import wire
from crtk_sim_backends.control import ControlSession, token
from crtk_sim_backends.fault_player import FaultPlayer
from crtk_sim_backends.faults import Fault, FaultError, read_faults
from crtk_sim_backends.kit import ALL_PORTS, Client, Mute, Port, Session
from crtk_sim_backends.process import (
    RunningSim,
    SimStartError,
    bind_somewhere,
    listen,
    spawn,
    use_realtime_priority,
)
from crtk_sim_backends.ur.config import SimConfig
from crtk_sim_backends.ur.controller import Controller
from crtk_sim_backends.ur.injection import BEGIN, END, EVENTS, KINDS
from crtk_sim_backends.ur.messages import KeyMessage
from crtk_sim_backends.ur.pace import Pace, Statistics
from crtk_sim_backends.ur.ports import realtime
from crtk_sim_backends.ur.ports.dashboard import GREETING, DashboardSession, Robot
from crtk_sim_backends.ur.ports.external import ExternalDevices
from crtk_sim_backends.ur.ports.interpreter_port import InterpreterSession
from crtk_sim_backends.ur.ports.primary import (
    STATE_PERIOD,
    RobotStateEncoder,
    encode_messages,
    hardware_info_message,
    version_message,
)
from crtk_sim_backends.ur.ports.robot_api import RobotApiSession
from crtk_sim_backends.ur.ports.rtde import InputClaims, RtdeError, RtdeSession, Trace
from crtk_sim_backends.ur.ports.script_port import ScriptSession
from crtk_sim_backends.ur.ports.script_queue import ScriptQueue
from crtk_sim_backends.ur.program.modbus_library import modbus_builtins
from crtk_sim_backends.ur.program.programs import ProgramFiles
from crtk_sim_backends.ur.program.script_rpc import ScriptRpc
from crtk_sim_backends.ur.program.script_sockets import ScriptSockets
from crtk_sim_backends.ur.signals.modbus_client import ModbusUnits
from crtk_sim_backends.ur.signals.recording import Recorder, Recording, RecordingError
from crtk_sim_backends.ur.urscript import Builtin
from crtk_sim_backends.ur.views import picture, scene
from crtk_sim_backends.ur.views.replay import NoInputs, ReplayedController, load

log = logging.getLogger(__name__)

CONTROL: Final = "control"

_SEND_BUFFER: Final = 65536  # bytes that the kernel keeps for one client
_BACKLOG_LIMIT: Final = 1 << 18  # bytes of untaken replies that end a connection
_CONTROL_BACKLOG_LIMIT: Final = 1 << 27  # the same on the control socket: whole traces
_SLOW_READER_LIMIT: Final = 5.0  # s (real) without taking anything that end an RTDE connection
_CLIENTS_PER_PORT: Final = 64
_HIGHEST_FD: Final = 1023  # that `select` can watch
_WAKE_UPS: Final = 8  # times that data is handled on arrival in one period, then at its end
_LAST_COMMANDS: Final = 20
_WRITABLE: Final = ("primary", "secondary", "realtime")
_PLACES: Final = ("port", "joint", "index")  # parameters that say where a fault is
_DECIDED_ONCE: Final = ("primary", "secondary")  # read-only for good when opened in local control
_SWITCH_INTERVAL: Final = 1e-4  # s that the loop waits for the thread that compiles


class UrServer:
    """A simulated UR controller that listens on all its ports.

    Args:
        config: what to simulate; its ports are bound by the constructor.
        parent_fd: file descriptor that becomes readable when the process that wants this simulator
            has died, None for none.

    Raises:
        SimStartError: when a port cannot be bound, a recording cannot be made or read, or the fault file
            is wrong.
    """

    def __init__(self, config: SimConfig, parent_fd: int | None = None) -> None:
        self.config = config
        self.statistics = Statistics()
        try:
            faults = read_faults(Path(config.faults), KINDS, EVENTS) if config.faults else []
            for fault in faults:
                self._check_possible(fault.kind)
            recording = load(Path(config.replay)) if config.replay else None
        except (FaultError, RecordingError) as error:
            raise SimStartError(str(error)) from error
        self._parent_fd = parent_fd
        self._stopping = False
        self._secret = token()
        self._elapsed = 0.0  # s of the controller since the start, what it hangs included
        self._ports: dict[str, Port[Session]] = {}
        self.host, _ = bind_somewhere(config.host, self._bind)
        self.ports = {name: port.number for name, port in self._ports.items()}
        self._by_fd: dict[int, Port[Session] | tuple[Port[Session], Client[Session]]] = {}
        self._watched: list[int] = []
        self._watch_again = True  # connections came, went, or must not be read any more

        self._sockets = ScriptSockets(self.host, self.ports.values())
        self._rpc = ScriptRpc(self.host)
        self._modbus_units = ModbusUnits(self.host, self.ports.get("modbus"))
        self.controller = self._make_controller(recording)
        self.controller.player.ended.append(self._sockets.close_all)
        try:
            self._external = ExternalDevices(config, self.controller)
        except SimStartError:
            self._close_ports()
            raise
        self._faults = FaultPlayer(KINDS, faults, self._begin, self._end, _PLACES)
        self._stalled = False
        self._scripts = ScriptQueue(self.controller)
        self._period = self.controller.dt
        self._pace = Pace(self._period, config.speed, self.statistics)
        self._state_every = round(STATE_PERIOD / self._period)
        self._encoder = RobotStateEncoder(config.robot, config.software)
        self._realtime_length = realtime.packet_length(config.software)
        self._slow_reader_limit = _SLOW_READER_LIMIT * config.speed
        self._claims = NoInputs() if config.replay else InputClaims()
        self._trace = Trace(config.trace_size)
        self._robot = Robot(
            self.controller, config.robot, config.software, config.serial_number, self.stop
        )
        self._was_remote = self.controller.remote
        self._was_moving = False
        self._dashboard_commands: deque[str] = deque(maxlen=_LAST_COMMANDS)
        self._recorder: Recorder | None = None
        self._watchers: list[RunningSim] = []
        try:
            if config.record:
                self._recorder = self._make_recorder()
            self._start_watchers()
        except SimStartError:
            self.close()
            raise

    def _make_controller(self, recording: Recording | None) -> Controller:
        config = self.config
        if recording is not None:
            return ReplayedController(
                config.robot,
                config.software,
                recording,
                loop=config.replay_loop,
                begins=self._is_heard,
            )
        return Controller(
            config.robot,
            config.software,
            powered_on=config.powered_on,
            remote=config.remote,
            wires=config.wires,
            boot_seconds=config.boot_seconds,
            programs=ProgramFiles(Path(config.programs) if config.programs else None),
            surfaces=config.surfaces,
            limits=config.limits,
            extra_builtins=self._network_builtins,
        )

    def _start_watchers(self) -> None:
        """Start the program that shows what happens in the terminal, in a process of its own."""
        control = f"{self.host}:{self.ports[CONTROL]}"
        if self.config.view:
            self._watchers.append(spawn(f"{__package__}.views.terminal", [control]))

    def _is_heard(self) -> bool:
        """Whether an RTDE client has started its packages."""
        sessions = (client.session for client in self._ports["rtde"].clients)
        return any(isinstance(session, RtdeSession) and session.started for session in sessions)

    def _make_recorder(self) -> Recorder:
        config = self.config
        every = int(config.robot.frequency / (config.record_rate or config.robot.frequency))
        try:
            return Recorder(Path(config.record), config.recorded, every)
        except RecordingError as error:
            raise SimStartError(f"record: {error}") from error

    # Life

    def _bind(self, host: str) -> None:
        numbers = {**self.config.ports, CONTROL: self.config.control_port}
        try:
            for name, number in numbers.items():
                self._ports[name] = Port(name, listen(host, number, name))
        except SimStartError:
            self._close_ports()
            raise

    def _network_builtins(self, controller: Controller) -> Iterator[Builtin]:
        yield from self._sockets.builtins(controller.clock)
        yield from self._rpc.builtins()
        yield from modbus_builtins(controller.state_signals, self._modbus_units)

    def _greeting(self, name: str) -> bytes:
        greetings: dict[str, Callable[[], bytes]] = {
            "dashboard": lambda: GREETING,
            **dict.fromkeys(("primary", "primary_read_only"), self._primary_greeting),
            **dict.fromkeys(("secondary", "secondary_read_only"), self._secondary_greeting),
        }
        return greetings.get(name, bytes)()

    def _primary_greeting(self) -> bytes:
        config, time = self.config, self.controller.time
        return (
            version_message(config.software, time)
            + hardware_info_message(config.robot, config.software, time)
            + self._state()
        )

    def _secondary_greeting(self) -> bytes:
        return version_message(self.config.software, self.controller.time) + self._state()

    def _state(self) -> bytes:
        c = self.controller
        return self._encoder.packet(c.outputs, c.operational_mode, c.tool_communication)

    def stop(self) -> None:
        """End :meth:`run` within one control period. Safe in a signal handler."""
        self._stopping = True

    def close(self) -> None:
        """Close the recording and every socket, and end the programs that watch."""
        if self._recorder is not None:
            self._recorder.close()
        self._sockets.close_all()
        self._modbus_units.close()
        self._external.close()
        self._close_ports()
        for watcher in self._watchers:
            watcher.stop()

    def _close_ports(self) -> None:
        for port in self._ports.values():
            for client in port.clients:
                client.connection.close()
            port.clients.clear()  # a program that was not complete is not run now
            port.close()
        self._ports.clear()

    def run(self) -> None:
        """Run at the chosen speed until :meth:`stop`, or until the parent process has died."""
        if self.config.realtime:
            use_realtime_priority()
        sys.setswitchinterval(_SWITCH_INTERVAL)
        gc.collect()
        gc.freeze()
        if self._recorder is not None:
            self._recorder.start()
        self._pace.begin(time.monotonic())
        while not self._stopping:
            self._serve_until(self._pace.wake)
            started = time.monotonic()
            self._pace.started(started)
            self.step(started * self.config.speed)
            self.statistics.busy += time.monotonic() - started

    def step(self, now: float) -> None:
        """Advance one control period. Called by :meth:`run`.

        Args:
            now: time of the wires: of the monotonic clock, but `speed` times as fast, s. Faults begin
                and end in the controller's time, which lags behind that on a slow machine.
        """
        self._elapsed += self._period
        answers = self._do_requests(now)
        if self._faults.play(self._elapsed):
            self._watch_again = True
        if not self._stalled:
            self._advance(now)
        for client, answer in answers:
            client.connection.send(answer, now)
            self._remove_if_ended(self._ports[CONTROL], client)

    def _advance(self, now: float) -> None:
        """Move everything on by one control period, unless the controller hangs."""
        for port in self._ports.values():
            if not port.silent and port.clients and port.name != CONTROL:
                self._push(port, now)
        self._scripts.run_compiled()
        self.controller.tick()
        self.statistics.ticks += 1
        if self._recorder is not None:
            self._recorder.add(self.controller.outputs, self.controller.tick_count)
        self._report(now)
        self._send_states(now)
        self._send_rtde(now)
        self._serve_tool(now)
        self._sockets.flush()

    def _do_requests(self, now: float) -> list[tuple[Client[Session], bytes]]:
        """Do what was asked on the control socket; it is answered once that has taken effect."""
        answers = []
        for client in self._ports[CONTROL].clients:
            client.connection.flush(now)
            if client.connection.has_input or client.connection.ended:
                answers.append((client, self._answer(CONTROL, client, now)))
        return answers

    # Receiving

    def _serve_until(self, deadline: float) -> None:
        """Handle what arrives until the deadline; at least once."""
        for _ in range(_WAKE_UPS):
            if self._watch_again:
                self._watch()
            wait = deadline - time.monotonic()
            ready, _, _ = select.select(self._watched, (), (), max(0.0, wait))
            if ready:
                self._handle(ready, time.monotonic() * self.config.speed)
            if wait <= 0.0 or self._stopping or not ready:
                return
        time.sleep(max(0.0, deadline - time.monotonic()))

    def _handle(self, ready: list[int], now: float) -> None:
        for fd in ready:
            owner = self._by_fd.get(fd)
            if owner is None:
                if fd == self._parent_fd:
                    log.info("the process that started this simulator has ended")
                    self.stop()
            elif isinstance(owner, Port):
                self._accept(owner, now)
            elif not owner[1].connection.closed:
                port, client = owner
                client.connection.read(now)
                if client.connection.peer_closed:
                    self._watch_again = True
                if port.name != CONTROL:  # whose requests are done at the next period
                    self._process(port, client, now)

    def _watch(self) -> None:
        """Collect the file descriptors that are read now."""
        self._watch_again = False
        self._by_fd = {}
        for port in self._ports.values():
            if port.silent or (self._stalled and port.name != CONTROL):
                continue
            if port.listener is not None:
                self._by_fd[port.listener.fileno()] = port
            for client in port.clients:
                if not client.connection.ended:
                    self._by_fd[client.connection.fileno()] = (port, client)
        self._watched = list(self._by_fd)
        if self._parent_fd is not None:
            self._watched.append(self._parent_fd)

    def _accept(self, port: Port[Session], now: float) -> None:
        while port.listener is not None:
            try:
                sock, _ = port.listener.accept()
            except BlockingIOError:
                break
            except OSError as error:
                log.warning("cannot accept on the %s port: %s", port.name, error)
                break
            full = len(port.clients) >= self._limit(port) or sock.fileno() > _HIGHEST_FD
            if full or "disconnect" in port.faults:
                sock.close()
                continue
            self._welcome(port, sock, now)

    def _limit(self, port: Port[Session]) -> int:
        """How many clients a port lets in."""
        return self._external.tool_clients if port.name == "tool" else _CLIENTS_PER_PORT

    def _welcome(self, port: Port[Session], sock: socket.socket, now: float) -> None:
        """Make a client of an accepted connection."""
        limit = _CONTROL_BACKLOG_LIMIT if port.name == CONTROL else _BACKLOG_LIMIT
        try:
            send_buffer = round(_SEND_BUFFER * max(1.0, self.config.speed))
            connection = wire.Connection(sock, limit, send_buffer=send_buffer)
        except OSError as error:
            log.info("a client of the %s port was gone at once: %s", port.name, error)
            sock.close()
            return
        self.statistics.accepted += 1
        number = self.statistics.accepted
        mute = "no_answer" in port.faults
        session = Mute() if mute else self._session(port.name, number)
        port.add(Client(connection, session, number))
        self._watch_again = True
        self._event(f"{port.name}_connected")
        if not mute:
            connection.send(self._greeting(port.name), now)

    def _session(self, name: str, number: int) -> Session:
        match name:
            case "rtde":
                return RtdeSession(
                    self.controller, self.config.software, self._claims, self._trace, number
                )
            case "dashboard":
                return DashboardSession(self._robot, self._dashboard_commands.append)
            case "robot_api":
                return RobotApiSession(self._robot)
            case "interpreter":
                return InterpreterSession(self.controller.interpreter)
            case "modbus":
                return self._external.modbus_session()
            case "tool":
                return self._external.tool_session()
            case "control":
                return ControlSession(
                    {
                        "inject": self._inject,
                        "clear": self._clear,
                        "status": self.status,
                        "arm": lambda: picture.arm(self.config, self.host),
                        "picture": self._picture,
                        "scene": lambda: scene.scene(self.config, self.host),
                        "live": lambda: scene.live(self.controller.model, self._picture()),
                        "outputs": self._outputs,
                        "trace": self._trace_after,
                    },
                    self._secret,
                )
        read_only = name not in _WRITABLE or (name in _DECIDED_ONCE and not self.controller.remote)
        return ScriptSession(self._scripts.refuse if read_only else self._scripts.put)

    def _process(self, port: Port[Session], client: Client[Session], now: float) -> None:
        """Let a client's session take what has arrived, and send its answer."""
        client.connection.send(self._answer(port.name, client, now), now)
        self._remove_if_ended(port, client)

    def _answer(self, port: str, client: Client[Session], now: float) -> bytes:
        """What a client's session answers to what has arrived."""
        connection = client.connection
        try:
            pieces = connection.take(now) or ([b""] if _waits(client) else [])
            return b"".join([client.session.receive(piece) for piece in pieces])
        except RtdeError as error:
            log.warning("closing %s connection %d: %s", port, client.number, error)
        except Exception:
            self.statistics.defects += 1
            log.exception("a defect of the simulator closes %s client %d", port, client.number)
        connection.close()
        return b""

    def _remove_if_ended(self, port: Port[Session], client: Client[Session]) -> None:
        if client.connection.ended or client.session.ended:
            self._remove(port, client)

    def _remove(self, port: Port[Session], client: Client[Session]) -> None:
        port.clients.remove(client)
        client.connection.close()
        self._watch_again = True
        try:
            client.session.close()
        except Exception:
            self.statistics.defects += 1
            log.exception("a defect of the simulator, as %s client %d went", port, client.number)

    def _disconnect(self, port: Port[Session]) -> None:
        for client in list(port.clients):
            self._remove(port, client)

    # Sending

    def _push(self, port: Port[Session], now: float) -> None:
        """Move on what a slow peer or a delaying wire has held back."""
        for client in list(port.clients):
            client.connection.flush(now)
            if client.connection.has_input or client.connection.ended or _waits(client):
                self._process(port, client, now)

    def _report(self, now: float) -> None:
        """Pass the controller's messages on, and follow what they and its state mean here."""
        controller = self.controller
        messages = controller.take_messages()
        for message in messages:
            if isinstance(message, KeyMessage):
                started = message.title.endswith("STARTED")
                self._event("program_started" if started else "program_stopped")
        moving = any(controller.outputs["target_qd"])
        if moving is not self._was_moving:
            self._event("motion_started" if moving else "motion_stopped")
            self._was_moving = moving
        if messages:
            encoded = encode_messages(messages, controller.time)
            self._broadcast(("primary", "primary_read_only"), lambda: encoded, now)
        if self._was_remote and not controller.remote:
            for name in _WRITABLE:
                self._disconnect(self._ports[name])
        self._was_remote = controller.remote

    def _event(self, name: str) -> None:
        self._faults.event(name, self._elapsed)

    def _send_states(self, now: float) -> None:
        """Send the periodic packets of all ports but RTDE."""
        outputs = self.controller.outputs
        if self.controller.tick_count % self._state_every == 0:
            self._broadcast(
                ("primary", "primary_read_only", "secondary", "secondary_read_only"),
                self._state,
                now,
            )
        self._broadcast(
            ("realtime", "realtime_read_only"),
            lambda: realtime.packet(outputs, self._realtime_length),
            now,
        )

    def _broadcast(self, names: tuple[str, ...], build: Callable[[], bytes], now: float) -> None:
        """Send one package to every client that keeps up; it is built only when there is one."""
        package: bytes | None = None
        for name in names:
            port = self._ports[name]
            if port.silent:
                continue
            for client in port.clients:
                if client.connection.blocked or isinstance(client.session, Mute):
                    client.connection.dropped += 1
                    continue
                package = build() if package is None else package
                client.connection.send_fresh(package, now)

    def _send_rtde(self, now: float) -> None:
        port = self._ports["rtde"]
        if port.silent:
            return
        for client in list(port.clients):
            if isinstance(client.session, RtdeSession):
                package = client.session.package(self.controller.tick_count)
                if package is not None and not client.connection.send_fresh(package, now):
                    self.statistics.rtde_dropped += 1
            connection = client.connection
            if connection.closed or connection.blocked_for(now) > self._slow_reader_limit:
                log.warning("closing RTDE connection %d: it does not read", client.number)
                self._remove(port, client)

    def _serve_tool(self, now: float) -> None:
        """Send on what the tool has said; without its serial line nobody stays connected."""
        port = self._ports.get("tool")
        if port is None:
            return
        said = self._external.advance_tool()
        if not self._external.tool_clients:
            self._disconnect(port)
        for client in port.clients:
            if said and not port.silent and not isinstance(client.session, Mute):
                client.connection.send(said, now)

    # Faults

    def _begin(self, fault: Fault) -> None:
        if fault.kind == "stall":
            self._stalled = True
        elif fault.kind in BEGIN:
            BEGIN[fault.kind](self.controller, fault.parameters)
        for port in self._concerned(fault):
            if fault.kind == "disconnect":
                self._disconnect(port)
            port.begin(fault)
        if fault.kind == "disconnect" and fault.duration is None:
            self._faults.end(fault)

    def _end(self, fault: Fault) -> None:
        if fault.kind == "stall":
            self._stalled = False
        elif fault.kind in END:
            END[fault.kind](self.controller, fault.parameters)
        for port in self._concerned(fault):
            port.end(fault.kind)

    def _concerned(self, fault: Fault) -> list[Port[Session]]:
        name = fault.parameters.get("port")
        return [
            port
            for port in self._ports.values()
            if port.name != CONTROL and name in (port.name, ALL_PORTS)
        ]

    # Requests on the control socket

    def _check_possible(self, kind: str) -> None:
        if self.config.replay and kind in BEGIN:
            raise FaultError(f"{kind}: a recording is replayed, only its wires can have faults")

    def _inject(self, kind: str, parameters: dict[str, Any]) -> None:
        self._check_possible(kind)
        self._faults.inject(kind, parameters, self._elapsed)
        self._watch_again = True

    def _clear(self, kind: str | None = None) -> None:
        self._faults.clear(kind)
        self._watch_again = True

    def _outputs(self, names: list[str]) -> dict[str, Any]:
        outputs = self.controller.outputs
        return {name: outputs[name] for name in names} if names else dict(outputs)

    def _trace_after(self, after: int) -> list[dict[str, Any]]:
        return [
            {
                "number": entry.number,
                "time_ns": entry.time_ns,
                "connection": entry.connection,
                "recipe": entry.recipe,
                "values": entry.values,
            }
            for entry in self._trace.after(after)
        ]

    def _picture(self) -> dict[str, Any]:
        return picture.picture(
            self.controller,
            self._pace,
            self.statistics,
            {port.name: len(port.clients) for port in self._ports.values() if port.name != CONTROL},
            [fault.kind for fault in self._faults.active],
        )

    def status(self) -> dict[str, Any]:
        """Everything that a test or a person wants to know, ready for JSON."""
        controller = self.controller
        return {
            "host": self.host,
            "model": self.config.model,
            "version": ".".join(map(str, self.config.software)),
            "time": controller.time,
            "speed": {"wanted": self.config.speed, "reached": self._pace.reached},
            "ticks": controller.tick_count,
            "robot_mode": controller.robot_mode.name,
            "safety_mode": controller.safety_mode.name,
            "runtime_state": controller.runtime_state.name,
            "program": controller.program_name,
            "remote": controller.remote,
            "statistics": asdict(self.statistics),
            "connections": {name: self._connections(port) for name, port in self._ports.items()},
            "input_packages": self._trace.count,
            "scripts": list(self._scripts.last),
            "popup": controller.popup_text,
            "log": [{"time": time, "text": str(entry)} for time, entry in controller.log],
            "dashboard_commands": list(self._dashboard_commands),
            "faults": [{"kind": fault.kind, **fault.parameters} for fault in self._faults.active],
            "record": self._recorder and self._recorder.status,
            "replay": controller.status if isinstance(controller, ReplayedController) else None,
            "outputs": dict(controller.outputs),
        }

    def _connections(self, port: Port[Session]) -> list[dict[str, Any]]:
        return [
            {
                "number": client.number,
                "bytes_in": client.connection.bytes_in,
                "bytes_out": client.connection.bytes_out,
                "dropped": client.connection.dropped,
                "packages_in": getattr(client.session, "packages_in", None),
                "packages_bad": getattr(client.session, "packages_bad", None),
            }
            for client in port.clients
        ]


def _waits(client: Client[Session]) -> bool:
    """Whether a client's command is not answered yet."""
    return (
        isinstance(client.session, RobotApiSession | InterpreterSession) and client.session.waiting
    )

"""The simulated controller on its ports: one thread, one control period after the other.

Everything happens in :meth:`UrServer.run`: received data is handled as it arrives, and at every
control period the controller advances and its packages go out. No socket ever blocks the loop
(:mod:`~crtk_sim_backends.ur.ports.clients`): a client that does not read loses packages, and one that
sends nonsense loses its connection.
"""

from __future__ import annotations

import gc
import logging
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from crtk_sim_backends.control import ControlSession, token
from crtk_sim_backends.fault_player import FaultPlayer
from crtk_sim_backends.faults import Fault, FaultError, read_faults
from crtk_sim_backends.kit import ALL_PORTS, Port, Session
from crtk_sim_backends.process import (
    SimStartError,
    bind_somewhere,
    use_realtime_priority,
)
from crtk_sim_backends.ur.config import SimConfig
from crtk_sim_backends.ur.controller import Controller
from crtk_sim_backends.ur.injection import BEGIN, END, EVENTS, KINDS
from crtk_sim_backends.ur.messages import KeyMessage
from crtk_sim_backends.ur.pace import Pace, Statistics
from crtk_sim_backends.ur.ports import realtime
from crtk_sim_backends.ur.ports.clients import CONTROL, Clients
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
from crtk_sim_backends.ur.ports.rtde import InputClaims, RtdeSession, Trace
from crtk_sim_backends.ur.ports.script_port import ScriptSession
from crtk_sim_backends.ur.ports.script_queue import ScriptQueue
from crtk_sim_backends.ur.program.modbus_library import modbus_builtins
from crtk_sim_backends.ur.program.programs import ProgramFiles
from crtk_sim_backends.ur.program.script_rpc import ScriptRpc
from crtk_sim_backends.ur.program.script_sockets import ScriptSockets
from crtk_sim_backends.ur.signals.modbus_client import ModbusUnits
from crtk_sim_backends.ur.signals.recording import Recorder, Recording, RecordingError
from crtk_sim_backends.ur.signals.registers import FIELDBUS_INPUTS
from crtk_sim_backends.ur.urscript import Builtin
from crtk_sim_backends.ur.views import picture, scene
from crtk_sim_backends.ur.views.replay import NoInputs, ReplayedController, load

log = logging.getLogger(__name__)

_SLOW_READER_LIMIT: Final = 5.0  # s (real) without taking anything that end an RTDE connection
_CLIENTS_PER_PORT: Final = 64
_LAST_COMMANDS: Final = 20
_WRITABLE: Final = ("primary", "secondary", "realtime")
_PLACES: Final = ("port", "joint", "index", "encoder")  # parameters that say where a fault is
_DECIDED_ONCE: Final = ("primary", "secondary")  # read-only for good when opened in local control
_CLIENTS_AHEAD: Final = 0.02  # s of a delay after which what they ask for is a leap
_STRIDE: Final = 0.008  # s in which periods are done at once where nobody waits for one of them
_SWITCH_INTERVAL: Final = 1e-4  # s that the loop waits for the thread that compiles


class UrServer:
    """A simulated UR controller that listens on all its ports.

    Args:
        config: what to simulate; its ports are bound by the constructor.
        parent_fd: file descriptor that becomes readable when the process that wants this simulator
            has died, None for none.

    Attributes:
        host: its address.
        ports: port numbers by name.
        controller: what it simulates.
        stopping: whether :meth:`run` is to end.

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
        self.stopping = False
        self._secret = token()
        self._elapsed = 0.0  # s of the controller since the start, what it hangs included
        self._clients = Clients(self, self.statistics, config.speed, parent_fd)
        self._ports = self._clients.ports
        numbers = {**config.ports, CONTROL: config.control_port}
        self.host, _ = bind_somewhere(config.host, lambda host: self._clients.bind(host, numbers))
        self.ports = {name: port.number for name, port in self._ports.items()}

        self._sockets = ScriptSockets(self.host, self.ports.values())
        self._rpc = ScriptRpc(self.host)
        self._modbus_units = ModbusUnits(self.host, self.ports.get("modbus"))
        self.controller = self._make_controller(recording)
        self.controller.player.ended.append(self._sockets.close_all)
        try:
            self._external = ExternalDevices(config, self.controller)
        except SimStartError:
            self._clients.close()
            raise
        self._faults = FaultPlayer(KINDS, faults, self._begin, self._end, _PLACES)
        self._scripts = ScriptQueue(self.controller)
        self._period = self.controller.dt
        self._pace = Pace(self._period, config.speed, self.statistics)
        self._state_every = round(STATE_PERIOD / self._period)
        self._stride = max(1, round(_STRIDE * min(1.0, config.speed) / self._period))
        self._unwatched = 0  # periods before the next that somebody waits for
        self._encoder = RobotStateEncoder(config.robot, config.software)
        self._realtime_length = realtime.packet_length(config.software)
        self._slow_reader_limit = _SLOW_READER_LIMIT * config.speed
        self._claims = (
            NoInputs() if config.replay else InputClaims(FIELDBUS_INPUTS if config.fieldbus else ())
        )
        self._trace = Trace(config.trace_size)
        self._robot = Robot(
            self.controller, config.robot, config.software, config.serial_number, self.stop
        )
        self._obeyed = self.controller.obeys_clients
        self._was_moving = False
        self._dashboard_commands: deque[str] = deque(maxlen=_LAST_COMMANDS)
        self._recorder: Recorder | None = None
        try:
            if config.record:
                self._recorder = self._make_recorder()
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
            remote_enforced=config.remote_enforced,
            wires=config.wires,
            boot_seconds=config.boot_seconds,
            power_seconds=config.power_seconds,
            lock_seconds=config.lock_seconds,
            programs=ProgramFiles(Path(config.programs) if config.programs else None),
            surfaces=config.surfaces,
            limits=config.limits,
            defects=config.wrong,
            extra_builtins=self._network_builtins,
        )

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

    def _network_builtins(self, controller: Controller) -> Iterator[Builtin]:
        yield from self._sockets.builtins(controller.clock)
        yield from self._rpc.builtins()
        yield from modbus_builtins(controller.state_signals, self._modbus_units)
        yield Builtin("powerdown", self._power_down)

    def _power_down(self) -> None:
        """Switch arm and controller off, as a program asks for."""
        self.controller.power_off()
        self.stop()

    def stop(self) -> None:
        """End :meth:`run` within 10 ms. Safe in a signal handler."""
        self.stopping = True

    def close(self) -> None:
        """Close the recording and every socket."""
        if self._recorder is not None:
            self._recorder.close()
        self._sockets.close_all()
        self._modbus_units.close()
        self._external.close()
        self._clients.close()

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
        while not self.stopping:
            self._clients.serve_until(self._wake)
            self.catch_up()
            self._do_period(time.monotonic())

    def _wake(self) -> float:
        """When the next period has to begin that somebody waits for, monotonic s; the others follow then."""
        self._unwatched = self._until_watched()
        return self._pace.wake + self._unwatched * self._period / self.config.speed

    def catch_up(self) -> None:
        """Do the periods that nobody waited for, up to now: what has just arrived comes after them."""
        now = time.monotonic()
        while self._unwatched and self._pace.due <= now:
            self._unwatched -= 1
            self._do_period(self._pace.due, watched=False)

    def _do_period(self, begun: float, *, watched: bool = True) -> None:
        started = time.monotonic()
        if self._pace.started(begun) > _CLIENTS_AHEAD:
            self.controller.plant.arm.forgive()
        self.step(started * self.config.speed, watched=watched)
        self.statistics.busy += time.monotonic() - started

    def _until_watched(self) -> int:
        """How many periods come before the next that somebody would miss at its time."""
        paced = (
            self.config.replay
            or self.config.tool_device
            or self._faults.active
            or self._scripts.waiting
            or self._sockets.open
            or self._clients.busy
        )
        if paced:
            return 0
        ticks = self.controller.tick_count
        sessions = (client.session for client in self._ports["rtde"].clients)
        dividers = [
            session.divider
            for session in sessions
            if isinstance(session, RtdeSession) and session.started
        ]
        return (
            min(every - ticks % every for every in (self._stride, self._state_every, *dividers)) - 1
        )

    def step(self, now: float, *, watched: bool = True) -> None:
        """Advance one control period. Called by :meth:`run`.

        Args:
            now: time of the wires: of the monotonic clock, but `speed` times as fast, s. Faults begin
                and end in the controller's time, which lags behind that on a slow machine.
            watched: whether there is anything to send, or to move on, on the ports.
        """
        self._elapsed += self._period
        answers = self._clients.do_requests(now) if watched else []
        if self._faults.play(self._elapsed):
            self._clients.changed = True
        if not self._clients.stalled:
            self._advance(now, watched)
        self._clients.answer(answers, now)

    def _advance(self, now: float, watched: bool) -> None:
        """Move everything on by one control period, unless the controller hangs."""
        if watched:
            self._clients.push(now)
        self._scripts.run_compiled()
        self.controller.tick()
        self.statistics.ticks += 1
        if self._recorder is not None:
            self._recorder.add(self.controller.outputs, self.controller.tick_count)
        self._report(now)
        if watched:
            self._send_states(now)
            self._send_rtde(now)
            self._serve_tool(now)
            self._sockets.flush()

    # Clients

    def limit(self, port: str) -> int:
        """How many clients a port lets in."""
        return self._external.tool_clients if port == "tool" else _CLIENTS_PER_PORT

    def connected(self, port: str) -> None:
        """Tell the faults that a client has come."""
        self._event(f"{port}_connected")

    def session(self, port: str, number: int) -> Session:
        """Return what answers a new client of a port."""
        match port:
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
                        "scene": lambda: scene.scene(self.config, self.host),
                        "live": lambda: scene.live(self.controller.model, self._picture()),
                        "outputs": self._outputs,
                        "trace": self._trace_after,
                    },
                    self._secret,
                )
        refused = port in _DECIDED_ONCE and not self.controller.obeys_clients
        read_only = port not in _WRITABLE or refused
        return ScriptSession(self._scripts.refuse if read_only else self._scripts.put)

    def greeting(self, port: str) -> bytes:
        """Return what a new client of a port is told first."""
        greetings: dict[str, Callable[[], bytes]] = {
            "dashboard": lambda: GREETING,
            **dict.fromkeys(("primary", "primary_read_only"), self._primary_greeting),
            **dict.fromkeys(("secondary", "secondary_read_only"), self._secondary_greeting),
        }
        return greetings.get(port, bytes)()

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
        return self._encoder.packet(c.outputs, c.safety.manual, c.tool_communication)

    # Sending

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
            self._clients.broadcast(("primary", "primary_read_only"), lambda: encoded, now)
        if self._obeyed and not controller.obeys_clients:
            for name in _WRITABLE:
                self._clients.disconnect(self._ports[name])
        self._obeyed = controller.obeys_clients

    def _event(self, name: str) -> None:
        self._faults.event(name, self._elapsed)

    def _send_states(self, now: float) -> None:
        """Send the periodic packets of all ports but RTDE."""
        outputs = self.controller.outputs
        if self.controller.tick_count % self._state_every == 0:
            self._clients.broadcast(
                ("primary", "primary_read_only", "secondary", "secondary_read_only"),
                self._state,
                now,
            )
        self._clients.broadcast(
            ("realtime", "realtime_read_only"),
            lambda: realtime.packet(outputs, self._realtime_length),
            now,
        )

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
                self._clients.remove(port, client)

    def _serve_tool(self, now: float) -> None:
        """Send on what the tool has said; without its serial line nobody stays connected."""
        port = self._ports.get("tool")
        if port is None:
            return
        said = self._external.advance_tool()
        if not self._external.tool_clients:
            self._clients.disconnect(port)
        for client in port.clients:
            if said and not port.silent and client.session is not None:
                client.connection.send(said, now)

    # Faults

    def _begin(self, fault: Fault) -> None:
        if fault.kind == "stall":
            self._clients.stalled = True
        elif fault.kind in BEGIN:
            BEGIN[fault.kind](self.controller, fault.parameters)
        for port in self._concerned(fault):
            if fault.kind == "disconnect":
                self._clients.disconnect(port)
            port.begin(fault)
        if fault.kind == "disconnect" and fault.duration is None:
            self._faults.end(fault)

    def _end(self, fault: Fault) -> None:
        if fault.kind == "stall":
            self._clients.stalled = False
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
        self._clients.changed = True

    def _clear(self, kind: str | None = None) -> None:
        self._faults.clear(kind)
        self._clients.changed = True

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
            "connections": {
                name: self._clients.connections(port) for name, port in self._ports.items()
            },
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

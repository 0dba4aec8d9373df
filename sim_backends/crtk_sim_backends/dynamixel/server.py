"""Simulated buses on their ttys, and the control socket: one thread that sleeps until something is due.

A reply has to be handed over at the microsecond: the loop sleeps until shortly before, and spins for the
rest.
"""

from __future__ import annotations

import logging
import math
import select
import shutil
import socket
import tempfile
import time
from collections import deque
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Final

from crtk_sim_backends import wire
from crtk_sim_backends.control import ControlSession, token
from crtk_sim_backends.dynamixel import scene, wake_up
from crtk_sim_backends.dynamixel.adapter import Adapter
from crtk_sim_backends.dynamixel.bus import make_servos
from crtk_sim_backends.dynamixel.config import SimConfig
from crtk_sim_backends.dynamixel.effects import FaultEffects
from crtk_sim_backends.dynamixel.injection import EVENTS, KINDS
from crtk_sim_backends.dynamixel.line import Line
from crtk_sim_backends.dynamixel.packets import Instruction
from crtk_sim_backends.dynamixel.servo import Servo
from crtk_sim_backends.dynamixel.tcp import TcpDoor
from crtk_sim_backends.fault_player import FaultPlayer
from crtk_sim_backends.faults import FaultError, check_fault, read_faults, unknown
from crtk_sim_backends.kit.tty import Tty
from crtk_sim_backends.page import Live
from crtk_sim_backends.process import (
    SimStartError,
    bind_somewhere,
    listen,
    prepare_process,
    use_exact_timers,
)

log = logging.getLogger(__name__)

_SPIN: Final = 80e-6  # s before a deadline from which on the loop does not sleep any more
_TICK: Final = 0.02  # s between looks at joints, faults and events while nobody asks
_BACKLOG_LIMIT: Final = 1 << 26  # bytes of untaken answers that end a control connection
_CLIENTS: Final = 64


class DynamixelServer:
    """Simulated buses, ready for clients.

    Args:
        config: what to simulate; ttys and control socket are opened by the constructor.
        parent_fd: file descriptor that becomes readable when the process that wants this simulator
            has died, None for none.

    Raises:
        SimStartError: when a tty, a link or the control socket cannot be made, or the fault file is wrong.
    """

    def __init__(self, config: SimConfig, parent_fd: int | None = None) -> None:
        self.config = config
        self._parent_fd = parent_fd
        use_exact_timers()  # before the machine is measured
        self._stopping = False
        self._epoch = time.monotonic()
        self._folder: Path | None = None
        self._secret = token()
        self._clients: list[tuple[wire.Connection, ControlSession]] = []
        self._trace: deque[tuple[int, int, str, Instruction]] = deque(maxlen=config.trace_size)
        self._traced = 0
        self._busy = 0.0
        self._wake_ups = 0
        self._lines: list[Line] = []
        self._sources: dict[int, Callable[[], object]] = {}
        self._watched: list[int] = []
        self._changed = True  # ttys or connections came or went
        self.host, (self._listener, *doors) = bind_somewhere(config.host, self._bind)
        self._doors = [TcpDoor(listener) for listener in doors]
        try:
            self._plug_in()
            faults = read_faults(Path(config.faults), KINDS, EVENTS) if config.faults else []
            self._effects = FaultEffects(self._lines)
            for fault in faults:
                self._effects.check(fault)
        except FaultError as error:
            self.close()
            raise SimStartError(str(error)) from error
        except BaseException:
            self.close()
            raise
        self._faults = FaultPlayer(
            KINDS, faults, self._effects.begin, self._effects.end, ("bus", "id")
        )
        self._was = {id(servo): (servo.torque_enabled, False) for servo in self._servos}

    def _bind(self, host: str) -> list[socket.socket]:
        """Bind the control port, and one for each bus."""
        first = self.config.tcp_port
        wanted = [(self.config.control_port, "control")]
        wanted += [
            (first and first + number, f"bus{number + 1}")
            for number in range(len(self.config.buses))
        ]
        bound: list[socket.socket] = []
        try:
            for port, name in wanted:
                bound.append(listen(host, port, name))
        except SimStartError:
            for listener in bound:
                listener.close()
            raise
        return bound

    def _plug_in(self) -> None:
        config = self.config
        lead = wake_up.measure() if config.timing == "wire" else None
        for number, specs in enumerate(config.buses, start=1):
            name = f"bus{number}"
            line = Line(
                name,
                Adapter(Tty(self._link(number, name)), self._doors[number - 1], config.baud),
                make_servos(specs, config.baud, config.return_delay, config.wrong),
                lead=lead,
                latency=config.adapter_latency * 1e-3,
                chain=config.chain,
                seed=config.seed + number,
                trace=lambda packet, at, name=name: self._note(name, packet, at),  # type: ignore[misc]
            )
            self._lines.append(line)
            line.port.plug()

    def _link(self, number: int, name: str) -> Path:
        if self.config.link:
            path = Path(self.config.link).absolute()
            return path if number == 1 else path.with_name(f"{path.name}-{number}")
        if self._folder is None:
            self._folder = Path(tempfile.mkdtemp(prefix="crtk-dynamixel-"))
        return self._folder / name

    @property
    def ports(self) -> dict[str, int]:
        """TCP ports by name: of every bus, and "control"."""
        buses = {f"bus{number}": door.port for number, door in enumerate(self._doors, start=1)}
        return {"control": self._listener.getsockname()[1], **buses}

    @property
    def ttys(self) -> dict[str, str]:
        """Path of every bus by name."""
        return {line.name: str(line.port.tty.link) for line in self._lines}

    @property
    def _servos(self) -> list[Servo]:
        return [servo for line in self._lines for servo in line.bus.servos]

    # Life

    def stop(self) -> None:
        """End :meth:`run` soon. Safe in a signal handler."""
        self._stopping = True

    def close(self) -> None:
        """Close every tty and socket, and remove the links."""
        for line in self._lines:
            line.unplug()
        self._lines.clear()
        for door in self._doors:
            door.close()
        for connection, _ in self._clients:
            connection.close()
        self._clients.clear()
        self._listener.close()
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)
            self._folder = None

    def run(self) -> None:
        """Run until :meth:`stop`, or until the parent process has died."""
        prepare_process(realtime=self.config.realtime)
        self._epoch = time.monotonic()
        tick = self._epoch
        while not self._stopping:
            due = min(line.due for line in self._lines)
            self._wait(min(due - _SPIN, tick))
            started = time.monotonic()
            if due - started <= _SPIN:
                while (started := time.monotonic()) < due:
                    pass
                self._deliver(started)
            elif started >= tick:
                tick = started + _TICK
                self._tick(started)
            self._busy += time.monotonic() - started
            self._wake_ups += 1

    def _deliver(self, now: float) -> None:
        for line in self._lines:
            line.deliver(now)

    def _wait(self, until: float) -> None:
        """Take what arrives until a deadline; at least look once."""
        if self._changed:
            self._watch()
        ready, _, _ = select.select(self._watched, (), (), max(0.0, until - time.monotonic()))
        for source in ready:
            self._sources[source]()

    def _watch(self) -> None:
        """Collect what is waited for, and who takes it."""
        self._changed = False
        self._sources = {self._listener.fileno(): self._accept}
        for line in self._lines:
            tty, door = line.port.tty, line.port.door
            if tty.plugged:
                self._sources[tty.fileno()] = partial(self._receive, line, by_tcp=False)
            if tty.openings is not None:
                self._sources[tty.openings.fileno()] = tty.look
            self._sources[door.listener] = partial(self._come_in, line)
            if door.client is not None:
                self._sources[door.client] = partial(self._receive, line, by_tcp=True)
        for connection, session in self._clients:
            self._sources[connection.fileno()] = partial(self._serve, connection, session)
        if self._parent_fd is not None:
            self._sources[self._parent_fd] = self._parent_died
        self._watched = list(self._sources)

    def _parent_died(self) -> None:
        log.info("the process that started this simulator has ended")
        self.stop()

    def _come_in(self, line: Line) -> None:
        """Let a client of a bus in by TCP."""
        line.port.door.accept(welcome=line.port.plugged)
        self._changed = True

    def _receive(self, line: Line, *, by_tcp: bool) -> None:
        now = time.monotonic()
        if line.port.plugged:  # it may have been unplugged since
            data = line.port.read(by_tcp=by_tcp)
            self._changed |= by_tcp and not data  # it may have left
            if data:
                line.receive(data, now, self._plant_time(now), line.port.baud)

    def _plant_time(self, now: float) -> float:
        return (now - self._epoch) * self.config.speed

    def _tick(self, now: float) -> None:
        """Look after what happens by itself."""
        self._changed |= self._faults.play(now - self._epoch)
        plant_time = self._plant_time(now)
        for servo in self._servos:
            servo.advance(plant_time)
            is_on, moves = servo.torque_enabled, servo.drive.velocity != 0.0
            was_on, moved = self._was[id(servo)]
            if is_on != was_on:
                self._faults.event("torque_on" if is_on else "torque_off", now - self._epoch)
            if moves != moved:
                self._faults.event(
                    "motion_started" if moves else "motion_stopped", now - self._epoch
                )
            self._was[id(servo)] = is_on, moves

    def _note(self, bus: str, packet: Instruction, at: float) -> None:
        if not self._traced:
            self._faults.event("instruction", time.monotonic() - self._epoch)
        self._traced += 1
        self._trace.append((self._traced, int(at * 1e9), bus, packet))

    # The control socket

    def _accept(self) -> None:
        try:
            sock, _ = self._listener.accept()
        except OSError as error:
            log.warning("cannot accept on the control port: %s", error)
            return
        if len(self._clients) >= _CLIENTS:
            sock.close()
            return
        session = ControlSession(
            {
                "inject": self._inject,
                "clear": self._clear,
                "status": self.status,
                "outputs": self._outputs,
                "trace": self._trace_after,
                "place": self._place,
                "write": self._write,
                "scene": lambda: scene.scene(self.config, self.host),
                "live": self._live,
            },
            self._secret,
        )
        try:
            connection = wire.Connection(sock, _BACKLOG_LIMIT)
        except OSError as error:
            log.info("a client of the control port was gone at once: %s", error)
            sock.close()
            return
        self._clients.append((connection, session))
        self._changed = True

    def _serve(self, connection: wire.Connection, session: ControlSession) -> None:
        now = time.monotonic()
        connection.read(now)
        for data in connection.take(now):
            connection.send(session.receive(data), now)
        connection.flush(now)
        if connection.ended or session.ended:
            connection.close()
            self._clients.remove((connection, session))
            self._changed = True

    def _inject(self, kind: str, parameters: dict[str, Any]) -> None:
        self._effects.check(check_fault(KINDS, kind, parameters, "inject"))
        self._advance()
        self._faults.inject(kind, parameters, time.monotonic() - self._epoch)
        self._changed = True
        self._advance()

    def _clear(self, kind: str | None = None) -> None:
        self._advance()
        self._faults.clear(kind)
        self._changed = True

    def _advance(self) -> None:
        plant_time = self._plant_time(time.monotonic())
        for servo in self._servos:
            servo.advance(plant_time)

    def _place(self, id: int, angle: float, bus: int = 1) -> None:
        """Put the joint of a servo somewhere by hand: angle of its horn from the middle, rad."""
        if not math.isfinite(angle):
            raise ValueError("angle must be finite")
        servo = self._servo(bus, id)
        self._advance()
        servo.joint.angle = servo.drive.mount * float(angle)
        servo.joint.velocity = 0.0
        servo.joint.wake()
        self._advance()

    def _write(self, id: int, address: int, data: str, bus: int = 1) -> None:
        """Put bytes (hexadecimal) into the registers of a servo, as another program would have."""
        servo = self._servo(bus, id)
        self._advance()
        servo.poke(address, bytes.fromhex(data))

    def _servo(self, bus: int, id: int) -> Servo:
        if not 1 <= bus <= len(self._lines):
            raise ValueError(f"there is no bus {bus}, only {len(self._lines)}")
        servos = {servo.number: servo for servo in self._lines[bus - 1].bus.servos}
        if id not in servos:
            raise ValueError(
                f"no servo has the id {id} on bus {bus}: {', '.join(map(str, servos))}"
            )
        return servos[id]

    def _outputs(self, names: list[str]) -> dict[str, Any]:
        """State of servos; a name is ``bus1/7``."""
        self._advance()
        known = {f"{line.name}/{s.number}": s for line in self._lines for s in line.bus.servos}
        for name in names:
            if name not in known:
                raise ValueError(unknown("servo", name, known))
        return {name: known[name].describe() for name in names or known}

    def _trace_after(self, after: int) -> list[dict[str, Any]]:
        return [
            {
                "number": number,
                "time_ns": time_ns,
                "bus": bus,
                "protocol": packet.protocol,
                "id": packet.id,
                "code": packet.code,
                "parameters": packet.parameters.hex(),
            }
            for number, time_ns, bus, packet in self._trace
            if number > after
        ]

    def _live(self) -> Live:
        self._advance()
        now = self._plant_time(time.monotonic())
        return scene.live(self._lines, [fault.kind for fault in self._faults.active], now)

    def status(self) -> dict[str, Any]:
        """Everything that a test or a person wants to know, ready for JSON."""
        return {
            "host": self.host,
            "time": self._plant_time(time.monotonic()),
            "cpu": time.process_time(),
            "busy": self._busy,
            "wake_ups": self._wake_ups,
            "instructions": self._traced,
            "buses": {line.name: line.describe() for line in self._lines},
            "faults": [{"kind": fault.kind, **fault.parameters} for fault in self._faults.active],
            "servos": self._outputs([]),
        }

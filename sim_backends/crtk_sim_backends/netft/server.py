"""The simulated sensor box on its ports: one thread, which sends each datagram at its time.

Everything happens in :meth:`NetFtServer.run`: it sleeps until the next datagram is due or something arrives.
After a late wake-up all that is due goes out at once, so that counters and the average rate stay right.
"""

from __future__ import annotations

import logging
import select
import socket
import struct
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from crtk_sim_backends import wire
from crtk_sim_backends.control import token
from crtk_sim_backends.fault_player import FaultPlayer
from crtk_sim_backends.faults import Fault, FaultError, read_faults
from crtk_sim_backends.kit import ALL_PORTS, Client, Port
from crtk_sim_backends.kit.loads import parse_load
from crtk_sim_backends.netft import rdt, rdt_port, scene
from crtk_sim_backends.netft.box import Box
from crtk_sim_backends.netft.config import HTTP_PORT, SimConfig
from crtk_sim_backends.netft.hostile import Hostile
from crtk_sim_backends.netft.http import HttpSession
from crtk_sim_backends.netft.injection import (
    BEGIN,
    END,
    EVENTS,
    KINDS,
    TCP_PORTS,
)
from crtk_sim_backends.netft.ports import Requests, Session
from crtk_sim_backends.netft.rdt_port import RdtPort
from crtk_sim_backends.netft.tcp import TcpSession
from crtk_sim_backends.process import (
    SimStartError,
    bind_somewhere,
    listen,
    prepare_process,
)

log = logging.getLogger(__name__)

CONTROL: Final = "control"

_CHORES: Final = 0.01  # s between two looks at faults and at slow connections
_DEAF_FOR: Final = 0.001  # s for which a fast stream is sent without a look at requests
_LONG_PAUSE: Final = 1.0  # s without a turn of the loop that count as a stand-still of the box
_BACKLOG_LIMIT: Final = 1 << 22  # bytes of untaken answers that end a connection
_CLIENTS_PER_PORT: Final = 32
_HIGHEST_FD: Final = 1023  # that `select` can watch


@dataclass
class Statistics:
    """How well the loop keeps its times."""

    turns: int = 0
    pauses: int = 0  # stand-stills of this process
    worst_delay: float = 0.0  # s from when a datagram was due to when it went out
    accepted: int = 0  # connections


class NetFtServer:
    """A simulated sensor box that listens on all its ports.

    Args:
        config: what to simulate; its ports are bound by the constructor.
        parent_fd: file descriptor that becomes readable when the process that wants this simulator
            has died, None for none.

    Raises:
        SimStartError: when a port cannot be bound or the fault file is wrong.
    """

    def __init__(self, config: SimConfig, parent_fd: int | None = None) -> None:
        self.config = config
        self.statistics = Statistics()
        try:
            faults = read_faults(Path(config.faults), KINDS, EVENTS) if config.faults else []
        except FaultError as error:
            raise SimStartError(str(error)) from error
        self._parent_fd = parent_fd
        self._stopping = False
        self._secret = token()
        self._ports: dict[str, Port[Session]] = {}
        self.host, self._rdt = bind_somewhere(config.host, self._bind)
        self.ports = {rdt_port.NAME: self._rdt.number}
        self.ports.update((name, port.number) for name, port in self._ports.items())
        self._now = self._epoch = time.monotonic()
        self.box = Box(config, self._epoch)
        self._faults = FaultPlayer(KINDS, faults, self._begin, self._end, ("port", "axis", "tag"))
        self._stalled_since: float | None = None
        self._booting: tuple[float, float] | None = None  # until when, and the change of scale
        self._seen = (0, False, False)  # streams begun, whether there is one, whether it is biased
        self._by_fd: dict[int, Callable[[], None]] = {}
        self._watched: list[int] = []
        self._watch_again = True

    # Life

    def _bind(self, host: str) -> RdtPort:
        config = self.config
        stream = RdtPort(host, config.rdt_port)
        wanted = {
            "tcp": config.tcp_port,
            "http": config.http_port,
            CONTROL: config.control_port,
        }
        try:
            for name, number in wanted.items():
                self._ports[name] = Port(name, _listen(host, number, name))
        except SimStartError:
            stream.close()
            self._close_ports()
            raise
        return stream

    def stop(self) -> None:
        """End :meth:`run` soon. Safe in a signal handler."""
        self._stopping = True

    def close(self) -> None:
        """Close every socket."""
        self._close_ports()
        self._rdt.close()

    def _close_ports(self) -> None:
        for port in self._ports.values():
            port.close()
        self._ports.clear()

    def run(self) -> None:
        """Run in real time until :meth:`stop`, or until the parent process has died."""
        prepare_process(realtime=self.config.realtime)
        chores = self._epoch = time.monotonic()
        self.box.sensor.clock.stand_still(self._epoch - self._now)
        self._now = self._epoch
        while not self._stopping:
            now = time.monotonic()
            self.statistics.turns += 1
            self._measure(now)
            if now >= chores:
                self._do_chores(now)
                chores = now + _CHORES
            if self._watch_again:
                self._watch()
            self._send_ahead(min(now + _DEAF_FOR, chores))
            wait = min(chores, self._due()) - time.monotonic()
            ready, _, _ = select.select(self._watched, (), (), max(0.0, wait))
            if ready:
                self._handle(ready)

    @property
    def _moment(self) -> float:
        """The time as the box knows it: it does not pass while the box hangs."""
        return self._now if self._stalled_since is None else self._stalled_since

    @property
    def _unreachable(self) -> bool:
        """Whether nothing comes through."""
        return self._booting is not None or "unplugged" in self._active

    @property
    def _active(self) -> set[str]:
        return {fault.kind for fault in self._faults.active}

    def _due(self) -> float:
        """When the next datagram is due, or the next block of measurements."""
        sensor, stream = self.box.sensor, self.box.stream
        if self._stalled_since is not None or self._booting is not None:
            return self._now + _CHORES
        due = sensor.clock.time_of(sensor.block.end)
        return due if stream is None else min(due, stream.due(sensor.clock))

    # Sending

    def _measure(self, now: float) -> None:
        """Measure up to now and send what is due."""
        paused, self._now = now - self._now, now
        if paused > _LONG_PAUSE and self._stalled_since is None:
            self.statistics.pauses += 1
            self.box.sensor.clock.stand_still(paused)
        if self._stalled_since is not None or self._booting is not None:
            return
        box = self.box
        stream = box.stream
        if stream is not None:
            late = now - stream.due(box.sensor.clock)
            self.statistics.worst_delay = max(self.statistics.worst_delay, late)
        found = box.datagrams(now)
        if stream is not None and not self._unreachable:
            self._rdt.send(found, stream.to)

    def _send_ahead(self, until: float) -> None:
        """Send a fast stream, of single records on a good wire, without a look at anything else."""
        stream, sensor = self.box.stream, self.box.sensor
        if stream is None or stream.size > 1 or stream.due(sensor.clock) > until:
            return
        if self._stalled_since is not None or self._unreachable or not self._rdt.is_plain:
            return
        before = stream.sent
        stream.send_ahead(sensor.block, sensor.clock, until, self._rdt.plain_sender(stream.to))
        self.box.counters.records += stream.sent - before

    # Receiving

    def _handle(self, ready: list[int]) -> None:
        self._measure(time.monotonic())
        for fd in ready:
            owner = self._by_fd.get(fd)
            if owner is not None:
                owner()
        self.box.settle(self._moment)
        self._notice()

    def _watch(self) -> None:
        """Collect the file descriptors that are read now."""
        self._watch_again = False
        self._by_fd = {}
        hangs = self._stalled_since is not None
        if self._rdt.fd >= 0 and not hangs:
            self._by_fd[self._rdt.fd] = self._receive_requests
        for port in self._ports.values():
            if port.name != CONTROL and (hangs or self._unreachable or port.silent):
                continue
            if port.listener is not None:
                self._by_fd[port.listener.fileno()] = partial(self._accept, port)
            for client in port.clients:
                if not client.connection.ended:
                    take = partial(self._receive, port, client)
                    self._by_fd[client.connection.fileno()] = take
        if self._parent_fd is not None:
            self._by_fd[self._parent_fd] = self._lose_parent
        self._watched = list(self._by_fd)

    def _lose_parent(self) -> None:
        log.info("the process that started this simulator has ended")
        self.stop()

    def _receive_requests(self) -> None:
        for data, sender in self._rdt.receive():
            if not self._unreachable:
                self.box.request(data, sender, self._now)

    def _accept(self, port: Port[Session]) -> None:
        while port.listener is not None:
            try:
                sock, sender = port.listener.accept()
            except BlockingIOError:
                return
            except OSError as error:
                log.warning("cannot accept on the %s port: %s", port.name, error)
                return
            full = len(port.clients) >= _CLIENTS_PER_PORT or sock.fileno() > _HIGHEST_FD
            if full or "disconnect" in port.faults:
                sock.close()
                continue
            try:
                connection = wire.Connection(sock, _BACKLOG_LIMIT)
            except OSError as error:
                log.info("a client of the %s port was gone at once: %s", port.name, error)
                sock.close()
                continue
            self.statistics.accepted += 1
            name = f"{sender[0]}:{sender[1]}"
            session = self._session(port.name, name) if port.answers else None
            port.add(Client(connection, session))
            self._watch_again = True
            if port.name in TCP_PORTS:
                self._event(f"{port.name}_connected")

    def _session(self, name: str, sender: str) -> Session:
        if name == "tcp":
            return TcpSession(self.box, sender, lambda: self._now)
        if name == "http":
            answer = next(
                (f.parameters["answer"] for f in self._faults.active if f.kind == "web_answer"),
                None,
            )
            hostile = None if answer is None else Hostile(answer)
            tags = {
                fault.parameters["tag"]: fault.parameters["text"]
                for fault in self._faults.active
                if fault.kind == "web_tag"
            }
            return HttpSession(self.box, self.host, sender, lambda: self._now, hostile, tags)
        return Requests(
            {
                "inject": self._inject,
                "clear": self._clear,
                "status": self.status,
                "outputs": self._outputs,
                "trace": self.box.trace,
                "load": self._load,
                "carry": self._carry,
                "scene": lambda: scene.scene(self.box, self.host),
                "live": lambda: scene.live(self.box, self.status()),
            },
            self._secret,
        )

    def _receive(self, port: Port[Session], client: Client[Session]) -> None:
        if client not in port.clients:
            return  # a fault has closed it in this turn
        client.connection.read(self._now)
        self._process(port, client)

    def _process(self, port: Port[Session], client: Client[Session]) -> None:
        """Let a client's session take what has arrived, and send its answer."""
        connection = client.connection
        try:
            for piece in connection.take(self._now):
                connection.send(client.receive(piece), self._now)
        except Exception:
            log.exception("a defect of the simulator closes a %s connection", port.name)
            connection.closed = True
        self._remove_if_ended(port, client)

    def _remove_if_ended(self, port: Port[Session], client: Client[Session]) -> None:
        connection = client.connection
        done = client.ended and not connection.has_output
        if (connection.ended or done) and client in port.clients:
            port.remove(client)
            self._watch_again = True

    # What has its time

    def _do_chores(self, now: float) -> None:
        self._finish_booting(now)
        if self._faults.play(now - self._epoch):
            self._watch_again = True
        for port in self._ports.values():
            hangs = self._stalled_since is not None or self._unreachable or port.silent
            if port.clients and not (hangs and port.name != CONTROL):
                self._push(port, now)
        self.box.settle(self._moment)
        self._notice()

    def _push(self, port: Port[Session], now: float) -> None:
        """Move on what a slow peer or a delaying wire has held back, and answers that take time."""
        for client in list(port.clients):
            connection = client.connection
            connection.flush(now)
            if connection.has_input:
                self._process(port, client)
            if client.session and not connection.has_output and not connection.closed:
                connection.send(client.session.more(now), now)
            self._remove_if_ended(port, client)

    def _finish_booting(self, now: float) -> None:
        if self._booting is None or now < self._booting[0]:
            return
        scale, self._booting = self._booting[1], None
        for name in TCP_PORTS:
            if name in self._ports:
                self._ports[name].disconnect()
        self.box.power_up(now, scale)
        self._watch_again = True

    def _notice(self) -> None:
        """Tell the timeline what has happened."""
        box = self.box
        before = self._seen
        seen = box.counters.streams, box.stream is not None, bool(box.settings.bias.any())
        self._seen = seen
        if seen[0] > before[0]:
            self._event("stream_started")
        if before[1] and not seen[1]:
            self._event("stream_stopped")
        if seen[2] and not before[2]:
            self._event("biased")

    def _event(self, name: str) -> None:
        self._faults.event(name, self._now - self._epoch)

    # Faults

    def _begin(self, fault: Fault) -> None:
        kind, parameters = fault.kind, fault.parameters
        if kind == "takeover":
            command = min(self.box.profile.single)
            start = struct.pack(">HHI", rdt.HEADER, command, parameters["count"])
            self.box.request(start, self._rdt.other_client, self._moment)
        elif kind == "reboot":
            self.box.stream = None
            self._booting = self._now + parameters["seconds"], parameters["scale"]
        elif kind == "stall":
            self._stalled_since = self._now
        elif kind in BEGIN:
            BEGIN[kind](self.box, parameters, self._moment)
            self.box.changed()
        self._rdt.begin(fault)
        for port in self._concerned(fault):
            port.begin(fault)
        self._watch_again = True

    def _end(self, fault: Fault) -> None:
        kind = fault.kind
        if kind == "stall" and self._stalled_since is not None:
            self.box.sensor.clock.stand_still(self._now - self._stalled_since)
            self._stalled_since = None
        elif kind in END:
            END[kind](self.box, fault.parameters, self._moment)
            self.box.changed()
        self._rdt.end(fault)
        for port in self._concerned(fault):
            port.end(kind)
        self._watch_again = True

    def _concerned(self, fault: Fault) -> list[Port[Session]]:
        name = fault.parameters.get("port")
        return [
            port
            for port in self._ports.values()
            if port.name != CONTROL and name in (port.name, ALL_PORTS)
        ]

    # Requests on the control socket

    def _inject(self, kind: str, parameters: dict[str, Any]) -> None:
        self._faults.inject(kind, parameters, self._now - self._epoch)
        self.box.settle(self._moment)

    def _clear(self, kind: str | None = None) -> None:
        self._faults.clear(kind)
        self.box.settle(self._moment)

    def _load(self, text: str) -> None:
        self.box.sensor.load = parse_load(text)
        self.box.changed()
        self.box.settle(self._moment)

    def _carry(self, wrench: list[float]) -> None:
        carried = np.array(wrench, np.float64)
        if carried.shape != (6,) or not np.isfinite(carried).all():
            raise ValueError(f"wrench must be six finite numbers, not {wrench}")
        self.box.sensor.carried = carried
        self.box.changed()
        self.box.settle(self._moment)

    def _outputs(self, names: list[str]) -> dict[str, Any]:
        newest = self.box.sensor.measurement(self._moment)
        values: dict[str, Any] = {
            "ft_sequence": newest.ft,
            "status": newest.status,
            "counts": list(newest.counts),
            "wrench": newest.smooth.tolist(),
            "bias": self.box.settings.bias.tolist(),
        }
        return {name: values[name] for name in names} if names else values

    def status(self) -> dict[str, Any]:
        """Everything that a test or a person wants to know, ready for JSON."""
        box, stream = self.box, self.box.stream
        settings = box.settings
        return {
            "host": self.host,
            "profile": box.profile.name,
            "preset": settings.preset.name,
            "time": self._now - self._epoch,
            "internal_rate": settings.internal_rate,
            "rdt_rate": settings.rdt_rate,
            "filter_code": settings.filter_code,
            "buffer_size": settings.buffer_size,
            "configuration": settings.active,
            "stream": None
            if stream is None
            else {
                "to": f"{stream.to[0]}:{stream.to[1]}",
                "sequence": stream.sequence,
                "records": stream.sent,
                "size": stream.size,
            },
            "unreachable": self._unreachable,
            "counters": {**asdict(box.counters), **asdict(self._rdt.traffic)},
            "statistics": asdict(self.statistics),
            "connections": {name: len(port.clients) for name, port in self._ports.items()},
            "faults": [{"kind": fault.kind, **fault.parameters} for fault in self._faults.active],
            "outputs": self._outputs([]),
        }


def _listen(host: str, number: int, name: str) -> socket.socket:
    """Listen on a port; on any free one where the system does not permit that of the web."""
    try:
        return listen(host, number, name)
    except SimStartError as error:
        forbidden = isinstance(error.__cause__, PermissionError)
        if name != "http" or number != HTTP_PORT or not forbidden:
            raise
        log.info("port %d is not permitted; the web pages are on another", number)
        return listen(host, 0, name)

"""A simulator in one thread: a device behind ports and serial lines, with control door, faults and page."""

from __future__ import annotations

import shutil
import socket
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final, NamedTuple

from crtk_sim_backends.faults import Fault, FaultError, Parameter
from crtk_sim_backends.kit.device import Device
from crtk_sim_backends.kit.fault_desk import FaultDesk
from crtk_sim_backends.kit.loop import Loop, Ticker
from crtk_sim_backends.kit.ports import Session
from crtk_sim_backends.kit.tcp_server import TcpServer, control_door
from crtk_sim_backends.kit.tty_server import TtyServer
from crtk_sim_backends.kit.udp_server import UdpServer
from crtk_sim_backends.kit.wire_faults import ALL_PORTS, wire_kinds
from crtk_sim_backends.options import Options
from crtk_sim_backends.page import Gauges, Live, Row, Scene, button, fault_row
from crtk_sim_backends.process import (
    SimStartError,
    bind_somewhere,
    bind_udp,
    listen,
    listen_in_files,
    prepare_process,
)

CONTROL: Final = "control"


class TcpDoor(NamedTuple):
    """A TCP port of a device.

    Attributes:
        port: its number; 0: any free one.
        session: makes that of a new client.
        most: clients at a time.
    """

    port: int
    session: Callable[[], Session]
    most: int = 64


class UdpDoor(NamedTuple):
    """A UDP port of a device. Who has sent last is its client.

    Attributes:
        port: its number; 0: any free one.
        session: makes that of a new client; what it returns is sent as one datagram.
    """

    port: int
    session: Callable[[], Session]


_Line = TcpServer | TtyServer | UdpServer


class LoopServer:
    """A simulator whose ports are bound, for :meth:`crtk_sim_backends.simulator.Simulator.serve`.

    Beside the kinds of fault of its device it has those of :func:`wire_kinds`, on every kind of line. By
    ``disconnect`` a serial line is unplugged. A piece of data is what is sent or read at a time: a datagram.

    Args:
        config: options.
        parent_fd: readable when the process that wants this simulator has died; None for none.
        device: that is simulated.
        title: of its page.
        tcp: its TCP ports, by name.
        udp: its UDP ports, by name.
        ttys: what makes the sessions of its serial lines, by name.
        sockets: what makes those of its sockets in the file system, by name; their paths are among `ttys`.
        gauges: what its page shows beside the status of the device.
        requests: what else its control door is asked for, by name.

    Attributes:
        host: the loopback address.
        ports: TCP and UDP ports by name, ``control`` among them.
        ttys: paths of the serial lines by name.
        paths: of other files by name, which whoever serves it adds.

    Raises:
        SimStartError: something cannot be bound, or the fault file is wrong.
    """

    def __init__(
        self,
        config: Options,
        parent_fd: int | None,
        device: Device,
        *,
        title: str,
        tcp: Mapping[str, TcpDoor] | None = None,
        udp: Mapping[str, UdpDoor] | None = None,
        ttys: Mapping[str, Callable[[], Session]] | None = None,
        sockets: Mapping[str, Callable[[], Session]] | None = None,
        gauges: Callable[[], Sequence[Gauges]] = tuple,
        requests: Mapping[str, Callable[..., Any]] | None = None,
    ) -> None:
        self._config = config
        self._device = device
        self._title = title
        self._tcp = dict(tcp or {})
        self._udp = dict(udp or {})
        self._lines = dict(ttys or {})
        self._sockets = dict(sockets or {})
        self._gauges = gauges
        self._requests = dict(requests or {})
        self._loop = Loop()
        self._servers: dict[str, _Line] = {}
        self.paths: dict[str, str] = {}
        self._closing = ExitStack()
        self._closing.callback(self._loop.close)
        try:
            lines = (*self._tcp, *self._udp, *self._lines, *self._sockets)
            port = Parameter(str, ALL_PORTS, choices=(*lines, ALL_PORTS))
            wires = wire_kinds(port) if lines else {}
            self._kinds = {**wires, **device.kinds}
            self._faults = FaultDesk(
                self._loop,
                self._kinds,
                self._begin,
                self._end,
                path=config.faults,
                places=("port",),
            )
            self.host, self.ports = bind_somewhere(config.host, self._bind)
            self.ttys = self._plug_in()
        except FaultError as error:
            self.close()
            raise SimStartError(str(error)) from error
        except BaseException:
            self.close()
            raise
        if parent_fd is not None:
            self._loop.watch(parent_fd, lambda _: self.stop())

    @property
    def device(self) -> Device:
        """What is simulated, for whoever judges by the simulator's own truth."""
        return self._device

    def every(self, period: float, tick: Callable[[], object]) -> None:
        """Call `tick` every `period` seconds while it runs; what it is late by is made up for."""
        Ticker(self._loop, period, tick)

    def after(self, seconds: float, function: Callable[[], object]) -> None:
        """Call `function` once, so many seconds from now."""
        self._loop.call_at(time.monotonic() + seconds, function)

    def watch(self, fd: int, ready: Callable[[int], object]) -> None:
        """Call `ready` in the loop whenever a file descriptor can be read: that of a UDP port."""
        self._loop.watch(fd, ready)

    def at_end(self, function: Callable[[], object]) -> None:
        """Call `function` when it is closed."""
        self._closing.callback(function)

    def send(self, name: str, data: bytes, to: Session | None = None) -> None:
        """Send to the clients of a port or a serial line, or to the one that has the session `to`."""
        self._servers[name].send(data, to)

    def run(self) -> None:
        """Run until `stop`, or until the parent process has died."""
        prepare_process(realtime=self._config.realtime)
        self._faults.start()
        self._loop.run()

    def stop(self) -> None:
        """Let `run` return; from any thread or signal handler."""
        self._loop.stop()

    def baud(self, name: str) -> int:
        """Return the rate in bit/s that the client of a serial line has set."""
        line = self._servers[name]
        assert isinstance(line, TtyServer)
        return line.baud

    def close(self) -> None:
        """Close everything; safe to repeat."""
        self._closing.close()

    def _bind(self, host: str) -> dict[str, int]:
        with ExitStack() as bound:
            door = listen(host, self._config.control_port, CONTROL)
            bound.callback(door.close)
            found = {}
            for name, wanted in self._tcp.items():
                found[name] = listen(host, wanted.port, name)
                bound.callback(found[name].close)
            for name, door_of in self._udp.items():
                found[name] = bind_udp(host, door_of.port, name)
                bound.callback(found[name].close)
            bound.pop_all()
        control = control_door(self._loop, door, self._handlers())
        self._closing.callback(control.close)
        ports = {CONTROL: control.number}
        for name, own in found.items():
            server = self._serve_port(name, own)
            self._closing.callback(server.close)
            self._servers[name] = server
            ports[name] = server.number
        return ports

    def _serve_port(self, name: str, own: socket.socket) -> TcpServer | UdpServer:
        if name in self._udp:
            return UdpServer(self._loop, own, name, self._udp[name].session)
        _, session, most = self._tcp[name]
        return TcpServer(self._loop, own, name, session, most)

    def _plug_in(self) -> dict[str, str]:
        if not self._lines and not self._sockets:
            return {}
        folder = Path(tempfile.mkdtemp(prefix="crtk-tty-"))
        self._closing.callback(shutil.rmtree, folder, ignore_errors=True)
        ttys = {}
        for name, session in self._lines.items():
            line = TtyServer(self._loop, folder / name, session)
            self._closing.callback(line.close)
            self._servers[name] = line
            ttys[name] = line.path
        for name, session in self._sockets.items():
            listener = listen_in_files(folder / name)
            server = TcpServer(self._loop, listener, name, session)
            self._closing.callback(server.close)
            self._servers[name] = server
            ttys[name] = str(folder / name)
        return ttys

    def _begin(self, fault: Fault) -> None:
        if fault.kind in self._device.kinds:
            self._device.begin(fault)
        for server in self._concerned(fault):
            server.begin(fault)

    def _end(self, fault: Fault) -> None:
        if fault.kind in self._device.kinds:
            self._device.end(fault)
        for server in self._concerned(fault):
            server.end(fault)

    def _concerned(self, fault: Fault) -> list[_Line]:
        if fault.kind in self._device.kinds:
            return []
        wanted = fault.parameters["port"]
        return [self._servers[name] for name in self._servers if wanted in (name, ALL_PORTS)]

    # Requests on the control door

    def _handlers(self) -> dict[str, Callable[..., Any]]:
        return {
            **self._faults.handlers,
            **self._requests,
            "status": self.status,
            "scene": self._scene,
            "live": self._live,
        }

    def status(self) -> dict[str, Any]:
        """What a test or a person wants to know, ready for JSON."""
        return {
            **self._device.status(),
            "host": self.host,
            "time": self._faults.now,
            "connections": {name: server.clients for name, server in self._servers.items()},
            "faults": self._faults.describe(),
        }

    def _scene(self) -> Scene:
        simple = [
            kind
            for kind in self._kinds.values()
            if all(parameter.default is not None for parameter in kind.parameters.values())
        ]
        return {
            "title": self._title,
            "detail": "simulated",
            "host": self.host,
            "buttons": [button(kind.name.replace("_", " "), kind.name) for kind in simple],
            "notes": {kind.name: kind.summary for kind in simple},
            "chain": None,
        }

    def _live(self) -> Live:
        rows: list[Row] = [
            (name, _text(value), "") for name, value in self._device.status().items()
        ]
        faults = self._faults.kinds
        return {
            "gauges": self._gauges(),
            "sections": {"State": rows, "Simulator": [fault_row(faults)]},
            "faults": faults,
        }


def _text(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(map(_text, value))
    return f"{value:.6g}" if isinstance(value, float) else f"{value}"

"""A relay between a driver and its device, which loses the link without root: one way, both, or closed.

``python -m crtk_drivers.labs.bench.relay`` takes a `DeviceLink`, and a folder for the names of serial lines,
as JSON in a line of its standard input, and answers with where it listens; then it takes a `Mode` a line, and
answers each when that holds. It ends with its input. It listens at a loopback address of its own, at the
ports of the device; where that takes a right that it has not, at others. Serial lines are pseudo terminals,
and a CAN bus is a port for socketcand.
"""

from __future__ import annotations

import contextlib
import json
import os
import selectors
import socket
import struct
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Final

from crtk_drivers.errors import ConnectionFailed, DeviceError
from crtk_drivers.labs.bench import programs
from crtk_drivers.plugins import DeviceLink

if TYPE_CHECKING:
    from crtk_drivers.labs.bench.can_relay import CanLine
    from crtk_drivers.labs.bench.serial_relay import SerialLine

CHUNK: Final = 65536

CATCHING_UP: Final = 0.1
"""Seconds for what came before a change, at most."""
CONNECT_TIMEOUT: Final = 2.0
"""Seconds for a connection to the device."""

ANSWER_TIMEOUT: Final = 10.0

ADDRESSES: Final = 200
"""Loopback addresses that are tried."""

UNPRIVILEGED: Final = 20000
"""Added to a port that may not be opened."""

RESET: Final = struct.pack("ii", 1, 0)
"""SO_LINGER: closing sends RST."""


class Mode(StrEnum):
    """What passes."""

    OPEN = "open"
    DEAF = "deaf"
    """Nothing from the driver reaches the device; what the device tells passes."""
    SILENT = "silent"
    """Nothing passes, and nobody is told: a cable that is unplugged at a switch."""
    CLOSED = "closed"
    """Connections are reset, and new ones refused; serial lines and buses hang up, and are not there."""


@dataclass(eq=False)
class _End:
    """One end of a connection through the relay, or a socket for datagrams.

    Attributes:
        own: its socket.
        inward: what comes from it goes to the device.
        peer: where that goes.
        waiting: bytes that it must still be sent.
    """

    own: socket.socket
    inward: bool
    peer: _End | None = None
    waiting: bytearray = field(default_factory=bytearray)
    ended: bool = False


class _Relay:
    """For one thread.

    Args:
        link: of the device.
        folder: for the names of serial lines.

    Attributes:
        host, tcp: where it listens, ports by name, those of CAN buses among them.
        serial: names of its ends of serial lines and rates, by name.

    Raises:
        OSError: it cannot listen.
        ConnectionFailed: a serial port, or a CAN adapter, cannot be opened.
    """

    def __init__(self, link: DeviceLink, folder: Path) -> None:
        self._link = link
        self._mode = Mode.OPEN
        self._selector = selectors.DefaultSelector()
        self.tcp = dict(link.tcp)
        self._listeners: dict[str, socket.socket] = {}
        self._datagrams: list[socket.socket] = []
        self._ends: list[_End] = []
        self._clients: dict[tuple[int, tuple[str, int]], socket.socket] = {}
        self._input = b""
        self._lines: list[SerialLine | CanLine] = []
        self.serial: dict[str, tuple[str, int]] = {}
        for name, (port, baud) in link.serial.items():
            from crtk_drivers.labs.bench.serial_relay import SerialLine  # needs pyserial

            own = folder / name
            self._lines.append(SerialLine(port, baud, own, self._selector, self._passes))
            self.serial[name] = str(own), baud
        self.host = self._bind()
        for name, bus in link.can.items():
            from crtk_drivers.labs.bench.can_relay import CanLine  # needs python-can

            door = CanLine(bus, self.host, self._selector, self._passes)
            self._lines.append(door)
            self.tcp[name] = door.port

    def serve(self) -> None:
        """Pass on until the input ends."""
        os.set_blocking(sys.stdin.fileno(), False)
        self._selector.register(sys.stdin.fileno(), selectors.EVENT_READ, self._command)
        while sys.stdin.fileno() in self._selector.get_map():
            for key, events in self._selector.select():
                if key.fd in self._selector.get_map():
                    key.data(events)

    # ----------------------------------------------------------------------------------- the door

    def _command(self, _: int) -> None:
        data = os.read(sys.stdin.fileno(), CHUNK)
        if not data:
            self._selector.unregister(sys.stdin.fileno())
            return
        *lines, self._input = (self._input + data).split(b"\n")
        for line in lines:
            self._treat_what_came()
            try:
                self._set(Mode(line.decode()))
            except ConnectionFailed as error:
                _answer({"error": f"the device is gone: {error.statement}", "remedy": error.remedy})
            else:
                _answer({"mode": self._mode})

    def _treat_what_came(self) -> None:
        """Pass on, or lose, what came before a change: a busy machine may not have come to it."""
        end = time.monotonic() + CATCHING_UP
        while time.monotonic() < end:
            found = self._selector.select(0.0)
            ready = [(key, events) for key, events in found if key.fd != sys.stdin.fileno()]
            if not ready:
                return
            for key, events in ready:
                if key.fd in self._selector.get_map():
                    key.data(events)

    def _set(self, mode: Mode) -> None:
        before, self._mode = self._mode, mode
        if mode is Mode.CLOSED:
            for listener in self._listeners.values():
                self._close(listener)
            self._listeners.clear()
            for end in list(self._ends):
                self._reset(end)
            for line in self._lines:
                line.close()
        elif before is Mode.CLOSED:
            self._listen(self.host)
            for line in self._lines:
                line.open()
        for listener in self._listeners.values():  # where nothing passes, they wait in its queue
            self._accept_at(listener, mode is Mode.OPEN)
        for end in self._ends:
            self._look(end)

    # ----------------------------------------------------------------------------------- listening

    def _bind(self) -> str:
        """Listen at a loopback address where all ports are free, and return it."""
        error: OSError | None = None
        for number in range(ADDRESSES):
            host = f"127.66.{1 + os.getpid() % 250}.{1 + number}"
            try:
                self._listen(host)
                self._bind_datagrams(host)
            except OSError as found:
                error = found
                for one in (*self._listeners.values(), *self._datagrams):
                    self._close(one)
                self._listeners.clear()
                self._datagrams.clear()
                continue
            return host
        assert error is not None
        raise error

    def _listen(self, host: str) -> None:
        for name in self._link.tcp:
            try:
                listener = socket.create_server((host, self.tcp[name]))
            except PermissionError:
                self.tcp[name] += UNPRIVILEGED
                listener = socket.create_server((host, self.tcp[name]))
            listener.setblocking(False)
            self._listeners[name] = listener
            self._accept_at(listener, True)

    def _accept_at(self, listener: socket.socket, accepts: bool) -> None:
        is_known = listener.fileno() in self._selector.get_map()
        if accepts and not is_known:
            name = next(name for name, own in self._listeners.items() if own is listener)
            self._selector.register(listener, selectors.EVENT_READ, self._accepting(name))
        elif is_known and not accepts:
            self._selector.unregister(listener)

    def _bind_datagrams(self, host: str) -> None:
        for port in self._link.udp.values():
            near = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self._datagrams.append(near)
            near.bind((host, port))
            near.setblocking(False)
            self._selector.register(near, selectors.EVENT_READ, self._from_driver(near, port))

    def _accepting(self, name: str) -> Callable[[int], None]:
        def accept(_: int) -> None:
            near, _address = self._listeners[name].accept()
            try:
                device = (self._link.host, self._link.tcp[name])
                far = socket.create_connection(device, CONNECT_TIMEOUT)
            except OSError:
                near.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)
                near.close()
                return
            ends = (_End(near, inward=True), _End(far, inward=False))
            for end, peer in zip(ends, reversed(ends), strict=True):
                end.own.setblocking(False)
                end.own.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                end.peer = peer
                self._ends.append(end)
            for end in ends:
                self._look(end)

        return accept

    # ----------------------------------------------------------------------------------- streams

    def _passes(self, inward: bool) -> bool:
        return self._mode is Mode.OPEN or (self._mode is Mode.DEAF and not inward)

    def _look(self, end: _End) -> None:
        """Look for what can be done with an end: what is paused stays in the kernel's buffers."""
        assert end.peer is not None
        events = 0
        if self._passes(end.inward) and not end.peer.waiting and not end.ended:
            events |= selectors.EVENT_READ
        if end.waiting and self._passes(not end.inward):
            events |= selectors.EVENT_WRITE
        is_known = end.own.fileno() in self._selector.get_map()
        if not events and is_known:
            self._selector.unregister(end.own)
        elif events:
            register = self._selector.modify if is_known else self._selector.register
            register(end.own, events, lambda found: self._move(end, found))

    def _move(self, end: _End, events: int) -> None:
        assert end.peer is not None
        try:
            if events & selectors.EVENT_WRITE:
                self._send(end)
            if events & selectors.EVENT_READ:
                data = end.own.recv(CHUNK)
                end.ended = not data
                end.peer.waiting += data
                self._send(end.peer)
        except BlockingIOError:
            pass
        except OSError:
            self._reset(end)
            return
        for one in (end, end.peer):
            self._look(one)
        if end.ended and not end.peer.waiting:
            with contextlib.suppress(OSError):
                end.peer.own.shutdown(socket.SHUT_WR)
            if end.peer.ended:
                self._drop(end)

    def _send(self, end: _End) -> None:
        with contextlib.suppress(BlockingIOError):
            while end.waiting:
                del end.waiting[: end.own.send(end.waiting)]

    def _reset(self, end: _End) -> None:
        """Close a connection by RST, on both sides."""
        for one in (end, end.peer):
            assert one is not None
            with contextlib.suppress(OSError):
                one.own.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)
        self._drop(end)

    def _drop(self, end: _End) -> None:
        for one in (end, end.peer):
            assert one is not None
            self._close(one.own)
            if one in self._ends:
                self._ends.remove(one)

    def _close(self, own: socket.socket) -> None:
        with contextlib.suppress(KeyError, ValueError):
            self._selector.unregister(own)
        own.close()

    # ----------------------------------------------------------------------------------- datagrams

    def _from_driver(self, near: socket.socket, port: int) -> Callable[[int], None]:
        def pass_on(_: int) -> None:
            with contextlib.suppress(OSError):  # as a network does
                data, address = near.recvfrom(CHUNK)
                if self._passes(inward=True):
                    self._client(near, port, address).send(data)

        return pass_on

    def _client(self, near: socket.socket, port: int, address: tuple[str, int]) -> socket.socket:
        """Return the socket that has the device's answers to one client."""
        found = self._clients.get((port, address))
        if found is None:
            found = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            found.connect((self._link.host, port))
            found.setblocking(False)
            self._clients[port, address] = found
            far = found

            def pass_on(_: int) -> None:
                with contextlib.suppress(OSError):
                    data = far.recv(CHUNK)
                    if self._passes(inward=False):
                        near.sendto(data, address)

            self._selector.register(found, selectors.EVENT_READ, pass_on)
        return found


class RelayProcess:
    """A relay in a process of its own. A context manager.

    Args:
        link: of the device.

    Raises:
        ConnectionFailed: it cannot listen.
    """

    def __init__(self, link: DeviceLink) -> None:
        self._names = TemporaryDirectory(prefix="crtk-relay-")
        self._process = programs.start(__name__, answers=True)
        self._mode = Mode.OPEN
        try:
            answer = self._ask(json.dumps({"link": asdict(link), "folder": self._names.name}))
        except DeviceError:
            self.close()
            raise
        serial = {name: (port, baud) for name, (port, baud) in answer["serial"].items()}
        self.link = DeviceLink(answer["host"], answer["tcp"], link.udp, serial)

    @property
    def mode(self) -> Mode:
        """What passes."""
        return self._mode

    @mode.setter
    def mode(self, mode: Mode) -> None:
        self._ask(mode)
        self._mode = mode

    def close(self) -> None:
        """End it: connections through it are closed. May be called twice."""
        # It closes pipes, and waits: one that died before has left something unread.
        with contextlib.suppress(BrokenPipeError), self._process:
            self._process.kill()
        self._names.cleanup()

    def __enter__(self) -> RelayProcess:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _ask(self, line: str) -> Mapping[str, Any]:
        """Send a line, and return the answer.

        Raises:
            ConnectionFailed: the answer is that it cannot.
            DeviceError: there is none.
        """
        process = self._process
        assert process.stdin is not None
        assert process.stdout is not None
        with contextlib.suppress(BrokenPipeError), selectors.DefaultSelector() as selector:
            process.stdin.write(f"{line}\n".encode())
            process.stdin.flush()
            selector.register(process.stdout, selectors.EVENT_READ)
            if selector.select(ANSWER_TIMEOUT):
                answer = process.stdout.readline()
                if answer:
                    found: Mapping[str, Any] = json.loads(answer)
                    if "error" in found:
                        raise ConnectionFailed(
                            found["error"], where="relay", remedy=found["remedy"]
                        )
                    return found
        raise DeviceError("does not answer", where="relay")


def _answer(values: Mapping[str, Any]) -> None:
    sys.stdout.write(json.dumps(values) + "\n")
    sys.stdout.flush()


def main() -> int:
    """Relay the link that comes on standard input; return the exit code."""
    order = json.loads(_first_line())
    link = DeviceLink(**order["link"])
    try:
        relay = _Relay(link, Path(order["folder"]))
    except ConnectionFailed as error:
        _answer(
            {"error": f"a relay cannot open the device: {error.statement}", "remedy": error.remedy}
        )
        return 1
    except OSError as error:
        _answer(
            {
                "error": f"a relay cannot listen at the ports of {link.host}: {error.strerror}",
                "remedy": "See which program has them on every address of this machine: ss -lptun.",
            }
        )
        return 1
    _answer({"host": relay.host, "tcp": relay.tcp, "serial": relay.serial})
    relay.serve()
    return 0


def _first_line() -> bytes:
    """Return a line of standard input, and read no byte beyond it."""
    return b"".join(_bytes_of_line())


def _bytes_of_line() -> Iterator[bytes]:
    while (byte := os.read(sys.stdin.fileno(), 1)) not in (b"", b"\n"):
        yield byte


if __name__ == "__main__":
    sys.exit(main())

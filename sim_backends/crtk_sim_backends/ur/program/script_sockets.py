"""The socket functions of URScript: the program on the robot is the client and connects out.

Source: URScript manual, module "interfaces". Nothing here waits: a function that may have to is a
generator that is resumed once a control period. Connections leave from the address of the simulated
robot, so that a peer can tell robots apart, and are closed when the program ends.
"""

from __future__ import annotations

import errno
import math
import re
import select
import socket
import struct
from collections.abc import Callable, Generator, Iterable
from typing import TYPE_CHECKING, Any, Final, TypeAlias, TypeVar

from crtk_sim_backends.ur.urscript.errors import ScriptRuntimeError
from crtk_sim_backends.ur.urscript.values import Builtin, List, from_bytes, to_bytes, to_text

if TYPE_CHECKING:
    from crtk_sim_backends.ur.clock import Clock

CONNECT_TIMEOUT: Final = 2.0  # s, of controller time
READ_TIMEOUT: Final = 2.0
_LIMIT: Final = 1 << 20  # bytes that a socket keeps in either direction
_SOCKETS: Final = 32  # open at a time
_COUNT: Final = 1024  # numbers that one call reads
_DEFAULT: Final = "socket_0"

T = TypeVar("T")
Steps: TypeAlias = Generator[None, None, T]
_Parser: TypeAlias = Callable[[bytearray], tuple[int, T] | None]


class _Socket:
    """One connected socket with what was read ahead and what the peer has not taken.

    Attributes:
        received: what was read ahead.
        read_tick: control period in which the program read from it last.
    """

    def __init__(self, sock: socket.socket) -> None:
        self._socket = sock
        self._unsent = bytearray()
        self.received = bytearray()
        self.open = True
        self.read_tick = -1

    def send(self, data: bytes) -> bool:
        self._unsent += data
        self.flush()
        if len(self._unsent) > _LIMIT:
            self.open = False
        return self.open

    def flush(self) -> None:
        if self._unsent and self.open:
            try:
                del self._unsent[: self._socket.send(self._unsent)]
            except BlockingIOError:
                pass
            except OSError:
                self.open = False

    def receive(self) -> None:
        while self.open and len(self.received) < _LIMIT:
            try:
                data = self._socket.recv(65536)
            except BlockingIOError:
                return
            except OSError:
                data = b""
            if not data:
                self.open = False
            self.received += data

    def close(self) -> None:
        self.flush()
        self.open = False
        self._socket.close()


class ScriptSockets:
    """The sockets of the running program.

    Args:
        host: address of the robot, from which the connections leave.
        own_ports: ports of the robot itself: its programs find them at 127.0.0.1 as well.
    """

    def __init__(self, host: str, own_ports: Iterable[int] = ()) -> None:
        self._host = host
        self._own_ports = frozenset(own_ports)
        self._sockets: dict[str, _Socket] = {}
        self._clock: Clock | None = None

    def builtins(self, clock: Clock) -> Iterable[Builtin]:
        """Give the built-ins for one controller; `clock` is the time that they use."""
        self._clock = clock
        waiting = (
            self.socket_open,
            self.socket_get_var,
            self.socket_read_ascii_float,
            self.socket_read_binary_integer,
            self.socket_read_byte_list,
            self.socket_read_line,
            self.socket_read_string,
        )
        instant = (
            self.socket_close,
            self.socket_send_byte,
            self.socket_send_int,
            self.socket_send_line,
            self.socket_send_string,
            self.socket_set_var,
        )
        yield from (Builtin(call.__name__, call, blocking=True) for call in waiting)
        yield from (Builtin(call.__name__, call) for call in instant)

    @property
    def open(self) -> bool:
        """Whether there is any."""
        return bool(self._sockets)

    def flush(self) -> None:
        """Send on what peers did not take at once."""
        for sock in self._sockets.values():
            sock.flush()

    def close_all(self) -> None:
        """Close every socket: the program has ended."""
        for sock in self._sockets.values():
            sock.close()
        self._sockets.clear()

    def socket_open(self, address: str, port: int, socket_name: str = _DEFAULT) -> Steps[bool]:
        """Connect to an IPv4 address or localhost; True when that succeeded within the timeout."""
        self.socket_close(socket_name)
        if len(self._sockets) >= _SOCKETS:
            raise ScriptRuntimeError(f"socket_open: more than {_SOCKETS} sockets")
        if not 0 < port < 65536:
            raise ScriptRuntimeError(f"socket_open: no port {port}")
        sock = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            address = "127.0.0.1" if address == "localhost" else address
            if address == "127.0.0.1" and port in self._own_ports:
                address = self._host
            socket.inet_aton(address)  # no name server: its answer would be waited for
            sock.setblocking(False)
            sock.bind((self._host, 0))
            started = sock.connect_ex((address, int(port)))
            deadline = self._time() + CONNECT_TIMEOUT
            pending = started == errno.EINPROGRESS
            while pending and self._time() < deadline:
                yield
                pending = not select.select([], [sock], [], 0)[1]
            failed = pending or started not in (0, errno.EINPROGRESS)
            if failed or sock.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
                sock.close()
                yield
                return False
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        except OSError:
            sock.close()
            yield
            return False
        except GeneratorExit:
            sock.close()
            raise
        self._sockets[socket_name] = _Socket(sock)
        return True

    def socket_close(self, socket_name: str = _DEFAULT) -> None:
        """Close the socket; nothing happens when it is not open."""
        sock = self._sockets.pop(socket_name, None)
        if sock is not None:
            sock.close()

    def socket_send_byte(self, value: int, socket_name: str = _DEFAULT) -> bool:
        """Send one byte."""
        return self._send(bytes([int(value) & 0xFF]), socket_name)

    def socket_send_int(self, value: int, socket_name: str = _DEFAULT) -> bool:
        """Send a 32-bit integer in network byte order."""
        return self._send(struct.pack(">I", int(value) & 0xFFFFFFFF), socket_name)

    def socket_send_string(self, str: Any, socket_name: str = _DEFAULT) -> bool:
        """Send text, or any value as text."""
        return self._send(to_bytes(to_text(str)), socket_name)

    def socket_send_line(self, str: Any, socket_name: str = _DEFAULT) -> bool:
        """Send text and a line end."""
        return self._send(to_bytes(to_text(str)) + b"\n", socket_name)

    def socket_set_var(self, name: str, value: Any, socket_name: str = _DEFAULT) -> bool:
        """Send ``SET name value``."""
        return self._send(to_bytes(f"SET {name} {int(value)}\n"), socket_name)

    def socket_get_var(self, name: str, socket_name: str = _DEFAULT) -> Steps[int]:
        """Ask ``GET name`` and read the answer ``name value``; 0 when there is none."""
        self._send(to_bytes(f"GET {name}\n"), socket_name)
        line = yield from self._read(_line, socket_name, READ_TIMEOUT)
        match = re.fullmatch(rf"\s*{re.escape(name)}\s+(-?\d+)\s*", line or "")
        return int(match[1]) if match else 0

    def socket_read_binary_integer(
        self, number: int, socket_name: str = _DEFAULT, timeout: float = READ_TIMEOUT
    ) -> Steps[List]:
        """Read 32-bit integers: ``[count, value, ...]``, or ``[0, -1, ...]`` on failure."""
        count = _count(number)

        def parse(data: bytearray) -> tuple[int, tuple[int, ...]] | None:
            size = 4 * count
            return (size, struct.unpack_from(f">{count}i", data)) if len(data) >= size else None

        values = yield from self._read(parse, socket_name, timeout)
        return List([0, *[-1] * count] if values is None else [count, *values])

    def socket_read_byte_list(
        self, number: int, socket_name: str = _DEFAULT, timeout: float = READ_TIMEOUT
    ) -> Steps[List]:
        """Read bytes: ``[count, value, ...]``, with what has come and -1 for the rest on failure."""
        count = _count(number)

        def parse(data: bytearray) -> tuple[int, bytes] | None:
            return (count, bytes(data[:count])) if len(data) >= count else None

        values = yield from self._read(parse, socket_name, timeout)
        if values is None:
            sock = self._sockets.get(socket_name)
            values = b"" if sock is None else bytes(sock.received)
            if sock is not None:
                sock.received.clear()
        return List([len(values), *values, *[-1] * (count - len(values))])

    def socket_read_ascii_float(
        self, number: int, socket_name: str = _DEFAULT, timeout: float = READ_TIMEOUT
    ) -> Steps[List]:
        """Read ``(v1, v2, ...)``: ``[count, value, ...]``, or ``[0, nan, ...]`` on failure."""
        count = _count(number)
        text = yield from self._read(_parenthesis, socket_name, timeout)
        try:
            values = [float(item) for item in (text or "").split(",")]
        except ValueError:
            values = []
        if len(values) != count:
            return List([0, *[math.nan] * count])
        return List([count, *values])

    def socket_read_line(
        self, socket_name: str = _DEFAULT, timeout: float = READ_TIMEOUT
    ) -> Steps[str]:
        """Read up to a line end, which is left out; "" on failure."""
        return (yield from self._read(_line, socket_name, timeout)) or ""

    def socket_read_string(
        self,
        socket_name: str = _DEFAULT,
        prefix: str = "",
        suffix: str = "",
        interpret_escape: bool = False,
        timeout: float = READ_TIMEOUT,
    ) -> Steps[str]:
        """Read what has come, or what lies between `prefix` and `suffix`; "" on failure."""
        if interpret_escape:
            prefix, suffix = _unescape(prefix), _unescape(suffix)
        before, after = to_bytes(prefix), to_bytes(suffix)

        def parse(data: bytearray) -> tuple[int, str] | None:
            start = data.find(before)
            end = data.find(after, start + len(before)) if after else len(data)
            if not data or start < 0 or end < 0:
                return None
            return end + len(after), from_bytes(bytes(data[start + len(before) : end]))

        return (yield from self._read(parse, socket_name, timeout)) or ""

    def _time(self) -> float:
        return self._clock.time if self._clock is not None else 0.0

    def _tick(self) -> int:
        return self._clock.ticks if self._clock is not None else 0

    def _send(self, data: bytes, socket_name: str) -> bool:
        sock = self._sockets.get(socket_name)
        return sock is not None and sock.send(data)

    def _read(self, parse: _Parser[T], socket_name: str, timeout: float) -> Steps[T | None]:
        """Read until `parse` finds something; None after `timeout` (never when it is <= 0).

        A read takes time: from one socket one succeeds in a control period, so that who sends faster
        than the program reads fills the buffers and does not keep the program busy without an end.
        """
        deadline = self._time() + timeout if timeout > 0 else math.inf
        while True:
            sock = self._sockets.get(socket_name)
            if sock is None:
                break
            if sock.read_tick == self._tick():
                yield
                continue
            sock.receive()
            found = parse(sock.received)
            if found is not None:
                size, value = found
                del sock.received[:size]
                sock.read_tick = self._tick()
                return value
            if not sock.open or self._time() >= deadline:
                break
            yield
        yield
        return None


def _count(number: Any) -> int:
    if not 0 <= number <= _COUNT:
        raise ScriptRuntimeError(f"Value out of range: {number} numbers to read from a socket")
    return int(number)


def _line(data: bytearray) -> tuple[int, str] | None:
    end = data.find(b"\n")
    if end < 0:
        return None
    return end + 1, from_bytes(bytes(data[:end]).rstrip(b"\r"))


def _parenthesis(data: bytearray) -> tuple[int, str] | None:
    start = data.find(b"(")
    end = data.find(b")", start)
    if start < 0 or end < 0:
        return None
    return end + 1, data[start + 1 : end].decode("ascii", "replace")


def _unescape(text: str) -> str:
    escapes = {"n": "\n", "r": "\r", "t": "\t", "0": "\0"}
    return re.sub(r"\\(.)", lambda match: escapes.get(match[1], match[1]), text)

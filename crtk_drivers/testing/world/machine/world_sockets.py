"""`_socket.socket` of a world: what Python's own `socket.socket` stands on."""

from __future__ import annotations

import _socket as constants
import array
import errno
import functools
import os
import struct
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final, TypeVar

from typing_extensions import Buffer

from crtk_drivers.testing.world.machine import files
from crtk_drivers.testing.world.machine.endpoints import Endpoint, Passed, drop
from crtk_drivers.testing.world.machine.files import READ, WRITE, fail
from crtk_drivers.testing.world.machine.kernel import NS, NotSimulated, here
from crtk_drivers.testing.world.machine.network import Address

_KIND_MASK: Final = 0xF
_SO_TIMESTAMP: Final = 29
_SO_TIMESTAMPNS: Final = 35
_TIME: Final = struct.Struct("@ll")
_BUFFERS: Final = (constants.SO_SNDBUF, constants.SO_RCVBUF)
_BUFFER_SIZE: Final = 212_992
"""What Linux says of SO_SNDBUF and SO_RCVBUF if nobody has set them."""

Found = TypeVar("Found")


class _Default:
    timeout: float | None = None


class Socket:
    """As `_socket.socket`."""

    __slots__ = ("_descriptor", "_end", "_timeout", "proto")  # Python's own adds what else it needs

    def __init__(
        self, family: int = -1, type: int = -1, proto: int = -1, fileno: int | None = None
    ) -> None:
        if fileno is None:
            family = constants.AF_INET if family == -1 else int(family)
            kind = constants.SOCK_STREAM if type == -1 else int(type)
            self._end = Endpoint(family, kind & _KIND_MASK)
            self._descriptor = files.add(self._end)
        else:
            found = files.find(fileno)
            if not isinstance(found, Endpoint):
                fail(errno.ENOTSOCK)
            self._end = found
            self._descriptor = fileno
        self.proto = proto if proto > 0 else 0
        self._timeout = _Default.timeout

    @property
    def family(self) -> int:
        """AF_INET or AF_UNIX."""
        return self._end.family

    @property
    def type(self) -> int:
        """SOCK_STREAM, SOCK_DGRAM or SOCK_SEQPACKET."""
        return self._end.kind

    @property
    def timeout(self) -> float | None:
        """s; None for ever."""
        return self._timeout

    def fileno(self) -> int:
        """Return its descriptor; -1 once it is closed."""
        return self._descriptor

    def settimeout(self, value: float | None) -> None:
        """Wait so long in each call."""
        if value is not None and value < 0:
            raise ValueError("Timeout value out of range")
        self._open().blocking = value is None
        self._timeout = value

    def gettimeout(self) -> float | None:
        """Return how long each call waits."""
        return self._timeout

    def setblocking(self, flag: bool) -> None:
        """Wait in each call, or never."""
        self.settimeout(None if flag else 0.0)

    def getblocking(self) -> bool:
        """Return whether calls wait."""
        return self._timeout != 0.0

    def setsockopt(self, level: int, name: int, value: Any, length: int | None = None) -> None:
        """Keep an option; SO_REUSEADDR and SO_LINGER change what happens.

        Raises:
            OSError: this system does not have it (ENOPROTOOPT): it stamps what arrives to microseconds only.
        """
        end = self._open()
        if (level, name) == (constants.SOL_SOCKET, _SO_TIMESTAMPNS):
            fail(errno.ENOPROTOOPT)
        if level == constants.SOL_SOCKET and name in _BUFFERS:
            value *= 2  # as Linux does
        end.options[level, name] = bytes(value) if isinstance(value, Buffer) else value

    def getsockopt(self, level: int, name: int, size: int = 0) -> Any:
        """Return an option, or the error that is due."""
        end = self._open()
        if level == constants.SOL_SOCKET:
            if name == constants.SO_ERROR:
                return end.take_error()
            fixed = {
                constants.SO_TYPE: end.kind,
                constants.SO_DOMAIN: end.family,
                constants.SO_PROTOCOL: self.proto,
                constants.SO_ACCEPTCONN: int(end.is_listening),
            }
            if name in fixed:
                return fixed[name]
        default = _BUFFER_SIZE if level == constants.SOL_SOCKET and name in _BUFFERS else 0
        value = end.options.get((level, name), default)
        if not size:
            return struct.unpack("i", value[:4])[0] if isinstance(value, bytes) else int(value)
        if not isinstance(value, bytes):
            raise NotSimulated(f"getsockopt({level}, {name}, {size})")
        return value[:size]

    def getsockname(self) -> Address:
        """Return its own address."""
        return self._open().name

    def getpeername(self) -> Address:
        """Return the other side's address."""
        end = self._open()
        if end.peer_name is None or (end.is_tcp and not end.is_connected):
            fail(errno.ENOTCONN)
        return end.peer_name

    def _open(self) -> Endpoint:
        if self._descriptor < 0:
            fail(errno.EBADF)
        return self._end

    def _repeat(self, attempt: Callable[[], Found | None], events: int, flags: int = 0) -> Found:
        """Return what `attempt` does as soon as that is not None, within the timeout.

        With a timeout, Python waits first and then calls the system: it finds a socket closed that another
        thread has closed meanwhile. Without one, the system call goes on.
        """
        end = self._open()
        here().preempt()
        deadline = here().deadline(self._timeout)
        while (found := attempt()) is None:
            if self._timeout == 0.0 or flags & constants.MSG_DONTWAIT:
                fail(errno.EAGAIN)
            if deadline is None:
                return end.repeat(attempt, events)
            left = (deadline - here().now) / 1e9
            if left <= 0.0:
                raise TimeoutError("timed out")
            end.await_events(events, left)
            self._open()
        return found

    # Addresses

    def bind(self, address: Address) -> None:
        """Have an address."""
        end = self._open()
        here().preempt()
        end.bind(self._plain(address, "bind"))

    def listen(self, backlog: int = 128) -> None:
        """Accept connections from now on."""
        self._open().listen(backlog)

    def _accept(self) -> tuple[int, Address]:
        found = self._repeat(self._open().accept, READ)
        return files.add(found), found.peer_name

    def connect_ex(self, address: Address) -> int:
        """Connect; return the number of the error."""
        try:
            return self._connect(self._plain(address, "connect"))
        except TimeoutError as error:
            if error.errno is None:
                return errno.EAGAIN
            raise

    def _connect(self, address: Address) -> int:
        end = self._open()
        here().preempt()
        waits = self._timeout is None
        try:
            code = end.connect(address, waits=waits)
        except OSError as error:
            code = error.errno or 0
        if code != errno.EINPROGRESS or self._timeout == 0.0:
            return code
        end.await_events(READ | WRITE, self._timeout)
        code = end.take_error()
        if waits:
            end.give_up()
        return code

    def connect(self, address: Address) -> None:
        """Connect."""
        if code := self._connect(self._plain(address, "connect")):
            fail(code)

    def _plain(self, address: Address, call: str) -> Address:
        """Return an address as it is bound: a host in numbers, a text for a path, bytes for an abstract name.

        Raises:
            TypeError: it is no address of this family.
            OverflowError: its port is no port.
        """
        if self._end.family == constants.AF_INET:
            if not isinstance(address, tuple) or len(address) != 2:
                raise TypeError(f"{call}(): AF_INET address must be tuple of two")
            host, port = address
            if not 0 <= port <= 65_535:
                raise OverflowError(f"{call}(): port must be 0-65535.")
            return resolved(host), port
        name = os.fsencode(address) if isinstance(address, str | os.PathLike) else bytes(address)
        return name if name[:1] == b"\0" else os.fsdecode(name)

    # Sending

    def send(self, data: Buffer, flags: int = 0) -> int:
        """Send what there is room for."""
        return self._send(data, None, flags, [])

    def sendall(self, data: Buffer, flags: int = 0) -> None:
        """Send all of it; the timeout counts for all."""
        deadline = here().deadline(self._timeout)
        rest = memoryview(data).cast("B")
        while rest:
            rest = rest[self.send(rest, flags) :]
            if rest and deadline is not None and here().now >= deadline:
                raise TimeoutError("timed out")

    def sendto(self, data: Buffer, *rest: Any) -> int:
        """Send to an address."""
        flags, address = (0, *rest) if len(rest) == 1 else rest
        if self._open().is_tcp:
            return self._send(data, None, flags, [])  # as Linux: the address counts for nothing
        return self._send(data, self._plain(address, "sendto"), flags, [])

    def sendmsg(
        self,
        buffers: Iterable[Buffer],
        ancdata: Iterable[tuple[int, int, Any]] = (),
        flags: int = 0,
        address: Address = None,
    ) -> int:
        """Send several pieces as one, and descriptors with them."""
        passed: Passed = []
        for level, kind, data in ancdata:
            if (level, kind) != (constants.SOL_SOCKET, constants.SCM_RIGHTS):
                raise NotSimulated(f"ancillary data ({level}, {kind})")
            passed += [
                files.find(number) if files.is_ours(number) else os.dup(number)
                for number in array.array("i", bytes(data))
            ]
        where = None if address is None else self._plain(address, "sendmsg")
        return self._send(b"".join(bytes(each) for each in buffers), where, flags, passed)

    def _send(self, data: Buffer, address: Address, flags: int, passed: Passed) -> int:
        if isinstance(data, str):
            raise TypeError("a bytes-like object is required, not 'str'")
        end = self._open()
        return self._repeat(lambda: end.send(data, address, passed), WRITE, flags)

    # Receiving

    def _receive(self, most: int, flags: int) -> tuple[bytes, Passed, Address]:
        """Return a packet as a whole, or what has arrived of a stream, up to `most` bytes.

        Raises:
            NotSimulated: MSG_WAITALL, of a call that waits.
        """
        if most < 0:
            raise ValueError("negative buffersize in recv")
        end, peek = self._open(), bool(flags & constants.MSG_PEEK)
        if not most and not end.keeps_packets:
            return b"", [], None
        found = self._repeat(lambda: end.take(most, peek=peek), READ, flags)
        if flags & constants.MSG_WAITALL and self._timeout is None and not end.keeps_packets:
            if peek:
                raise NotSimulated("MSG_WAITALL with MSG_PEEK")
            data, passed, sender = found
            while left := most - len(data):
                more, others, _ = end.repeat(functools.partial(end.take, left, peek=False), READ)
                if not more:
                    break
                data, passed = data + more, passed + others
            return data, passed, sender
        return found

    def recv(self, most: int, flags: int = 0) -> bytes:
        """Return what has arrived."""
        return self.recvfrom(most, flags)[0]

    def recvfrom(self, most: int, flags: int = 0) -> tuple[bytes, Address]:
        """Return what has arrived, and from whom."""
        data, passed, sender = self._receive(most, flags)
        drop(passed)
        return data[:most], sender

    def recv_into(self, buffer: Any, most: int = 0, flags: int = 0) -> int:
        """Read into a buffer."""
        return self.recvfrom_into(buffer, most, flags)[0]

    def recvfrom_into(self, buffer: Any, most: int = 0, flags: int = 0) -> tuple[int, Address]:
        """Read into a buffer, and return from whom it came."""
        room = memoryview(buffer).cast("B")
        if most > len(room):
            raise ValueError("buffer too small for requested bytes")
        data, passed, sender = self._receive(most or len(room), flags)
        drop(passed)
        kept = data[: most or len(room)]
        room[: len(kept)] = kept
        return (len(data) if flags & constants.MSG_TRUNC else len(kept)), sender

    def recvmsg(
        self, most: int, ancillary: int = 0, flags: int = 0
    ) -> tuple[bytes, list[tuple[int, int, bytes]], int, Address]:
        """Return what has arrived, and the descriptors that came with it, or when a datagram did."""
        data, passed, sender = self._receive(most, flags)
        told = constants.MSG_TRUNC if len(data) > most else 0
        room = max(0, ancillary - constants.CMSG_LEN(0)) // array.array("i").itemsize
        if len(passed) > room:
            told |= constants.MSG_CTRUNC
            drop(passed[room:])
        numbers = array.array("i", [_number(each) for each in passed[:room]])
        rights = (
            [(int(constants.SOL_SOCKET), int(constants.SCM_RIGHTS), numbers.tobytes())]
            if numbers
            else []
        )
        end = self._open()
        if end.arrived and end.options.get((constants.SOL_SOCKET, _SO_TIMESTAMP)):
            if ancillary < constants.CMSG_LEN(_TIME.size):
                told |= constants.MSG_CTRUNC
            else:
                stamp = _TIME.pack(end.arrived // NS, end.arrived % NS // 1000)
                rights.append((int(constants.SOL_SOCKET), _SO_TIMESTAMP, stamp))
        return data[:most], rights, told, sender

    def recvmsg_into(self, buffers: Sequence[Any], *rest: int) -> Any:
        """Refuse: nothing here needs it."""
        raise NotSimulated("recvmsg_into")

    # The end

    def shutdown(self, how: int) -> None:
        """End one direction or both."""
        here().preempt()
        self._open().shutdown(how)

    def close(self) -> None:
        """Close it; safe to repeat."""
        descriptor, self._descriptor = self._descriptor, -1
        if descriptor >= 0:
            files.close(descriptor)

    def detach(self) -> int:
        """Let go of the descriptor, which stays open."""
        descriptor, self._descriptor = self._descriptor, -1
        return descriptor


def _number(passed: int | files.OpenFile) -> int:
    """Return the descriptor of something that was on its way."""
    if isinstance(passed, int):
        return passed
    number = files.add(passed)
    passed.drop()
    return number


def socketpair(family: int = -1, type: int = -1, proto: int = 0) -> tuple[Socket, Socket]:
    """As `_socket.socketpair`."""
    family = constants.AF_UNIX if family == -1 else int(family)
    kind = constants.SOCK_STREAM if type == -1 else int(type)
    if family != constants.AF_UNIX:
        fail(errno.EOPNOTSUPP)
    one, other = Socket(family, kind), Socket(family, kind)
    one._end.pair(other._end)  # noqa: SLF001 - both are of this module
    return one, other


def getdefaulttimeout() -> float | None:
    """As `_socket.getdefaulttimeout`."""
    return _Default.timeout


def setdefaulttimeout(timeout: float | None) -> None:
    """As `_socket.setdefaulttimeout`."""
    _Default.timeout = timeout


# Names: there are addresses in numbers, and "localhost"


def resolved(host: str | bytes | bytearray) -> str:
    """Return the address of a host.

    Raises:
        socket.gaierror: it is known by no other name.
    """
    text = host if isinstance(host, str) else bytes(host).decode()
    text = {"localhost": "127.0.0.1", "": "0.0.0.0", "<broadcast>": "255.255.255.255"}.get(
        text, text
    )
    try:
        return constants.inet_ntoa(constants.inet_aton(text))
    except OSError as error:
        raise constants.gaierror(constants.EAI_NONAME, "Name or service not known") from error


def gethostbyname(name: str) -> str:
    """As `_socket.gethostbyname`."""
    return resolved(name)


_HOST_NOT_FOUND: Final = 1


def gethostbyaddr(name: str) -> tuple[str, list[str], list[str]]:
    """As `_socket.gethostbyaddr`, of a machine that knows no name but its own."""
    address = resolved(name)
    if address != "127.0.0.1":
        raise constants.herror(_HOST_NOT_FOUND, "Unknown host")
    return "localhost", [], [address]


def getnameinfo(address: Address, flags: int) -> tuple[str, str]:
    """As `_socket.getnameinfo`, in numbers."""
    numbers = constants.NI_NUMERICHOST | constants.NI_NUMERICSERV
    if flags & numbers != numbers:
        raise NotSimulated("getnameinfo but in numbers")
    return resolved(address[0]), str(address[1])


_SOCKETS: Final = (
    (constants.SOCK_STREAM, constants.IPPROTO_TCP),
    (constants.SOCK_DGRAM, constants.IPPROTO_UDP),
    (constants.SOCK_RAW, 0),
)


def getaddrinfo(
    host: str | bytes | None,
    port: Any,
    family: int = 0,
    type: int = 0,
    proto: int = 0,
    flags: int = 0,
) -> list[tuple[int, int, int, str, Address]]:
    """As `_socket.getaddrinfo`."""
    if host is None:
        address = "0.0.0.0" if flags & constants.AI_PASSIVE else "127.0.0.1"
    else:
        address = resolved(host or "-")
    if family not in (constants.AF_UNSPEC, constants.AF_INET):
        raise constants.gaierror(
            constants.EAI_ADDRFAMILY, "Address family for hostname not supported"
        )
    return [
        (constants.AF_INET, kind, number, "", (address, int(port or 0)))
        for kind, number in _SOCKETS
        if type in (0, kind) and proto in (0, number)
    ]

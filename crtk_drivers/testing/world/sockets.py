"""`_socket.socket` of a world: what Python's own `socket.socket` stands on."""

from __future__ import annotations

import _socket as constants
import array
import errno
import os
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final, TypeVar

from typing_extensions import Buffer

from crtk_drivers.testing.world import files
from crtk_drivers.testing.world.files import READ, WRITE, OpenFile, fail
from crtk_drivers.testing.world.kernel import NotSimulated, here
from crtk_drivers.testing.world.network import Address, Endpoint

_KIND_MASK: Final = 0xF
_SO_TIMESTAMPNS: Final = 35
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
        self.proto = max(proto, 0)
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
        self._timeout = value
        self._end.blocking = value is None

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
        """Keep an option; none of them changes what happens.

        Raises:
            OSError: this system does not have it (ENOPROTOOPT): it does not stamp what arrives.
        """
        if (level, name) == (constants.SOL_SOCKET, _SO_TIMESTAMPNS):
            fail(errno.ENOPROTOOPT)
        self._end.options[level, name] = value

    def getsockopt(self, level: int, name: int, size: int = 0) -> Any:
        """Return an option, or the error that is due."""
        if (level, name) == (constants.SOL_SOCKET, constants.SO_ERROR):
            return self._end.take_error()
        if (level, name) == (constants.SOL_SOCKET, constants.SO_TYPE):
            return self._end.kind
        if size:
            raise NotSimulated(f"getsockopt({level}, {name}, {size})")
        return self._end.options.get((level, name), _BUFFER_SIZE)

    def getsockname(self) -> Address:
        """Return its own address."""
        return self._end.name

    def getpeername(self) -> Address:
        """Return the other side's address."""
        if self._end.peer_name is None:
            fail(errno.ENOTCONN)
        return self._end.peer_name

    def _open(self) -> Endpoint:
        if self._descriptor < 0:
            fail(errno.EBADF)
        return self._end

    def _repeat(self, attempt: Callable[[], Found | None], events: int, flags: int = 0) -> Found:
        """Return what `attempt` does as soon as that is not None, within the timeout."""
        here().preempt()
        end = self._open()
        deadline = here().deadline(self._timeout)
        while (found := attempt()) is None:
            if self._timeout == 0.0 or flags & constants.MSG_DONTWAIT:
                fail(errno.EAGAIN)
            left = None if deadline is None else (deadline - here().now) / 1e9
            if left is not None and left <= 0.0:
                raise TimeoutError("timed out")
            end.await_events(events, left)
        return found

    # Addresses

    def bind(self, address: Address) -> None:
        """Have an address."""
        here().preempt()
        self._open().bind(address)
        self._make_file(address)

    def _make_file(self, address: Address) -> None:
        """Make a file for a Unix socket with a path, so that whoever looks sees one."""
        if self._end.family == constants.AF_UNIX and address and address[0] not in ("\0", 0):
            os.mknod(address, 0o140777)  # a socket that nobody serves

    def listen(self, backlog: int = 128) -> None:
        """Accept connections from now on."""
        self._open().listen(backlog)

    def _accept(self) -> tuple[int, Address]:
        end = self._open()
        found = self._repeat(lambda: end.pending.popleft() if end.pending else None, READ)
        return files.add(found), found.peer_name

    def connect_ex(self, address: Address) -> int:
        """Connect; return the number of the error."""
        here().preempt()
        end = self._open()
        code = end.connect(_plain(address))
        if code != errno.EINPROGRESS or self._timeout == 0.0:
            return code
        try:
            end.await_events(READ | WRITE, self._timeout)
        except TimeoutError:
            return errno.EAGAIN
        return end.take_error()

    def connect(self, address: Address) -> None:
        """Connect."""
        code = self.connect_ex(address)
        if code == errno.EAGAIN:
            raise TimeoutError("timed out")
        if code:
            fail(code)

    # Sending

    def send(self, data: Buffer, flags: int = 0) -> int:
        """Send what there is room for."""
        return self.sendto(data, flags, None)

    def sendall(self, data: Buffer, flags: int = 0) -> None:
        """Send all of it."""
        rest = memoryview(data).cast("B")
        while rest:
            rest = rest[self.send(rest, flags) :]

    def sendto(self, data: Buffer, *rest: Any) -> int:
        """Send to an address."""
        flags, address = (0, *rest) if len(rest) == 1 else rest
        return self._send(data, _plain(address), flags, [])

    def sendmsg(
        self,
        buffers: Iterable[Buffer],
        ancdata: Iterable[tuple[int, int, Any]] = (),
        flags: int = 0,
        address: Address = None,
    ) -> int:
        """Send several pieces as one, and descriptors with them."""
        passed: list[int | OpenFile] = []
        for level, kind, data in ancdata:
            if (level, kind) != (constants.SOL_SOCKET, constants.SCM_RIGHTS):
                raise NotSimulated(f"ancillary data ({level}, {kind})")
            passed += [
                files.find(number) if files.is_ours(number) else os.dup(number)
                for number in array.array("i", bytes(data))
            ]
        return self._send(b"".join(bytes(each) for each in buffers), _plain(address), flags, passed)

    def _send(
        self, data: Buffer, address: Address, flags: int, passed: list[int | OpenFile]
    ) -> int:
        end = self._open()

        def attempt() -> int | None:
            if not end.keeps_packets:
                return end.send_stream(data) or None if memoryview(data).nbytes else 0
            sent = end.send_packet(data, address, passed)
            return None if sent < 0 else sent

        return self._repeat(attempt, WRITE, flags)

    # Receiving

    def _receive(self, most: int, flags: int) -> tuple[bytes, list[int | OpenFile], Address]:
        end, peek = self._open(), bool(flags & constants.MSG_PEEK)

        def attempt() -> tuple[bytes, list[int | OpenFile], Address] | None:
            if end.keeps_packets:
                return end.take_packet(peek=peek)
            data = end.take_bytes(most, peek=peek)
            return None if data is None else (data, [], end.peer_name)

        return self._repeat(attempt, READ, flags)

    def recv(self, most: int, flags: int = 0) -> bytes:
        """Return what has arrived."""
        return self._receive(most, flags)[0][:most]

    def recvfrom(self, most: int, flags: int = 0) -> tuple[bytes, Address]:
        """Return what has arrived, and from whom."""
        data, _, sender = self._receive(most, flags)
        return data[:most], sender

    def recv_into(self, buffer: Any, most: int = 0, flags: int = 0) -> int:
        """Read into a buffer."""
        return self.recvfrom_into(buffer, most, flags)[0]

    def recvfrom_into(self, buffer: Any, most: int = 0, flags: int = 0) -> tuple[int, Address]:
        """Read into a buffer, and return from whom it came."""
        room = memoryview(buffer).cast("B")
        data, _, sender = self._receive(most or len(room), flags)
        kept = data[: most or len(room)]
        room[: len(kept)] = kept
        return (len(data) if flags & constants.MSG_TRUNC else len(kept)), sender

    def recvmsg(
        self, most: int, ancillary: int = 0, flags: int = 0
    ) -> tuple[bytes, list[tuple[int, int, bytes]], int, Address]:
        """Return what has arrived, and the descriptors that came with it."""
        data, passed, sender = self._receive(most, flags)
        numbers = array.array(
            "i", [each if isinstance(each, int) else files.add(each) for each in passed]
        )
        rights = (
            [(int(constants.SOL_SOCKET), int(constants.SCM_RIGHTS), numbers.tobytes())]
            if passed
            else []
        )
        return data[:most], rights, constants.MSG_TRUNC if len(data) > most else 0, sender

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


def _plain(address: Address) -> Address:
    """Return an address as it is bound: a loopback address for a name, a text for a path."""
    if isinstance(address, tuple):
        host = "127.0.0.1" if address[0] == "localhost" else address[0]
        return host, address[1]
    return os.fsdecode(address) if isinstance(address, os.PathLike) else address


def socketpair(family: int = -1, type: int = -1, proto: int = 0) -> tuple[Socket, Socket]:
    """As `_socket.socketpair`."""
    family = constants.AF_UNIX if family == -1 else int(family)
    kind = constants.SOCK_STREAM if type == -1 else int(type)
    one, other = Socket(family, kind), Socket(family, kind)
    pair(one._end, other._end)  # noqa: SLF001 - both are of this module
    return one, other


def pair(one: Endpoint, other: Endpoint) -> None:
    """Connect two sockets with each other."""
    one.peer, other.peer = other, one
    one.peer_name = other.peer_name = ""


def close(descriptor: int) -> None:
    """As `_socket.close`."""
    files.close(descriptor)


def dup(descriptor: int) -> int:
    """As `_socket.dup`."""
    return files.add(files.find(descriptor))


def getdefaulttimeout() -> float | None:
    """As `_socket.getdefaulttimeout`."""
    return _Default.timeout


def setdefaulttimeout(timeout: float | None) -> None:
    """As `_socket.setdefaulttimeout`."""
    _Default.timeout = timeout


def getaddrinfo(
    host: str | bytes | None,
    port: Any,
    family: int = 0,
    type: int = 0,
    proto: int = 0,
    flags: int = 0,
) -> list[tuple[int, int, int, str, Address]]:
    """As `_socket.getaddrinfo`: there are addresses in numbers, and "localhost"."""
    text = host.decode() if isinstance(host, bytes) else host
    text = {
        "localhost": "127.0.0.1",
        None: "0.0.0.0" if flags & constants.AI_PASSIVE else "127.0.0.1",
    }.get(text, text)
    assert text is not None
    try:
        constants.inet_pton(constants.AF_INET, text)
    except OSError as error:
        raise constants.gaierror(constants.EAI_NONAME, "Name or service not known") from error
    kinds = [type] if type else [constants.SOCK_STREAM, constants.SOCK_DGRAM]
    return [(constants.AF_INET, kind, proto, "", (text, int(port or 0))) for kind in kinds]


def gethostbyname(host: str) -> str:
    """As `_socket.gethostbyname`."""
    address: str = getaddrinfo(host, None)[0][4][0]
    return address

"""Small programs of what drivers and simulators use of the system; each returns what it saw, in JSON.

They run in the real system and in a world. What they return must not depend on time: they wait for what they
look at.
"""

from __future__ import annotations

import array
import asyncio
import concurrent.futures
import contextlib
import copy
import datetime
import errno
import fcntl
import hashlib
import os
import pickle
import queue
import select
import selectors
import signal
import socket
import stat
import struct
import subprocess
import sys
import termios
import threading
import time
import tty
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import serial

LOCAL = "127.0.0.1"
PATIENCE = 5.0
"""s that something may take that must come."""
MOMENT = 0.03
"""s in which something would come that must not."""
_FLAGS = {
    "IN": select.POLLIN,
    "OUT": select.POLLOUT,
    "PRI": select.POLLPRI,
    "ERR": select.POLLERR,
    "HUP": select.POLLHUP,
    "NVAL": select.POLLNVAL,
    "RDHUP": select.POLLRDHUP,
}


def _plain(value: Any) -> Any:
    """Return what JSON can have of a value."""
    if isinstance(value, bytes | bytearray | memoryview):
        return bytes(value).decode("latin-1")
    if isinstance(value, tuple | list):
        return [_plain(each) for each in value]
    return value


def _try(function: Callable[..., Any], *arguments: Any, **more: Any) -> Any:
    """Return what a call returns, or the name of its error."""
    try:
        return _plain(function(*arguments, **more))
    except (OSError, termios.error) as error:
        number = error.args[0] if error.args else None
        if isinstance(number, int):
            return errno.errorcode.get(number, number)
        return type(error).__name__
    except (ArithmeticError, RuntimeError, LookupError, TypeError, ValueError) as error:
        return type(error).__name__
    except subprocess.TimeoutExpired:
        return "TimeoutExpired"


def _named(events: int) -> str:
    return " ".join(name for name, flag in _FLAGS.items() if events & flag)


def _flags(file: Any, wanted: int = select.POLLIN | select.POLLOUT | select.POLLRDHUP) -> str:
    """Return what poll says of a file now."""
    poll = select.poll()
    poll.register(file, wanted)
    return _named(next((events for _, events in poll.poll(0)), 0))


def _await(file: Any, wanted: int = select.POLLIN) -> str:
    """Wait for events of a file, and return them."""
    poll = select.poll()
    poll.register(file, wanted)
    return _named(next((events for _, events in poll.poll(1000.0 * PATIENCE)), 0))


def _comes(file: Any) -> bool:
    """Return whether a file is readable within a moment."""
    return bool(select.select([file], [], [], MOMENT)[0])


def _eventually(ask: Callable[[], bool]) -> bool:
    deadline = time.monotonic() + PATIENCE
    while not ask():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.002)
    return True


def _listener() -> socket.socket:
    return socket.create_server((LOCAL, 0))


def _free_port() -> int:
    with _listener() as server:
        port: int = server.getsockname()[1]
    return port


def _tcp() -> tuple[socket.socket, socket.socket]:
    """Return both ends of a connection."""
    with _listener() as server:
        near = socket.create_connection(server.getsockname())
        far, _ = server.accept()
    for each in (near, far):
        each.settimeout(PATIENCE)
    return near, far


def _udp() -> socket.socket:
    found = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    found.bind((LOCAL, 0))
    found.settimeout(PATIENCE)
    return found


def _all(sock: socket.socket) -> bytes:
    """Return what comes until the end."""
    return b"".join(iter(lambda: sock.recv(65536), b""))


def _in_thread(function: Callable[..., Any], *arguments: Any) -> tuple[threading.Thread, list[Any]]:
    """Return a thread that runs a function, and what will have come of it."""
    found: list[Any] = []
    thread = threading.Thread(target=lambda: found.append(_try(function, *arguments)), daemon=True)
    thread.start()
    return thread, found


def _result(thread: threading.Thread, found: list[Any]) -> Any:
    thread.join(PATIENCE)
    return found[0] if found else "waits"


# TCP


def tcp_refused() -> Any:
    port = _free_port()
    found = []
    for timeout in (None, PATIENCE):
        with socket.socket() as sock:
            sock.settimeout(timeout)
            found.append(sock.connect_ex((LOCAL, port)))
            found += [sock.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR), _flags(sock)]
    found.append(_try(socket.create_connection, (LOCAL, port), PATIENCE))
    return found


def tcp_refused_without_waiting() -> Any:
    with socket.socket() as sock:
        sock.setblocking(False)
        found = [_try(sock.connect, (LOCAL, _free_port())), _await(sock, select.POLLOUT)]
        found += [_flags(sock)]
        found += [sock.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR) for _ in range(2)]
        return [*found, _flags(sock)]


def tcp_connected_without_waiting() -> Any:
    with _listener() as server, socket.socket() as sock:
        sock.setblocking(False)
        found = [_try(sock.connect, server.getsockname()), _await(sock, select.POLLOUT)]
        found.append(sock.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR))
        found += [sock.connect_ex(server.getsockname()) for _ in range(2)]
        found += [_try(sock.recv, 1), _flags(sock), sock.getpeername() == server.getsockname()]
        return found


def tcp_connected_twice() -> Any:
    near, far = _tcp()
    return [_try(near.connect, (LOCAL, 1)), _try(far.connect, (LOCAL, 1)), _try(near.listen)]


def tcp_not_connected() -> Any:
    sock = socket.socket()
    found = [_try(sock.recv, 1), _try(sock.send, b"x"), _try(sock.getpeername)]
    found += [_try(sock.accept), sock.getsockname(), _flags(sock), _try(sock.shutdown, 2)]
    return found


def tcp_backlog() -> Any:
    with socket.socket() as server:
        server.bind((LOCAL, 0))
        server.listen(1)
        found = [_flags(server)]
        clients = []
        for timeout in (PATIENCE, PATIENCE, 4 * MOMENT):
            sock = socket.socket()
            sock.settimeout(timeout)
            clients.append(sock)
            found.append(_try(sock.connect, server.getsockname()))
        found.append(_flags(server))
        near = [server.accept()[1] for _ in range(2)]
        found += [_flags(server), near == [each.getsockname() for each in clients[:2]]]
        return found


def tcp_half_close() -> Any:
    near, far = _tcp()
    near.sendall(b"question")
    near.shutdown(socket.SHUT_WR)
    asked = _all(far)
    found = [_plain(asked), _flags(far), _try(near.send, b"more"), _flags(near)]
    far.sendall(b"answer")
    far.close()
    return [*found, _plain(_all(near)), _flags(near), _plain(near.recv(1))]


def tcp_end_by_the_other_side() -> Any:
    near, far = _tcp()
    far.sendall(b"last words")
    far.close()
    found = [_await(near, select.POLLRDHUP), _flags(near), _plain(near.recv(4))]
    found += [_plain(near.recv(100)), _plain(near.recv(100)), _flags(near)]
    near.shutdown(socket.SHUT_WR)
    return [*found, _flags(near)]


def tcp_peek() -> Any:
    near, far = _tcp()
    near.sendall(b"abcdef")
    far.recv(6, socket.MSG_PEEK | socket.MSG_WAITALL)
    found = [_plain(far.recv(3, socket.MSG_PEEK)), _plain(far.recv(2)), _plain(far.recv(9))]
    near.close()
    _await(far)
    return [*found, _plain(far.recv(1, socket.MSG_PEEK)), _plain(far.recv(1))]


def tcp_wait_for_all() -> Any:
    near, far = _tcp()
    near.sendall(b"abc")
    far.settimeout(None)
    waiting = _in_thread(far.recv, 6, socket.MSG_WAITALL)
    time.sleep(MOMENT)
    near.sendall(b"def")
    return _result(*waiting)


def tcp_partial_send() -> Any:
    near, far = _tcp()
    near.setblocking(False)
    sent = 0
    with contextlib.suppress(BlockingIOError):
        while sent < 1 << 26:
            sent += near.send(bytes(100_000))
    found = [sent < 1 << 26, _flags(near), _try(near.send, b"x")]
    left = sent
    while left:
        left -= len(far.recv(1 << 20))
    return [*found, _await(near, select.POLLOUT), near.send(b"x")]


def tcp_send_to_one_that_is_gone() -> Any:
    near, far = _tcp()
    far.close()
    found = [_plain(near.recv(1)), near.send(b"nobody"), _eventually(lambda: "ERR" in _flags(near))]
    found += [_flags(near), _try(near.send, b"x"), _flags(near), _try(near.send, b"x")]
    return [*found, _try(near.recv, 1), _try(near.getpeername)]


def tcp_reset_by_unread_data() -> Any:
    near, far = _tcp()
    near.sendall(b"unread")
    _await(far)
    far.close()
    found = [_await(near), _try(near.recv, 1), _try(near.recv, 1), _try(near.send, b"x")]
    return [*found, _flags(near)]


def tcp_reset_by_linger() -> Any:
    near, far = _tcp()
    far.sendall(b"read me")
    _await(near)
    far.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    far.close()
    found = [_eventually(lambda: "ERR" in _flags(near)), _flags(near)]
    return [*found, *(_try(near.recv, 100) for _ in range(3))]


def tcp_error_is_told_once() -> Any:
    near, far = _tcp()
    far.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    far.close()
    found = [_eventually(lambda: "ERR" in _flags(near))]
    found += [near.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR) for _ in range(2)]
    return [*found, _flags(near), _try(near.recv, 1), _try(near.send, b"x")]


def tcp_timeouts() -> Any:
    near, _ = _tcp()
    near.settimeout(MOMENT)
    begin = time.monotonic()
    found = [_try(near.recv, 1), time.monotonic() - begin >= MOMENT]
    with _listener() as server:
        server.settimeout(MOMENT)
        found.append(_try(server.accept))
        server.setblocking(False)
        found.append(_try(server.accept))
    near.setblocking(False)
    found += [_try(near.recv, 1), near.gettimeout(), near.getblocking()]
    found += [_try(near.settimeout, -1)]
    with _listener() as server:
        server.settimeout(PATIENCE)
        near = socket.create_connection(server.getsockname(), MOMENT)
        far, _ = server.accept()
        found += [near.gettimeout(), far.gettimeout(), _try(near.recv, 1)]
    return found


def tcp_sendall_times_out() -> Any:
    near, far = _tcp()
    near.settimeout(MOMENT)
    found = [_try(near.sendall, bytes(1 << 25))]
    far.close()
    return found


def tcp_shut_for_reading() -> Any:
    near, far = _tcp()
    near.shutdown(socket.SHUT_RD)
    found = [_flags(near), _plain(near.recv(1)), far.send(b"late"), _flags(far)]
    found.append(_eventually(lambda: near.recv(9, socket.MSG_PEEK) == b"late"))
    return [
        *found,
        _plain(near.recv(9)),
        _plain(near.recv(9)),
        near.send(b"x"),
        _plain(far.recv(9)),
    ]


def tcp_shut_for_both() -> Any:
    near, far = _tcp()
    near.shutdown(socket.SHUT_RDWR)
    found = [_flags(near), _try(near.send, b"x"), _plain(near.recv(1)), _await(far)]
    far.shutdown(socket.SHUT_RDWR)
    found.append(_flags(far))
    found.append(_eventually(lambda: _try(far.shutdown, 2) == "ENOTCONN"))
    return [*found, _try(near.send, b"x")]


def tcp_shutdown_wakes_a_reader() -> Any:
    near, far = _tcp()
    near.settimeout(None)
    waiting = _in_thread(near.recv, 1)
    time.sleep(MOMENT)
    near.shutdown(socket.SHUT_RDWR)
    found = [_result(*waiting), _plain(far.recv(1))]
    server = _listener()
    waiting = _in_thread(server.accept)
    time.sleep(MOMENT)
    server.shutdown(socket.SHUT_RD)
    return [*found, _result(*waiting), _try(socket.create_connection, server.getsockname())]


def tcp_closed_while_a_thread_reads() -> Any:
    near, far = _tcp()
    near.settimeout(None)
    waiting = _in_thread(near.recv, 100)
    time.sleep(MOMENT)
    near.close()
    found = [near.fileno(), _comes(far), waiting[0].is_alive()]
    far.sendall(b"still heard")
    return [*found, _result(*waiting), _plain(far.recv(1))]


def tcp_closed_while_a_thread_reads_with_timeout() -> Any:
    near, far = _tcp()
    waiting = _in_thread(near.recv, 100)
    time.sleep(MOMENT)
    near.close()
    found = [_comes(far), waiting[0].is_alive()]
    far.sendall(b"too late")
    return [*found, _result(*waiting)]


def tcp_read_into() -> Any:
    near, far = _tcp()
    near.sendall(b"abcdefgh")
    far.recv(8, socket.MSG_PEEK | socket.MSG_WAITALL)
    room = bytearray(b"........")
    found = [
        far.recv_into(room, 3),
        _plain(room),
        far.recv_into(memoryview(room)[4:6]),
        _plain(room),
    ]
    count, sender = far.recvfrom_into(room)
    numbers = array.array("H", [0, 0])
    near.sendall(b"1234")
    return [*found, count, sender, _plain(room), far.recv_into(numbers), _plain(numbers.tobytes())]


def tcp_recvfrom() -> Any:
    near, far = _tcp()
    near.sendall(b"abc")
    _await(far)
    return [_plain(far.recvfrom(9)), _plain(_try(near.sendto, b"x", (LOCAL, 1)))]


def tcp_files() -> Any:
    near, far = _tcp()
    with near.makefile("rb") as reading, far.makefile("w", newline="\n") as writing:
        writing.write("one\ntw")
        writing.flush()
        writing.write("o\nthree")
        far.close()
        found = [_plain(reading.readline()), _comes(near)]
        writing.close()
        found += [_plain(reading.readline()), _plain(reading.read()), _plain(reading.readline())]
        near.close()
    return [*found, near.fileno(), _try(near.recv, 1)]


def tcp_read_and_written_as_a_file() -> Any:
    near, far = _tcp()
    with near.makefile("rwb") as file:
        file.write(b"question\n")
        file.flush()
        with far.makefile("rwb", buffering=0) as raw:
            found = [_plain(raw.read(100)), raw.write(b"answer\n")]
        return [*found, _plain(file.readline())]


def tcp_a_file_with_a_timeout() -> Any:
    near, far = _tcp()
    near.settimeout(MOMENT)
    file = near.makefile("rb")
    found = [_try(file.readline), _try(file.readline)]
    far.sendall(b"late\n")
    return [*found, _plain(near.recv(9))]


def tcp_by_name() -> Any:
    with socket.create_server(("localhost", 0)) as server:
        host, port = server.getsockname()
        near = socket.create_connection(("localhost", port), PATIENCE)
        far, address = server.accept()
    found = [host, near.getpeername() == (host, port), far.getpeername() == near.getsockname()]
    found += [address == near.getsockname(), far.getsockname() == (host, port)]
    found += [near.family.name, near.type.name, far.family.name, far.type.name, near.proto]
    return found


def tcp_a_megabyte() -> Any:
    near, far = _tcp()
    data = hashlib.sha256(b"seed").digest() * (1 << 15)
    waiting = _in_thread(lambda: hashlib.sha256(_all(far)).hexdigest())
    near.sendall(data)
    near.close()
    return [_result(*waiting) == hashlib.sha256(data).hexdigest(), len(data)]


def tcp_echo_of_many() -> Any:
    with _listener() as server:

        def serve() -> list[str]:
            seen = []
            for _ in range(5):
                sock, _ = server.accept()
                with sock:
                    data = _all(sock)
                    seen.append(data.decode())
                    sock.sendall(data.upper())
            return seen

        waiting = _in_thread(serve)
        answers = []
        for number in range(5):
            with socket.create_connection(server.getsockname(), PATIENCE) as sock:
                sock.sendall(b"message %d" % number)
                sock.shutdown(socket.SHUT_WR)
                answers.append(_plain(_all(sock)))
        return [answers, _result(*waiting)]


def tcp_addresses_in_use() -> Any:
    server = _listener()
    address = server.getsockname()
    found = [_try(socket.create_server, address), _try(server.bind, address)]
    with socket.socket() as other:
        found += [_try(other.bind, address), _try(other.bind, ("192.0.2.1", 0))]
    with socket.socket() as other:
        other.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        found.append(_try(other.bind, address))
    with socket.socket() as other:
        found.append(_try(other.bind, ("", address[1])))
    server.close()
    with socket.create_server(address) as again:
        return [*found, again.getsockname() == address]


def tcp_port_after_a_connection() -> Any:
    server = _listener()
    address = server.getsockname()
    near = socket.create_connection(address)
    far, _ = server.accept()
    server.close()
    found = []
    with socket.socket() as other:
        found.append(_try(other.bind, address))
    found.append(_try(socket.create_connection, address))
    with socket.create_server(address) as again:
        found.append(_comes(again))
    far.close()
    near.close()
    return found


def tcp_accepted_late() -> Any:
    server = _listener()
    near = socket.create_connection(server.getsockname())
    near.sendall(b"early")
    near.close()
    far, _ = server.accept()
    return [_plain(_all(far)), _try(far.getpeername)[0]]


def tcp_never_accepted() -> Any:
    server = _listener()
    near = socket.create_connection(server.getsockname(), PATIENCE)
    near.sendall(b"early")
    server.close()
    return [_try(near.recv, 1), _flags(near)]


def tcp_flags() -> Any:
    near, far = _tcp()
    found = {"idle": _flags(near)}
    far.sendall(b"x")
    _await(near)
    found["data"] = _flags(near)
    found["only errors"] = _flags(near, 0)
    near.recv(1)
    far.shutdown(socket.SHUT_WR)
    _await(near)
    found["end"] = _flags(near)
    found["end, waiting to write"] = _flags(near, select.POLLOUT)
    near.shutdown(socket.SHUT_WR)
    _await(far)
    found["both ends"] = _flags(near)
    found["both ends, far"] = _flags(far)
    return found


def tcp_options() -> Any:
    with socket.socket() as sock, _listener() as server:
        asked = (
            (socket.SOL_SOCKET, socket.SO_REUSEADDR),
            (socket.SOL_SOCKET, socket.SO_KEEPALIVE),
            (socket.SOL_SOCKET, socket.SO_TYPE),
            (socket.SOL_SOCKET, socket.SO_DOMAIN),
            (socket.SOL_SOCKET, socket.SO_BROADCAST),
            (socket.SOL_SOCKET, socket.SO_ACCEPTCONN),
            (socket.IPPROTO_TCP, socket.TCP_NODELAY),
        )
        found = [[each.getsockopt(*one) for one in asked] for each in (sock, server)]
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, True)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 10_000)
        found.append([sock.getsockopt(*one) for one in asked])
        found.append([sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)])
        return found


def tcp_read_and_written_by_number() -> Any:
    near, far = _tcp()
    found = [os.write(near.fileno(), b"abc"), _await(far), _plain(os.read(far.fileno(), 9))]
    far.setblocking(False)
    found.append(_try(os.read, far.fileno(), 9))
    near.close()
    _await(far)
    return [*found, _plain(os.read(far.fileno(), 9))]


def tcp_detached_and_duplicated() -> Any:
    near, far = _tcp()
    number = near.detach()
    found = [near.fileno(), _try(near.recv, 1), near.detach()]
    again = socket.socket(fileno=number)
    copy = again.dup()
    again.close()
    found.append(_comes(far))
    copy.sendall(b"by the copy")
    found.append(_plain(far.recv(100)))
    copy.close()
    found += [_plain(far.recv(1)), again.family.name, again.type.name]
    return [*found, _try(socket.socket, fileno=number)]


def tcp_closed() -> Any:
    near, _ = _tcp()
    number = near.fileno()
    near.close()
    near.close()
    found = [near.fileno(), repr(near).startswith("<socket.socket [closed]")]
    calls = near.getsockname, near.getpeername, near.accept, near.listen
    found += [_try(call) for call in calls]
    found += [_try(near.send, b"x"), _try(near.setsockopt, 1, 2, 1), _try(near.getsockopt, 1, 2)]
    found += [_try(near.shutdown, 2), _try(near.connect, (LOCAL, 1)), _try(near.setblocking, False)]
    return [*found, _try(os.read, number, 1), _flags(number)]


def tcp_bad_calls() -> Any:
    near, _ = _tcp()
    found = [_try(near.recv, -1), _try(near.send, "text"), _try(near.connect, (LOCAL,))]
    found += [_try(near.bind, "text"), _try(near.recv, 0), near.send(b"")]
    with socket.socket() as sock:
        found += [_try(sock.connect, (LOCAL, 70_000)), _try(sock.bind, (LOCAL, 70_000))]
    found += [_try(socket.socket, 99), _try(socket.socket, socket.AF_INET, 77)]
    return found


def tcp_under_asyncio() -> Any:
    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while line := await reader.readline():
            writer.write(line.upper())
            await writer.drain()
        writer.close()

    async def main() -> list[str]:
        server = await asyncio.start_server(serve, LOCAL, 0)
        reader, writer = await asyncio.open_connection(*server.sockets[0].getsockname())
        found = []
        for word in ("one", "two"):
            writer.write(f"{word}\n".encode())
            found.append((await asyncio.wait_for(reader.readline(), PATIENCE)).decode())
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(reader.readline(), MOMENT)
            found.append("not late")
        writer.close()
        server.close()
        return found

    return asyncio.run(main())


# UDP


def udp_unconnected() -> Any:
    one, other = _udp(), _udp()
    found = [one.sendto(b"abc", other.getsockname()), _await(other), _flags(other)]
    data, sender = other.recvfrom(100)
    found += [_plain(data), sender == one.getsockname(), _flags(other), _try(other.getpeername)]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as third:
        found.append(third.getsockname())
        third.sendto(b"x", other.getsockname())
        _, sender = other.recvfrom(100)
        found += [sender == (LOCAL, third.getsockname()[1]), third.getsockname()[0]]
    return found


def udp_connected() -> Any:
    one, other = _udp(), _udp()
    one.connect(other.getsockname())
    other.connect(one.getsockname())
    found = [one.send(b"abc"), _plain(other.recv(9)), other.send(b"def"), _plain(one.recv(9))]
    third = _udp()
    found.append(one.sendto(b"elsewhere", third.getsockname()))
    found += [_plain(third.recv(9)), one.getpeername() == other.getsockname()]
    one.connect(third.getsockname())
    found.append(one.send(b"anew"))
    return [*found, _plain(third.recv(9)), one.getpeername() == third.getsockname()]


def udp_refused() -> Any:
    gone = _free_port()
    one = _udp()
    one.connect((LOCAL, gone))
    found = [one.send(b"x"), _eventually(lambda: "ERR" in _flags(one)), _flags(one)]
    found += [_try(one.recv, 9), _flags(one), one.send(b"x")]
    found += [_eventually(lambda: "ERR" in _flags(one)), _try(one.send, b"x"), one.send(b"x")]
    _eventually(lambda: "ERR" in _flags(one))
    found += [one.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR), _flags(one)]
    other = _udp()
    other.settimeout(MOMENT)
    return [*found, other.sendto(b"x", (LOCAL, gone)), _try(other.recv, 9), _flags(other)]


def udp_truncated() -> Any:
    one, other = _udp(), _udp()
    for _ in range(5):
        one.sendto(b"abcdef", other.getsockname())
    found = [_plain(other.recv(3))]
    room = bytearray(4)
    found += [other.recv_into(room), _plain(room)]
    found += [other.recv_into(room, 0, socket.MSG_TRUNC), _plain(room)]
    data, ancillary, flags, sender = other.recvmsg(2)
    found += [_plain(data), ancillary, flags == socket.MSG_TRUNC, sender == one.getsockname()]
    data, ancillary, flags, sender = other.recvmsg(20)
    return [*found, _plain(data), flags, _flags(other)]


def udp_stamped() -> Any:
    one, other = _udp(), _udp()
    one.setsockopt(socket.SOL_SOCKET, 29, 1)  # SO_TIMESTAMP, which Python has no name for
    is_early = False
    for _ in range(100):  # Linux begins with it a moment after it was asked
        before = time.time()
        other.sendto(b"a", one.getsockname())
        select.select([one], [], [], 1.0)
        time.sleep(0.05)
        _, ((level, kind, stamp),), flags, _ = one.recvmsg(10, socket.CMSG_SPACE(16))
        seconds, micros = struct.unpack("@ll", stamp)
        is_early = before - 1e-5 <= seconds + 1e-6 * micros <= time.time() - 0.05
        if is_early:
            break
    other.sendto(b"b", one.getsockname())
    select.select([one], [], [], 1.0)
    return level, kind, flags, is_early, one.recvmsg(10, 8)[1:3]


def udp_peek() -> Any:
    one, other = _udp(), _udp()
    one.sendto(b"abc", other.getsockname())
    one.sendto(b"def", other.getsockname())
    found = [_plain(other.recv(2, socket.MSG_PEEK)), _plain(other.recv(9, socket.MSG_PEEK))]
    return [*found, _plain(other.recv(9)), _plain(other.recv(9))]


def udp_only_from_the_peer() -> Any:
    one, other, stranger = _udp(), _udp(), _udp()
    stranger.sendto(b"before", one.getsockname())
    _await(one)
    one.connect(other.getsockname())
    stranger.sendto(b"after", one.getsockname())
    other.sendto(b"from the peer", one.getsockname())
    found = [_plain(one.recv(99)), _plain(one.recv(99)), _comes(one)]
    stranger.connect(one.getsockname())
    stranger.send(b"x")
    return [*found, _eventually(lambda: "ERR" in _flags(stranger)), _try(stranger.recv, 9)]


def udp_empty_and_long() -> Any:
    one, other = _udp(), _udp()
    found = [one.sendto(b"", other.getsockname()), _plain(other.recvfrom(9)[0])]
    found += [_try(one.sendto, bytes(65_508), other.getsockname())]
    found += [one.sendto(bytes(65_507), other.getsockname()), len(other.recv(1 << 17))]
    found += [_try(one.send, b"x"), _try(one.sendto, b"x", (LOCAL, 0)), _try(one.listen)]
    return found


def udp_waits() -> Any:
    one = _udp()
    one.settimeout(MOMENT)
    found = [_try(one.recv, 1)]
    one.setblocking(False)
    found += [_try(one.recv, 1), _try(one.recvfrom, 1), _try(one.recv_into, bytearray(1))]
    one.setblocking(True)
    return [*found, _try(one.recv, 1, socket.MSG_DONTWAIT)]


def udp_order() -> Any:
    one, other = _udp(), _udp()
    for number in range(20):
        one.sendto(b"%d" % number, other.getsockname())
        other.recv(9, socket.MSG_PEEK)
    return [_plain(other.recv(9)) for _ in range(20)]


def udp_shut() -> Any:
    one, other = _udp(), _udp()
    one.connect(other.getsockname())
    one.settimeout(None)
    one.shutdown(socket.SHUT_RD)
    found = [_flags(one), _plain(one.recv(9)), one.send(b"x"), _plain(other.recv(9))]
    one.shutdown(socket.SHUT_WR)
    found += [_flags(one), _try(one.send, b"x")]
    other.settimeout(None)
    waiting = _in_thread(other.recv, 9)
    time.sleep(MOMENT)
    found.append(_try(other.shutdown, socket.SHUT_RDWR))
    return [*found, _result(*waiting)]


def udp_addresses() -> Any:
    one = _udp()
    found = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        found += [_try(other.bind, one.getsockname()), other.getsockname()]
        other.bind(("", 0))
        host, port = other.getsockname()
        one.sendto(b"to any", (LOCAL, port))
        found += [host, _plain(other.recv(9))]
    address = one.getsockname()
    one.close()
    again = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    again.bind(address)
    return [*found, again.getsockname() == address]


def udp_closed_with_data() -> Any:
    one, other = _udp(), _udp()
    one.connect(other.getsockname())
    one.send(b"unread")
    _await(other)
    other.close()
    found = [_flags(one)]
    one.send(b"x")
    return [*found, _eventually(lambda: "ERR" in _flags(one)), _try(one.recv, 1)]


def names_of_hosts() -> Any:
    found = [socket.gethostbyname(each) for each in (LOCAL, "localhost", "10.1.2.3", "")]
    found.append(socket.gethostbyname("0.0.0.0"))
    found.append(socket.gethostbyaddr("127.0.0.1")[0])
    asked = (
        (LOCAL, 80, socket.AF_INET, socket.SOCK_STREAM),
        ("localhost", 80, socket.AF_INET, socket.SOCK_STREAM),
        (LOCAL, "80", 0, socket.SOCK_DGRAM),
        (LOCAL, None, 0, socket.SOCK_STREAM),
        (None, 80, socket.AF_INET, socket.SOCK_STREAM, 0, socket.AI_PASSIVE),
        (None, 80, socket.AF_INET, socket.SOCK_STREAM),
        (LOCAL, 80, socket.AF_INET, 0, socket.IPPROTO_TCP),
        (LOCAL, 80),
    )
    found += [_try(socket.getaddrinfo, *arguments) for arguments in asked]
    found.append(socket.getnameinfo((LOCAL, 80), socket.NI_NUMERICHOST | socket.NI_NUMERICSERV))
    found.append(_try(socket.getaddrinfo, "10.1.2.3", 80, socket.AF_INET6, socket.SOCK_STREAM))
    return _plain(found)


# Unix sockets


def _unix(kind: int) -> socket.socket:
    found = socket.socket(socket.AF_UNIX, kind)
    found.settimeout(PATIENCE)
    return found


def unix_stream() -> Any:
    server, near = _unix(socket.SOCK_STREAM), _unix(socket.SOCK_STREAM)
    found = [server.getsockname(), _try(near.connect, "door"), _try(server.listen)]
    server.bind("door")
    found += [_try(near.connect, "door"), stat.S_ISSOCK(os.stat("door").st_mode)]
    server.listen(1)
    found += [server.getsockname(), _try(near.connect, "door"), near.getpeername()]
    far, address = server.accept()
    far.settimeout(PATIENCE)
    found += [address, far.getsockname(), far.getpeername(), near.getsockname()]
    near.sendall(b"abc")
    found += [_plain(far.recv(9)), _try(near.connect, "door")]
    near.close()
    found += [_plain(far.recv(9)), _flags(far), _try(far.send, b"x"), _flags(far)]
    found.append(_try(_unix(socket.SOCK_STREAM).bind, "door"))
    server.close()
    found.append(_try(_unix(socket.SOCK_STREAM).connect, "door"))
    os.unlink("door")
    return [*found, _try(_unix(socket.SOCK_STREAM).connect, "door")]


def unix_door_moved() -> Any:
    server = _unix(socket.SOCK_STREAM)
    server.bind("door")
    server.listen()
    os.unlink("door")
    found = [_try(_unix(socket.SOCK_STREAM).connect, "door")]
    again = _unix(socket.SOCK_STREAM)
    again.bind("door")
    again.listen()
    near = _unix(socket.SOCK_STREAM)
    near.connect("door")
    found += [_await(again), _flags(server)]
    third = _unix(socket.SOCK_STREAM)
    third.connect(f"{os.getcwd()}/door")
    return [*found, third.getpeername() == f"{os.getcwd()}/door"]


def unix_stream_pair() -> Any:
    one, other = socket.socketpair()
    found = [one.family.name, one.type.name, one.getsockname(), one.getpeername(), _flags(one)]
    one.sendall(b"abc")
    one.sendall(b"def")
    _eventually(lambda: len(other.recv(9, socket.MSG_PEEK)) == 6)
    found += [_plain(other.recv(4)), _plain(other.recv(9))]
    one.shutdown(socket.SHUT_WR)
    found += [_await(other), _flags(other), _plain(other.recv(9)), _flags(one)]
    other.close()
    found += [_await(one), _flags(one), _plain(one.recv(9)), _try(one.send, b"x"), _flags(one)]
    return found


def unix_stream_with_unread_data() -> Any:
    one, other = socket.socketpair()
    one.settimeout(PATIENCE)
    one.sendall(b"unread")
    _await(other)
    other.close()
    found = [_eventually(lambda: "HUP" in _flags(one)), _flags(one), _try(one.recv, 1)]
    return [*found, _try(one.recv, 1), _try(one.send, b"x"), _flags(one)]


def unix_stream_full() -> Any:
    one, other = socket.socketpair()
    one.setblocking(False)
    sent = 0
    with contextlib.suppress(BlockingIOError):
        while sent < 1 << 26:
            sent += one.send(bytes(10_000))
    found = [0 < sent < 1 << 26, _flags(one)]
    left = sent
    while left:
        left -= len(other.recv(1 << 16))
    return [*found, _await(one, select.POLLOUT)]


def unix_stream_backlog() -> Any:
    server = _unix(socket.SOCK_STREAM)
    server.bind("door")
    server.listen(0)
    found, kept = [], []
    for _ in range(3):
        sock = socket.socket(socket.AF_UNIX)
        sock.setblocking(False)
        kept.append(sock)
        found.append(_try(sock.connect, "door"))
    waiting = _unix(socket.SOCK_STREAM)
    thread = _in_thread(waiting.connect, "door")
    time.sleep(MOMENT)
    server.accept()
    return [*found, _result(*thread)]


def unix_datagrams() -> Any:
    server, near = _unix(socket.SOCK_DGRAM), _unix(socket.SOCK_DGRAM)
    found = [_try(near.sendto, b"x", "mailbox")]
    server.bind("mailbox")
    found += [near.sendto(b"one", "mailbox"), near.sendto(b"two", "mailbox")]
    found += [_plain(server.recvfrom(9)), _plain(server.recvfrom(2))]
    near.bind("sender")
    near.sendto(b"three", "mailbox")
    found += [_plain(server.recvfrom(9)), _try(near.send, b"x")]
    near.connect("mailbox")
    found += [near.send(b"four"), _plain(server.recv(9)), near.getpeername()]
    server.close()
    found += [_try(near.send, b"five"), _try(_unix(socket.SOCK_DGRAM).sendto, b"x", "mailbox")]
    return found


def unix_datagram_pair() -> Any:
    one, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    other.settimeout(PATIENCE)
    found = [one.send(b"abc"), one.send(b"defgh"), one.send(b"")]
    _eventually(lambda: "IN" in _flags(other))
    found += [_plain(other.recv(9)), _plain(other.recv(2)), _plain(other.recv(9)), _flags(other)]
    one.setblocking(False)
    count = 0
    with contextlib.suppress(BlockingIOError):
        while count < 10_000:
            one.send(bytes(1000))
            count += 1
    found += [0 < count < 10_000, _flags(one)]
    while count:
        other.recv(1000)
        count -= 1
    found.append(_await(one, select.POLLOUT))
    other.close()
    return [*found, _try(one.send, b"x")]


def unix_packets() -> Any:
    server, near = _unix(socket.SOCK_SEQPACKET), _unix(socket.SOCK_SEQPACKET)
    server.bind("door")
    server.listen()
    found = [_try(_unix(socket.SOCK_STREAM).connect, "door"), _try(near.connect, "door")]
    far, _ = server.accept()
    far.settimeout(PATIENCE)
    found += [near.send(b"abc"), near.send(b"defgh"), _plain(far.recv(9)), _plain(far.recv(2))]
    found += [far.send(b"answer"), _plain(near.recv(99))]
    near.send(b"last")
    near.close()
    found += [_plain(far.recv(9)), _plain(far.recv(9)), _flags(far), _try(far.send, b"x")]
    return found


def unix_packet_pair() -> Any:
    one, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    one.settimeout(PATIENCE)
    other.settimeout(PATIENCE)
    one.send(b"abcdef")
    data, _, flags, _ = other.recvmsg(3)
    found = [_plain(data), bool(flags & socket.MSG_TRUNC), _flags(other)]
    other.send(b"unread")
    _await(one)
    found += [_plain(one.recv(3, socket.MSG_PEEK))]
    one.close()
    return [*found, _eventually(lambda: "HUP" in _flags(other)), _flags(other), _try(other.recv, 1)]


def unix_abstract_names() -> Any:
    name = f"\0crtk-{os.getpid()}"
    server, near = _unix(socket.SOCK_STREAM), _unix(socket.SOCK_STREAM)
    server.bind(name)
    server.listen()
    near.connect(name)
    far, _ = server.accept()
    found = [server.getsockname() == name.encode(), near.getpeername() == name.encode()]
    found += [far.getsockname() == name.encode(), _try(_unix(socket.SOCK_STREAM).bind, name)]
    server.close()
    found.append(_try(_unix(socket.SOCK_STREAM).connect, name))
    near.close()
    far.close()
    again = _unix(socket.SOCK_STREAM)
    again.bind(name.encode())
    return [*found, os.listdir(".")]


def unix_passed_descriptors() -> Any:
    one, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    reading, writing = os.pipe()
    socket.send_fds(one, [b"take this"], [writing])
    os.close(writing)
    found = [_comes(reading)]
    data, numbers, _, _ = socket.recv_fds(other, 100, 2)
    found += [_plain(data), len(numbers), os.write(numbers[0], b"by the copy")]
    found += [_plain(os.read(reading, 99)), _comes(reading)]
    os.close(numbers[0])
    return [*found, _plain(os.read(reading, 99))]


def unix_passed_and_never_taken() -> Any:
    one, other = socket.socketpair()
    reading, writing = os.pipe()
    socket.send_fds(one, [b"take this"], [writing])
    os.close(writing)
    _await(other)
    other.close()
    one.close()
    return [_await(reading), _plain(os.read(reading, 9))]


def unix_stream_passed_descriptors() -> Any:
    one, other = socket.socketpair()
    reading, writing = os.pipe()
    socket.send_fds(one, [b"a", b"b"], [reading, writing])
    data, numbers, _, _ = socket.recv_fds(other, 100, 4)
    found = [_plain(data), len(numbers), os.write(numbers[1], b"x"), _plain(os.read(reading, 9))]
    return [*found, _try(socket.send_fds, one, [b"x"], [999])]


# Pipes and counters


def pipe_read() -> Any:
    reading, writing = os.pipe()
    waiting = _in_thread(os.read, reading, 99)
    found = [_flags(reading), _flags(writing), os.write(writing, b"abc"), _result(*waiting)]
    os.write(writing, b"defgh")
    found += [_plain(os.read(reading, 2)), _flags(reading), _plain(os.read(reading, 99))]
    return [
        *found,
        _try(os.read, writing, 1),
        _try(os.write, reading, b"x"),
        os.write(writing, b""),
    ]


def pipe_without_waiting() -> Any:
    reading, writing = os.pipe2(os.O_NONBLOCK)
    found = [_try(os.read, reading, 1), os.get_blocking(reading)]
    os.set_blocking(reading, True)
    found += [os.get_blocking(reading), os.get_blocking(writing)]
    flags = fcntl.fcntl(reading, fcntl.F_GETFL)
    fcntl.fcntl(reading, fcntl.F_SETFL, flags | os.O_NONBLOCK)
    return [*found, flags & os.O_ACCMODE, os.get_blocking(reading), _try(os.read, reading, 1)]


def pipe_full() -> Any:
    reading, writing = os.pipe2(os.O_NONBLOCK)
    found = [os.write(writing, bytes(70_000)), _try(os.write, writing, b"x"), _flags(writing)]
    found += [len(os.read(reading, 4096)), _flags(writing), os.write(writing, bytes(5000))]
    found += [_flags(writing), len(os.read(reading, 1 << 17)), _flags(writing)]
    return found


def pipe_small_writes_are_whole() -> Any:
    reading, writing = os.pipe2(os.O_NONBLOCK)
    os.write(writing, bytes(61_440))
    os.write(writing, bytes(2000))
    found = [_try(os.write, writing, bytes(3000)), os.write(writing, bytes(2000))]
    return [*found, len(os.read(reading, 1 << 17))]


def pipe_blocking_write() -> Any:
    reading, writing = os.pipe()
    waiting = _in_thread(os.write, writing, bytes(200_000))
    time.sleep(MOMENT)
    found = [waiting[0].is_alive()]
    count = 0
    while count < 200_000:
        count += len(os.read(reading, 50_000))
    return [*found, count, _result(*waiting)]


def pipe_broken() -> Any:
    reading, writing = os.pipe()
    os.close(reading)
    found = [_flags(writing), _try(os.write, writing, b"x"), select.select([], [writing], [], 0)[1]]
    found[-1] = bool(found[-1])
    reading, writing = os.pipe()
    waiting = _in_thread(os.write, writing, bytes(200_000))
    time.sleep(MOMENT)
    os.close(reading)
    return [*found, _result(*waiting)]


def pipe_end() -> Any:
    reading, writing = os.pipe()
    os.write(writing, b"last")
    os.close(writing)
    found = [_flags(reading), _plain(os.read(reading, 99)), _flags(reading)]
    found += [_plain(os.read(reading, 99)), bool(select.select([reading], [], [], 0)[0])]
    reading, writing = os.pipe()
    waiting = _in_thread(os.read, reading, 1)
    time.sleep(MOMENT)
    os.close(writing)
    return [*found, _result(*waiting)]


def pipe_duplicated() -> Any:
    reading, writing = os.pipe()
    copy = os.dup(writing)
    os.close(writing)
    found = [_comes(reading), os.write(copy, b"x"), _plain(os.read(reading, 9))]
    os.close(copy)
    return [*found, _plain(os.read(reading, 9))]


def pipe_closed() -> Any:
    reading, writing = os.pipe()
    os.close(reading)
    found = [
        _try(os.close, reading),
        _try(os.read, reading, 1),
        _flags(reading),
        _try(os.dup, reading),
    ]
    found += [_try(os.write, reading, b"x"), _try(os.fstat, reading), os.isatty(writing)]
    found += [_try(fcntl.fcntl, reading, fcntl.F_GETFL), _try(os.fdopen, reading)]
    again = os.dup(writing)
    return [*found, again == reading, _try(os.ttyname, writing), _try(termios.tcgetattr, writing)]


def pipe_kinds() -> Any:
    reading, writing = os.pipe()
    near, far = _tcp()
    found = [
        stat.S_ISFIFO(os.fstat(reading).st_mode),
        stat.S_ISSOCK(os.fstat(near.fileno()).st_mode),
    ]
    found += [_try(os.lseek, reading, 0, 0), os.get_inheritable(reading)]
    os.write(writing, b"abc")
    far.sendall(b"defg")
    _await(near)
    for each in (reading, near):
        room = bytearray(4)
        fcntl.ioctl(each, termios.FIONREAD, room)
        found.append(struct.unpack("i", room)[0])
    return found


def files_of_numbers() -> Any:
    reading, writing = os.pipe()
    with os.fdopen(writing, "w") as text, os.fdopen(reading, "rb") as data:
        text.write("one\ntwo")
        found = [_comes(reading)]
        text.flush()
        found += [_plain(data.readline()), _plain(data.read(2)), text.fileno() == writing]
        text.close()
        found += [_plain(data.read()), data.closed, text.closed, _try(text.write, "x")]
    found += [_try(os.close, reading), _try(os.close, writing)]
    reading, writing = os.pipe()
    with os.fdopen(writing, "wb", buffering=0, closefd=False) as raw:
        found.append(raw.write(b"raw\n"))
    os.close(writing)
    with os.fdopen(reading, "r", encoding="ascii") as text:
        return [*found, list(text)]


def files_of_broken_pipes() -> Any:
    reading, writing = os.pipe()
    os.close(reading)
    file = os.fdopen(writing, "w")
    file.write("x")
    return [_try(file.flush), _try(file.close), file.closed, _try(os.close, writing)]


def files_by_open() -> Any:
    reading, writing = os.pipe()
    with open(writing, "w", buffering=1) as file:
        file.write("a line\n")
        return [_plain(os.read(reading, 99)), file.fileno() == writing, file.isatty()]


def counter() -> Any:
    number = os.eventfd(0, os.EFD_NONBLOCK)
    found = [_flags(number), _try(os.eventfd_read, number)]
    os.eventfd_write(number, 3)
    os.eventfd_write(number, 4)
    found += [_flags(number), os.eventfd_read(number), _flags(number)]
    found += [os.write(number, struct.pack("Q", 5)), list(os.read(number, 8))]
    os.eventfd_write(number, 1)
    found += [_try(os.read, number, 4), _try(os.write, number, b"abc")]
    os.eventfd_read(number)
    os.eventfd_write(number, 2**64 - 2)
    found += [
        _flags(number),
        _try(os.eventfd_write, number, 1),
        os.eventfd_read(number) == 2**64 - 2,
    ]
    found.append(_try(os.write, number, b"\xff" * 8))
    return found


def counter_waits() -> Any:
    number = os.eventfd(0)
    waiting = _in_thread(os.eventfd_read, number)
    time.sleep(MOMENT)
    os.eventfd_write(number, 7)
    found = [_result(*waiting)]
    number = os.eventfd(2, os.EFD_SEMAPHORE | os.EFD_NONBLOCK)
    found += [_try(os.eventfd_read, number) for _ in range(3)]
    os.close(number)
    return [*found, _try(os.eventfd_read, number)]


# Waiting for descriptors


def select_calls() -> Any:
    near, far = _tcp()
    far.sendall(b"x")
    reading, writing = os.pipe()
    _await(near)
    ready = select.select([near, far, reading], [near, writing], [near], PATIENCE)
    found = [[each is near for each in ready[0]], len(ready[1]), len(ready[2])]
    found += [_try(select.select, [near], [], [], -1), _try(select.select, ["x"], [], [], 0)]
    os.close(reading)
    found += [_try(select.select, [reading], [], [], 0), _try(select.select, [-1], [], [], 0)]
    near.close()
    found += [_try(select.select, [near], [], [], 0), select.select([], [], [], 0.01)]
    return found


def select_writing_only() -> Any:
    near, far = _tcp()
    far.shutdown(socket.SHUT_WR)
    _await(near)
    found = [[len(each) for each in select.select([near], [], [], 0)]]
    found.append([len(each) for each in select.select([], [near], [], 0)])
    far.close()
    reading, writing = os.pipe()
    os.write(writing, b"x")
    found.append([len(each) for each in select.select([reading], [reading], [], 0)])
    os.close(writing)
    found.append([len(each) for each in select.select([reading], [reading], [], 0)])
    return found


def poll_calls() -> Any:
    reading, writing = os.pipe()
    poll = select.poll()
    found = [poll.poll(0), _try(poll.unregister, reading), _try(poll.modify, reading, 1)]
    poll.register(reading, select.POLLIN)
    poll.register(writing, select.POLLIN)
    found.append(poll.poll(1))
    poll.register(writing, select.POLLOUT)
    found.append([(number == writing, _named(events)) for number, events in poll.poll()])
    poll.modify(writing, 0)
    found.append(poll.poll(0.5))
    os.write(writing, b"x")
    found.append([(number == reading, _named(events)) for number, events in poll.poll(-1)])
    poll.unregister(writing)
    os.close(reading)
    found.append([_named(events) for _, events in poll.poll()])
    return [*found, _try(poll.register, "x"), _try(poll.register, -1)]


def epoll_calls() -> Any:
    reading, writing = os.pipe()
    epoll = select.epoll()
    epoll.register(reading, select.EPOLLIN)
    found = [_try(epoll.register, reading), epoll.poll(0), epoll.closed]
    found += [
        _try(epoll.modify, writing, 1),
        _try(epoll.unregister, writing),
        _try(epoll.register, 999),
    ]
    os.write(writing, b"x")
    found.append([(number == reading, _named(events)) for number, events in epoll.poll()])
    epoll.modify(reading, 0)
    found.append(epoll.poll(0.001))
    epoll.register(writing)
    found.append([(number == writing, _named(events)) for number, events in epoll.poll(1)])
    epoll.modify(reading, select.EPOLLIN)
    found += [len(epoll.poll(1, 1)), len(epoll.poll(1, 2)), _try(epoll.poll, 0, 0)]
    epoll.unregister(reading)
    os.close(writing)
    found += [epoll.poll(0), _try(epoll.register, writing)]
    with epoll:
        found.append(epoll.fileno() >= 0)
    return [*found, epoll.closed, _try(epoll.poll, 0), _try(epoll.register, 0), _try(epoll.fileno)]


def epoll_of_closed_descriptors() -> Any:
    epoll = select.epoll()
    reading, writing = os.pipe()
    epoll.register(reading, select.EPOLLIN)
    os.write(writing, b"x")
    copy = os.dup(reading)
    os.close(reading)
    found = [[(number == reading, _named(events)) for number, events in epoll.poll(0)]]
    found += [_try(epoll.unregister, reading), _try(epoll.modify, reading, 0)]
    os.close(copy)
    found.append(epoll.poll(0))
    other, far = os.pipe()
    os.write(far, b"x")
    found += [other == reading, epoll.poll(0), _try(epoll.register, other, select.EPOLLIN)]
    return [*found, [(number == other, _named(events)) for number, events in epoll.poll(0)]]


def epoll_of_an_epoll() -> Any:
    inner, outer = select.epoll(), select.epoll()
    reading, writing = os.pipe()
    inner.register(reading, select.EPOLLIN)
    outer.register(inner, select.EPOLLIN)
    found = [_flags(inner), outer.poll(0)]
    waiting = _in_thread(lambda: [_named(events) for _, events in outer.poll(PATIENCE)])
    time.sleep(MOMENT)
    os.write(writing, b"x")
    found += [_result(*waiting), _flags(inner), bool(select.select([inner], [], [], 0)[0])]
    os.read(reading, 1)
    return [*found, _flags(inner), outer.poll(0)]


def epoll_at_the_end() -> Any:
    near, far = _tcp()
    epoll = select.epoll()
    epoll.register(near, select.EPOLLIN | select.EPOLLRDHUP)
    far.close()
    found = [[_named(events) for _, events in epoll.poll(PATIENCE)]]
    near.close()
    return [*found, epoll.poll(0)]


def epoll_registered_while_waiting() -> Any:
    epoll = select.epoll()
    waiting = _in_thread(lambda: [_named(events) for _, events in epoll.poll(PATIENCE)])
    reading, writing = os.pipe()
    os.write(writing, b"x")
    time.sleep(MOMENT)
    epoll.register(reading, select.EPOLLIN)
    return _result(*waiting)


def epoll_once() -> Any:
    epoll = select.epoll()
    reading, writing = os.pipe()
    os.write(writing, b"x")
    epoll.register(reading, select.EPOLLIN | select.EPOLLONESHOT)
    found = [len(epoll.poll(0)), len(epoll.poll(0))]
    epoll.modify(reading, select.EPOLLIN)
    return [*found, len(epoll.poll(0)), len(epoll.poll(0))]


def selector() -> Any:
    with selectors.DefaultSelector() as chosen:
        near, far = _tcp()
        chosen.register(near, selectors.EVENT_READ, "near")
        found: list[Any] = [chosen.select(0)]
        far.sendall(b"x")
        found.append([(key.data, mask) for key, mask in chosen.select(PATIENCE)])
        chosen.modify(near, selectors.EVENT_READ | selectors.EVENT_WRITE, "both")
        found.append([(key.data, mask) for key, mask in chosen.select(PATIENCE)])
        chosen.unregister(near)
        return [*found, chosen.select(0.001)]


# Terminals


def _terminal() -> tuple[int, int]:
    """Return a master and a client in raw mode."""
    master, client = os.openpty()
    tty.setraw(client)
    return master, client


def _set(client: int, least: int, tenths: int) -> None:
    attributes = termios.tcgetattr(client)
    attributes[6][termios.VMIN], attributes[6][termios.VTIME] = least, tenths
    termios.tcsetattr(client, termios.TCSANOW, attributes)


def _waiting(terminal: int) -> int:
    room = bytearray(4)
    fcntl.ioctl(terminal, termios.FIONREAD, room)
    count: int = struct.unpack("i", room)[0]
    return count


def terminal_bytes() -> Any:
    master, client = _terminal()
    found = [_flags(master), _flags(client), os.write(client, b"\x00\xff\r\n\x03"), _await(master)]
    found += [_plain(os.read(master, 99)), os.write(master, b"\x11\x13\x04abc"), _await(client)]
    found += [_plain(os.read(client, 3)), _flags(client), _plain(os.read(client, 99))]
    found += [
        os.isatty(master),
        os.isatty(client),
        stat.S_ISCHR(os.stat(os.ttyname(client)).st_mode),
    ]
    return [*found, stat.S_ISCHR(os.fstat(client).st_mode)]


def terminal_reads() -> Any:
    master, client = _terminal()
    found = []
    _set(client, 0, 0)
    found.append(_plain(os.read(client, 9)))
    os.set_blocking(client, False)
    found.append(_plain(os.read(client, 9)))
    _set(client, 1, 0)
    found.append(_try(os.read, client, 9))
    os.set_blocking(client, True)
    waiting = _in_thread(os.read, client, 9)
    time.sleep(MOMENT)
    os.write(master, b"x")
    found.append(_result(*waiting))
    _set(client, 0, 1)
    begin = time.monotonic()
    found += [_plain(os.read(client, 9)), time.monotonic() - begin >= 0.09]
    os.write(master, b"y")
    return [*found, _plain(os.read(client, 9))]


def terminal_without_master() -> Any:
    master, client = _terminal()
    name = os.ttyname(client)
    waiting = _in_thread(os.read, client, 9)
    time.sleep(MOMENT)
    os.close(master)
    found = [_result(*waiting) in ("", "EIO"), _flags(client), _plain(os.read(client, 9))]
    found += [
        _try(os.write, client, b"x"),
        _try(termios.tcgetattr, client),
        _try(_waiting, client),
        _try(termios.tcflush, client, 2),
    ]
    found += [_try(tty.setraw, client), _try(termios.tcdrain, client), os.isatty(client)]
    return [*found, _try(os.open, name, os.O_RDWR) in ("ENOENT", "EIO")]


def terminal_data_lost_with_the_master() -> Any:
    master, client = _terminal()
    os.write(master, b"unread")
    _await(client)
    os.close(master)
    return [_flags(client), _plain(os.read(client, 9))]


def terminal_without_client() -> Any:
    master, client = _terminal()
    name = os.ttyname(client)
    os.write(client, b"last")
    _await(master)
    os.close(client)
    found = [_flags(master), _plain(os.read(master, 9)), _try(os.read, master, 9), _flags(master)]
    client = os.open(name, os.O_RDWR | os.O_NOCTTY)
    found += [
        _flags(master),
        os.write(client, b"again"),
        _await(master),
        _plain(os.read(master, 9)),
    ]
    os.set_blocking(master, True)
    waiting = _in_thread(os.read, master, 9)
    time.sleep(MOMENT)
    os.close(client)
    return [*found, _result(*waiting)]


def terminal_written_without_client() -> Any:
    master, client = _terminal()
    name = os.ttyname(client)
    os.close(client)
    found = [os.write(master, b"early"), _flags(master)]
    client = os.open(name, os.O_RDWR | os.O_NOCTTY)
    found += [_await(client), _plain(os.read(client, 9))]
    return found


def terminal_opened_twice() -> Any:
    master, client = _terminal()
    other = os.open(os.ttyname(client), os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    found = [os.write(other, b"from the other"), _await(master), _plain(os.read(master, 99))]
    os.close(client)
    found += [_flags(master), os.write(master, b"abc"), _await(other), _plain(os.read(other, 9))]
    os.close(other)
    return [*found, _flags(master)]


def terminal_queues() -> Any:
    master, client = _terminal()
    os.write(master, b"abcdef")
    _await(client)
    found = [_waiting(client)]
    os.read(client, 2)
    found.append(_waiting(client))
    termios.tcflush(client, termios.TCIFLUSH)
    found += [_waiting(client), _flags(client)]
    os.write(master, b"gh")
    _await(client)
    termios.tcsetattr(client, termios.TCSADRAIN, termios.tcgetattr(client))
    found.append(_waiting(client))
    termios.tcsetattr(client, termios.TCSAFLUSH, termios.tcgetattr(client))
    found.append(_waiting(client))
    os.write(client, b"out")
    _await(master)
    termios.tcdrain(client)
    found.append(_waiting(master))
    termios.tcflush(client, termios.TCOFLUSH)
    return found


def terminal_full() -> Any:
    master, client = _terminal()
    os.set_blocking(client, False)
    sent = 0
    with contextlib.suppress(BlockingIOError):
        while sent < 1 << 20:
            sent += os.write(client, bytes(1000))
    is_full = 0 < sent < 1 << 20
    count = 0
    while count < sent:
        count += len(os.read(master, 4096))
    return [is_full, count == sent, _await(client, select.POLLOUT), _try(os.write, client, b"x")]


def terminal_blocking_write() -> Any:
    master, client = _terminal()
    waiting = _in_thread(os.write, client, bytes(100_000))
    time.sleep(MOMENT)
    found = [waiting[0].is_alive()]
    count = 0
    while count < 100_000:
        count += len(os.read(master, 4096))
    return [*found, _result(*waiting)]


def terminal_locks() -> Any:
    _master, client = _terminal()
    name = os.ttyname(client)
    one, other = (os.open(name, os.O_RDWR | os.O_NOCTTY) for _ in range(2))
    now = fcntl.LOCK_NB
    found = [
        _try(fcntl.flock, one, fcntl.LOCK_EX | now),
        _try(fcntl.flock, other, fcntl.LOCK_EX | now),
    ]
    found += [
        _try(fcntl.flock, one, fcntl.LOCK_EX | now),
        _try(fcntl.flock, other, fcntl.LOCK_SH | now),
    ]
    fcntl.flock(one, fcntl.LOCK_UN)
    found += [_try(fcntl.flock, each, fcntl.LOCK_SH | now) for each in (one, other)]
    found.append(_try(fcntl.flock, one, fcntl.LOCK_EX | now))
    os.close(other)
    found.append(_try(fcntl.flock, one, fcntl.LOCK_EX | now))
    copy = os.dup(one)
    os.close(one)
    found.append(_try(fcntl.flock, client, fcntl.LOCK_EX | now))
    os.close(copy)
    return [*found, _try(fcntl.flock, client, fcntl.LOCK_EX | now)]


def terminal_exclusive() -> Any:
    _master, client = _terminal()
    fcntl.ioctl(client, termios.TIOCEXCL)
    fcntl.ioctl(client, termios.TIOCNXCL)
    return [_try(fcntl.ioctl, client, 0x9999), _waiting(client)]


def terminal_speeds() -> Any:
    master, client = _terminal()
    attributes = termios.tcgetattr(client)
    attributes[4] = attributes[5] = termios.B57600
    termios.tcsetattr(client, termios.TCSANOW, attributes)
    found = [each == termios.B57600 for each in termios.tcgetattr(master)[4:6]]
    room = array.array("i", [0] * 64)
    fcntl.ioctl(client, 0x802C542A, room)
    room[2] = room[2] & ~termios.CBAUD | 0o010000 if hasattr(termios, "CBAUD") else 0o010000
    room[9] = room[10] = 31_250
    fcntl.ioctl(client, 0x402C542B, room)
    again = array.array("i", [0] * 64)
    fcntl.ioctl(master, 0x802C542A, again)
    return [*found, again[9], again[10]]


def terminal_links() -> Any:
    master, client = _terminal()
    os.symlink(os.ttyname(client), "link")
    other = os.open("link", os.O_RDWR | os.O_NOCTTY)
    found = [
        os.ttyname(other) == os.ttyname(client),
        os.write(other, b"by the link"),
        _await(master),
    ]
    found.append(_plain(os.read(master, 99)))
    os.unlink("link")
    return [*found, _try(os.open, "link", os.O_RDWR)]


def terminal_by_pyserial() -> Any:
    master, client = os.openpty()
    name = os.ttyname(client)
    os.set_blocking(master, False)
    found = []
    with serial.Serial(name, 115_200, timeout=MOMENT, exclusive=True) as port:
        os.close(client)
        found += [port.write(b"abc\r\n"), _await(master), _plain(os.read(master, 99))]
        try:
            serial.Serial(name, exclusive=True)
        except serial.SerialException as error:
            found.append(error.errno == errno.EAGAIN)
        os.write(master, b"answer")
        found += [_plain(port.read(6)), _plain(port.read(1)), port.in_waiting]
        os.write(master, b"more")
        _await(port)
        found.append(port.in_waiting)
        port.reset_input_buffer()
        port.reset_output_buffer()
        found.append(port.in_waiting)
        port.baudrate = 31_250
        port.timeout = None
        waiting = _in_thread(port.read, 3)
        os.write(master, b"one")
        found.append(_result(*waiting))
        port.timeout = 0
        found.append(_plain(port.read(1)))
        port.timeout = PATIENCE
        waiting = _in_thread(port.read, 3)
        time.sleep(MOMENT)
        port.cancel_read()
        found.append(_result(*waiting))
        os.close(master)
        found.append(_try(port.read, 1))
    return found


# Threads


def thread_locks() -> Any:
    lock = threading.Lock()
    found = [_try(lock.release), lock.acquire(), lock.locked(), lock.acquire(False)]
    begin = time.monotonic()
    found += [lock.acquire(timeout=MOMENT), time.monotonic() - begin >= MOMENT]
    found += [_try(lock.acquire, False, 1), _try(lock.acquire, True, -2), lock.acquire(timeout=0)]
    waiting = _in_thread(lock.acquire)
    time.sleep(MOMENT)
    found.append(waiting[0].is_alive())
    lock.release()
    found += [_result(*waiting), lock.locked()]
    waiting = _in_thread(lock.release)
    found += [_result(*waiting), lock.locked()]
    with lock:
        found.append(lock.locked())
    return found


def thread_rlocks() -> Any:
    lock = threading.RLock()
    found = [_try(lock.release), lock.acquire(), lock.acquire(), _result(*_in_thread(lock.release))]
    found += [_result(*_in_thread(lock.acquire, False)), lock.release()]
    found += [_result(*_in_thread(lock.acquire, True, 0.01)), lock.release()]
    found.append(_result(*_in_thread(lock.acquire)))
    return [*found, lock.acquire(False), _try(lock.release)]


def thread_conditions() -> Any:
    condition = threading.Condition()
    found = [_try(condition.notify), _try(condition.wait, 0.01)]
    items: list[int] = []
    with condition:
        found += [condition.wait(0.01), condition.wait_for(lambda: False, 0.01)]

    def take() -> int:
        with condition:
            condition.wait_for(lambda: items)
            return items.pop()

    waiting = [_in_thread(take) for _ in range(3)]
    time.sleep(MOMENT)
    with condition:
        items.extend((1, 2))
        condition.notify(1)
    with condition:
        items.append(3)
        condition.notify_all()
    return [*found, sorted(_result(*each) for each in waiting)]


def thread_events() -> Any:
    event = threading.Event()
    begin = time.monotonic()
    found = [event.is_set(), event.wait(MOMENT), time.monotonic() - begin >= MOMENT]
    waiting = [_in_thread(event.wait) for _ in range(3)]
    event.set()
    found += [[_result(*each) for each in waiting], event.wait(), event.is_set()]
    event.clear()
    return [*found, event.wait(0)]


def thread_semaphores() -> Any:
    semaphore = threading.BoundedSemaphore(2)
    found = [semaphore.acquire(), semaphore.acquire(), semaphore.acquire(False)]
    found.append(semaphore.acquire(timeout=0.01))
    waiting = _in_thread(semaphore.acquire)
    semaphore.release()
    found.append(_result(*waiting))
    semaphore.release(2)
    return [*found, _try(semaphore.release), _try(threading.Semaphore, -1)]


def thread_barriers() -> Any:
    barrier = threading.Barrier(3)
    waiting = [_in_thread(barrier.wait) for _ in range(2)]
    numbers = sorted([barrier.wait(), *(_result(*each) for each in waiting)])
    found = [numbers, barrier.broken, barrier.n_waiting]
    waiting = [_in_thread(barrier.wait, 0.01)]
    found += [_result(*waiting[0]), barrier.broken, _try(barrier.wait)]
    barrier.reset()
    return [*found, barrier.broken]


def thread_queues() -> Any:
    line: queue.Queue[int] = queue.Queue(2)
    found: list[Any] = []
    with contextlib.suppress(queue.Empty):
        line.get(timeout=0.01)
        found.append("not empty")
    line.put(1)
    line.put(2)
    found += [line.full(), line.qsize()]
    try:
        line.put(3, timeout=0.01)
    except queue.Full:
        found.append("full")
    seen: list[int] = []

    def work() -> None:
        while (item := line.get()) >= 0:
            seen.append(item)
            line.task_done()

    waiting = _in_thread(work)
    for number in range(3, 10):
        line.put(number)
    line.join()
    line.put(-1)
    _result(*waiting)
    found.append(seen)
    urgent: queue.PriorityQueue[int] = queue.PriorityQueue()
    for number in (3, 1, 2):
        urgent.put(number)
    return [*found, [urgent.get() for _ in range(3)], _try(line.task_done), _try(line.task_done)]


def thread_simple_queues() -> Any:
    line: queue.SimpleQueue[int] = queue.SimpleQueue()
    found = [line.empty(), line.qsize()]
    waiting = _in_thread(line.get)
    line.put(1)
    found.append(_result(*waiting))
    begin = time.monotonic()
    try:
        line.get(timeout=MOMENT)
    except queue.Empty:
        found.append(time.monotonic() - begin >= MOMENT)
    try:
        line.get_nowait()
    except queue.Empty:
        found.append("empty")
    for number in range(3):
        line.put(number)
    return [*found, [line.get() for _ in range(3)]]


def thread_timers() -> Any:
    line: queue.SimpleQueue[str] = queue.SimpleQueue()
    begin = time.monotonic()
    timer = threading.Timer(MOMENT, line.put, ["rang"])
    cancelled = threading.Timer(MOMENT, line.put, ["cancelled"])
    timer.start()
    cancelled.start()
    cancelled.cancel()
    found = [line.get(timeout=PATIENCE), time.monotonic() - begin >= MOMENT]
    for each in (timer, cancelled):
        each.join()
    return [*found, line.empty(), timer.is_alive()]


def thread_joins() -> Any:
    go_on = threading.Event()
    thread = threading.Thread(target=go_on.wait, name="waiter")
    found = [_try(thread.join), thread.is_alive(), thread.daemon, thread.ident is None]
    thread.start()
    found += [_try(thread.start), thread.join(0.01), thread.is_alive(), thread.ident is None]
    found += [_try(threading.current_thread().join), thread in threading.enumerate()]
    found.append(_try(setattr, thread, "daemon", True))
    go_on.set()
    found += [thread.join(), thread.is_alive(), thread.join(), thread in threading.enumerate()]
    return [*found, thread.name, _try(thread.start)]


def thread_names() -> Any:
    main = threading.current_thread()
    found = [main is threading.main_thread(), main.name, main.daemon, threading.active_count()]

    def look() -> list[Any]:
        me = threading.current_thread()
        idents = me.ident == threading.get_ident(), me.ident == main.ident
        return [me is main, threading.main_thread() is main, me.daemon, *idents]

    found.append(_result(*_in_thread(look)))
    return [*found, threading.get_ident() == main.ident, threading.active_count()]


def thread_errors() -> Any:
    seen: list[Any] = []
    before = threading.excepthook
    threading.excepthook = lambda what: seen.append(
        [what.exc_type.__name__, str(what.exc_value), what.thread and what.thread.name]
    )

    def fail() -> None:
        raise LookupError("on purpose")

    def leave() -> None:
        sys.exit("no process ends by this")

    threads = [threading.Thread(target=each, name=each.__name__) for each in (fail, leave)]
    for thread in threads:
        thread.start()
        thread.join()
    threading.excepthook = before
    return [seen, [thread.is_alive() for thread in threads]]


def thread_own_variables() -> Any:
    own = threading.local()
    own.value = "main"

    def look() -> list[Any]:
        found = [hasattr(own, "value")]
        own.value = "other"
        return [*found, own.value]

    return [_result(*_in_thread(look)), own.value]


def thread_pools() -> Any:
    with concurrent.futures.ThreadPoolExecutor(3) as pool:
        found = list(pool.map(lambda number: number**2, range(10)))
        failed = pool.submit(lambda: 1 // 0)
        slow = pool.submit(time.sleep, MOMENT)
        error = type(failed.exception(PATIENCE)).__name__
        try:
            slow.result(0.001)
            error += " in time"
        except TimeoutError:
            error += " late"
    return [found, error, slow.done()]


def thread_order() -> Any:
    """Let two threads take turns by two semaphores."""
    turns = [threading.Semaphore(1), threading.Semaphore(0)]
    seen: list[int] = []

    def play(me: int) -> None:
        for _ in range(20):
            turns[me].acquire()
            seen.append(me)
            turns[1 - me].release()

    players = [_in_thread(play, me) for me in range(2)]
    return [[_result(*each) for each in players], seen == [0, 1] * 20]


def thread_sums() -> Any:
    """Let threads add under a lock."""
    lock, total = threading.Lock(), [0]

    def add() -> None:
        for _ in range(50):
            with lock:
                before = total[0]
                time.sleep(0)
                total[0] = before + 1

    threads = [_in_thread(add) for _ in range(4)]
    return [[_result(*each) for each in threads], total]


# Time


def time_goes_on() -> Any:
    clocks = (time.monotonic, time.perf_counter, time.time, time.monotonic_ns, time.time_ns)
    found = []
    for clock in clocks:
        looks = [clock() for _ in range(100)]
        found.append(looks == sorted(looks))
    before = time.monotonic()
    wall = time.time()
    time.sleep(MOMENT)
    found += [time.monotonic() - before >= MOMENT, time.time() - wall >= 0.9 * MOMENT]
    found += [
        _try(time.sleep, -1),
        time.sleep(0),
        abs(time.monotonic() - time.monotonic_ns() / 1e9) < 1,
    ]
    return found


def time_spins() -> Any:
    end = time.monotonic() + 0.01
    count = 0
    while time.monotonic() < end:
        count += 1
    return count > 10


def time_waits_are_not_short() -> Any:
    reading, _ = os.pipe()
    near, _ = _tcp()
    near.settimeout(MOMENT)
    epoll, poll = select.epoll(), select.poll()
    epoll.register(reading, select.EPOLLIN)
    poll.register(reading, select.POLLIN)
    thread = threading.Thread(target=os.read, args=(reading, 1), daemon=True)
    thread.start()
    condition = threading.Condition()

    def wait() -> None:
        with condition:
            condition.wait(MOMENT)

    waits: tuple[Callable[[], object], ...] = (
        lambda: time.sleep(MOMENT),
        lambda: epoll.poll(MOMENT),
        lambda: poll.poll(1000.0 * MOMENT),
        lambda: select.select([reading], [], [], MOMENT),
        lambda: thread.join(MOMENT),
        lambda: threading.Event().wait(MOMENT),
        lambda: threading.Semaphore(0).acquire(timeout=MOMENT),
        lambda: _try(near.recv, 1),
        wait,
    )
    found = []
    for each in waits:
        begin = time.monotonic()
        each()
        found.append(time.monotonic() - begin >= MOMENT)
    return found


# Processes


def _python(program: str, *arguments: object, **more: Any) -> Any:
    """Start a program of Python."""
    command = [sys.executable, "-S", "-c", program, *map(str, arguments)]
    return subprocess.Popen(command, **more)


@contextlib.contextmanager
def _telling(program: str, **more: Any) -> Iterator[tuple[Any, int, int]]:
    """Give a child a pipe in each direction: its arguments; yield it and our ends."""
    reading, out = os.pipe()
    into, writing = os.pipe()
    child = _python(program, into, out, pass_fds=(into, out), **more)
    os.close(into)
    os.close(out)
    try:
        yield child, reading, writing
    finally:
        child.kill()
        child.wait()
        os.close(reading)
        os.close(writing)


_HEAD = "import os, sys, time, signal, threading\ninto, out = map(int, sys.argv[1:])\n"


def process_exit_codes() -> Any:
    programs = (
        "pass",
        "import sys; sys.exit(3)",
        "import sys; sys.exit(None)",
        "import sys; sys.exit(True)",
        "import sys; sys.exit(256 + 7)",
        "import os; os._exit(5)",
        "import sys\ntry:\n    sys.exit(4)\nfinally:\n    pass",
        "raise SystemExit",
    )
    children = [_python(each) for each in programs]
    return [child.wait(PATIENCE) for child in children]


def process_exit_texts() -> Any:
    found = []
    for program in ("import sys; sys.exit('a text')", "raise SystemExit(('a', 1))"):
        reading, writing = os.pipe()
        child = _python(program, stderr=writing)
        os.close(writing)
        with os.fdopen(reading) as file:
            found += [file.read(), child.wait(PATIENCE)]
    return found


def process_outputs() -> Any:
    reading, writing = os.pipe()
    program = (
        "import os, sys\nprint('printed', flush=True)\nos.write(1, b'written\\n')\n"
        "print('to stderr', file=sys.stderr)\nsys.stdout.write('at the end')"
    )
    child = _python(program, stdout=writing, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL)
    os.close(writing)
    with os.fdopen(reading) as file:
        found = [file.read(), child.wait(PATIENCE)]
    child = _python("print('nobody reads this')", stdout=subprocess.DEVNULL)
    return [*found, child.wait(PATIENCE)]


def process_pipes() -> Any:
    program = f"{_HEAD}os.write(out, os.read(into, 99).upper())"
    with _telling(program) as (child, reading, writing):
        found = [child.poll(), os.write(writing, b"abc"), _plain(os.read(reading, 99))]
        found += [
            _plain(os.read(reading, 99)),
            child.wait(PATIENCE),
            child.poll(),
            child.returncode,
        ]
        return [*found, _try(os.write, writing, b"x")]


def process_arguments() -> Any:
    program = f"{_HEAD}os.write(out, repr([sys.argv[0], __name__, os.getpid()]).encode())"
    with _telling(program) as (child, reading, _):
        return _plain(os.read(reading, 99)) == repr(["-c", "__main__", child.pid])


def process_terminated() -> Any:
    program = f"{_HEAD}os.write(out, b'up')\nos.read(into, 1)"
    with _telling(program) as (child, reading, _):
        found = [_plain(os.read(reading, 9)), _try(child.wait, MOMENT)]
        child.terminate()
        found += [child.wait(PATIENCE), _plain(os.read(reading, 9)), child.terminate()]
    with _telling(program) as (child, reading, _):
        os.read(reading, 9)
        os.kill(child.pid, signal.SIGUSR1)
        found.append(child.wait(PATIENCE))
    return [*found, _try(os.kill, child.pid, 0)]


def process_wait_times_out() -> Any:
    with _telling(f"{_HEAD}os.read(into, 1)") as (child, _, writing):
        begin = time.monotonic()
        try:
            child.wait(MOMENT)
        except subprocess.TimeoutExpired as error:
            found = [error.timeout, time.monotonic() - begin >= MOMENT, child.returncode]
        os.write(writing, b"x")
        return [*found, child.wait(PATIENCE), child.wait()]


def process_handles_a_signal() -> Any:
    program = (
        f"{_HEAD}"
        "def stop(number, frame):\n    os.write(out, b'stopping')\n    sys.exit(7)\n"
        "signal.signal(signal.SIGTERM, stop)\nos.write(out, b'up')\ntime.sleep(60)"
    )
    with _telling(program) as (child, reading, _):
        found = [_plain(os.read(reading, 9))]
        child.send_signal(signal.SIGTERM)
        return [*found, _plain(os.read(reading, 99)), child.wait(PATIENCE)]


def process_goes_on_after_a_signal() -> Any:
    program = (
        f"{_HEAD}"
        "signal.signal(signal.SIGUSR1, lambda *_: os.write(out, b'handled'))\n"
        "signal.signal(signal.SIGUSR2, signal.SIG_IGN)\n"
        "os.write(out, b'up')\nos.write(out, os.read(into, 9))"
    )
    with _telling(program) as (child, reading, writing):
        found = [_plain(os.read(reading, 2))]
        child.send_signal(signal.SIGUSR2)
        child.send_signal(signal.SIGUSR1)
        found.append(_plain(os.read(reading, 99)))
        os.write(writing, b"go on")
        return [*found, _plain(os.read(reading, 99)), child.wait(PATIENCE)]


def process_signals_while_it_waits() -> Any:
    waits = (
        "time.sleep(60)",
        "os.read(into, 1)",
        "threading.Event().wait()",
        "threading.Lock().acquire() and threading.Event().wait(60)",
        "import select; select.select([into], [], [])",
        "import socket; a, b = socket.socketpair(); a.recv(1)",
        "t = threading.Thread(target=os.read, args=(into, 1), daemon=True); t.start(); t.join()",
    )
    found = []
    for wait in waits:
        program = (
            f"{_HEAD}"
            "def stop(number, frame):\n    raise SystemExit(9)\n"
            f"signal.signal(signal.SIGTERM, stop)\nos.write(out, b'up')\n{wait}"
        )
        with _telling(program) as (child, reading, _):
            os.read(reading, 2)
            time.sleep(MOMENT / 2)
            child.terminate()
            found.append(child.wait(PATIENCE))
    return found


def process_interrupted() -> Any:
    program = f"{_HEAD}os.write(out, b'up')\ntime.sleep(60)"
    with _telling(program, stderr=subprocess.DEVNULL) as (child, reading, _):
        os.read(reading, 2)
        child.send_signal(signal.SIGINT)
        found = [child.wait(PATIENCE)]
    program = (
        f"{_HEAD}try:\n    os.write(out, b'up')\n"
        "    time.sleep(60)\nexcept KeyboardInterrupt:\n    sys.exit(11)"
    )
    with _telling(program) as (child, reading, _):
        os.read(reading, 2)
        child.send_signal(signal.SIGINT)
        return [*found, child.wait(PATIENCE)]


def process_stopped() -> Any:
    program = f"{_HEAD}\nwhile data := os.read(into, 9):\n    os.write(out, data.upper())"
    with _telling(program) as (child, reading, writing):
        os.write(writing, b"a")
        found = [_plain(os.read(reading, 9))]
        child.send_signal(signal.SIGSTOP)
        child.send_signal(signal.SIGSTOP)
        time.sleep(MOMENT)
        os.write(writing, b"b")
        found += [_comes(reading), child.poll()]
        child.send_signal(signal.SIGCONT)
        found.append(_plain(os.read(reading, 9)))
        child.send_signal(signal.SIGSTOP)
        child.kill()
        return [*found, child.wait(PATIENCE), _plain(os.read(reading, 9))]


def process_terminated_while_stopped() -> Any:
    program = f"{_HEAD}os.write(out, b'up')\nos.read(into, 1)"
    with _telling(program) as (child, reading, _):
        os.read(reading, 2)
        child.send_signal(signal.SIGSTOP)
        time.sleep(MOMENT)
        child.terminate()
        found = [_try(child.wait, 2 * MOMENT), child.returncode]
        child.send_signal(signal.SIGCONT)
        return [*found, child.wait(PATIENCE)]


def process_waits_for_its_threads() -> Any:
    program = (
        f"{_HEAD}"
        "def work():\n    os.read(into, 1)\n    os.write(out, b'worked')\n"
        "threading.Thread(target=work).start()\n"
        "threading.Thread(target=lambda: (time.sleep(600), os.write(out, b'late')), daemon=True).start()"
    )
    with _telling(program) as (child, reading, writing):
        found = [_try(child.wait, 2 * MOMENT)]
        os.write(writing, b"x")
        return [
            *found,
            _plain(os.read(reading, 9)),
            child.wait(PATIENCE),
            _plain(os.read(reading, 9)),
        ]


def process_says_goodbye() -> Any:
    program = (
        f"{_HEAD}import atexit\n"
        "atexit.register(os.write, out, b'second')\natexit.register(os.write, out, b'first ')\n"
        "os.write(out, b'main ')\nsys.exit(2)"
    )
    with _telling(program) as (child, reading, _):
        found = [child.wait(PATIENCE), _plain(os.read(reading, 99))]
    with _telling(program.replace("sys.exit", "os._exit")) as (child, reading, _):
        return [*found, child.wait(PATIENCE), _plain(os.read(reading, 99))]


def process_exits_in_a_thread() -> Any:
    program = f"{_HEAD}threading.Thread(target=os._exit, args=(6,)).start()\ntime.sleep(60)"
    with _telling(program) as (child, reading, _):
        return [child.wait(PATIENCE), _plain(os.read(reading, 9))]


def process_with_a_socket() -> Any:
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    near.settimeout(PATIENCE)
    program = (
        "import os, socket, sys\nsock = socket.socket(fileno=int(sys.argv[1]))\n"
        "reading, writing = os.pipe()\nsocket.send_fds(sock, [b'take'], [reading])\n"
        "os.write(writing, sock.recv(9))"
    )
    child = _python(program, far.fileno(), pass_fds=[far.fileno()])
    far.close()
    data, numbers, _, _ = socket.recv_fds(near, 99, 1)
    near.send(b"through")
    found = [_plain(data), _plain(os.read(numbers[0], 99)), child.wait(PATIENCE)]
    return [*found, _plain(near.recv(9)), _plain(os.read(numbers[0], 9))]


def process_serves_tcp() -> Any:
    program = (
        f"{_HEAD}import socket\nserver = socket.create_server(('127.0.0.1', 0))\n"
        "os.write(out, str(server.getsockname()[1]).encode())\n"
        "sock, _ = server.accept()\nsock.sendall(sock.recv(9).upper())\nos.read(into, 1)"
    )
    with _telling(program) as (child, reading, _):
        port = int(os.read(reading, 9))
        near = socket.create_connection((LOCAL, port), PATIENCE)
        near.sendall(b"abc")
        found = [_plain(near.recv(9))]
        child.kill()
        found += [_plain(near.recv(9)), child.wait(PATIENCE)]
        return [*found, _try(socket.create_connection, (LOCAL, port))]


def process_has_own_descriptors() -> Any:
    reading, writing = os.pipe()
    program = (
        f"{_HEAD}def use(number):\n    try:\n        os.write(number, b'x')\n"
        "    except OSError as error:\n        return str(error.errno)\n    return 'used'\n"
    )
    with _telling(f"{program}os.write(out, use({writing}).encode())") as (_, told, _):
        return [_plain(os.read(told, 9)), _comes(reading)]


def process_by_run() -> Any:
    done = subprocess.run([sys.executable, "-S", "-c", "import sys; sys.exit(3)"])
    found = [done.returncode]
    command = [sys.executable, "-S", "-c", "print(input().upper())"]
    answer = subprocess.run(
        command, input="abc\n", capture_output=True, text=True, timeout=PATIENCE
    )
    found += [answer.returncode, answer.stdout, answer.stderr]
    command = [sys.executable, "-S", "-c", "import time; time.sleep(60)"]
    try:
        subprocess.run(command, timeout=4 * MOMENT)
    except subprocess.TimeoutExpired:
        found.append("late")
    return found


def process_missing() -> Any:
    return [_try(subprocess.Popen, ["./no-such-program"]), _try(os.kill, 2**22 + 5, 0)]


# Signals


def signal_defaults() -> Any:
    asked = (signal.SIGTERM, signal.SIGINT, signal.SIGPIPE, signal.SIGUSR1, signal.SIGCHLD)
    found = [getattr(signal.getsignal(each), "name", None) for each in asked]
    found.append(signal.getsignal(signal.SIGINT) is signal.default_int_handler)
    return found


def signal_handlers() -> Any:
    seen: list[int] = []

    def handle(number: int, _: object) -> None:
        seen.append(number)

    found: list[Any] = [signal.signal(signal.SIGUSR1, handle) == signal.SIG_DFL]
    found.append(signal.getsignal(signal.SIGUSR1) is handle)
    os.kill(os.getpid(), signal.SIGUSR1)
    found.append(list(seen))
    signal.raise_signal(signal.SIGUSR1)
    found += [list(seen), signal.signal(signal.SIGUSR1, signal.SIG_IGN) is handle]
    os.kill(os.getpid(), signal.SIGUSR1)
    found += [list(seen), _try(signal.signal, signal.SIGKILL, handle)]
    found += [_try(signal.signal, 999, handle), _try(signal.signal, signal.SIGUSR1, "x")]
    found.append(_result(*_in_thread(signal.signal, signal.SIGUSR1, handle)))
    return [*found, os.kill(os.getpid(), 0)]


def signal_while_sleeping() -> Any:
    seen: list[int] = []
    signal.signal(signal.SIGUSR1, lambda number, _: seen.append(number))
    begin = time.monotonic()
    timer = threading.Timer(MOMENT, os.kill, [os.getpid(), signal.SIGUSR1])
    timer.start()
    time.sleep(3 * MOMENT)
    found = [time.monotonic() - begin >= 3 * MOMENT, list(seen)]

    def stop(number: int, _: object) -> None:
        raise LookupError(number)

    signal.signal(signal.SIGUSR1, stop)
    timer = threading.Timer(MOMENT, os.kill, [os.getpid(), signal.SIGUSR1])
    timer.start()
    try:
        threading.Event().wait(PATIENCE)
    except LookupError as error:
        found.append(error.args[0])
    timer.join()
    return found


def time_of_dates() -> Any:
    now, utc = time.time(), datetime.UTC
    looks = [
        datetime.datetime.now(utc).timestamp(),
        datetime.datetime.now().astimezone().timestamp(),
        datetime.datetime.now().timestamp(),
        datetime.datetime.today().timestamp(),
        datetime.datetime.fromtimestamp(now, utc).timestamp(),
        time.mktime(time.localtime()),
        time.mktime(time.strptime(time.ctime())),
        time.mktime(time.strptime(time.asctime())),
        time.mktime(time.strptime(time.strftime("%Y %m %d %H %M %S"), "%Y %m %d %H %M %S")),
        time.mktime(time.gmtime()) - time.mktime(time.gmtime(now)) + now,
    ]
    day = datetime.date.today()
    return [abs(look - now) < PATIENCE for look in looks] + [
        abs((day - datetime.date.fromtimestamp(now)).days) <= 1,
        time.localtime(0.0) == time.localtime(0),
        time.strftime("%Y", time.gmtime(0)),
    ]


def time_kinds_of_dates() -> Any:
    moment = datetime.datetime(2026, 2, 3, 4, 5, 6, 7, tzinfo=datetime.UTC)
    day, now = datetime.date(2026, 2, 3), datetime.datetime.now()
    later = moment + datetime.timedelta(days=1)
    return [
        moment.isoformat(),
        day.isoformat(),
        later.isoformat(),
        (later - moment).total_seconds(),
        datetime.datetime.combine(day, moment.time()).isoformat(),
        datetime.datetime.strptime("2026-02-03", "%Y-%m-%d").isoformat(),
        datetime.datetime.fromisoformat("2026-02-03T04:05:06").isoformat(),
        pickle.loads(pickle.dumps(moment)) == moment,
        copy.deepcopy(day) == day,
        [isinstance(each, datetime.datetime) for each in (moment, later, now, day)],
        [isinstance(each, datetime.date) for each in (moment, now, day, 3)],
        [issubclass(type(each), datetime.datetime) for each in (moment, day)],
        issubclass(datetime.datetime, datetime.date),
        repr(moment),
        _try(datetime.datetime, 2026, 2, 31),
        datetime.datetime.max.isoformat(),
    ]


def _programs() -> dict[str, Callable[[], Any]]:
    kinds = "tcp udp names unix pipe files counter select poll epoll selector terminal thread time"
    prefixes = (*kinds.split(), "process", "signal")
    return {
        name: each
        for name, each in globals().items()
        if callable(each) and name.split("_")[0] in prefixes
    }


def _in_a_world(program: Callable[[], Any]) -> Callable[[object], Any]:
    return lambda _: program()


WORLDS = SimpleNamespace(**{name: _in_a_world(each) for name, each in _programs().items()})
"""Scenarios of the same names."""

"""A network between a UR driver and its controller in which exactly one message can go wrong."""

from __future__ import annotations

import select
import socket
import struct
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from types import SimpleNamespace
from typing import Any

from rigs.ur_bench import LONG, UrBench, brisk_sim, driver_at

PORTS = (30001, 30002, 30003, 30004, 30011, 29999)
RTDE = 30004
STATE = ord("U")
TIME_STAMP = struct.Struct(">d")
"""What a state begins with after its header, s."""

LATE = 0.4
"""Seconds."""

PIECES = 20
"""Into which a message is split, at least."""

Chosen = Callable[[int, bool, bytes], bool]
"""Whether a message is the one: port, whether it goes to the controller, bytes."""


class Proxy:
    """Listens on the ports of a controller at an address of its own, and passes messages on to it.

    Args:
        host: of this.
        controller: address of the controller.

    Attributes:
        lag: seconds that every message takes, to the controller (True) and from it (False).
        came: when a state came from the controller, in monotonic seconds, by its time stamp.
    """

    def __init__(self, host: str, controller: str) -> None:
        self.host = host
        self._controller = controller
        self.lag = {True: 0.0, False: 0.0}
        self.came: dict[float, float] = {}
        self._ended = threading.Event()
        self._lock = threading.Lock()
        self._chosen: Chosen | None = None
        self._action = ""
        self.hit = threading.Event()
        self._sockets: list[socket.socket] = []
        for port in PORTS:
            listener = socket.create_server((host, port))
            self._sockets.append(listener)
            threading.Thread(target=self._accept, args=(listener, port), daemon=True).start()

    def spoil(self, action: str, chosen: Chosen) -> None:
        """Let the next message that is chosen be ``lost``, ``doubled``, ``late``, ``split`` or ``cut``."""
        with self._lock:
            self.hit.clear()
            self._action, self._chosen = action, chosen

    def clear(self) -> None:
        """Let every message pass at once."""
        with self._lock:
            self._chosen = None
        self.lag = {True: 0.0, False: 0.0}

    def close(self) -> None:
        """Close everything."""
        self._ended.set()
        for one in self._sockets:
            with suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
            one.close()

    def _accept(self, listener: socket.socket, port: int) -> None:
        while not self._ended.is_set():
            try:
                near, _ = listener.accept()
                far = socket.create_connection((self._controller, port), LONG)
            except OSError:
                continue
            for one in (near, far):
                one.settimeout(None)
                one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._sockets.append(one)
            for source, target, inward in ((near, far, True), (far, near, False)):
                threading.Thread(
                    target=self._pass, args=(source, target, port, inward), daemon=True
                ).start()

    def _pass(self, source: socket.socket, target: socket.socket, port: int, inward: bool) -> None:
        with suppress(OSError, ValueError):  # closed meanwhile
            for messages in self._due(source, port, inward):
                self._deliver(messages, target, port, inward)
        for one in (source, target):
            with suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)

    def _due(self, source: socket.socket, port: int, inward: bool) -> Iterator[list[bytes]]:
        """Yield what has taken its time, all at once, until the other end has closed."""
        under_way: deque[tuple[float, bytes]] = deque()
        buffer, is_open = b"", True
        while is_open or under_way:
            now = time.monotonic()
            left = max(0.0, under_way[0][0] - now) if under_way else None
            if not is_open:
                time.sleep(left or 0.0)
            elif select.select([source], [], [], left)[0]:
                data = source.recv(65536)
                is_open = bool(data)
                messages, buffer = _messages(buffer + data, port)
                now = time.monotonic()
                due = now + self.lag[inward]
                under_way.extend((due, message) for message in messages)
                if port == RTDE and not inward:
                    self.came |= dict.fromkeys(map(_time_stamp, filter(_is_state, messages)), now)
            now = time.monotonic()
            ready = []
            while under_way and under_way[0][0] <= now:
                ready.append(under_way.popleft()[1])
            if ready:
                yield ready

    def _action_for(self, port: int, inward: bool, message: bytes) -> str:
        if self._chosen is None:
            return ""
        with self._lock:
            if self._chosen is None or not self._chosen(port, inward, message):
                return ""
            self._chosen = None
            self.hit.set()
            return self._action

    def _deliver(
        self, messages: list[bytes], target: socket.socket, port: int, inward: bool
    ) -> None:
        sound: list[bytes] = []
        for message in messages:
            action = self._action_for(port, inward, message)
            if not action:
                sound.append(message)
                continue
            target.sendall(b"".join(sound))
            sound.clear()
            _spoiled(message, target, action)
        if sound:
            target.sendall(b"".join(sound))


def _spoiled(message: bytes, target: socket.socket, action: str) -> None:
    if action == "lost":
        return
    if action == "cut":
        raise OSError("cut")
    if action == "late":
        time.sleep(LATE)
    if action == "split":
        size = max(1, len(message) // PIECES)
        for start in range(0, len(message), size):
            target.sendall(message[start : start + size])
            time.sleep(0.001)
        return
    target.sendall(message * (2 if action == "doubled" else 1))


def _is_state(message: bytes) -> bool:
    return message[2] == STATE and len(message) > 4 + TIME_STAMP.size


def _time_stamp(state: bytes) -> float:
    return float(TIME_STAMP.unpack_from(state, 4)[0])


def _messages(data: bytes, port: int) -> tuple[list[bytes], bytes]:
    """Return whole packages of RTDE, of the other ports what is there, and the rest."""
    if port != RTDE:
        return ([data] if data else []), b""
    found, start = [], 0
    while len(data) - start >= 3:
        (size,) = struct.unpack_from(">H", data, start)
        if len(data) - start < size:
            break
        found.append(data[start : start + size])
        start += size
    return found, data[start:]


@contextmanager
def proxy_to(controller: str) -> Iterator[Proxy]:
    """A proxy at a loopback address that is free."""
    last = 1
    while True:
        try:
            proxy = Proxy(f"127.77.77.{last}", controller)
            break
        except OSError:
            last += 1
    try:
        yield proxy
    finally:
        proxy.close()


@contextmanager
def bench_at_proxy(config: Mapping[str, Any]) -> Iterator[tuple[UrBench, Proxy]]:
    """A simulated controller, a proxy to it, and a driver that is connected to that."""
    with brisk_sim(model="ur5e") as sim, proxy_to(sim.host) as proxy:
        at_proxy: Any = SimpleNamespace(host=proxy.host, control=sim.control)
        with driver_at(at_proxy, config) as bench:
            yield bench, proxy

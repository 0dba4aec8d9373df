"""A network between a UR driver and its controller in which exactly one message can go wrong."""

from __future__ import annotations

import queue
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from types import SimpleNamespace
from typing import Any

from crtk_sim_backends.ur import SIM
from rigs.ur_bench import UrBench, driver_at

PORTS = (30001, 30002, 30003, 30004, 30011, 29999)
RTDE = 30004
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
    """

    def __init__(self, host: str, controller: str) -> None:
        self.host = host
        self._controller = controller
        self.lag = {True: 0.0, False: 0.0}
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
                far = socket.create_connection((self._controller, port), 5.0)
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
        under_way: queue.Queue[tuple[float, bytes]] = queue.Queue()
        threading.Thread(
            target=self._hand_over, args=(under_way, source, target, port, inward), daemon=True
        ).start()
        with suppress(OSError):
            for message in _messages(source, port):
                under_way.put((time.monotonic(), message))
        under_way.put((0.0, b""))

    def _hand_over(
        self,
        under_way: queue.Queue[tuple[float, bytes]],
        source: socket.socket,
        target: socket.socket,
        port: int,
        inward: bool,
    ) -> None:
        with suppress(OSError):
            while True:
                came, message = under_way.get()
                if not message:
                    break
                time.sleep(max(0.0, came + self.lag[inward] - time.monotonic()))
                self._deliver(message, target, self._action_for(port, inward, message))
        for one in (source, target):
            with suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)

    def _action_for(self, port: int, inward: bool, message: bytes) -> str:
        if self._chosen is None:
            return ""
        with self._lock:
            if self._chosen is None or not self._chosen(port, inward, message):
                return ""
            self._chosen = None
            self.hit.set()
            return self._action

    def _deliver(self, message: bytes, target: socket.socket, action: str) -> None:
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


def _messages(source: socket.socket, port: int) -> Iterator[bytes]:
    """Yield whole packages of RTDE; of the other ports what comes in one piece."""
    buffer = b""
    while data := source.recv(65536):
        if port != RTDE:
            yield data
            continue
        buffer += data
        while len(buffer) >= 3 and len(buffer) >= (size := struct.unpack_from(">H", buffer)[0]):
            yield buffer[:size]
            buffer = buffer[size:]


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
    with SIM.spawn(realtime=True, model="ur5e") as sim, proxy_to(sim.host) as proxy:
        at_proxy: Any = SimpleNamespace(host=proxy.host, control=sim.control)
        with driver_at(at_proxy, config) as bench:
            yield bench, proxy

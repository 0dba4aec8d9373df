"""A virtual CAN bus: everybody who is connected gets the frames of all others.

How to connect, from another process (see `crtk_sim_backends.can.bus` and docs/can_hub.md):

* python-can: ``can.Bus(interface="crtk", channel="/path/to.sock")``, or the name of a hub that was
  started with a name, ``can.Bus(interface="crtk", channel="can0")``. Has `fileno()`.
* a program of its own: AF_UNIX, SOCK_SEQPACKET, connect to the path. Each packet to the hub is one
  or more `struct can_frame` (16 bytes, little-endian, linux/can.h, flags in the identifier), each
  packet from it exactly one. A frame is not returned to its sender.
* socketcand: ``can.Bus(interface="socketcand", host=..., port=..., channel="can0")``.
* slcan: ``can.Bus(interface="slcan", channel=TTY, bitrate=1000000, sleep_after_open=0)``, or
  ``slcand -o -s8 TTY can0``.

And inside the process of the hub, as the simulated drives do::

    hub = Hub(bitrate=1_000_000)
    node = hub.attach(on_frame, name="drive-1")    # on_frame(can_id, data), from the hub's thread
    hub.open_socket("/tmp/can0.sock")              # the doors for other processes, each as wanted
    hub.open_socketcand("127.0.0.1", 29536)
    hub.open_slcan()
    hub.join_interface("vcan0")                    # where the kernel has CAN
    hub.call_at(time.monotonic() + 0.1, lambda: node.send(0x701, b"\\x05"))
    hub.run()                                      # until hub.stop(); hub.step(until) is one round
    hub.close()

`can_id` carries the flags of linux/can.h (`frames.EXTENDED`, `frames.REMOTE`, `frames.ERROR`).
`send` returns 0, or the errno that a network interface would give: ENOBUFS, ENETDOWN.

The hub lives in one thread and takes no locks: attach, send, call_at and step are called from that
thread; only `stop` may be called from anywhere, signal handlers included.
"""

from __future__ import annotations

import errno
import logging
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from types import TracebackType
from typing import Any, Final, Self, TypeVar

from crtk_sim_backends.can import frames
from crtk_sim_backends.can.candump import LogWriter
from crtk_sim_backends.can.injection import FrameHook
from crtk_sim_backends.can.kernel import KernelDoor
from crtk_sim_backends.can.medium import Medium
from crtk_sim_backends.can.native import SocketDoor
from crtk_sim_backends.can.node import Node
from crtk_sim_backends.can.port import DEAF, REFUSING, Counters, Port, State
from crtk_sim_backends.can.slcan import SlcanDoor
from crtk_sim_backends.can.socketcand import SocketcandDoor
from crtk_sim_backends.kit.loop import Loop, Timer

DEFAULT_QUEUE: Final = 128
"""Frames of one node that may wait for the bus, as `txqueuelen` of a network interface."""

_FRAMES_PER_ROUND: Final = 1000  # then sockets and timers have their turn
_MOST_ROUTES: Final = 4096  # that are remembered

log = logging.getLogger(__name__)

FrameCallback = Callable[[int, bytes], object]


DoorKind = TypeVar("DoorKind", SocketDoor, SocketcandDoor, SlcanDoor, KernelDoor)


@dataclass
class _Route:
    """Where a frame goes that has a certain sender and identifier.

    Attributes:
        heard: counters of all nodes that hear it, its sender's too when it comes back.
        given: ports that are given it.
        returned: whether it comes back to its sender.
        passed: frames that went this way and are not in the counters yet.
    """

    heard: tuple[Counters, ...]
    given: tuple[Port, ...]
    returned: bool
    passed: int = 0


class _Local:
    """Port of a node in this process."""

    def __init__(self, callback: FrameCallback) -> None:
        self._callback = callback

    def deliver(self, raw: bytes) -> None:
        self._callback(*frames.unpack(raw))

    def state_changed(self, state: State) -> None:
        """Do nothing: `Node.state` tells."""

    def waiting(self, count: int) -> None:
        """Do nothing: `Node.send` tells when the queue is full."""


class Hub:
    """The bus, its nodes and its doors.

    Args:
        bitrate: bit/s at which frames follow each other; 0: as fast as the machine can.
        stuffing: how stuffed bits are counted (`medium.STUFFING`).
        echo: whether nodes get their own frames back.
        queue: how many frames of one node may wait for the bus; at bit rate 0 nothing waits.
    """

    def __init__(
        self,
        bitrate: int = 0,
        stuffing: str = "exact",
        *,
        echo: bool = False,
        queue: int = DEFAULT_QUEUE,
    ) -> None:
        self.bitrate = bitrate
        self.echo = echo
        self.queue = queue
        self.loop = Loop()
        self.nodes: list[Node] = []
        self.frame_count = 0  # that went over the bus
        self.recorder: LogWriter | None = None
        self.hook: FrameHook | None = None
        self.state_of: Callable[[str], State] = lambda name: State(0)
        self.happened: Callable[[str], object] = lambda event: None  # one of `injection.EVENTS`
        self._medium = Medium[Node](bitrate, stuffing) if bitrate else None
        self._pending: deque[tuple[Node, bytes]] = deque()  # at bit rate 0
        self._routes: dict[tuple[Node, bytes], _Route] = {}
        self._unsent: list[Callable[[], object]] = []
        self._afterwards: list[Callable[[], object]] = []
        self._doors: list[SocketDoor | SocketcandDoor | SlcanDoor | KernelDoor] = []
        self._errors = Node(self, "errors", _Local(lambda can_id, data: None))
        self._numbers: dict[str, int] = {}

    # Nodes

    def attach(self, callback: FrameCallback, name: str = "node") -> Node:
        """Add a node of this process; ``callback(can_id, data)`` gets the frames of all others."""
        return self.add(name, _Local(callback))

    def add(self, name: str, port: Port) -> Node:
        """Add a node with a port of its own kind; a name that is taken gets a number."""
        node = Node(self, self._free_name(name), port)
        node.state = self.state_of(node.name)
        self.nodes = [*self.nodes, node]  # a new list: somebody may be going through the old one
        self.forget_routes()
        return node

    def _free_name(self, name: str) -> str:
        taken = {node.name for node in self.nodes}
        chosen = name
        while chosen in taken:
            self._numbers[name] = self._numbers.get(name, 1) + 1
            chosen = f"{name}-{self._numbers[name]}"
        return chosen

    def rename(self, node: Node, name: str) -> None:
        """Give a node the name that its client has asked for, with a number when it is taken."""
        if name != node.name:
            node.name = self._free_name(name)
            self.set_state(node, self.state_of(node.name))

    def remove(self, node: Node) -> None:
        """Take a node off the bus; what waits in its queue is still sent."""
        self.nodes = [other for other in self.nodes if other is not node]
        self.forget_routes()

    def waiting(self, node: Node) -> int:
        """How many frames of a node wait for the bus."""
        return 0 if self._medium is None else self._medium.waiting(node)

    def set_state(self, node: Node, state: State) -> None:
        """Change what is wrong with a node's interface, and tell it."""
        if state == node.state:
            return
        if state & DEAF and self._medium is not None:
            node.counters.lost += self._medium.forget(node)
            node.port.waiting(0)
        node.state = state
        self.forget_routes()
        node.port.state_changed(state)

    # Frames

    def transmit(self, node: Node, raw: bytes) -> int:
        """Queue a checked frame of `node`; 0, or why it was not taken: ENOBUFS or ENETDOWN."""
        state = node.state
        if not state and self.hook is None and self._medium is None:
            self._pending.append((node, raw))
            return 0
        if state and state & (REFUSING | State.LISTEN_ONLY):
            node.counters.lost += 1
            if state & State.DOWN:
                return errno.ENETDOWN
            return errno.ENOBUFS if state & REFUSING else 0
        if self.hook is None:
            return self._queue(node, raw)
        now = time.monotonic()
        result = 0
        pieces = self.hook(node.name, raw, now)
        if not pieces:
            node.counters.lost += 1
        for seconds, piece in pieces:
            if seconds > 0.0:
                self.call_at(now + seconds, partial(self._queue, node, piece))
            else:
                result = self._queue(node, piece)
        return result

    def _queue(self, node: Node, raw: bytes) -> int:
        medium = self._medium
        if medium is None:
            self._pending.append((node, raw))
        elif medium.waiting(node) >= self.queue:
            node.counters.lost += 1
            return errno.ENOBUFS
        else:
            medium.put(node, raw, time.monotonic())
            node.port.waiting(medium.waiting(node))
        return 0

    def error(self, classes: int, data: bytes = bytes(8), node: Node | None = None) -> None:
        """Let `node` receive an error frame (`frames.ERROR_...`), or all nodes, from the bus."""
        raw = frames.error_frame(classes, data)
        if node is not None:
            if node.listening and not node.state & State.DOWN:
                node.counters.received += 1
                node.port.deliver(raw)
        elif self._medium is None:
            self._pending.append((self._errors, raw))
        elif self._medium.waiting(self._errors) < self.queue:
            self._medium.put(self._errors, raw, time.monotonic())

    def _move(self) -> None:
        """Deliver what has gone over the bus."""
        if self._medium is None:
            pending = self._pending
            for _ in range(_FRAMES_PER_ROUND):
                if not pending:
                    break
                sender, raw = pending.popleft()
                if self.recorder is not None:
                    self.recorder.write(time.time(), raw)
                self._deliver(sender, raw)
        else:
            for transfer in self._medium.due(time.monotonic()):
                transfer.sender.port.waiting(self._medium.waiting(transfer.sender))
                if self.recorder is not None:
                    self.recorder.write(transfer.end + time.time() - time.monotonic(), transfer.raw)
                self._deliver(transfer.sender, transfer.raw)
        if self._unsent:
            unsent, self._unsent = self._unsent, []
            for flush in unsent:
                flush()
        if self._afterwards:
            afterwards, self._afterwards = self._afterwards, []
            for function in afterwards:
                function()

    def _deliver(self, sender: Node, raw: bytes) -> None:
        self.frame_count += 1
        if self.frame_count == 1:
            self.happened("first_frame")
        route = self._routes.get((sender, raw[:4])) or self._find_route(sender, raw[:4])
        route.passed += 1
        for port in route.given:
            port.deliver(raw)
        if route.returned:
            sender.port.deliver(frames.own(raw))

    def _find_route(self, sender: Node, identifier: bytes) -> _Route:
        """Look up who hears a frame, and remember it until something changes."""
        can_id = int.from_bytes(identifier, "little")
        hearing = [node for node in self.nodes if node.listening and not node.state & DEAF]
        others = [node for node in hearing if node is not sender]
        given = (node.port for node in others if node.interests is None or can_id in node.interests)
        returned = sender.echo and sender in hearing
        heard = [*others, sender] if returned else others
        route = _Route(tuple(node.counters for node in heard), tuple(given), returned)
        if len(self._routes) >= _MOST_ROUTES:
            self.forget_routes()
        self._routes[sender, identifier] = route
        return route

    def forget_routes(self) -> None:
        """Look up anew who hears what: a node has come, gone or changed."""
        self._count()
        self._routes.clear()

    def _count(self) -> None:
        """Bring the counters of the nodes up to date."""
        for (sender, _), route in self._routes.items():
            sender.counters.sent += route.passed
            for counters in route.heard:
                counters.received += route.passed
            route.passed = 0

    def after_round(self, flush: Callable[[], object]) -> None:
        """Call `flush` when all frames that are due have been delivered."""
        self._unsent.append(flush)

    def when_sent(self, function: Callable[[], object]) -> None:
        """Call `function` when all frames that are due have left: what others need not wait for."""
        self._afterwards.append(function)

    # Time

    def call_at(self, at: float, function: Callable[[], object]) -> Timer:
        """Call `function` from the loop at a time of the monotonic clock (s); can be cancelled."""
        return self.loop.call_at(at, function)

    def step(self, until: float | None = None) -> None:
        """Wait for something to do until `until` (monotonic, s; None: no limit), and do it."""
        if self._pending or self._unsent:
            until = 0.0
        elif self._medium is not None:
            due = self._medium.next_at
            if due is not None and (until is None or due < until):
                until = due
        self.loop.step(until)
        self._move()

    def run(self) -> None:
        """Keep the bus going until `stop`."""
        while not self.loop.stopped:
            self.step()

    def stop(self) -> None:
        """Let `run` return; may be called from any thread and from a signal handler."""
        self.loop.stop()

    # Doors

    def open_socket(self, path: str) -> SocketDoor:
        """Listen for python-can's interface `crtk` and for plain Unix sockets at `path`.

        Raises:
            SimStartError: when another hub has it, or the place cannot be written.
        """
        return self._opened(SocketDoor(self, path))

    def open_socketcand(self, host: str, port: int, channel: str = "can0") -> SocketcandDoor:
        """Listen for socketcand clients at a loopback address.

        Raises:
            SimStartError: when the address cannot be bound.
        """
        return self._opened(SocketcandDoor(self, host, port, channel))

    def open_slcan(self, link: str = "") -> SlcanDoor:
        """Offer an slcan adapter on a new pty; `link` becomes a symbolic link to it.

        Raises:
            SimStartError: when there is no pty left, or the link cannot be made.
        """
        return self._opened(SlcanDoor(self, link))

    def join_interface(self, interface: str) -> KernelDoor:
        """Join a CAN interface of the kernel, such as vcan0, to the bus.

        Raises:
            SimStartError: when there is no such interface, or it is down.
        """
        return self._opened(KernelDoor(self, interface))

    def _opened(self, door: DoorKind) -> DoorKind:
        self._doors.append(door)
        return door

    def close(self) -> None:
        """Close all doors, their connections and the log; safe to repeat."""
        for door in self._doors:
            door.close()
        self._doors.clear()
        if self.recorder is not None:
            self.recorder.close()
            self.recorder = None
        self.nodes = []
        self.loop.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    # What there is to know

    def status(self) -> dict[str, Any]:
        """Bit rate, load, and each node's counters, ready for JSON."""
        self._count()
        medium = self._medium
        return {
            "bitrate": self.bitrate,
            "frames": self.frame_count,
            "error_frames": self._errors.counters.sent,
            "bits": None if medium is None else medium.bits,
            "load": None if medium is None else medium.load.last_second(time.monotonic()),
            "nodes": {
                node.name: {
                    "listening": node.listening,
                    **vars(node.counters),
                    "waiting": self.waiting(node),
                    "state": [flag.name for flag in State if flag & node.state],
                }
                for node in self.nodes
            },
        }

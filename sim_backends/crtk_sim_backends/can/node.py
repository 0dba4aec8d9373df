"""A participant of the bus, and what it and the doors need of the bus."""

from __future__ import annotations

from collections.abc import Callable, Container
from typing import Protocol

from crtk_sim_backends.can import frames
from crtk_sim_backends.can.port import Counters, Port, State
from crtk_sim_backends.kit.loop import Loop, Timer


class Bus(Protocol):
    """What lies behind a node: `crtk_sim_backends.can.hub.Hub`.

    Attributes:
        loop: in which everything happens.
        bitrate: bit/s; 0: as fast as the machine can.
        queue: frames of one node that may wait for the bus.
        echo: whether nodes get their own frames back, if they do not ask for something else.
        happened: told of what clients do: one of `injection.EVENTS`.
    """

    loop: Loop
    bitrate: int
    queue: int
    echo: bool
    happened: Callable[[str], object]

    def add(self, name: str, port: Port) -> Node:
        """Add a node; a name that is taken gets a number."""

    def rename(self, node: Node, name: str) -> None:
        """Give a node the name that its client has asked for, with a number when it is taken."""

    def remove(self, node: Node) -> None:
        """Take a node off the bus; what waits in its queue is still sent."""

    def transmit(self, node: Node, raw: bytes) -> int:
        """Queue a checked frame of `node`; 0, or why it was not taken: ENOBUFS or ENETDOWN."""

    def error(self, classes: int, data: bytes = ..., node: Node | None = None) -> None:
        """Let `node` receive an error frame, or all nodes, from the bus."""

    def forget_routes(self) -> None:
        """Look up anew who hears what."""

    def after_round(self, flush: Callable[[], object]) -> None:
        """Call `flush` when all frames that are due have been delivered."""

    def call_at(self, at: float, function: Callable[[], object]) -> Timer:
        """Call `function` from the loop at a time of the monotonic clock (s); can be cancelled."""


class Node:
    """One participant of the bus, in this process or behind a door."""

    def __init__(self, bus: Bus, name: str, port: Port) -> None:
        self.name = name
        self.port = port
        self.state = State(0)  # the bus changes it
        self.counters = Counters()
        self._bus = bus
        self._echo = bus.echo
        self._listening = True
        self._interests: Container[int] | None = None

    @property
    def echo(self) -> bool:
        """Whether it gets its own frames back."""
        return self._echo

    @echo.setter
    def echo(self, echo: bool) -> None:
        self._echo = echo
        self._bus.forget_routes()

    @property
    def listening(self) -> bool:
        """Whether it hears the bus; a client may not have opened its channel."""
        return self._listening

    @listening.setter
    def listening(self, listening: bool) -> None:
        self._listening = listening
        self._bus.forget_routes()

    @property
    def interests(self) -> Container[int] | None:
        """Identifiers with flags that its port is given, as by an acceptance filter; None: all."""
        return self._interests

    @interests.setter
    def interests(self, interests: Container[int] | None) -> None:
        self._interests = interests
        self._bus.forget_routes()

    def send(self, can_id: int, data: bytes = b"", length: int | None = None) -> int:
        """Queue a frame; 0 when it was taken, else an errno (ENOBUFS, ENETDOWN).

        Args:
            can_id: identifier, with the flags of linux/can.h.
            data: 0 to 8 bytes.
            length: data length code of a remote frame.

        Raises:
            ValueError: for a frame that CAN does not have.
        """
        if len(data) > frames.MAX_DATA:
            raise ValueError(f"{self.name}: a frame has at most 8 data bytes, not {len(data)}")
        raw = frames.pack(can_id, data, length)
        if can_id > frames.STANDARD_MASK or length is not None:
            fault = frames.fault_of(raw)
            if fault is not None:
                raise ValueError(f"{self.name}: {fault}")
        return self._bus.transmit(self, raw)

    def detach(self) -> None:
        """Leave the bus; what waits in the queue is still sent. Safe to repeat."""
        self._bus.remove(self)

"""What a node of the bus has: a port to whoever is behind it, a state, counters."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntFlag
from typing import Final, Protocol


class State(IntFlag):
    """What is wrong with the interface of one node."""

    DOWN = 1  # neither sends nor receives; ENETDOWN
    BUS_OFF = 2  # the controller has taken itself off the bus; ENOBUFS
    FULL = 4  # the transmit queue takes nothing; ENOBUFS
    LISTEN_ONLY = 8  # receives; what it sends is lost, without an error
    PASSIVE = 16  # error passive; sends and receives


DEAF: Final = State.DOWN | State.BUS_OFF
REFUSING: Final = State.DOWN | State.BUS_OFF | State.FULL


class Port(Protocol):
    """Who is behind a node: takes frames from the bus, and is told how the node is."""

    def deliver(self, raw: bytes) -> None:
        """Take a frame (or error frame) from the bus."""

    def state_changed(self, state: State) -> None:
        """Take note of a new state of the node."""

    def waiting(self, count: int) -> None:
        """Take note of how many frames of the node wait for the bus."""


@dataclass
class Counters:
    """Frames of one node."""

    sent: int = 0  # went onto the bus
    received: int = 0
    lost: int = 0  # of those that it wanted to send: refused, or dropped by a fault
    missed: int = 0  # of those for it: it did not read in time
    invalid: int = 0  # pieces of data from it that were no frame and no command

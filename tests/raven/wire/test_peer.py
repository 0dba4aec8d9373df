"""The driver without its core, at a socket: what its packets say, one by one."""

from __future__ import annotations

import socket
import struct
import time
from collections import deque
from collections.abc import Iterator

import pytest

from crtk_driver_raven import device
from crtk_driver_raven.config import RavenConfig
from crtk_driver_raven.device import RavenDevice
from crtk_driver_raven.packets import PRIMING
from crtk_drivers.device import Setpoint, Steps
from crtk_drivers.device.capabilities import Mode
from crtk_drivers.errors import CommandRefused, ConnectionFailed, TransitionFailed
from crtk_drivers.samples import vector
from rigs.waiting import LONG

GOAL = Setpoint(Mode.CARTESIAN_POSITION, vector((0.004, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)))


class Peer:
    """A socket that a driver sends to."""

    def __init__(self, listener: socket.socket) -> None:
        self._listener = listener
        host, self.port = listener.getsockname()
        self.device = RavenDevice(RavenConfig(host=host, port=self.port))

    def packet(self) -> tuple[int, list[int], int]:
        """Return number, moves and pedal of the next packet."""
        words = struct.unpack("<3I6i8d6i", self._listener.recv(200))
        return words[0], list(words[3:9]), words[21]

    def drive(self, steps: Steps) -> None:
        """Let the device carry out a procedure, a packet a step."""
        for _ in steps:
            self.device.read(0.0)
            self.packet()


@pytest.fixture
def peer() -> Iterator[Peer]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        listener.settimeout(LONG)
        found = Peer(listener)
        found.device.open(time.monotonic() + LONG)
        yield found
        found.device.close()


@pytest.mark.real_time  # who has a port open is looked up in /proc
def test_a_second_driver_of_this_machine_is_refused_before_it_sends_anything(peer: Peer) -> None:
    second = RavenDevice(RavenConfig(host=peer.device.address.split(":")[0], port=peer.port))
    with pytest.raises(ConnectionFailed, match=r"this one.* drives it already"):
        second.open(time.monotonic() + LONG)
    before = [peer.packet()[0] for _ in range(2)]
    peer.device.read(0.0)
    assert peer.packet()[0] == before[1] + 1, "no packet of the second"
    peer.device.close()
    second.open(time.monotonic() + LONG)
    second.close()


def test_it_begins_with_two_packets_that_lead_nowhere(peer: Peer) -> None:
    first, moves, pedal = peer.packet()
    second, *others = peer.packet()
    peer.device.read(0.0)
    third, *_ = peer.packet()
    assert (second - first, third - second) == (PRIMING, 1)
    assert (moves, pedal) == ([0] * 6, 0)
    assert others == [[0] * 6, 0]


def test_the_pedal_counts_as_moved_after_five_packets(peer: Peer) -> None:
    peer.packet(), peer.packet()
    steps = peer.device.enable()
    said = []
    for _ in steps:
        peer.device.read(0.0)
        said.append(peer.packet()[2])
    assert said == [1] * 5


def test_an_enable_that_is_broken_off_lifts_the_pedal(peer: Peer) -> None:
    peer.packet(), peer.packet()
    steps = peer.device.enable()
    next(steps)
    peer.device.read(0.0)
    assert peer.packet()[2] == 1
    steps.close()
    peer.device.read(0.0)
    assert [peer.packet()[2] for _ in range(6)] == [0] * 6


def test_an_enable_that_fails_lifts_the_pedal(peer: Peer, monkeypatch: pytest.MonkeyPatch) -> None:
    """As after a process that was stopped for a while in the middle of it."""
    monkeypatch.setattr(device, "TOLD", -1.0)
    peer.packet(), peer.packet()
    with pytest.raises(TransitionFailed, match="do not go out"):
        deque(peer.device.enable(), maxlen=0)
    peer.device.read(0.0)
    assert [peer.packet()[2] for _ in range(6)] == [0] * 6


def test_no_packets_pile_up_in_this_computer(peer: Peer) -> None:
    """They would lead the arms all at once when the way is free again."""
    sending = peer.device._link._socket
    assert sending is not None
    room = sending.getsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF)
    assert room <= 2 * device.AT_MOST_WAITING, "the system doubles it"


def test_what_led_nowhere_yet_is_forgotten_when_the_pedal_moves(peer: Peer) -> None:
    peer.packet(), peer.packet()
    peer.drive(peer.device.enable())
    gold = peer.device.children["gold"]
    with pytest.raises(CommandRefused, match="the pedal is up, or was"):
        gold.write(GOAL)
    assert list(gold.enable()) == []
    gold.write(GOAL)
    peer.device.read(0.0)
    x, *others = peer.packet()[1]
    assert 0 < x <= 800, "of 4 periods at most"
    assert others == [0] * 5
    peer.device.left()
    assert [peer.packet()[1:] for _ in range(5)] == [([0] * 6, 0)] * 5
    peer.drive(peer.device.enable())
    with pytest.raises(CommandRefused, match="the pedal is up, or was"):
        gold.write(GOAL)  # a stream that does not know yet
    peer.device.read(0.0)
    assert peer.packet()[1:] == ([0] * 6, 1)

"""What is sent, and what is not any more: a driver at a peer that a test speaks for."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
import time
from collections.abc import Iterator

import pytest

from crtk_driver_weiss_wsg.binary import PREAMBLE, frame
from crtk_driver_weiss_wsg.config import WsgConfig
from crtk_driver_weiss_wsg.device import OTHERS, WsgHand, create
from crtk_driver_weiss_wsg.link import WsgLink
from crtk_driver_weiss_wsg.orders import Order
from crtk_driver_weiss_wsg.tables import Command, Grasping, Status
from crtk_drivers.config import from_values, load
from crtk_drivers.kit import TcpTransport
from rigs.waiting import LONG, endless, eventually

MOVE, STOP, RELEASE = Command.MOVE, Command.STOP, Command.RELEASE
OK, PENDING = Status.OK, Status.PENDING


def told(command: Command, form: str = "", *values: float, status: int = OK) -> bytes:
    return frame(command, struct.pack("<H" + form, status, *values))


def state(grasping: Grasping = Grasping.IDLE) -> bytes:
    """A gripper with a reference, that stands."""
    return told(Command.SYSTEM, "I", 1) + told(Command.GRASPING, "B", grasping)


LIMITS = told(Command.LIMITS, "8f", 110, 5, 420, 100, 5000, 5, 80, 120)


def at(width: float) -> bytes:
    """How far it is open, in mm."""
    rest = (told(command, "f", 0.0) for command in (Command.SPEED, Command.FORCE))
    return b"".join(rest) + told(Command.WIDTH, "f", width)


class Peer:
    """A gripper that says what a test lets it say."""

    def __init__(self, server: socket.socket) -> None:
        self._server = server
        host, port = server.getsockname()
        values = {"host": host, "tcp_port": port, "on_close": "release"}
        self.config = load(WsgConfig, from_values(values))
        self.heard = b""

    def greet(self, *first: bytes) -> None:
        self.peer, _ = self._server.accept()
        self.peer.settimeout(LONG)
        self.peer.sendall(b"".join(first))

    def commands(self) -> list[int]:
        """Which have come, but for what it is asked to tell."""
        self.peer.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            self.heard += self.peer.recv(4096)
        numbers = (part[0] for part in self.heard.split(PREAMBLE)[1:])
        return [number for number in numbers if number < Command.SYSTEM]


@pytest.fixture
def peer() -> Iterator[Peer]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        made = Peer(server)
        yield made
        made.peer.close()


def soon() -> float:
    return time.monotonic() + LONG


def greeted(peer: Peer, *first: bytes) -> threading.Thread:
    thread = threading.Thread(target=peer.greet, args=(LIMITS, *first))
    thread.start()
    return thread


def test_what_waits_does_not_follow_a_stop_from_another_thread(peer: Peer) -> None:
    link = WsgLink(peer.config, 0.02)
    greeting = greeted(peer, state(), at(50.0))
    opener = threading.Thread(target=link.open, args=(soon(), lambda: False))
    opener.start()
    opener.join()
    greeting.join()
    link.put(Order(MOVE, (0.02, 0.1)))
    waiting = link.put(Order(MOVE, (0.03, 0.1)))
    link.stop()
    peer.peer.sendall(told(MOVE, status=PENDING))
    link.receive(soon())
    eventually(lambda: peer.commands() == [MOVE, STOP, STOP], "a stop of the I/O thread's own")
    assert waiting.status == Status.ABORTED
    link.close()


def test_a_motion_that_was_accepted_and_does_not_show_yet_is_stopped(peer: Peer) -> None:
    device = create(peer.config)
    greeting = greeted(peer, state(), at(50.0))
    device.open(soon())
    greeting.join()
    link: WsgLink = device._hand._link  # type: ignore[attr-defined]
    link.put(Order(MOVE, (0.02, 0.1)))
    peer.peer.sendall(told(MOVE, status=PENDING) + state() + at(50.0))
    while device.read(soon()) is None or not link.rests:
        pass
    device.stop()
    eventually(lambda: STOP in peer.commands(), "stopped")
    assert not device.has_stopped, "it has not answered"
    device.close()


def test_a_motion_that_was_told_once_is_no_other_programs_however_late_it_is_looked_at(
    peer: Peer,
) -> None:
    """As at the end of one of ours, by a driver that is held up just then."""
    device = create(peer.config)
    greeting = greeted(peer, state(Grasping.POSITIONING), at(50.0))
    device.open(soon())
    greeting.join()
    hand = device._hand
    assert isinstance(hand, WsgHand)
    hand._look(0.0)
    assert not hand.taken_over
    hand._look(2.0 * OTHERS)
    assert hand.taken_over
    device.close()


def test_what_came_while_nobody_looked_is_no_width_of_now(peer: Peer) -> None:
    """A port keeps what came while this computer stood still."""
    link = WsgLink(peer.config, 0.02)
    greeting = greeted(peer, state(), at(50.0))
    link.open(soon(), lambda: False)
    greeting.join()
    link._looked -= 2.5
    peer.peer.sendall(at(20.0))
    assert link.receive(soon()) is False
    assert link.width == pytest.approx(0.02)
    peer.peer.sendall(at(21.0))
    assert link.receive(soon())
    link.close()


def test_who_tells_no_width_without_end_keeps_nobody(
    peer: Peer, monkeypatch: pytest.MonkeyPatch
) -> None:
    device = create(peer.config)
    greeting = greeted(peer, state(), at(50.0))
    device.open(soon())
    greeting.join()
    with monkeypatch.context() as patched:
        patched.setattr(TcpTransport, "read", lambda self, deadline: read(deadline))
        read = endless(state())
        assert device.read(time.monotonic()) is None
    device.close()


def test_release_on_close_of_what_cannot_be_opened_further_says_goodbye(peer: Peer) -> None:
    """A part that is held from inside at the end of the stroke."""
    device = create(peer.config)
    greeting = greeted(peer, state(Grasping.HOLDING), at(110.0))
    device.open(soon())
    greeting.join()
    device._is_enabled = device._may_move = True
    device.will_close()
    device.close()
    eventually(lambda: peer.commands() == [Command.GOODBYE], "it took its leave")

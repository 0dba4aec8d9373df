"""Commands on their way at once, to a scripted peer over TCP: which answer is whose."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from crtk_driver_galil.commander import Commander
from rigs.waiting import LONG


class Peer:
    """A controller that says what a test says."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        self._heard = b""

    def command(self) -> str:
        """The next command that it hears."""
        while b"\r" not in self._heard:
            self._heard += self._connection.recv(64)
        command, _, self._heard = self._heard.partition(b"\r")
        return command.decode()

    def say(self, text: str) -> None:
        """Answer."""
        self._connection.sendall(text.encode())


@contextmanager
def at_a_peer() -> Iterator[tuple[Commander, Peer]]:
    with socket.create_server(("127.0.0.1", 0)) as door:
        commander = Commander("127.0.0.1", door.getsockname()[1], LONG)
        commander.open(time.monotonic() + LONG)
        connection, _ = door.accept()
        with connection:
            connection.settimeout(LONG)
            yield commander, Peer(connection)
        commander.close()


def collect(commander: Commander, until: Callable[[], bool]) -> None:
    deadline = time.monotonic() + LONG
    while not until():
        assert time.monotonic() < deadline
        commander.collect()


def refused(commander: Commander) -> list[str]:
    collect(commander, lambda: not commander.waiting)
    return [error.message for error in commander.take_refused()]


def test_a_refusal_whose_code_was_overwritten_is_not_told_with_that_of_another() -> None:
    """A controller keeps one code: that of the last command that it refused, until it is asked for it."""
    with at_a_peer() as (commander, peer):
        for each in ("SP 1", "AC 99999999", "DC 1"):
            commander.send(each)
        assert [peer.command() for _ in range(3)] == ["SP 1", "AC 99999999", "DC 1"]
        peer.say("??:")
        collect(commander, lambda: commander.waiting == 2)
        assert [peer.command(), peer.command()] == ["TC1", "TC1"]
        peer.say("6 Number out of range\r\n:0\r\n:")
        first, second = refused(commander)
        assert "'SP 1' was refused, and no code tells why" in first
        assert "'AC 99999999' was refused after it: 6 number out of range" in first
        assert "'AC 99999999' was refused: 6 number out of range" in second


def test_refusals_that_were_asked_about_in_time_have_their_own_codes() -> None:
    with at_a_peer() as (commander, peer):
        for command, code in (("BG A", 22), ("SP 1", 6)):
            commander.send(command)
            assert peer.command() == command
            peer.say("?")
            collect(commander, lambda: commander.waiting == 1 and bool(commander._unexplained))
            assert peer.command() == "TC1"
            peer.say(f"{code} it says so\r\n:")
            (told,) = refused(commander)
            assert f"'{command}' was refused: {code} " in told

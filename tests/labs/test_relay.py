"""The relay: what passes it, what does not, and what is told of that."""

from __future__ import annotations

import os
import selectors
import signal
import socket
import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from crtk_drivers.errors import ConnectionFailed, DeviceError
from crtk_drivers.labs.bench.relay import Mode, RelayProcess
from crtk_drivers.plugins import DeviceLink
from rigs.waiting import LONG

SHORT = 0.2
"""Seconds in which what must not come would have."""

MANY = 3_000_000


@pytest.fixture
def stream() -> Iterator[socket.socket]:
    """A device's listener."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.settimeout(LONG)
        yield listener


@pytest.fixture
def datagrams() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
        own.bind(("127.0.0.1", 0))
        own.settimeout(LONG)
        yield own


@pytest.fixture
def relay(stream: socket.socket, datagrams: socket.socket) -> Iterator[RelayProcess]:
    link = DeviceLink(
        "127.0.0.1",
        {"commands": stream.getsockname()[1]},
        {"samples": datagrams.getsockname()[1]},
    )
    with RelayProcess(link) as made:
        yield made


def connected(relay: RelayProcess, stream: socket.socket) -> tuple[socket.socket, socket.socket]:
    """Return both ends of a connection through the relay: the driver's and the device's."""
    near = socket.create_connection((relay.link.host, relay.link.tcp["commands"]), LONG)
    far, _ = stream.accept()
    far.settimeout(LONG)
    return near, far


def comes(own: socket.socket, seconds: float) -> bool:
    with selectors.DefaultSelector() as selector:
        selector.register(own, selectors.EVENT_READ)
        return bool(selector.select(seconds))


def passes(source: socket.socket, target: socket.socket, seconds: float = LONG) -> bool:
    source.send(b"x")
    return comes(target, seconds) and target.recv(1) == b"x"


def test_it_listens_at_a_loopback_address_of_its_own_and_the_same_ports(
    relay: RelayProcess, stream: socket.socket
) -> None:
    assert relay.link.host.startswith("127.66.")
    assert relay.link.tcp == {"commands": stream.getsockname()[1]}


def test_all_passes_both_ways_however_much_it_is(
    relay: RelayProcess, stream: socket.socket
) -> None:
    near, far = connected(relay, stream)
    with near, far:
        for source, target in ((near, far), (far, near)):
            sender = threading.Thread(target=source.sendall, args=(bytes(MANY),))
            sender.start()
            left = MANY
            while left:
                left -= len(target.recv(left))
            sender.join()
        near.shutdown(socket.SHUT_WR)
        assert far.recv(1) == b""
        assert passes(far, near), "the other way is still open"
        far.close()
        assert near.recv(1) == b""


@pytest.mark.parametrize("mode", [Mode.DEAF, Mode.SILENT])
def test_what_is_paused_comes_later_and_nobody_is_told(
    relay: RelayProcess, stream: socket.socket, mode: Mode
) -> None:
    near, far = connected(relay, stream)
    with near, far:
        assert passes(near, far)
        relay.mode = mode
        assert not passes(near, far, SHORT)
        assert passes(far, near, LONG if mode is Mode.DEAF else SHORT) is (mode is Mode.DEAF)
        relay.mode = Mode.OPEN
        assert far.recv(1) == b"x"


def test_a_connection_that_is_asked_for_meanwhile_waits(
    relay: RelayProcess, stream: socket.socket
) -> None:
    relay.mode = Mode.SILENT
    with socket.create_connection((relay.link.host, relay.link.tcp["commands"]), LONG) as near:
        assert not comes(stream, SHORT)
        relay.mode = Mode.OPEN
        far, _ = stream.accept()
        with far:
            assert passes(near, far)


def test_closed_is_reset_and_refused_until_it_is_open_again(
    relay: RelayProcess, stream: socket.socket
) -> None:
    near, far = connected(relay, stream)
    with near, far:
        assert passes(near, far)
        relay.mode = Mode.CLOSED
        for one in (near, far):
            with pytest.raises(ConnectionResetError):
                one.recv(1)
    with pytest.raises(ConnectionRefusedError):
        connected(relay, stream)
    relay.mode = Mode.OPEN
    near, far = connected(relay, stream)
    with near, far:
        assert passes(near, far)


def test_datagrams_pass_and_are_lost(relay: RelayProcess, datagrams: socket.socket) -> None:
    clients = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2)]
    device = (relay.link.host, relay.link.udp["samples"])
    addresses = []
    for client in clients:
        client.sendto(b"go", device)
        data, address = datagrams.recvfrom(10)
        assert data == b"go"
        addresses.append(address)
    assert len(set(addresses)) == 2
    for client, address in zip(clients, addresses, strict=True):
        datagrams.sendto(b"sample", address)
        assert comes(client, LONG)
        assert client.recv(10) == b"sample"
    relay.mode = Mode.SILENT
    datagrams.sendto(b"lost", addresses[0])
    clients[0].sendto(b"lost", device)
    assert not comes(clients[0], SHORT)
    assert not comes(datagrams, 0.0)
    relay.mode = Mode.DEAF
    datagrams.sendto(b"heard", addresses[0])
    clients[0].sendto(b"lost", device)
    assert comes(clients[0], LONG)
    assert clients[0].recv(10) == b"heard"
    assert not comes(datagrams, SHORT)
    relay.mode = Mode.OPEN
    clients[0].sendto(b"again", device)
    assert datagrams.recv(10) == b"again"
    for client in clients:
        client.close()


def test_what_came_before_a_change_is_treated_as_it_was_until_then(
    relay: RelayProcess, datagrams: socket.socket
) -> None:
    """Also by a relay that had no time for it."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.sendto(b"go", (relay.link.host, relay.link.udp["samples"]))
        _, address = datagrams.recvfrom(10)
        relay.mode = Mode.SILENT
        os.kill(relay._process.pid, signal.SIGSTOP)
        for _ in range(3):
            datagrams.sendto(b"lost", address)
        changing = threading.Thread(target=setattr, args=(relay, "mode", Mode.DEAF))
        changing.start()
        changing.join(0.1)  # it has been told by then, but is not to answer
        os.kill(relay._process.pid, signal.SIGCONT)
        changing.join(LONG)
        datagrams.sendto(b"heard", address)
        assert comes(client, LONG)
        assert client.recv(10) == b"heard"


def test_a_device_that_is_gone_resets_and_the_relay_goes_on(
    relay: RelayProcess, stream: socket.socket
) -> None:
    near, far = connected(relay, stream)
    with near:
        far.close()
        assert near.recv(1) == b""
    near, far = connected(relay, stream)
    with near, far:
        assert passes(near, far)


def test_ports_that_are_taken_everywhere_are_told(stream: socket.socket) -> None:
    with socket.create_server(("0.0.0.0", 0)) as taken:
        link = DeviceLink("127.0.0.1", {"commands": taken.getsockname()[1]})
        with pytest.raises(ConnectionFailed, match="Address already in use"):
            RelayProcess(link)


def test_it_ends_with_whoever_started_it(relay: RelayProcess) -> None:
    process = relay._process
    assert process.stdin is not None
    with suppress(BrokenPipeError):
        process.stdin.close()
    assert process.wait(LONG) == 0


def test_one_that_was_killed_is_told_and_closed(relay: RelayProcess) -> None:
    relay._process.kill()
    relay._process.wait()
    with pytest.raises(DeviceError, match="does not answer"):
        relay.mode = Mode.SILENT
    relay.close()
    assert not Path(relay._names.name).exists()

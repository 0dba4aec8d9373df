"""Wire hooks and the connection that applies them, over real sockets."""

import socket
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_sim_backends import wire


@pytest.fixture
def pair():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        theirs = socket.create_connection(listener.getsockname())
        ours, _ = listener.accept()
    connection = wire.Connection(ours, limit=1 << 20, send_buffer=4096)
    theirs.settimeout(30)
    yield connection, theirs
    connection.close()
    theirs.close()


def receive(sock, size):
    data = b""
    while len(data) < size:
        data += sock.recv(size - len(data))
    return data


@given(st.binary(min_size=1), st.integers(1, 50))
def test_split_loses_and_adds_nothing(data, size):
    pieces = wire.split(size)(wire.Direction.OUT, data, 0.0)
    assert b"".join(piece for _, piece in pieces) == data
    assert all(len(piece) <= size for _, piece in pieces)


@given(st.binary(min_size=1), st.integers(0, 1000))
def test_corrupt_changes_one_byte_and_repeats_for_its_seed(data, seed):
    hooks = [wire.corrupt(every=1, seed=seed) for _ in range(2)]
    (first,), (second,) = (hook(wire.Direction.IN, data, 0.0) for hook in hooks)
    assert first == second
    assert len(first[1]) == len(data)
    assert sum(a != b for a, b in zip(first[1], data, strict=True)) == 1


def test_drop_loses_every_nth_piece():
    hook = wire.drop(every=3)
    kept = [bool(hook(wire.Direction.IN, b"x", 0.0)) for _ in range(6)]
    assert kept == [True, True, False, True, True, False]


def test_hooks_in_a_chain_add_their_delays():
    hook = wire.chain([wire.delay(1.0), wire.split(1, spacing=0.5), wire.delay(2.0)])
    assert hook(wire.Direction.IN, b"ab", 0.0) == [(3.0, b"a"), (3.5, b"b")]
    assert wire.chain([]) is None


def test_one_way_leaves_the_other_direction_alone():
    hook = wire.one_way(wire.drop(), wire.Direction.OUT)
    assert hook(wire.Direction.OUT, b"x", 0.0) == []
    assert hook(wire.Direction.IN, b"x", 0.0) == [(0.0, b"x")]


def test_delayed_data_arrives_at_its_time_and_in_order(pair):
    connection, peer = pair
    connection.hook = wire.delay(1.0)
    connection.send(b"first", now=0.0)
    connection.hook = None
    connection.send(b"second", now=0.5)
    connection.flush(now=0.9)
    peer.setblocking(False)
    with pytest.raises(BlockingIOError):
        peer.recv(100)
    connection.flush(now=1.0)
    peer.settimeout(30)
    assert receive(peer, 11) == b"firstsecond"


def test_a_peer_that_does_not_read_loses_packages_but_never_gets_half_of_one(pair):
    connection, peer = pair
    packages = [bytes([n % 251]) * 1000 for n in range(5000)]
    sent = [package for package in packages if connection.send_fresh(package, now=0.0)]
    assert connection.dropped == 5000 - len(sent) > 0
    assert connection.blocked_for(now=7.0) == pytest.approx(7.0)
    data = b""
    deadline = time.monotonic() + 30
    while len(data) < 1000 * len(sent):
        assert time.monotonic() < deadline
        data += peer.recv(65536)
        connection.flush(now=0.0)
    assert data == b"".join(sent)
    assert connection.send_fresh(b"again", now=0.0)
    assert connection.blocked_for(now=8.0) == 0.0


def test_untaken_replies_end_the_connection_at_the_limit(pair):
    connection, _ = pair
    for _ in range(400):
        connection.send(bytes(65536), now=0.0)
    assert connection.closed


def test_the_end_of_the_peer_is_noticed(pair):
    connection, peer = pair
    peer.close()
    deadline = time.monotonic() + 30
    while not connection.peer_closed:
        assert time.monotonic() < deadline
        connection.read(now=0.0)


def test_coalesced_data_leaves_as_one_piece(pair):
    connection, peer = pair
    connection.hook = wire.coalesce(1.0)
    for n in range(10):
        connection.send(bytes([n]) * 100, now=5.0 + n / 100)
    connection.flush(now=6.1)
    assert len(peer.recv(65536)) == 1000

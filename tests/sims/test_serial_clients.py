"""Clients of a simulated serial line that come and go faster than its loop looks."""

import os
import tty

import pytest

from crtk_sim_backends.kit.loop import Loop
from crtk_sim_backends.kit.tty_server import TtyServer
from rigs.waiting import eventually


class Listener:
    """A session that keeps what it was sent, and answers all of it."""

    def __init__(self):
        self.heard = b""
        self.is_closed = False

    def receive(self, data):
        self.heard += data
        return data

    def close(self):
        self.is_closed = True


class Line:
    """A serial line whose loop looks when a test says so."""

    def __init__(self, path):
        self.loop = Loop()
        self.sessions = []
        self.server = TtyServer(self.loop, path, self._session)

    def _session(self):
        self.sessions.append(Listener())
        return self.sessions[-1]

    def look(self):
        self.loop.step(0.0)

    def open(self):
        client = os.open(self.server.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        tty.setraw(client)
        return client


@pytest.fixture
def line(tmp_path):
    made = Line(tmp_path / "serial")
    yield made
    made.server.close()
    made.loop.close()


def test_last_words_reach_the_session_of_their_client(line):
    client = line.open()
    os.write(client, b"stop\n")
    os.close(client)
    line.look()
    assert [session.heard for session in line.sessions] == [b"stop\n", b""]
    assert [session.is_closed for session in line.sessions] == [True, False]


def test_last_words_are_not_answered_to_the_next_client(line):
    client = line.open()
    os.write(client, b"stop\n")
    os.close(client)
    line.look()
    client = line.open()
    os.write(client, b"hello\n")
    eventually(lambda: line.look() or line.sessions[-1].heard == b"hello\n")
    assert os.read(client, 100) == b"hello\n"
    os.close(client)


def test_a_client_that_writes_at_once_is_answered(line):
    client = line.open()
    line.look()
    os.close(client)
    client = line.open()
    os.write(client, b"hello\n")
    line.server._receive(0)  # before anybody has looked who has come
    assert line.sessions[-1].heard == b"hello\n"
    assert len(line.sessions) == 2
    assert os.read(client, 100) == b"hello\n"
    os.close(client)


def answers(line, client):
    """Whether a client is answered by the newest session."""
    os.write(client, b"hello\n")
    eventually(lambda: line.look() or line.sessions[-1].heard.endswith(b"hello\n"))
    return os.read(client, 100) == b"hello\n"


def test_one_of_two_that_opened_at_once_may_leave(line):
    first, second = line.open(), line.open()
    line.look()
    os.close(first)
    line.look()
    assert answers(line, second)
    assert [session.is_closed for session in line.sessions] == [False]
    os.close(second)
    line.look()
    client = line.open()
    line.look()
    assert answers(line, client)
    os.close(client)


def test_two_that_close_at_once_have_both_left(line):
    clients = [line.open()]
    line.look()
    clients.append(line.open())
    line.look()
    for client in clients:
        os.close(client)
    line.look()
    assert line.server.clients == 0
    assert [session.is_closed for session in line.sessions] == [True, False]


def test_who_comes_while_last_words_are_read_is_answered(line, monkeypatch):
    os.close(line.open())
    came = []

    def read():
        if not came:
            came.append(line.open())
            os.write(came[0], b"hello\n")
        return tty_read()

    tty_read = line.server._tty.read
    monkeypatch.setattr(line.server._tty, "read", read)
    eventually(lambda: line.look() or line.sessions[-1].heard == b"hello\n")
    assert os.read(came[0], 100) == b"hello\n"
    os.close(came[0])

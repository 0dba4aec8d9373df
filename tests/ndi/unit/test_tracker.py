"""Which reply is the answer to which question: a tracker that a test speaks for."""

from __future__ import annotations

import select
import socket
import time
from collections.abc import Iterator

import pytest

from crtk_driver_ndi.codec import command
from crtk_driver_ndi.config import NdiConfig
from crtk_driver_ndi.stream import FrameStream
from crtk_driver_ndi.tracker import Tracker
from crtk_drivers.errors import ConnectionLost
from rigs.waiting import LONG


def soon() -> float:
    return time.monotonic() + LONG


@pytest.fixture
def talk() -> Iterator[tuple[Tracker, socket.socket]]:
    """A tracker that is connected, and its far side."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        tracker = Tracker(NdiConfig(host="127.0.0.1", tcp_port=server.getsockname()[1]))
        tracker._link._tcp.open(soon())
        peer, _ = server.accept()
        with peer:
            yield tracker, peer
        tracker.close()


def say(talk: tuple[Tracker, socket.socket], text: str) -> None:
    """Let a reply lie there."""
    tracker, peer = talk
    peer.sendall(command(text))
    assert select.select([tracker._link._tcp._peer], [], [], LONG)[0]


def test_a_late_reply_is_not_the_answer_to_the_next_question(
    talk: tuple[Tracker, socket.socket],
) -> None:
    tracker, peer = talk
    steps = tracker.asking("BEEP:1")
    next(steps)
    say(talk, "00")
    tracker.read(time.monotonic())
    assert peer.recv(100) == command("BEEP:1")
    say(talk, "1")
    assert tracker.read(soon())
    with pytest.raises(StopIteration) as end:
        next(steps)
    assert end.value.value.text == "1"
    assert tracker.counters["surplus_replies"] == 1


def test_that_it_was_reset_is_heard_before_a_question(talk: tuple[Tracker, socket.socket]) -> None:
    tracker, _ = talk
    say(talk, "RESET")
    with pytest.raises(ConnectionLost, match="was reset"):
        tracker.read(time.monotonic())


def test_a_missed_frame_answers_no_later_question(
    talk: tuple[Tracker, socket.socket], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A link holds replies back for longer than they are waited for."""
    monkeypatch.setattr("crtk_driver_ndi.tracker.REPLY", 0.1)
    tracker, peer = talk
    tracker.stream = FrameStream(60.0, "TX")
    tracker.read(time.monotonic() + 0.15)
    asked = peer.recv(200)
    assert asked.startswith(command("TX:0801"))
    if not asked.endswith(command("APIREV:")):
        tracker.read(time.monotonic() + 0.05)
        assert peer.recv(100) == command("APIREV:")
    say(talk, "010AMISSING0000003100000003\n0000")
    assert not tracker.read(time.monotonic() + 0.05)
    assert tracker.stream.newest is None
    say(talk, "D.001.004")
    assert not tracker.read(time.monotonic() + 0.05)
    assert peer.recv(100).endswith(command("TX:0801"))
    say(talk, "010AMISSING0000003100000006\n0000")
    assert not tracker.read(time.monotonic() + 0.05)  # a first frame that took long to come
    assert peer.recv(100) == command("TX:0801")
    say(talk, "010AMISSING0000003100000007\n0000")
    before = time.monotonic()
    assert tracker.read(soon())
    assert tracker.stream.newest is not None
    assert tracker.stream.newest.number == 7
    assert tracker.stream.stamp.monotonic < before

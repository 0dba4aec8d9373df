"""The way to the boards, at a scripted peer over UDP."""

from __future__ import annotations

import socket
import time

import pytest

from crtk_driver_dvrk.boards import Boards
from rigs.waiting import LONG

FLOOD = 100


@pytest.mark.real_time  # how much fits in a socket is up to Linux
def test_a_flood_keeps_no_answer_from_its_deadline() -> None:
    """What is there when the time is over is looked at, but not all that somebody goes on sending."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        peer.bind(("127.0.0.1", 0))
        peer.settimeout(LONG)
        boards = Boards("127.0.0.1", peer.getsockname()[1], "", 0.02)
        boards._link.open(time.monotonic() + LONG)
        label = boards.ask_state(0)
        _, client = peer.recvfrom(200)
        for _ in range(FLOOD):
            peer.sendto(b"of somebody else", client)
        assert boards.answer(0, label, 0.0) is None
        assert 0 < boards.damaged < FLOOD
        boards.close()

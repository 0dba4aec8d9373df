"""Signs of life between two processes."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time

import pytest

from crtk_drivers.status import pulse
from crtk_drivers.status.pulse import PERIOD, Pulse, pulse_ends
from rigs.waiting import eventually

OTHER = """
import socket, sys, time
from crtk_drivers.status.pulse import Pulse
Pulse.start(socket.socket(fileno=int(sys.argv[1])))
time.sleep(1000)
"""


@pytest.mark.parametrize("number", [signal.SIGSTOP, signal.SIGKILL])
def test_a_process_that_stands_still_is_noticed(number: signal.Signals) -> None:
    ours, theirs = pulse_ends()
    own = Pulse.start(ours)
    with theirs:
        other = subprocess.Popen(
            [sys.executable, "-c", OTHER, str(theirs.fileno())], pass_fds=[theirs.fileno()]
        )
    try:
        eventually(lambda: own.silence() == 0.0 and own.has_begun, "it is heard")
        os.kill(other.pid, number)
        eventually(lambda: own.silence() > 1.0, "it is heard no more")
        if number == signal.SIGSTOP:
            other.send_signal(signal.SIGCONT)
            eventually(lambda: own.silence() == 0.0, "it is heard again")
    finally:
        own.close()
        own.close()
        other.kill()
        other.wait()


def test_own_standing_still_is_no_silence_of_the_other(monkeypatch: pytest.MonkeyPatch) -> None:
    ours, theirs = pulse_ends()
    with theirs:
        own = Pulse.start(ours)
        own.silence()
        now = time.monotonic() + 1000.0
        monkeypatch.setattr(pulse.time, "monotonic", lambda: now)
        assert own.silence() < 1.0
        own.close()


def fill(end: socket.socket) -> None:
    """Send until nothing more is taken."""
    while True:
        end.send(b"." * 4096)


def test_a_receiver_that_stands_still_keeps_nobody() -> None:
    """However much it has not taken."""
    ours, theirs = pulse_ends()
    own = Pulse.start(ours)
    theirs.setblocking(False)
    with pytest.raises(BlockingIOError):
        fill(ours)
    time.sleep(2.0 * PERIOD)
    began = time.monotonic()
    own.silence()
    own.close()
    assert time.monotonic() - began < 10.0
    theirs.close()

"""The link to a unit that answers when a test lets it: answers do not say what they are of."""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections.abc import Iterator
from contextlib import suppress

import pytest

from crtk_driver_optoforce import link as links
from crtk_driver_optoforce.config import OptoForceConfig
from crtk_driver_optoforce.link import OptoForceLink
from crtk_drivers.device import Steps
from crtk_drivers.errors import TransitionFailed
from rigs.waiting import LONG, eventually


def summed(data: bytes) -> bytes:
    return data + struct.pack(">H", sum(data) & 0xFFFF)


class SlowUnit:
    """Measures, and confirms configurations: all at once while it is quick, then as many as it may."""

    def __init__(self, listener: socket.socket) -> None:
        self.configured = 0
        self.is_quick = True
        self.may_confirm = threading.Semaphore(0)
        self.over = threading.Event()
        self._listener = listener
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        with suppress(ConnectionError):  # the driver has left
            self._serve()

    def _serve(self) -> None:
        peer, _ = self._listener.accept()
        number = confirmed = 0
        came = b""
        with peer:
            peer.settimeout(0.005)
            while not self.over.is_set():
                with suppress(TimeoutError):
                    came += peer.recv(100)
                self.configured = came.count(b"\xaa\x00\x32\x03")
                is_due = confirmed < self.configured
                if is_due and (self.is_quick or self.may_confirm.acquire(blocking=False)):
                    confirmed += 1
                    peer.sendall(summed(b"\xaa\x00\x50\x01\x00"))
                number = (number + 1) % 65536
                peer.sendall(summed(b"\xaa\x07\x08\x0a" + struct.pack(">HH3h", number, 0, 1, 2, 3)))

    def close(self) -> None:
        self.over.set()
        self._thread.join()


def carried_out(link: OptoForceLink, steps: Steps) -> None:
    for _ in steps:
        link.read(time.monotonic() + 0.01)


@pytest.fixture
def unit() -> Iterator[SlowUnit]:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        found = SlowUnit(listener)
        try:
            yield found
        finally:
            found.close()


@pytest.fixture
def link(unit: SlowUnit) -> Iterator[OptoForceLink]:
    host, port = unit._listener.getsockname()
    config = OptoForceConfig(port=f"socket://{host}:{port}", rate=1000)
    found = OptoForceLink(config, lambda: False)
    found.open(time.monotonic() + LONG)
    carried_out(found, found.zeroing(False))  # what open has asked for again, too
    unit.is_quick = False
    yield found
    found.close()


def test_an_answer_that_comes_late_is_none_to_what_is_told_next(
    unit: SlowUnit, link: OptoForceLink, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = unit.configured
    monkeypatch.setattr(links, "ANSWER", 0.1)
    with pytest.raises(TransitionFailed, match="does not answer"):
        carried_out(link, link.zeroing(True))
    monkeypatch.setattr(links, "ANSWER", LONG)
    steps, over = link.zeroing(True), []

    def go_on() -> None:
        link.read(time.monotonic() + 0.01)
        if not over and next(steps, steps) is steps:
            over.append(True)

    def told(count: int) -> bool:
        go_on()
        return unit.configured == before + count

    go_on()
    unit.may_confirm.release()  # the late one
    eventually(lambda: told(2), "its zero is removed once more")
    for _ in range(20):
        go_on()
    assert told(2), "that has not been confirmed"
    unit.may_confirm.release()
    eventually(lambda: told(3), "it is told to zero")
    unit.may_confirm.release()
    eventually(lambda: go_on() or over, "that is confirmed")

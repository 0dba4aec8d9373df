"""What is at the other end of a serial port: a thread that answers each request as it was told to."""

import os
import select
import threading
import time
import tty

from crtk_driver_dynamixel.bus import Bus, ServoLink
from crtk_drivers.kit.serial_port import SerialPort
from rigs.waiting import LONG

FAST = 100_000_000
"""Bits a second, at which bytes take no time worth the name."""


class Peer:
    """A pseudo-terminal, and answers: of each request the next one of the script.

    An answer is bytes, or a list of bytes and of seconds to wait. What is not in the script is not answered.
    """

    def __init__(self):
        self.requests = []
        self._script = []
        self._answer_all = lambda request: b""
        self.master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.name = os.ttyname(self._slave)
        self._stop_read, self._stop_write = os.pipe()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._heard = threading.Condition()

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        os.write(self._stop_write, b"x")
        self._thread.join(LONG)
        for fd in (self.master, self._slave, self._stop_read, self._stop_write):
            os.close(fd)

    def script(self, *answers):
        """Answer the next requests so; None is silence."""
        self._script = [
            answer if isinstance(answer, list) else [answer] if answer else [] for answer in answers
        ]

    def answer_all(self, answer):
        """Answer every request behind the script with what this function makes of it."""
        self._answer_all = answer

    def say(self, data):
        """Send without being asked, and wait until it is there."""
        os.write(self.master, data)
        self.until_heard()

    def until_heard(self):
        """Wait until something has come to the bus that it has not read."""
        assert select.select([self._slave], [], [], LONG)[0]

    def wait_for(self, count):
        """Wait until so many requests were heard, and return them."""
        with self._heard:
            assert self._heard.wait_for(lambda: len(self.requests) >= count, LONG)
        return self.requests

    def _run(self):
        buffer = b""
        while True:
            ready, _, _ = select.select([self.master, self._stop_read], [], [])
            if self._stop_read in ready:
                return
            buffer += os.read(self.master, 4096)
            while (size := request_size(buffer)) <= len(buffer):
                self._answer(buffer[:size])
                buffer = buffer[size:]

    def _answer(self, request):
        with self._heard:
            self.requests.append(request)
            self._heard.notify_all()
        for step in self._script.pop(0) if self._script else [self._answer_all(request)]:
            if isinstance(step, bytes):
                os.write(self.master, step)
            else:
                time.sleep(step)


def request_size(buffer):
    if buffer.startswith(b"\xff\xff\xfd"):
        return 7 + int.from_bytes(buffer[5:7], "little") if len(buffer) >= 7 else 7
    return 4 + buffer[3] if len(buffer) >= 4 else 4


def open_bus(peer, links=None, *, budget=0.2, baud=FAST):
    """A bus on a peer whose servos answer at once; at any slow rate nobody could."""
    known = {id: ServoLink(return_delay=0.0) for id in range(1, 20)} | (links or {})
    bus = Bus(SerialPort(peer.name, baud), known, latency_budget=budget)
    bus.open()
    return bus

"""The port on a pseudo-terminal: deadlines, exclusive use, rates, unplugging, the stable name."""

import os
import select
import subprocess
import sys
import threading
import time
import tty

import pytest

from crtk_driver_dynamixel.bus import Bus
from crtk_drivers.errors import ConnectionFailed, ConnectionLost, DeviceError
from crtk_drivers.kit.latency import Latency
from crtk_drivers.kit.serial_port import SerialPort, stable_name
from rigs.waiting import LONG


class Terminal:
    """Both ends of a pseudo-terminal; the near one as a device behind a link."""

    def __init__(self, link=None):
        self.master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.name = os.ttyname(self._slave)
        if link is not None:
            link.unlink(missing_ok=True)
            link.symlink_to(self.name)

    def hear(self, size):
        data = b""
        while len(data) < size:
            assert select.select([self.master], [], [], LONG)[0]
            data += os.read(self.master, 4096)
        return data

    def unplug(self):
        if self.master >= 0:
            os.close(self.master)
            os.close(self._slave)
            self.master = -1


@pytest.fixture
def terminal():
    made = Terminal()
    yield made
    made.unplug()


def test_bytes_cross_it_as_they_are(terminal):
    every = bytes(range(256))
    with SerialPort(terminal.name) as port:
        port.write(every)
        assert terminal.hear(256) == every
        os.write(terminal.master, every)
        received = b""
        while len(received) < 256:
            received += port.read(time.monotonic() + LONG)
        assert received == every
        assert port.drain() == b""


def test_nothing_comes_before_the_deadline(terminal):
    with SerialPort(terminal.name) as port:
        deadline = time.monotonic() + 0.02
        assert port.read(deadline) == b""
        assert time.monotonic() >= deadline


def test_a_last_look_after_the_deadline(terminal):
    with SerialPort(terminal.name) as port:
        os.write(terminal.master, b"in time")
        assert select.select([port._fd], [], [], LONG)[0]
        assert port.read(time.monotonic() - 1.0) == b"in time"


@pytest.mark.real_time  # measures the processor
def test_waiting_costs_no_cpu(terminal):
    with SerialPort(terminal.name) as port:
        before = time.thread_time()
        port.read(time.monotonic() + 0.3)
        assert time.thread_time() - before < 0.1


@pytest.mark.parametrize("baud", [57_600, 1_000_000, 4_000_000, 4_500_000, 123_457])
def test_any_rate(terminal, baud):
    with SerialPort(terminal.name, baud) as port:
        assert port.wire_time(100) == pytest.approx(1000.0 / baud)
        assert f"{baud} bit/s" in port.where


def test_the_rate_can_be_changed(terminal):
    with SerialPort(terminal.name) as port:
        port.set_baud(57_600)
        assert port.baud == 57_600
        with pytest.raises(DeviceError, match="-1 bit/s refused"):
            port.set_baud(-1)
        assert port.baud == 57_600
        os.write(terminal.master, b"a")
        assert port.read(time.monotonic() + LONG) == b"a"
        assert port.read(time.monotonic()) == b""


def test_a_long_message_waits_for_the_adapter(terminal):
    data = os.urandom(50_000)
    heard = []
    reader = threading.Thread(target=lambda: heard.append(terminal.hear(len(data))))
    with SerialPort(terminal.name) as port:
        reader.start()
        port.write(data)
        reader.join(LONG)
    assert heard == [data]


def test_an_adapter_that_takes_nothing(terminal):
    with (
        SerialPort(terminal.name, 100_000_000) as port,
        pytest.raises(ConnectionLost, match="no bytes"),
    ):
        port.write(bytes(1_000_000))


@pytest.mark.real_time  # who has a port open is looked up in /proc
def test_one_process_opens_it_once(terminal):
    with SerialPort(terminal.name), pytest.raises(ConnectionFailed) as caught:
        SerialPort(terminal.name).open()
    for part in (terminal.name, f"process {os.getpid()}", "this one", "one master"):
        assert part in str(caught.value)
    SerialPort(terminal.name).open()  # a port that is closed is free


HOLD = """
import sys
from crtk_drivers.kit.serial_port import SerialPort
with SerialPort(sys.argv[1]):
    print("open", flush=True)
    sys.stdin.read()
"""


@pytest.mark.real_time  # who has a port open is looked up in /proc
def test_another_process_is_named(terminal):
    command = [sys.executable, "-c", HOLD, terminal.name]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout.readline() == "open\n"
        with pytest.raises(ConnectionFailed) as caught:
            SerialPort(terminal.name).open()
        assert f"process {other.pid} ({sys.executable} -c" in str(caught.value)
        other.kill()
    with SerialPort(terminal.name):  # it died with the port open
        pass


def test_a_port_that_is_not_there(tmp_path):
    by_id = tmp_path / "by-id"
    with pytest.raises(ConnectionFailed, match="No USB serial adapter"):
        SerialPort(tmp_path / "ttyUSB9", by_id=by_id).open()
    by_id.mkdir()
    (by_id / "usb-FTDI-if00").symlink_to("/dev/null")
    with pytest.raises(ConnectionFailed, match="usb-FTDI-if00"):
        SerialPort(tmp_path / "ttyUSB9", by_id=by_id).open()


def test_a_file_is_no_port(tmp_path):
    file = tmp_path / "file"
    file.touch()
    with pytest.raises(ConnectionFailed, match="cannot be opened"):
        SerialPort(file).open()


@pytest.mark.parametrize(
    "use", [lambda port: port.read(time.monotonic() + LONG), lambda port: port.write(b"a")]
)
def test_it_is_unplugged(terminal, use):
    with SerialPort(terminal.name) as port:
        terminal.unplug()
        with pytest.raises(ConnectionLost, match=r"adapter is gone.*plugged in"):
            use(port)
    with pytest.raises(ConnectionLost, match="closed"):
        use(port)


def test_it_is_found_again_by_its_stable_name(tmp_path):
    by_id = tmp_path / "by-id"
    by_id.mkdir()
    link = by_id / "usb-FTDI_U2D2-if00-port0"
    first = Terminal(link)
    port = SerialPort(first.name, by_id=by_id)
    port.open()
    port.close()
    second = Terminal(link)  # while the first is still there, so that the name differs
    try:
        assert second.name != first.name
        assert str(stable_name(link.resolve(), by_id)) == str(link)
        first.unplug()
        port.open()
        port.write(b"hello")
        assert second.hear(5) == b"hello"
    finally:
        port.close()
        first.unplug()
        second.unplug()


def test_the_latency_timer_is_part_of_the_deadlines(terminal):
    bus = Bus(SerialPort(terminal.name), latency_budget=0.004)
    assert bus.latency_budget == 0.004
    bus.port.latency = Latency(16)
    assert bus.latency_budget == pytest.approx(0.018)
    bus.port.latency = Latency(1)
    assert bus.latency_budget == 0.004

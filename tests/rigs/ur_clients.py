"""Small, separate clients of the controller's ports, written from the manuals, for tests."""

import contextlib
import json
import os
import socket
import struct
import subprocess
import sys
import time

from crtk_sim_backends.process import loopback_addresses
from rigs.waiting import LONG

SIZES = {
    "BOOL": "?",
    "UINT8": "B",
    "UINT32": "I",
    "UINT64": "Q",
    "INT32": "i",
    "DOUBLE": "d",
    "VECTOR3D": "3d",
    "VECTOR6D": "6d",
    "VECTOR6INT32": "6i",
    "VECTOR6UINT32": "6I",
}
PORTS = {
    "dashboard": 29999,
    "primary": 30001,
    "secondary": 30002,
    "realtime": 30003,
    "rtde": 30004,
    "primary_read_only": 30011,
    "secondary_read_only": 30012,
    "realtime_read_only": 30013,
    "interpreter": 30020,
}


def own_address():
    """Return a loopback address that no simulator has: a user may have one running at any, also 127.0.0.1."""
    for address in loopback_addresses(os.getpid() + 1):
        with contextlib.suppress(OSError), socket.create_server((address, PORTS["rtde"])):
            return address
    raise AssertionError("no free loopback address")


class TcpClient:
    """A blocking connection with a deadline for everything."""

    def __init__(self, host, port, timeout=LONG):
        self.socket = socket.create_connection((host, PORTS.get(port, port)), timeout)
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def send(self, data):
        self.socket.sendall(data)

    def read(self, size):
        data = b""
        while len(data) < size:
            piece = self.socket.recv(size - len(data))
            if not piece:
                raise EOFError("the simulator closed the connection")
            data += piece
        return data

    def closed_by_peer(self):
        """Read everything until the peer closes (True) or is silent for the timeout (False)."""
        try:
            while self.socket.recv(65536):
                pass
        except ConnectionError:
            return True
        except TimeoutError:
            return False
        return True

    def silent_for(self, seconds):
        """Whether nothing arrives for some time."""
        before = self.socket.gettimeout()
        self.socket.settimeout(seconds)
        try:
            return self.socket.recv(1) is None
        except TimeoutError:
            return True
        finally:
            self.socket.settimeout(before)

    def close(self):
        self.socket.close()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()


class RtdeClient(TcpClient):
    """RTDE, one request after the other."""

    def __init__(self, host, protocol=2, timeout=LONG):
        super().__init__(host, "rtde", timeout)
        self.protocol = 1
        self.types = []
        if protocol == 2:
            assert self.request("V", struct.pack(">H", 2)) == b"\x01"
            self.protocol = 2

    def write(self, kind, payload=b""):
        self.send(struct.pack(">HB", 3 + len(payload), ord(kind)) + payload)

    def package(self):
        size, kind = struct.unpack(">HB", self.read(3))
        return chr(kind), self.read(size - 3)

    def request(self, kind, payload=b""):
        """Send a request and return its reply, skipping data packages."""
        self.write(kind, payload)
        while True:
            got, reply = self.package()
            if got == kind:
                return reply
            assert got == "U", f"unexpected package {got!r} before the reply to {kind!r}"

    def setup_outputs(self, names, frequency=500.0):
        """Return (recipe id, list of types); the id is None in protocol 1."""
        head = struct.pack(">d", frequency) if self.protocol == 2 else b""
        reply = self.request("O", head + names.encode())
        number, text = (reply[0], reply[1:]) if self.protocol == 2 else (None, reply)
        self.types = text.decode().split(",")
        return number, self.types

    def setup_inputs(self, names):
        """Return (recipe id, list of types)."""
        reply = self.request("I", names.encode())
        return reply[0], reply[1:].decode().split(",")

    def start(self):
        return self.request("S") == b"\x01"

    def pause(self):
        return self.request("P") == b"\x01"

    def data(self):
        """Values of the next data package, flat."""
        while True:
            kind, payload = self.package()
            if kind == "U":
                break
        if self.protocol == 2:
            assert payload[0] == 1
            payload = payload[1:]
        return struct.unpack(">" + "".join(SIZES[t] for t in self.types), payload)

    def write_data(self, recipe, format_, *values):
        self.write("U", bytes([recipe]) + struct.pack(">" + format_, *values))

    def wait_for(self, condition, seconds=LONG):
        """Read data packages until one fulfils the condition, and return it."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            values = self.data()
            if condition(values):
                return values
        raise AssertionError("no package fulfilled the condition")


class DashboardClient(TcpClient):
    """One line out, one line in."""

    def __init__(self, host, timeout=LONG):
        super().__init__(host, "dashboard", timeout)
        self.greeting = self.line()

    def line(self):
        text = b""
        while not text.endswith(b"\n"):
            text += self.read(1)
        return text.decode().removesuffix("\n")

    def ask(self, command):
        self.send(command.encode() + b"\n")
        return self.line()


class InterpreterClient(TcpClient):
    """One line out, one line in."""

    def __init__(self, host, timeout=LONG):
        super().__init__(host, "interpreter", timeout)

    def line(self):
        text = b""
        while not text.endswith(b"\n"):
            text += self.read(1)
        return text.decode().removesuffix("\n")

    def ask(self, line):
        self.send(line.encode() + b"\n")
        return self.line()


class PrimaryClient(TcpClient):
    """Frames of the primary and secondary ports."""

    def __init__(self, host, port="primary", timeout=LONG):
        super().__init__(host, port, timeout)

    def frame(self):
        """Return (type, body)."""
        size, kind = struct.unpack(">iB", self.read(5))
        return kind, self.read(size - 5)

    def message(self, kind, seconds=LONG):
        """Body of the next robot message of a kind, without its header."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            frame, body = self.frame()
            if frame == 20 and body[9] == kind:
                return body[10:]
        raise AssertionError(f"no message of kind {kind}")

    def state(self):
        """Sub-packages of the next robot state, by type."""
        while True:
            kind, body = self.frame()
            if kind == 16:
                return subpackages(body)


def subpackages(body):
    parts = {}
    while body:
        size, kind = struct.unpack_from(">iB", body)
        parts[kind] = body[5:size]
        body = body[size:]
    return parts


def output_of(program, *arguments):
    """What a Python program prints that runs in a process of its own."""
    return subprocess.run(
        [sys.executable, "-c", program, *arguments],
        stdout=subprocess.PIPE,
        text=True,
        timeout=45,
        check=True,
    ).stdout


def last_json(text):
    return json.loads(text.strip().splitlines()[-1])

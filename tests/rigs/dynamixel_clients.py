"""Clients of a simulated bus: the vendor's SDK, and bytes written by hand.

The packets here are built and cut independently of the simulator: the CRC is that of fastcrc.
"""

from __future__ import annotations

import os
import select
import struct
import termios
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final, NamedTuple, Self
from unittest.mock import patch

import dynamixel_sdk as sdk
from dynamixel_sdk import port_handler
from fastcrc import crc16

from crtk_sim_backends.dynamixel import SIM, RunningSim
from rigs.waiting import LONG, eventually

# ms: the SDK waits twice as long, and 2 ms, for an answer. Its own 34 ms are too little on a busy machine.
port_handler.LATENCY_TIMER = 500
IN_VAIN: Final = 175
"""The SDK's LATENCY_TIMER, in ms, where no answer comes, or where the request is repeated until one does."""

HEADER: Final = b"\xff\xff\xfd\x00"
MARK: Final = b"\xff\xff\xfd"
EVERYONE: Final = 254

TORQUE, WATCHDOG, GOAL_PWM, GOAL_CURRENT, GOAL_VELOCITY = 64, 98, 100, 102, 104
PROFILE_ACCELERATION, PROFILE_VELOCITY, GOAL_POSITION = 108, 112, 116
CURRENT, VELOCITY, POSITION, HARDWARE_ERROR = 126, 128, 132, 70
MODE, DRIVE_MODE, HOMING, STATUS_LEVEL, SHUTDOWN = 11, 10, 20, 68, 63


def hand(text: str) -> bytes:
    """Bytes as the manual prints them."""
    return bytes.fromhex(text)


def instruction(number: int, code: int, parameters: bytes = b"") -> bytes:
    """A packet of protocol 2.0."""
    body = (bytes((code,)) + parameters).replace(MARK, MARK + b"\xfd")
    packet = HEADER + struct.pack("<BH", number, len(body) + 2) + body
    return packet + struct.pack("<H", crc16.umts(packet))


def legacy(number: int, code: int, parameters: bytes = b"") -> bytes:
    """A packet of protocol 1.0."""
    body = bytes((number, len(parameters) + 2, code)) + parameters
    return b"\xff\xff" + body + bytes((~sum(body) & 0xFF,))


def read(number: int, address: int, length: int) -> bytes:
    return instruction(number, 0x02, struct.pack("<HH", address, length))


def write(number: int, address: int, data: bytes) -> bytes:
    return instruction(number, 0x03, struct.pack("<H", address) + data)


def sync_read(address: int, length: int, *numbers: int, code: int = 0x82) -> bytes:
    return instruction(EVERYONE, code, struct.pack("<HH", address, length) + bytes(numbers))


class Status(NamedTuple):
    """A status packet."""

    number: int
    error: int
    data: bytes


def statuses(data: bytes) -> list[Status]:
    """Cut bytes that hold nothing but whole and intact status packets of protocol 2.0."""
    found = []
    while data:
        assert data[:4] == HEADER, data.hex(" ")
        number, length = struct.unpack_from("<BH", data, 4)
        packet, data = data[: length + 7], data[length + 7 :]
        assert len(packet) == length + 7, packet.hex(" ")
        assert struct.unpack("<H", packet[-2:])[0] == crc16.umts(packet[:-2]), packet.hex(" ")
        assert packet[7] == 0x55
        body = packet[8:-2].replace(MARK + b"\xfd", MARK)
        found.append(Status(number, body[0], body[1:]))
    return found


TAKEN: Final = 3
"""Requests on the control socket, within which a simulator hands over what it has to say at once."""

TURNS: Final = 0.02
"""Seconds in which servos behind missing ones answer: they give each of those a millisecond."""


class Wire:
    """A port without any protocol.

    Args:
        sim: the simulator whose first bus this port is on. Its control socket says when it took a request
            and how many bytes it answered, so that the end of an answer is known without a wait. Only for
            a bus whose bytes take no time.
    """

    def __init__(
        self, path: str, speed: int = termios.B1000000, *, sim: RunningSim | None = None
    ) -> None:
        self._fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        tty.setraw(self._fd)
        self.set_speed(speed)
        self._sim = sim
        told = self._told()
        self._taken, self._handed = told["bytes_in"], told["bytes_out"]

    def set_speed(self, speed: int) -> None:
        """`speed` is a constant of termios."""
        settings = termios.tcgetattr(self._fd)
        settings[4] = settings[5] = speed
        termios.tcsetattr(self._fd, termios.TCSANOW, settings)

    def send(self, *packets: bytes) -> None:
        self._taken += os.write(self._fd, b"".join(packets))

    def receive(self, length: int, timeout: float = LONG) -> bytes:
        """Exactly that many bytes, or what came before the time was over."""
        data = b""
        deadline = time.monotonic() + timeout
        while len(data) < length:
            wait = deadline - time.monotonic()
            if wait <= 0.0 or not select.select([self._fd], [], [], wait)[0]:
                break
            data += os.read(self._fd, length - len(data))
        self._handed += len(data)
        return data

    def rest(self, quiet: float = 0.3, first: float = 0.7) -> bytes:
        """All that comes until nothing came for a while, or nothing at first for longer.

        Where the simulator tells, it is all that it has handed over, and nothing may come after that.
        """
        if self._sim is not None:
            return self._all_told()
        data = b""
        while select.select([self._fd], [], [], quiet if data else first)[0]:
            data += os.read(self._fd, 4096)
        return data

    def _all_told(self) -> bytes:
        eventually(lambda: self._told()["bytes_in"] >= self._taken)
        time.sleep(TURNS)
        for _ in range(TAKEN):
            told = self._told()
        data = self.receive(told["bytes_out"] - self._handed)
        assert not select.select([self._fd], [], [], 0.05)[0], "more than the simulator tells of"
        return data

    def _told(self) -> dict[str, Any]:
        """What the simulator says of the bus."""
        if self._sim is None:
            return {"bytes_in": 0, "bytes_out": 0}
        bus: dict[str, Any] = self._sim.control.status()["buses"]["bus1"]
        return bus

    def ask(self, packet: bytes, length: int | None = None) -> list[Status]:
        """The status packets to an instruction; `length` of them in bytes, until it is quiet if None."""
        self.send(packet)
        return statuses(self.rest() if length is None else self.receive(length))

    def ask_raw(self, packet: bytes, length: int) -> bytes:
        self.send(packet)
        return self.receive(length)

    def fileno(self) -> int:
        return self._fd

    def close(self) -> None:
        os.close(self._fd)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class Vendor:
    """The vendor's SDK on one port: values come back signed, with the error byte of the status."""

    def __init__(self, path: str, baud: int = 1_000_000, protocol: float = 2.0) -> None:
        self.port = sdk.PortHandler(path)
        assert self.port.openPort()
        assert self.port.setBaudRate(baud)
        self.packets = sdk.PacketHandler(protocol)

    def read(self, number: int, address: int, size: int) -> int:
        call = getattr(self.packets, f"read{size}ByteTxRx")
        value, result, error = call(self.port, number, address)
        assert (result, error & 0x7F) == (sdk.COMM_SUCCESS, 0)
        bits = 8 * size
        return int(value - (1 << bits) if size > 1 and value >> (bits - 1) else value)

    def write(self, number: int, address: int, size: int, value: int) -> int:
        """Returns the error byte."""
        call = getattr(self.packets, f"write{size}ByteTxRx")
        result, error = call(self.port, number, address, value % (1 << 8 * size))
        assert result == sdk.COMM_SUCCESS
        return int(error)

    def error_of_read(self, number: int, address: int, length: int) -> int:
        _, result, error = self.packets.readTxRx(self.port, number, address, length)
        assert result == sdk.COMM_SUCCESS
        return int(error)

    @contextmanager
    def in_vain(self) -> Iterator[None]:
        """Wait less for answers, but longer than a simulator may get no time."""
        with patch.object(port_handler, "LATENCY_TIMER", IN_VAIN):
            yield

    def ping_in_vain(self, number: int) -> int:
        """Result of a ping that is not answered, or not yet."""
        with self.in_vain():
            return self.ping(number)[1]

    def ping(self, number: int) -> tuple[int, int, int]:
        """Model number, result of the communication, error."""
        answer: tuple[int, int, int] = self.packets.ping(self.port, number)
        return answer

    def sync_reader(self, address: int, length: int, *numbers: int) -> Any:
        group = sdk.GroupSyncRead(self.port, self.packets, address, length)
        for number in numbers:
            assert group.addParam(number)
        return group

    def close(self) -> None:
        self.port.closePort()


@contextmanager
def running(**options: Any) -> Iterator[RunningSim]:
    """A simulator that takes no time for bytes, unless told otherwise."""
    with SIM.spawn(**{"timing": "none", "return_delay": 0, **options}) as sim:
        yield sim


@contextmanager
def wire_at(sim: RunningSim) -> Iterator[Wire]:
    """The first bus of a simulator that `running` has started, which tells when it has answered."""
    with Wire(sim.ttys["bus1"], sim=sim) as wire:
        yield wire


@contextmanager
def vendor_at(sim: RunningSim, bus: str = "bus1", **options: Any) -> Iterator[Vendor]:
    vendor = Vendor(sim.ttys[bus], **options)
    try:
        yield vendor
    finally:
        vendor.close()

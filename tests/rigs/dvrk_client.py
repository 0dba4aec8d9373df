"""A bare client of simulated boards: packets that are written here byte for byte."""

from __future__ import annotations

import socket

from crtk_sim_backends.dvrk import RunningSim
from crtk_sim_backends.dvrk.wire import checksum

EVERYBODY = 63
SIZE = 128
"""Bytes of a state."""


def _header(code: int, address: int, node: int, label: int) -> bytes:
    packet = (0xFFC0 | node).to_bytes(2) + (label << 10 | code << 4).to_bytes(2)
    return packet + bytes.fromhex("ff d0 00 00") + address.to_bytes(4)


class BoardClient:
    """Asks and writes, as any program in the network of the boards can.

    Args:
        sim: whose boards.
        door: a socket connected to them.
        node: of the board; that with the cable, whichever it is, if it is `EVERYBODY`.
    """

    def __init__(self, sim: RunningSim, door: socket.socket, node: int = EVERYBODY) -> None:
        self.door = door
        self._sim = sim
        self._node = node

    def send(self, packet: bytes) -> None:
        """Send a packet of the bus."""
        generation = self._sim.control.status()["generation"]
        forward = self._node != EVERYBODY
        self.door.send(bytes((0 if forward else 1, generation)) + packet)

    def read(self, address: int) -> int:
        """Return a register."""
        packet = _header(4, address, self._node, 2)
        self.send(packet + checksum(packet))
        return int.from_bytes(self.door.recv(100)[12:16])

    def write(self, address: int, value: int) -> None:
        """Write a register."""
        packet = _header(0, address, self._node, 2) + value.to_bytes(4)
        self.send(packet + checksum(packet))

    def block(self, address: int, quadlets: int) -> list[int]:
        """Return a block."""
        packet = _header(5, address, self._node, 2) + (4 * quadlets).to_bytes(2) + bytes(2)
        self.send(packet + checksum(packet))
        data = self.door.recv(2000)
        assert len(data) == 20 + 4 * quadlets + 4 + 8
        return [int.from_bytes(data[at : at + 4]) for at in range(20, 20 + 4 * quadlets, 4)]

    def state(self) -> list[int]:
        """Return the state of the board: the block at 0."""
        return self.block(0, SIZE // 4)

    def command(self, board: int, motors: list[int], control: int = 0) -> None:
        """Write a block at 0, as firmware 8 takes it: header, four motors, control."""
        data = b"".join(value.to_bytes(4) for value in [board << 8 | 6, *motors, control])
        packet = _header(1, 0, self._node, 2) + len(data).to_bytes(2) + bytes(2)
        self.send(packet + checksum(packet) + data + checksum(data))

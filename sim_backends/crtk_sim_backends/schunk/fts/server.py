"""The simulated sensor behind its ports."""

from __future__ import annotations

import logging
import socket
from typing import Final

from crtk_sim_backends.kit import LoopServer, TcpDoor
from crtk_sim_backends.page import Gauge, Gauges
from crtk_sim_backends.schunk.fts.box import HEAD, Box
from crtk_sim_backends.schunk.fts.config import SimConfig

log = logging.getLogger(__name__)

PERIOD: Final = 0.001
AXES: Final = ("x", "y", "z")
CLIENT: Final = "127.0.0.1"
"""Where the stream goes: a simulator stays on this machine."""


class CommandSession:
    """One client of the commands."""

    def __init__(self, box: Box) -> None:
        self.ended = False
        self._box = box
        self._rest = b""

    def receive(self, data: bytes) -> bytes:
        """Take received bytes and return the answers."""
        self._rest += data
        answers = b""
        while len(self._rest) >= HEAD.size:
            sync, counter, size = HEAD.unpack_from(self._rest)
            if sync != b"\xff\xff" or not size:
                self.ended = True
                break
            if len(self._rest) < HEAD.size + size:
                break
            payload = self._rest[HEAD.size : HEAD.size + size]
            self._rest = self._rest[HEAD.size + size :]
            answers += self._box.answer(counter, payload)
        return answers

    def close(self) -> None:
        """Forget an unfinished request."""
        self._rest = b""


def _gauges(box: Box, config: SimConfig) -> list[Gauges]:
    def row(title: str, unit: str, first: int, most: float) -> Gauges:
        gauges: list[Gauge] = [
            {"name": axis, "low": -most, "high": most, "value": float(box.measured[first + at])}
            for at, axis in enumerate(AXES)
        ]
        return {"title": title, "unit": unit, "rate": "", "digits": 2, "gauges": gauges}

    return [
        row("Force", "N", 0, config.rated_force),
        row("Torque", "N·m", 3, config.rated_torque),
    ]


def serve(config: SimConfig, parent_fd: int | None) -> LoopServer:
    """Bind the ports of a simulated sensor."""
    box = Box(config)
    server = LoopServer(
        config,
        parent_fd,
        box,
        title="SCHUNK FTS",
        tcp={"tcp": TcpDoor(config.tcp_port, lambda: CommandSession(box))},
        gauges=lambda: _gauges(box, config),
        requests={"carry": box.carry},
    )
    sender, stranger = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    for peer in (sender, stranger):
        server.at_end(peer.close)
    sender.bind((server.host, 0))

    def send(peer: socket.socket, data: bytes) -> None:
        try:
            peer.sendto(data, (CLIENT, box.port))
        except OSError as error:
            log.debug("a datagram was not sent: %s", error)

    def tick() -> None:
        for data in box.tick():
            send(sender, data)
        for data in box.foreign:
            send(stranger, data)

    server.every(PERIOD, tick)
    return server

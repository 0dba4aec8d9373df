"""A simulated Raven II that takes packets at its UDP port as the robot's network layer does.

:data:`SIM` starts it; ``python -m crtk_sim_backends.raven`` runs it alone.
"""

from __future__ import annotations

import socket
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Final

from typing_extensions import override

from crtk_sim_backends.kit import (
    LoopServer,
    Options,
    RunningSim,
    SimStartError,
    Simulator,
    check_port,
    check_range,
    option,
)
from crtk_sim_backends.raven.robot import PERIOD, Robot

__all__ = ["SIM", "RavenSimulator", "RunningSim", "SimConfig"]

LONGEST: Final = 2048


@dataclass(frozen=True, kw_only=True)
class SimConfig(Options):
    """The options of ``crtk-driver sim raven``."""

    HEADINGS: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "The robot": ("port", "timeout"),
        **Options.HEADINGS,
    }

    port: int = option(36000, "UDP port of its network layer; 0: any free one")
    timeout: float = option(5.0, "seconds without a packet after which its pedal is up")

    @override
    def __post_init__(self) -> None:
        super().__post_init__()
        check_port("port", self.port)
        check_range("timeout", self.timeout, 0.05, 60.0)


class Door:
    """The UDP port; nobody listens while it is closed.

    Args:
        host, port: where it is.

    Raises:
        SimStartError: it is taken.
    """

    def __init__(self, host: str, port: int) -> None:
        self._host = host
        self._socket: socket.socket | None = None
        self.port = port
        try:
            self.open()
        except OSError as error:
            raise SimStartError(f"UDP port {port} cannot be had: {error.strerror}") from error

    def open(self) -> None:
        """Listen, if nobody does."""
        if self._socket is None:
            peer = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            peer.setblocking(False)
            try:
                peer.bind((self._host, self.port))
            except OSError:
                peer.close()
                raise
            self._socket = peer
            self.port = peer.getsockname()[1]

    def close(self) -> None:
        """Let nobody listen; safe to repeat."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def arrived(self) -> list[bytes]:
        """Return what has come since."""
        found: list[bytes] = []
        while self._socket is not None:
            try:
                found.append(self._socket.recv(LONGEST))
            except BlockingIOError:
                break
        return found


class RavenSimulator(Simulator[SimConfig, LoopServer]):
    """The robot as a plug-in."""

    name = "raven"
    summary = "Raven II that takes teleoperation packets, and tells nobody what it does"
    Config = SimConfig

    @override
    def serve(self, config: SimConfig, parent_fd: int | None) -> LoopServer:
        """Bind its port."""
        robot = Robot(config.timeout)
        server = LoopServer(config, parent_fd, robot, title="Raven II", gauges=robot.gauges)
        try:
            door = Door(server.host, config.port)
        except SimStartError:
            server.close()
            raise
        server.at_end(door.close)
        server.ports = {**server.ports, "itp": door.port}

        def tick() -> None:
            if robot.closed:
                door.close()
            else:
                door.open()
                for data in door.arrived():
                    robot.take(data)
                    robot.advance(0.0)  # what was late came one by one
            robot.advance(PERIOD)

        server.every(PERIOD, tick)
        return server


SIM: Final = RavenSimulator()

"""The simulated controller behind its ports."""

from __future__ import annotations

import socket
from typing import Final

from crtk_sim_backends.galil.axis import STEP
from crtk_sim_backends.galil.config import SimConfig
from crtk_sim_backends.galil.controller import LETTERS, Controller
from crtk_sim_backends.kit import LoopServer, TcpDoor
from crtk_sim_backends.page import Gauge, Gauges

HANDLES: Final = 8
_CHATTER: Final = 0.05


class CommandSession:
    """One TCP client: commands end with CR or ``;``, LF is nothing."""

    def __init__(self, controller: Controller) -> None:
        self.ended = False
        self._controller = controller
        self._rest = b""

    def receive(self, data: bytes) -> bytes:
        """Take received bytes and return the answers."""
        *lines, self._rest = (self._rest + data).replace(b"\n", b"").split(b"\r")
        faults = self._controller.faults
        answers = b"".join(self._controller.obey(line.decode("ascii", "replace")) for line in lines)
        if "mute" in faults:
            return b""
        return answers[:-1] if "half_line" in faults else answers

    def close(self) -> None:
        """Forget an unfinished line."""
        self._rest = b""


def _gauges(controller: Controller) -> list[Gauges]:
    travel = float(controller.config.travel)
    gauges: list[Gauge] = [
        {"name": letter, "low": -travel, "high": travel, "value": axis.position}
        for letter, axis in zip(LETTERS, controller.axes, strict=False)
    ]
    return [{"title": "Axes", "unit": "counts", "rate": "", "digits": 0, "gauges": gauges}]


def serve(config: SimConfig, parent_fd: int | None) -> LoopServer:
    """Bind the ports of a simulated controller."""
    controller = Controller(config)
    sessions: list[CommandSession] = []

    def session() -> CommandSession:
        sessions.append(CommandSession(controller))
        return sessions[-1]

    server = LoopServer(
        config,
        parent_fd,
        controller,
        title=f"Galil DMC-{config.model}",
        tcp={"command": TcpDoor(config.tcp_port, session, HANDLES)},
        gauges=lambda: _gauges(controller),
        requests={"place": controller.place},
    )
    door = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    server.at_end(door.close)
    door.bind((server.host, config.udp_port))
    door.setblocking(False)
    server.ports["records"] = door.getsockname()[1]

    def restart() -> None:
        for session in sessions:
            session.ended = True
            server.send("command", b"", session)
        sessions.clear()

    controller.restart = restart

    def hear() -> None:
        try:
            while True:
                data, sender = door.recvfrom(2048)
                _send(door, controller.datagram(data, sender), sender)
        except OSError:
            return  # nothing more has come, or the last client is gone

    def tick() -> None:
        hear()
        for data in controller.step():
            if controller.client is not None:
                _send(door, data, controller.client)

    def talk() -> None:
        if "chatter" in controller.faults:
            server.send("command", controller.chatter())

    server.every(STEP, tick)
    server.every(_CHATTER, talk)
    return server


def _send(door: socket.socket, data: bytes, to: tuple[str, int]) -> None:
    try:
        door.sendto(data, to)
    except OSError:
        return  # nobody is there any more, which no controller notices

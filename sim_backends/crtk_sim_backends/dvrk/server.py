"""The simulated controller behind its port."""

from __future__ import annotations

import socket
from functools import partial
from typing import Final

from crtk_sim_backends.dvrk.config import SimConfig
from crtk_sim_backends.dvrk.controller import Controller
from crtk_sim_backends.kit import LoopServer
from crtk_sim_backends.page import Gauge, Gauges

_STEP: Final = 0.02
"""Seconds after which motors and watchdogs come to the present, if nobody asks."""

_SHOWN: Final = 200_000.0
"""Counts to both sides on the page."""


def _gauges(controller: Controller) -> list[Gauges]:
    found: list[Gauges] = []
    for board in controller.boards:
        gauges: list[Gauge] = [
            {"name": f"axis {at}", "low": -_SHOWN, "high": _SHOWN, "value": axis.position}
            for at, axis in enumerate(board.axes)
        ]
        title = f"Board {board.number}"
        found.append({"title": title, "unit": "counts", "rate": "", "digits": 0, "gauges": gauges})
    return found


def serve(config: SimConfig, parent_fd: int | None) -> LoopServer:
    """Bind the ports of a simulated controller."""
    controller = Controller(config)
    server = LoopServer(
        config,
        parent_fd,
        controller,
        title="dVRK controller",
        gauges=lambda: _gauges(controller),
        requests={"turn": controller.turn, "place": controller.place, "press": controller.press},
    )
    door = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    server.at_end(door.close)
    door.bind((server.host, config.udp_port))
    door.setblocking(False)
    server.ports["boards"] = door.getsockname()[1]

    def send(data: bytes, to: tuple[str, int]) -> None:
        try:
            door.sendto(data, to)
        except OSError:
            return  # nobody is there any more, which no board notices

    def hear(_: int) -> None:
        try:
            while True:
                data, sender = door.recvfrom(2048)
                for told in controller.datagram(data):
                    delay = controller.faults.get("delay")
                    if delay is None:
                        send(told, sender)
                    else:
                        server.after(delay["seconds"], partial(send, told, sender))
        except OSError:
            return  # nothing more has come, or a client has gone

    server.watch(door.fileno(), hear)
    server.every(_STEP, controller.advance)
    return server

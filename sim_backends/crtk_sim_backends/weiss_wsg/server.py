"""The simulated gripper behind its ports."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

from crtk_sim_backends.kit import LoopServer, Session, TcpDoor
from crtk_sim_backends.page import Gauge, Gauges
from crtk_sim_backends.weiss_wsg.config import SimConfig
from crtk_sim_backends.weiss_wsg.gripper import Gripper
from crtk_sim_backends.weiss_wsg.sessions import BinarySession, TextSession

PERIOD: Final = 0.002
"""Seconds from one step of the mechanics to the next."""


def serve(config: SimConfig, parent_fd: int | None) -> LoopServer:
    """Bind the ports of a simulated gripper; each lets one client in."""
    gripper = Gripper(config)
    clients: dict[str, BinarySession | TextSession] = {}

    def of(
        name: str, kind: type[BinarySession | TextSession], *, minds: bool
    ) -> Callable[[], Session]:
        def later(seconds: float, session: Session, data: bytes) -> None:
            if seconds:
                server.after(seconds, lambda: server.send(name, data, session))
            else:
                server.send(name, data, session)

        def session() -> Session:
            clients[name] = kind(gripper, later, minds=minds)
            return clients[name]

        return session

    def gauges() -> list[Gauges]:
        force: Gauge = {
            "name": "force",
            "low": 0.0,
            "high": gripper.model.force[1],
            "value": gripper.force,
        }
        return [
            gripper.jaw.gauges(0.0, 1e-3 * gripper.model.stroke),
            {"title": "Grip", "unit": "N", "rate": "", "digits": 1, "gauges": [force]},
        ]

    stops = config.fast_stop_on_disconnect
    server = LoopServer(
        config,
        parent_fd,
        gripper,
        title=config.model.upper().replace("WSG-", "WSG "),
        tcp={
            "binary": TcpDoor(config.binary_port, of("binary", BinarySession, minds=stops), 1),
            "text": TcpDoor(config.text_port, of("text", TextSession, minds=stops), 1),
        },
        ttys={"serial": of("serial", BinarySession, minds=False)},
        gauges=gauges,
    )

    def tick() -> None:
        gripper.advance(PERIOD)
        now = time.monotonic()
        for name, client in clients.items():
            told = client.tick(now)
            if told or client.ended:
                server.send(name, told, client)

    def cut() -> None:
        for client in clients.values():
            client.vanish()

    gripper.cut = cut
    server.every(PERIOD, tick)
    return server

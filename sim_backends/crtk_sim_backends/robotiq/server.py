"""The simulated gripper behind its ports."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

from crtk_sim_backends.kit import Fault, LoopServer, Session, TcpDoor
from crtk_sim_backends.page import Gauge, Gauges
from crtk_sim_backends.robotiq import gripper as mechanics
from crtk_sim_backends.robotiq import line as wires
from crtk_sim_backends.robotiq.config import SimConfig
from crtk_sim_backends.robotiq.gripper import Gripper, Thing
from crtk_sim_backends.robotiq.line import Distortion, RtuLine, RtuSession, TcpSession
from crtk_sim_backends.robotiq.urcap import UrcapSession

PERIOD: Final = 0.002
"""Seconds from one step of the mechanics to the next."""


class Unit:
    """The gripper and the electronics that answer for it, as one device."""

    def __init__(self, config: SimConfig) -> None:
        self.kinds = {**mechanics.KINDS, **wires.KINDS}
        band = config.band_open, config.band_closed
        self.gripper = Gripper(
            config.model, band, activated=config.activated, lag=config.object_lag
        )
        self.gripper.position += config.closed * (band[1] - band[0])
        if config.object_width:
            self.gripper.thing = Thing(config.object_width, config.object_stiffness, around=False)
        self.distortion = Distortion()

    def begin(self, fault: Fault) -> None:
        """Let a fault begin."""
        self._whose(fault).begin(fault)

    def end(self, fault: Fault) -> None:
        """Let it end."""
        self._whose(fault).end(fault)

    def _whose(self, fault: Fault) -> Gripper | Distortion:
        return self.gripper if fault.kind in mechanics.KINDS else self.distortion

    def status(self) -> Mapping[str, Any]:
        """What a test or a person wants to know."""
        return self.gripper.status()

    def gauges(self) -> list[Gauges]:
        """What the page shows."""
        gripper = self.gripper
        opening: Gauge = {
            "name": "opening",
            "low": 0.0,
            "high": 1e3 * gripper.model.stroke,
            "value": 1e3 * gripper.opening,
        }
        current: Gauge = {"name": "current", "low": 0.0, "high": 2.55, "value": gripper.current}
        return [
            {"title": "Fingers", "unit": "mm", "rate": "", "digits": 1, "gauges": [opening]},
            {"title": "Motor", "unit": "A", "rate": "", "digits": 2, "gauges": [current]},
        ]


def serve(config: SimConfig, parent_fd: int | None) -> LoopServer:
    """Bind the ports of a simulated gripper."""
    unit = Unit(config)
    gripper, distortion = unit.gripper, unit.distortion

    def line(name: str) -> RtuLine:
        return RtuLine(
            gripper,
            distortion,
            config.unit,
            config.baud,
            config.turnaround,
            after=lambda seconds, function: server.after(seconds, function),
            deliver=lambda session, data: server.send(name, data, session),
        )

    def later(name: str) -> Callable[[float, Session, bytes], None]:
        return lambda seconds, session, data: server.after(
            seconds, lambda: server.send(name, data, session)
        )

    tool, serial = line("tool"), line("serial")
    end = b"\n" if config.urcap_newline else b""
    server = LoopServer(
        config,
        parent_fd,
        unit,
        title=f"Robotiq {config.model.upper()}",
        tcp={
            "tool": TcpDoor(config.tool_port, lambda: RtuSession(tool)),
            "modbus": TcpDoor(
                config.modbus_port,
                lambda: TcpSession(gripper, distortion, config.unit, later("modbus")),
            ),
            "urcap": TcpDoor(
                config.urcap_port,
                lambda: UrcapSession(gripper, distortion, end, later("urcap")),
            ),
        },
        ttys={"serial": lambda: RtuSession(serial)},
        gauges=unit.gauges,
    )
    server.every(PERIOD, lambda: gripper.advance(PERIOD))
    return server

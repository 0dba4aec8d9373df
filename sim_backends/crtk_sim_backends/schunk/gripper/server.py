"""The simulated gripper and the electronics that answer for it, behind their ports."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from crtk_sim_backends.kit import Fault, LoopServer, TcpDoor
from crtk_sim_backends.kit.modbus import ILLEGAL_ADDRESS, Refused
from crtk_sim_backends.kit.modbus_line import Distortion
from crtk_sim_backends.kit.modbus_server import Later, serve_modbus
from crtk_sim_backends.page import Gauge, Gauges
from crtk_sim_backends.schunk.gripper import gripper as mechanics
from crtk_sim_backends.schunk.gripper import web
from crtk_sim_backends.schunk.gripper.config import SimConfig
from crtk_sim_backends.schunk.gripper.gripper import CONTROL, STATUS, Gripper
from crtk_sim_backends.schunk.gripper.parameters import parameters
from crtk_sim_backends.schunk.gripper.web import Manners, WebSession

SPACE = 8
"""Registers from one instance to the next; register 0 is that of instance 1."""


class Unit:
    """The gripper and its module, as one device."""

    functions = frozenset({3, 16})

    def __init__(self, config: SimConfig) -> None:
        self._config = config
        self.kinds = {**mechanics.KINDS, **web.KINDS}
        self.gripper = Gripper(config)
        self.manners = Manners()
        self.memory = parameters(config)
        self.advance = self.gripper.advance

    # ----------------------------------------------------------------------------------- its registers

    @property
    def powered(self) -> bool:
        """Whether it answers."""
        return self.gripper.powered

    def heard(self) -> None:
        """It does not mind silence."""

    def read(self, address: int, count: int) -> bytes:
        """Return the bytes of registers, which are those of one instance."""
        instance = (address + 1) // SPACE * SPACE
        values = {**self.memory, STATUS: self.gripper.report, CONTROL: bytes(self.gripper.written)}
        value = values.get(instance, b"")
        begin = 2 * (address + 1 - instance)
        found = (value + bytes(len(value) % 2))[begin : begin + 2 * count]
        if len(found) < 2 * count:
            raise Refused(ILLEGAL_ADDRESS)
        return found

    def write(self, address: int, data: bytes) -> None:
        """Take the bytes of registers of its control, all or some."""
        begin = 2 * (address + 1 - CONTROL)
        if not 0 <= begin <= begin + len(data) <= 16:
            raise Refused(ILLEGAL_ADDRESS)
        self.gripper.write(begin, data)

    # ------------------------------------------------------------------------------------- its faults

    def begin(self, fault: Fault) -> None:
        """Let a fault begin."""
        self._whose(fault).begin(fault)

    def end(self, fault: Fault) -> None:
        """Let it end."""
        self._whose(fault).end(fault)

    def _whose(self, fault: Fault) -> Gripper | Manners:
        return self.gripper if fault.kind in mechanics.KINDS else self.manners

    def status(self) -> Mapping[str, Any]:
        """What a test or a person wants to know."""
        return self.gripper.status()

    def gauges(self) -> list[Gauges]:
        """What the page shows."""
        gripper, config = self.gripper, self._config
        force: Gauge = {
            "name": "force",
            "low": 0.0,
            "high": config.max_force,
            "value": gripper.pressed,
        }
        return [
            gripper.jaw.gauges(config.lower, config.upper),
            {"title": "Grip", "unit": "N", "rate": "", "digits": 0, "gauges": [force]},
        ]


def serve(config: SimConfig, parent_fd: int | None) -> LoopServer:
    """Bind the ports of a simulated gripper."""
    unit = Unit(config)

    def web_server(distortion: Distortion, later: Callable[[str], Later]) -> Mapping[str, TcpDoor]:
        def session() -> WebSession:
            return WebSession(unit.gripper, unit.memory, unit.manners, distortion, later("http"))

        return {"http": TcpDoor(config.http_port, session)}

    return serve_modbus(config, parent_fd, unit, f"SCHUNK {config.model.upper()}", web_server)

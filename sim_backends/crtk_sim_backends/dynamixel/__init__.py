"""Simulated DYNAMIXEL servos on a serial bus.

:data:`SIM` starts them; ``python -m crtk_sim_backends.dynamixel`` runs them alone and tells the tty to
use.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

from typing_extensions import override

from crtk_sim_backends.dynamixel.config import SimConfig
from crtk_sim_backends.options import ConfigError
from crtk_sim_backends.process import RunningSim, SimStartError
from crtk_sim_backends.simulator import Simulator

if TYPE_CHECKING:
    from crtk_sim_backends.dynamixel.server import DynamixelServer

__all__ = ["SIM", "ConfigError", "DynamixelSimulator", "RunningSim", "SimConfig", "SimStartError"]


class DynamixelSimulator(Simulator[SimConfig, "DynamixelServer"]):
    """The servos as a plug-in; `ports` has the TCP port of each bus by the same name as `ttys`."""

    name = "dynamixel"
    summary = "DYNAMIXEL servos on a serial bus (protocol 2.0 and 1.0), with their timing"
    Config = SimConfig

    @override
    def serve(self, config: SimConfig, parent_fd: int | None) -> DynamixelServer:
        """Make the ttys and the control socket."""
        from crtk_sim_backends.dynamixel.server import DynamixelServer

        return DynamixelServer(config, parent_fd)

    @override
    def describe(self, server: DynamixelServer) -> Iterator[str]:
        """Tell the tty and the servos of every bus."""
        config = server.config
        for (name, path), specs in zip(server.ttys.items(), config.buses, strict=True):
            servos = ", ".join(f"{spec.number} {spec.model.name}" for spec in specs)
            url = f"socket://{server.host}:{server.ports[name]}"
            yield f"simulated DYNAMIXEL {name} at {path} and {url}, {config.baud} bps: {servos}"
        yield f"control socket at {server.host}:{server.ports['control']}"


SIM: Final = DynamixelSimulator()

"""A simulated ATI NetFT sensor box on the ports of a real one.

:data:`SIM` starts it; ``python -m crtk_sim_backends.netft`` runs it alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

from typing_extensions import override

from crtk_sim_backends.netft.config import SimConfig
from crtk_sim_backends.options import ConfigError
from crtk_sim_backends.process import RunningSim, SimStartError
from crtk_sim_backends.simulator import Simulator

if TYPE_CHECKING:
    from crtk_sim_backends.netft.server import NetFtServer

__all__ = ["SIM", "ConfigError", "NetFtSimulator", "RunningSim", "SimConfig", "SimStartError"]


class NetFtSimulator(Simulator[SimConfig, "NetFtServer"]):
    """The sensor box as a plug-in."""

    name = "ati-netft"
    summary = "ATI NetFT sensor box (Net Box, Ethernet Axia, SCHUNK FTN, OnRobot HEX)"
    Config = SimConfig

    @override
    def serve(self, config: SimConfig, parent_fd: int | None) -> NetFtServer:
        """Bind its ports."""
        from crtk_sim_backends.netft.server import NetFtServer

        return NetFtServer(config, parent_fd)

    @override
    def describe(self, server: NetFtServer) -> Iterator[str]:
        """Tell which box it is, and its ports."""
        config = server.config
        yield f"{config.family.product}, sensor {config.sensor.part}, at {server.host}"
        yield "ports: " + ", ".join(f"{name} {port}" for name, port in server.ports.items())


SIM: Final = NetFtSimulator()

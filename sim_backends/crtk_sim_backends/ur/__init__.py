"""A simulated Universal Robots controller on the ports of a real one.

:data:`SIM` starts it; ``python -m crtk_sim_backends.ur`` runs it alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

from typing_extensions import override

from crtk_sim_backends.options import ConfigError
from crtk_sim_backends.process import RunningSim, SimStartError
from crtk_sim_backends.simulator import Simulator
from crtk_sim_backends.ur.config import SimConfig

if TYPE_CHECKING:
    from crtk_sim_backends.ur.server import UrServer

__all__ = ["SIM", "ConfigError", "RunningSim", "SimConfig", "SimStartError", "UrSimulator"]


class UrSimulator(Simulator[SimConfig, "UrServer"]):
    """The controller as a plug-in."""

    name = "ur"
    summary = "Universal Robots controller (CB3, e-Series, PolyScope X) that runs URScript"
    Config = SimConfig

    @override
    def serve(self, config: SimConfig, parent_fd: int | None) -> UrServer:
        """Bind its ports."""
        from crtk_sim_backends.ur.server import UrServer

        return UrServer(config, parent_fd)

    @override
    def describe(self, server: UrServer) -> Iterator[str]:
        """Tell which arm it is, its software, and its ports."""
        config = server.config
        version = ".".join(map(str, config.software[:3]))
        state = "running" if config.powered_on else "powered off"
        yield f"simulated {config.robot.title}, software {version}, {state}, at {server.host}"
        yield "ports: " + ", ".join(f"{name} {port}" for name, port in sorted(server.ports.items()))


SIM: Final = UrSimulator()

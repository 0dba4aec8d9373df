"""A simulated Galil DMC controller: commands over TCP, data records over UDP, axes that move.

:data:`SIM` starts it; ``python -m crtk_sim_backends.galil`` runs it alone.
"""

from __future__ import annotations

from typing import Final

from typing_extensions import override

from crtk_sim_backends.galil.config import SimConfig
from crtk_sim_backends.galil.server import serve
from crtk_sim_backends.kit import LoopServer, RunningSim, Simulator

__all__ = ["SIM", "GalilSimulator", "RunningSim", "SimConfig"]


class GalilSimulator(Simulator[SimConfig, LoopServer]):
    """The controller as a plug-in."""

    name = "galil"
    summary = "Galil DMC motion controller with axes that move, limit and home switches"
    Config = SimConfig

    @override
    def serve(self, config: SimConfig, parent_fd: int | None) -> LoopServer:
        """Bind its ports."""
        return serve(config, parent_fd)


SIM: Final = GalilSimulator()

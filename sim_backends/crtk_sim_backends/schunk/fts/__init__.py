"""A simulated SCHUNK FTS with its Ethernet box: commands over TCP, measurements over UDP.

:data:`SIM` starts it; ``python -m crtk_sim_backends.schunk.fts`` runs it alone.
"""

from __future__ import annotations

from typing import Final

from typing_extensions import override

from crtk_sim_backends.kit import LoopServer, RunningSim, Simulator
from crtk_sim_backends.schunk.fts.config import SimConfig
from crtk_sim_backends.schunk.fts.server import serve

__all__ = ["SIM", "FtsSimulator", "RunningSim", "SimConfig"]


class FtsSimulator(Simulator[SimConfig, LoopServer]):
    """The sensor as a plug-in."""

    name = "schunk-fts"
    summary = "SCHUNK FTS force/torque sensor with its Ethernet box"
    Config = SimConfig

    @override
    def serve(self, config: SimConfig, parent_fd: int | None) -> LoopServer:
        """Bind its ports."""
        return serve(config, parent_fd)


SIM: Final = FtsSimulator()

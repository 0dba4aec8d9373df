"""A simulated Haply Inverse service: an Inverse3 that a hand may push, and a VerseGrip.

:data:`SIM` starts it; ``python -m crtk_sim_backends.haply`` runs it alone.
"""

from __future__ import annotations

from typing import Final

from typing_extensions import override

from crtk_sim_backends.haply.config import SimConfig
from crtk_sim_backends.haply.server import serve
from crtk_sim_backends.kit import LoopServer, RunningSim, Simulator

__all__ = ["SIM", "HaplySimulator", "RunningSim", "SimConfig"]


class HaplySimulator(Simulator[SimConfig, LoopServer]):
    """The service as a plug-in."""

    name = "haply"
    summary = "Haply Inverse service with an Inverse3 that a hand pushes, and a VerseGrip"
    Config = SimConfig

    @override
    def serve(self, config: SimConfig, parent_fd: int | None) -> LoopServer:
        """Bind its port."""
        return serve(config, parent_fd)


SIM: Final = HaplySimulator()

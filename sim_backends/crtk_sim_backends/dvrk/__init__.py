"""A simulated dVRK controller: FPGA1394 boards with QLAs on a FireWire bus, reached over UDP.

:data:`SIM` starts it; ``python -m crtk_sim_backends.dvrk`` runs it alone.
"""

from __future__ import annotations

from typing import Final

from typing_extensions import override

from crtk_sim_backends.dvrk.config import SimConfig
from crtk_sim_backends.dvrk.server import serve
from crtk_sim_backends.kit import LoopServer, RunningSim, Simulator

__all__ = ["SIM", "DvrkSimulator", "RunningSim", "SimConfig"]


class DvrkSimulator(Simulator[SimConfig, LoopServer]):
    """The controller as a plug-in."""

    name = "dvrk"
    summary = "controller of a da Vinci Research Kit: FPGA1394 boards with QLAs, over UDP"
    Config = SimConfig

    @override
    def serve(self, config: SimConfig, parent_fd: int | None) -> LoopServer:
        """Bind its ports."""
        return serve(config, parent_fd)


SIM: Final = DvrkSimulator()

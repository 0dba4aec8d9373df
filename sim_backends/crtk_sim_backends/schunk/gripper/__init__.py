"""A simulated SCHUNK gripper: web server of its fieldbus module, serial line, the robot's tool line.

:data:`SIM` starts it; ``python -m crtk_sim_backends.schunk.gripper`` runs it alone.
"""

from __future__ import annotations

from typing import Final

from typing_extensions import override

from crtk_sim_backends.kit import LoopServer, RunningSim, Simulator
from crtk_sim_backends.schunk.gripper.config import SimConfig
from crtk_sim_backends.schunk.gripper.server import serve

__all__ = ["SIM", "RunningSim", "SchunkSimulator", "SimConfig"]


class SchunkSimulator(Simulator[SimConfig, LoopServer]):
    """The gripper as a plug-in."""

    name = "schunk"
    summary = "SCHUNK gripper (EGU, EGK, EZU) with an object to grip"
    Config = SimConfig

    @override
    def serve(self, config: SimConfig, parent_fd: int | None) -> LoopServer:
        """Bind its ports and its serial line."""
        return serve(config, parent_fd)


SIM: Final = SchunkSimulator()

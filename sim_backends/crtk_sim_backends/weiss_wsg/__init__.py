"""A simulated WSG gripper: its binary protocol and its text mode by TCP, and a serial line.

:data:`SIM` starts it; ``python -m crtk_sim_backends.weiss_wsg`` runs it alone.
"""

from __future__ import annotations

from typing import Final

from typing_extensions import override

from crtk_sim_backends.kit import LoopServer, RunningSim, Simulator
from crtk_sim_backends.weiss_wsg.config import SimConfig
from crtk_sim_backends.weiss_wsg.server import serve

__all__ = ["SIM", "RunningSim", "SimConfig", "WsgSimulator"]


class WsgSimulator(Simulator[SimConfig, LoopServer]):
    """The gripper as a plug-in."""

    name = "weiss-wsg"
    summary = "Weiss Robotics WSG gripper (WSG 50, WSG 32) with a part to grip"
    Config = SimConfig

    @override
    def serve(self, config: SimConfig, parent_fd: int | None) -> LoopServer:
        """Bind its ports and its serial line."""
        return serve(config, parent_fd)


SIM: Final = WsgSimulator()

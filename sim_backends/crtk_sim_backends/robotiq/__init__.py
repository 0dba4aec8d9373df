"""A simulated Robotiq gripper: serial line, the robot's tool line, Modbus TCP, and the URCap's text server.

:data:`SIM` starts it; ``python -m crtk_sim_backends.robotiq`` runs it alone.
"""

from __future__ import annotations

from typing import Final

from typing_extensions import override

from crtk_sim_backends.kit import LoopServer, RunningSim, Simulator
from crtk_sim_backends.robotiq.config import SimConfig
from crtk_sim_backends.robotiq.server import serve

__all__ = ["SIM", "RobotiqSimulator", "RunningSim", "SimConfig"]


class RobotiqSimulator(Simulator[SimConfig, LoopServer]):
    """The gripper as a plug-in."""

    name = "robotiq"
    summary = "Robotiq gripper (2F-85, 2F-140, Hand-E) with an object to grip"
    Config = SimConfig

    @override
    def serve(self, config: SimConfig, parent_fd: int | None) -> LoopServer:
        """Bind its ports and its serial line."""
        return serve(config, parent_fd)


SIM: Final = RobotiqSimulator()

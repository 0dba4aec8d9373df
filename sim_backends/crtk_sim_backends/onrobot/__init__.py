"""A simulated OnRobot gripper: behind a Compute Box (Modbus TCP), at a serial line, at a robot's tool line.

:data:`SIM` starts it; ``python -m crtk_sim_backends.onrobot`` runs it alone.
"""

from __future__ import annotations

from typing import Final

from typing_extensions import override

from crtk_sim_backends.kit import LoopServer, RunningSim, Simulator
from crtk_sim_backends.kit.modbus_server import serve_modbus
from crtk_sim_backends.onrobot.config import SimConfig
from crtk_sim_backends.onrobot.models import MODELS, Channels
from crtk_sim_backends.onrobot.tool import ComputeBox

__all__ = ["SIM", "OnRobotSimulator", "RunningSim", "SimConfig"]


class OnRobotSimulator(Simulator[SimConfig, LoopServer]):
    """The gripper as a plug-in."""

    name = "onrobot"
    summary = "OnRobot gripper (RG2, RG6, 2FG7, 2FG14, 3FG15, VG10, VGC10) with an object to grip"
    Config = SimConfig

    @override
    def serve(self, config: SimConfig, parent_fd: int | None) -> LoopServer:
        """Bind its ports and its serial line."""
        from crtk_sim_backends.onrobot.fingers import FingerTool
        from crtk_sim_backends.onrobot.vacuum import VacuumTool

        family = MODELS[config.model].family
        tool = (VacuumTool if isinstance(family, Channels) else FingerTool)(config)
        title = f"OnRobot {config.model.upper()}"
        return serve_modbus(config, parent_fd, tool, title, beyond=ComputeBox(tool).answer)


SIM: Final = OnRobotSimulator()

"""A simulated Robotiq vacuum gripper (ePick), with an object that may leak.

:data:`SIM` starts it; ``python -m crtk_sim_backends.robotiq.epick`` runs it alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Final

from typing_extensions import override

from crtk_sim_backends.kit import LoopServer, RunningSim, Simulator, check_range, option
from crtk_sim_backends.kit.modbus_server import ModbusOptions, serve_modbus
from crtk_sim_backends.robotiq.epick.pump import Pump

__all__ = ["SIM", "EpickSimulator", "RunningSim", "SimConfig"]


@dataclass(frozen=True, kw_only=True)
class SimConfig(ModbusOptions):
    """The options of ``crtk-driver sim robotiq-epick``."""

    HEADINGS: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "The gripper": ("activated", "unit"),
        "What lies under its cups": ("object", "leak"),
        "Ports": ModbusOptions.PORTS,
        **ModbusOptions.HEADINGS,
    }

    activated: bool = option(
        True, "somebody has activated it before; otherwise it is as powered on"
    )
    object: bool = option(True, "something lies under the cups")
    leak: float = option(0.0, "of what lies there: share of its pump's flow at full vacuum")
    unit: int = option(9, "its Modbus address")

    @override
    def __post_init__(self) -> None:
        super().__post_init__()
        check_range("leak", self.leak, 0.0, 2.0)


class EpickSimulator(Simulator[SimConfig, LoopServer]):
    """The gripper as a plug-in."""

    name = "robotiq-epick"
    summary = "Robotiq vacuum gripper (ePick) with an object that may leak"
    Config = SimConfig

    @override
    def serve(self, config: SimConfig, parent_fd: int | None) -> LoopServer:
        """Bind its ports and its serial line."""
        pump = Pump(activated=config.activated, leak=config.leak if config.object else None)
        return serve_modbus(config, parent_fd, pump, "Robotiq ePick")


SIM: Final = EpickSimulator()

"""A simulated Robotiq force sensor (FT 300): its data stream and its registers.

:data:`SIM` starts it; ``python -m crtk_sim_backends.robotiq.ft300`` runs it alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Final

from typing_extensions import override

from crtk_sim_backends.kit import LoopServer, RunningSim, Simulator, check_range, option
from crtk_sim_backends.kit.modbus_server import ModbusOptions, serve_modbus
from crtk_sim_backends.robotiq.ft300.line import StreamLine
from crtk_sim_backends.robotiq.ft300.sensor import Sensor

__all__ = ["SIM", "Ft300Simulator", "RunningSim", "SimConfig"]


@dataclass(frozen=True, kw_only=True)
class SimConfig(ModbusOptions):
    """The options of ``crtk-driver sim robotiq-ft300``."""

    HEADINGS: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "The sensor": ("unit", "noise", "streams"),
        "Ports": ModbusOptions.PORTS,
        **ModbusOptions.HEADINGS,
    }

    unit: int = option(9, "its Modbus address")
    baud: int = option(19200, "bits a second of its serial lines; 0: as fast as it goes")
    noise: float = option(0.05, "standard deviation of each force, in N; a tenth of it in N·m")
    streams: bool = option(False, "somebody has let it stream, and has gone")

    @override
    def __post_init__(self) -> None:
        super().__post_init__()
        check_range("noise", self.noise, 0.0, 10.0)


class Ft300Simulator(Simulator[SimConfig, LoopServer]):
    """The sensor as a plug-in."""

    name = "robotiq-ft300"
    summary = "Robotiq force sensor (FT 300, FT 300-S) that can be loaded"
    Config = SimConfig

    @override
    def serve(self, config: SimConfig, parent_fd: int | None) -> LoopServer:
        """Bind its ports and its serial line."""
        sensor = Sensor(config.noise, streams=config.streams)
        return serve_modbus(config, parent_fd, sensor, "Robotiq FT 300", make_line=StreamLine)


SIM: Final = Ft300Simulator()

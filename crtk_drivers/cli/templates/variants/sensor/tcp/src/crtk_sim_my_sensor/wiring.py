"""The line of the simulated sensor, a TCP port, and its options."""

from __future__ import annotations

from dataclasses import dataclass

from crtk_sim_backends.kit import LineSession, LoopServer, Options, TcpDoor, check_port, option
from typing_extensions import override

from crtk_sim_my_sensor.device import SimulatedSensor


@dataclass(frozen=True, kw_only=True)
class SimConfig(Options):
    """The options of ``crtk-driver sim my_sensor``."""

    load: float = option(0.0, "what lies on it from the start, in N")
    port: int = option(0, "TCP port of the sensor; 0: any free one")

    @override
    def __post_init__(self) -> None:
        super().__post_init__()
        check_port("port", self.port)


def make_server(config: SimConfig, parent_fd: int | None, device: SimulatedSensor) -> LoopServer:
    """Make its line."""
    door = TcpDoor(config.port, lambda: LineSession(device.obey), most=1)
    return LoopServer(config, parent_fd, device, title="my_sensor", tcp={"line": door})

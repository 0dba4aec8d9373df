"""A simulated sensor that speaks the real one's protocol. It shares no code with the driver."""

from __future__ import annotations

from dataclasses import dataclass

from crtk_sim_backends.kit import LineSession, LoopServer, Options, Simulator, option
from typing_extensions import override

from crtk_sim_my_sensor.device import SimulatedSensor


@dataclass(frozen=True, kw_only=True)
class SimConfig(Options):
    """The options of ``crtk-driver sim my_sensor``."""

    load: float = option(0.0, "what lies on it from the start, in N")


class MySensorSimulator(Simulator[SimConfig, LoopServer]):
    """The sensor as a plugin."""

    name = "my_sensor"
    summary = "my_sensor, a force sensor at a serial line"
    Config = SimConfig

    @override
    def serve(self, config: SimConfig, parent_fd: int | None) -> LoopServer:
        """Make its serial line."""
        device = SimulatedSensor(config.load)
        lines = {"line": lambda: LineSession(device.obey)}
        return LoopServer(config, parent_fd, device, title="my_sensor", ttys=lines)


SIM = MySensorSimulator()

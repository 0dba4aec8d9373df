"""A simulated sensor that speaks the real one's protocol. It shares no code with the driver."""

from __future__ import annotations

from crtk_sim_backends.kit import LoopServer, Simulator
from typing_extensions import override

from crtk_sim_my_sensor.device import SimulatedSensor
from crtk_sim_my_sensor.wiring import SimConfig, make_server


class MySensorSimulator(Simulator[SimConfig, LoopServer]):
    """The sensor as a plugin."""

    name = "my_sensor"
    summary = "my_sensor, a force sensor"
    Config = SimConfig

    @override
    def serve(self, config: SimConfig, parent_fd: int | None) -> LoopServer:
        """Make its line, with the sensor behind it."""
        return make_server(config, parent_fd, SimulatedSensor(config.load))


SIM = MySensorSimulator()

"""The line of the simulated sensor, a serial line, and its options."""

from __future__ import annotations

from dataclasses import dataclass

from crtk_sim_backends.kit import LineSession, LoopServer, Options, option

from crtk_sim_my_sensor.device import SimulatedSensor


@dataclass(frozen=True, kw_only=True)
class SimConfig(Options):
    """The options of ``crtk-driver sim my_sensor``."""

    load: float = option(0.0, "what lies on it from the start, in N")


def make_server(config: SimConfig, parent_fd: int | None, device: SimulatedSensor) -> LoopServer:
    """Make its line."""
    lines = {"line": lambda: LineSession(device.obey)}
    return LoopServer(config, parent_fd, device, title="my_sensor", ttys=lines)

"""A simulated scale that speaks the real one's protocol. It shares no code with the driver."""

from __future__ import annotations

from dataclasses import dataclass

from typing_extensions import override

from crtk_sim_backends.kit import LineSession, LoopServer, Options, Simulator, option
from crtk_sim_sartorius.scale import Scale


@dataclass(frozen=True, kw_only=True)
class SimConfig(Options):
    """The options of ``crtk-driver sim sartorius``."""

    mass: float = option(0.0, "what lies on it from the start, in g")


class SartoriusSimulator(Simulator[SimConfig, LoopServer]):
    """The scale as a plugin."""

    name = "sartorius"
    summary = "a Sartorius scale at a serial line (example of a plugin)"
    Config = SimConfig

    @override
    def serve(self, config: SimConfig, parent_fd: int | None) -> LoopServer:
        """Make its serial line."""
        scale = Scale(config.mass)
        lines = {"line": lambda: LineSession(scale.obey, b"\r\n")}
        return LoopServer(config, parent_fd, scale, title="Scale", ttys=lines)


SIM = SartoriusSimulator()

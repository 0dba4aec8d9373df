"""Simulated pedals, a joystick and a six-axis mouse, as the kernel and spacenavd tell of them.

:data:`SIM` starts it; ``python -m crtk_sim_backends.inputs`` runs it alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from typing_extensions import override

from crtk_sim_backends.inputs.panel import Daemon, EventClient, Panel
from crtk_sim_backends.kit import (
    LoopServer,
    Options,
    RunningSim,
    Simulator,
    check_range,
    option,
)

__all__ = ["SIM", "InputsSimulator", "RunningSim", "SimConfig"]

PERIOD: Final = 1.0 / 60.0
"""Seconds between two reports of a mouse that is pushed, and two repetitions of a key that is held."""


@dataclass(frozen=True, kw_only=True)
class SimConfig(Options):
    """The options of ``crtk-driver sim inputs``."""

    protocol: int = option(1, "of spacenavd: 1, or 0 for a daemon that knows no other")

    @override
    def __post_init__(self) -> None:
        super().__post_init__()
        check_range("protocol", self.protocol, 0, 1)


class InputsSimulator(Simulator[SimConfig, LoopServer]):
    """The panel as a plug-in."""

    name = "inputs"
    summary = (
        "Foot pedals and a joystick as the kernel tells them, a six-axis mouse as spacenavd does"
    )
    Config = SimConfig

    @override
    def serve(self, config: SimConfig, parent_fd: int | None) -> LoopServer:
        """Make its lines and its socket."""
        panel = Panel()
        server = LoopServer(
            config,
            parent_fd,
            panel,
            title="Pedals, joystick, mouse",
            ttys={"evdev": EventClient, "js": EventClient},
            sockets={"spacenavd": lambda: Daemon(panel, config.protocol)},
            gauges=panel.gauges,
        )
        panel.send = server.send
        server.every(PERIOD, panel.tick)
        return server


SIM: Final = InputsSimulator()

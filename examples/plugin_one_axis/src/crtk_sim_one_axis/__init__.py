"""A simulated linear stage that speaks the real one's protocol. It shares no code with the driver."""

from __future__ import annotations

from dataclasses import dataclass

from typing_extensions import override

from crtk_sim_backends.kit import (
    LineSession,
    LoopServer,
    Options,
    Simulator,
    TcpDoor,
    check_port,
    check_range,
    option,
)
from crtk_sim_one_axis.stage import Stage

PERIOD = 0.01
"""Seconds from one report of the stage to the next."""


@dataclass(frozen=True, kw_only=True)
class SimConfig(Options):
    """The options of ``crtk-driver sim one_axis``."""

    port: int = option(0, "TCP port of the stage; 0: any free one")
    travel: float = option(0.5, "length of the stage, in m")

    @override
    def __post_init__(self) -> None:
        super().__post_init__()
        check_port("port", self.port)
        check_range("travel", self.travel, 0.01, 10.0)


class OneAxisSimulator(Simulator[SimConfig, LoopServer]):
    """The stage as a plugin."""

    name = "one_axis"
    summary = "a linear stage with a line protocol over TCP (example of a plugin)"
    Config = SimConfig

    @override
    def serve(self, config: SimConfig, parent_fd: int | None) -> LoopServer:
        """Bind its port, for one host at a time."""
        stage = Stage(config.travel)
        door = TcpDoor(config.port, lambda: LineSession(stage.obey), most=1)
        server = LoopServer(config, parent_fd, stage, title="Stage", tcp={"stage": door})

        def tick() -> None:
            stage.advance(PERIOD)
            server.send("stage", stage.report())

        server.every(PERIOD, tick)
        return server


SIM = OneAxisSimulator()

"""A simulated arm that speaks the real one's protocol. It shares no code with the driver."""

from __future__ import annotations

from dataclasses import dataclass

from crtk_sim_backends.kit import (
    LineSession,
    LoopServer,
    Options,
    Simulator,
    TcpDoor,
    check_port,
    option,
)
from typing_extensions import override

from crtk_sim_my_arm.device import PERIOD, SimulatedArm


@dataclass(frozen=True, kw_only=True)
class SimConfig(Options):
    """The options of ``crtk-driver sim my_arm``."""

    port: int = option(0, "TCP port of the arm; 0: any free one")

    @override
    def __post_init__(self) -> None:
        super().__post_init__()
        check_port("port", self.port)


class MyArmSimulator(Simulator[SimConfig, LoopServer]):
    """The arm as a plugin."""

    name = "my_arm"
    summary = "my_arm, an arm of three joints"
    Config = SimConfig

    @override
    def serve(self, config: SimConfig, parent_fd: int | None) -> LoopServer:
        """Bind its port, for one host at a time."""
        device = SimulatedArm()
        door = TcpDoor(config.port, lambda: LineSession(device.obey), most=1)
        server = LoopServer(config, parent_fd, device, title="my_arm", tcp={"arm": door})

        def tick() -> None:
            device.advance()
            server.send("arm", device.report())

        server.every(PERIOD, tick)
        return server


SIM = MyArmSimulator()

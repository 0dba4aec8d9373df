"""A simulated gripper that speaks the real one's protocol. It shares no code with the driver."""

from __future__ import annotations

from dataclasses import dataclass

from crtk_sim_backends.kit import LineSession, LoopServer, Options, Simulator, check_range, option
from typing_extensions import override

from crtk_sim_my_gripper.device import PERIOD, WIDEST, SimulatedGripper


@dataclass(frozen=True, kw_only=True)
class SimConfig(Options):
    """The options of ``crtk-driver sim my_gripper``."""

    thing: float = option(0.0, "width of what lies between the fingers, in m")

    @override
    def __post_init__(self) -> None:
        super().__post_init__()
        check_range("thing", self.thing, 0.0, WIDEST)


class MyGripperSimulator(Simulator[SimConfig, LoopServer]):
    """The gripper as a plugin."""

    name = "my_gripper"
    summary = "my_gripper, two fingers at a serial line"
    Config = SimConfig

    @override
    def serve(self, config: SimConfig, parent_fd: int | None) -> LoopServer:
        """Make its serial line."""
        device = SimulatedGripper(config.thing)
        lines = {"line": lambda: LineSession(device.obey)}
        server = LoopServer(config, parent_fd, device, title="my_gripper", ttys=lines)
        server.every(PERIOD, device.advance)
        return server


SIM = MyGripperSimulator()

"""A gripper's driver in this process, connected to a simulator in its own."""

from __future__ import annotations

from typing import Any

from crtk_drivers.config import DeviceConfig
from crtk_drivers.plugins import DevicePlugin
from crtk_sim_backends.process import RunningSim
from rigs.device_bench import DeviceBench
from rigs.waiting import eventually


class GripperBench(DeviceBench):
    """A driver and the simulator that it is connected to."""

    def __init__(self, plugin: DevicePlugin, sim: RunningSim, config: DeviceConfig) -> None:
        super().__init__(plugin, sim, config)
        self.config: Any = config
        self.device: Any = self.session.engine.device

    def simulated(self, name: str) -> Any:
        """Return an entry of the simulator's status."""
        return self.sim.control.call("status")[name]

    def grip(self, *words: str) -> str:
        """Wait until `state/grip` is one of the words, and return it."""

        def told() -> str:
            grip = str(self.front.state.grip())
            return grip if grip in words else ""

        return str(eventually(told, lambda: f"{words}, only {self.front.state.grip()}"))

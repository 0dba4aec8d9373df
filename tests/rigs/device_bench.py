"""A driver in this process, and the simulator in its own that it is connected to."""

from __future__ import annotations

from typing import Any, Self

from crtk_drivers.config import DeviceConfig
from crtk_drivers.front import LocalDevice
from crtk_drivers.plugins import DevicePlugin, RunningSim
from crtk_drivers.session import Session
from crtk_drivers.state import OperatingState
from rigs.told_states import ToldStates
from rigs.waiting import eventually


class DeviceBench:
    """Both. A context manager: the driver is connected in it.

    Attributes:
        sim: the simulator.
        session: of the driver.
        front: the device.
    """

    def __init__(self, plugin: DevicePlugin, sim: RunningSim, config: DeviceConfig) -> None:
        self.sim: Any = sim
        self.session = Session(plugin, config)
        self.front: Any = LocalDevice(self.session)
        self._told = ToldStates(self.session.engine)

    def __enter__(self) -> Self:
        self.session.start()
        try:
            self.connected()
        except BaseException:
            self.front.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.front.close()

    def connected(self) -> None:
        """Wait until it measures."""
        engine = self.session.engine
        eventually(lambda: engine.connected and engine.has_sample, "connected")

    def state(self, state: OperatingState, detail: str = "") -> str:
        """Wait for a state, for a reason that has these words, and return its detail."""
        return self._told.detail(state, detail)

    def counter(self, name: str) -> float:
        """Return a counter of the device."""
        return float(self.front.health().device[name])

    def samples(self, count: int) -> None:
        """Wait for so many new samples."""
        goal = self.front.health().samples + count
        eventually(lambda: self.front.health().samples >= goal, f"{count} samples")

"""A simulated gripper in its own process, and its driver in this one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from crtk_driver_robotiq import PLUGIN
from crtk_driver_robotiq.config import RobotiqConfig
from crtk_driver_robotiq.device import RobotiqDevice
from crtk_drivers.config import from_values, load
from crtk_drivers.front import LocalDevice
from crtk_drivers.session import Session
from crtk_drivers.state import OperatingState
from crtk_sim_backends.robotiq import SIM, RunningSim
from rigs.waiting import eventually

FREE_PORTS = {"tool_port": 0, "modbus_port": 0, "urcap_port": 0}
LINKS = ("serial", "tool", "modbus", "urcap")


def configuration(sim: RunningSim, **values: Any) -> RobotiqConfig:
    """Return the driver's configuration for a running simulator."""
    patient = {"sample_timeout": 2.0, "open_timeout": 10.0}
    config = load(RobotiqConfig, from_values({**patient, **values}))
    pointed = PLUGIN.sim_config(config, sim)
    assert isinstance(pointed, RobotiqConfig)
    return pointed


class RobotiqBench:
    """A driver and the simulator that it is connected to."""

    def __init__(self, sim: RunningSim, config: RobotiqConfig) -> None:
        self.sim = sim
        self.session = Session(PLUGIN, config)
        self.front: Any = LocalDevice(self.session)
        device = self.session.engine.device
        assert isinstance(device, RobotiqDevice)
        self.device = device

    def __enter__(self) -> RobotiqBench:
        self.session.start()
        self.connected()
        return self

    def __exit__(self, *_: object) -> None:
        self.front.close()

    def connected(self) -> None:
        """Wait until it measures."""
        engine = self.session.engine
        eventually(lambda: engine.connected and engine.has_sample, "connected")

    def state(self, state: OperatingState, detail: str = "") -> str:
        """Wait for a state, and return its detail."""

        def reached() -> bool:
            status = self.session.engine.status
            return status.state is state and detail in status.detail

        eventually(reached, f"{state} ({detail}), only {self.session.engine.status}")
        return str(self.session.engine.status.detail)

    def simulated(self, name: str) -> Any:
        """Return an entry of the simulator's status."""
        return self.sim.control.call("status")[name]

    def counter(self, name: str) -> float:
        """Return a counter of the device."""
        return float(self.front.health().device[name])

    def grip(self, *words: str) -> str:
        """Wait until `state/grip` is one of the words, and return it."""
        eventually(
            lambda: self.front.state.grip() in words, f"{words}, only {self.front.state.grip()}"
        )
        return str(self.front.state.grip())

    def samples(self, count: int) -> None:
        """Wait for so many new samples."""
        goal = self.front.health().samples + count
        eventually(lambda: self.front.health().samples >= goal, f"{count} samples")


@contextmanager
def bench(
    link: str = "tool", *, simulated: dict[str, Any] | None = None, **values: Any
) -> Iterator[RobotiqBench]:
    """Run a simulator and the driver at it, connected."""
    with (
        SIM.spawn(**FREE_PORTS, **(simulated or {})) as sim,
        RobotiqBench(sim, configuration(sim, link=link, **values)) as running,
    ):
        yield running

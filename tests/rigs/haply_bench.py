"""A simulated Inverse service in its own process, its driver in this one, and what tests ask of both."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from crtk_driver_haply import PLUGIN
from crtk_driver_haply.config import HaplyConfig
from crtk_drivers.config import from_values, load
from crtk_drivers.errors import CommandRefused
from crtk_drivers.state import OperatingState
from crtk_sim_backends.haply import SIM, RunningSim
from rigs.device_bench import DeviceBench
from rigs.waiting import eventually

PATIENT = {"sample_timeout": 2.0, "open_timeout": 10.0, "rate": 200.0}
"""A busy machine is no fault."""


def configuration(sim: RunningSim, **values: Any) -> HaplyConfig:
    """Return the driver's configuration for a running simulator."""
    pointed = PLUGIN.sim_config(load(HaplyConfig, from_values({**PATIENT, **values})), sim)
    assert isinstance(pointed, HaplyConfig)
    return pointed


class HaplyBench(DeviceBench):
    """A driver and the simulator that it is connected to."""

    def __init__(self, sim: RunningSim, config: HaplyConfig) -> None:
        super().__init__(PLUGIN, sim, config)

    def exerted(self) -> np.ndarray:
        """Return the force (3,) that the motors exert."""
        return np.array(self.sim.control.status()["force"])

    def push(self, force: tuple[float, float, float], *, once: bool = False) -> None:
        """Stream a force until the motors exert it, or send it once."""
        wanted = np.array(force)

        def is_felt() -> bool:
            self.send(force)
            return bool(np.abs(self.exerted() - wanted).max() < 1e-6)

        if once:
            self.send(force)
        else:
            eventually(is_felt, f"the motors exert {force}")

    def send(self, force: tuple[float, float, float]) -> None:
        """Ask for a force once."""
        self.front.servo_cf([*force, 0.0, 0.0, 0.0])

    def limp(self) -> None:
        """Wait until the motors exert nothing."""
        eventually(lambda: not self.exerted().any(), "no force")

    def pushes_until(self, state: OperatingState, detail: str = "") -> None:
        """Stream a force until it is refused because of a state that is come."""

        def is_refused() -> bool:
            try:
                self.send((1.0, 0.0, 0.0))
            except CommandRefused:
                return True
            return False

        eventually(is_refused, f"refused in {state}")
        self.state(state, detail)

    def notes(self) -> dict[str, str]:
        """Return what people should know, by key."""
        return {note.key: note.text for note in self.front.health().notes}


@contextmanager
def haply(sim: RunningSim, **values: Any) -> Iterator[HaplyBench]:
    """The driver at a simulator, connected; its faults are over afterwards."""
    try:
        with HaplyBench(sim, configuration(sim, **values)) as bench:
            yield bench
    finally:
        sim.control.clear()


def simulated(**options: Any) -> Any:
    """A simulated service."""
    return SIM.spawn(**options)

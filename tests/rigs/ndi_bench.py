"""A tracker's driver in this process at a simulated tracker in its own, and what tests ask of both."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from crtk_driver_ndi import PLUGIN
from crtk_driver_ndi.config import NdiConfig
from crtk_drivers.config import from_values, load
from crtk_drivers.front import LocalDevice
from crtk_drivers.session import Session
from crtk_drivers.state import OperatingState
from crtk_sim_backends.ndi import SIM
from crtk_sim_backends.ndi.handles import make_rom
from crtk_sim_backends.process import RunningSim
from rigs.told_states import ToldStates
from rigs.waiting import eventually

TRANSPORTS = ("tcp", "serial")


def configuration(sim: RunningSim, **values: Any) -> NdiConfig:
    """Return the driver's configuration for a running simulator."""
    config = load(NdiConfig, from_values({"sample_timeout": 2.0, **values}))
    pointed = PLUGIN.sim_config(config, sim)
    assert isinstance(pointed, NdiConfig)
    return pointed


def write_rom(folder: Path, part_number: str, kind: int = 2) -> str:
    """Make a tool definition; return its path."""
    path = folder / f"{part_number}.rom"
    path.write_bytes(make_rom(part_number, kind))
    return str(path)


class NdiBench:
    """A driver and the simulator that it is connected to.

    Attributes:
        front: the tracker.
        sim: the simulator.
        session: of both.
    """

    def __init__(self, sim: RunningSim, config: NdiConfig) -> None:
        self.sim = sim
        self.session = Session(PLUGIN, config)
        self.front: Any = LocalDevice(self.session)
        self._told = ToldStates(self.session.engine)

    def connected(self) -> None:
        """Wait until tracker and tools have answered."""
        engines = self.session.engines
        eventually(lambda: all(e.connected and e.has_sample for e in engines), "connected")

    def state(self, state: OperatingState, detail: str = "") -> None:
        """Wait until the tracker is in a state, for a reason that has these words."""
        self._told.detail(state, detail)

    def tracking(self) -> None:
        """Enable the tracker, and wait for poses of all tools."""
        self.front.enable()
        for name in self.session.children:
            self.sees(name)

    def sees(self, tool: str, visible: bool = True) -> None:
        """Wait until a tool has a valid pose, or none."""
        eventually(lambda: self.is_valid(tool) is visible, f"{tool} visible: {visible}")

    def is_valid(self, tool: str) -> bool:
        """Whether the newest pose of a tool is valid."""
        found = self.session.children[tool].feedback("measured_cp")
        return found is not None and bool(found[1].wall_ns)

    def told(self, tool: str) -> str:
        """What the quality of a tool says."""
        return str(getattr(self.front, tool).state.quality())

    @property
    def counters(self) -> Mapping[str, float]:
        """Of the device."""
        found: Mapping[str, float] = self.front.health().device
        return found


@contextmanager
def ndi_bench(sim: RunningSim, **values: Any) -> Iterator[NdiBench]:
    """A driver at a running simulator, connected; closed afterwards."""
    bench = NdiBench(sim, configuration(sim, **values))
    try:
        bench.session.start()
        bench.connected()
        yield bench
    finally:
        bench.front.close()


@contextmanager
def simulated(**options: Any) -> Iterator[RunningSim]:
    """A simulated tracker."""
    with SIM.spawn(**options) as sim:
        yield sim

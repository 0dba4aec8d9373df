"""A NetFT driver in this process against a simulated sensor box in its own, and what tests ask of both."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from typing_extensions import override

from crtk_driver_ati_netft import PLUGIN
from crtk_driver_ati_netft.blocks import Block
from crtk_driver_ati_netft.config import NetFtConfig
from crtk_driver_ati_netft.device import NetFtDevice
from crtk_drivers.config import from_values, load
from crtk_drivers.device import Severity
from crtk_drivers.engine import Observer
from crtk_drivers.front import LocalDevice
from crtk_drivers.session import Session
from crtk_drivers.state import OperatingState, Status
from crtk_sim_backends.netft import SIM, RunningSim
from rigs.told_states import ToldStates
from rigs.waiting import LONG, eventually

FREE_PORTS = {"rdt_port": 0, "tcp_port": 0, "http_port": 0}


def configuration(sim: RunningSim, **values: Any) -> NetFtConfig:
    """Return the driver's configuration for a running simulator."""
    patient = {"sample_timeout": 2.0, "open_timeout": 10.0, "rate": 100.0}
    config = load(NetFtConfig, from_values({**patient, **values}))
    pointed = PLUGIN.sim_config(config, sim)
    assert isinstance(pointed, NetFtConfig)
    return pointed


class Log(Observer):
    """Every status that the driver announced."""

    def __init__(self) -> None:
        self.statuses: list[Status] = []

    @override
    def status_changed(self, status: Status, stamp: object) -> None:
        self.statuses.append(status)


class NetFtBench:
    """A driver and the simulator that it is connected to."""

    def __init__(self, sim: RunningSim, config: NetFtConfig) -> None:
        self.sim = sim
        self.session = Session(PLUGIN, config)
        self.front: Any = LocalDevice(self.session)
        self._told = ToldStates(self.session.engine)
        self.log = Log()
        self.session.engine.add_observer(self.log)
        device = self.session.engine.device
        assert isinstance(device, NetFtDevice)
        self.device = device

    def connected(self) -> None:
        """Wait until it measures."""
        engine = self.session.engine
        eventually(lambda: engine.connected and engine.has_sample, "connected")

    def state(self, state: OperatingState, detail: str = "") -> None:
        """Wait for a state."""
        self._told.detail(state, detail)

    def was(self, state: OperatingState, detail: str = "") -> None:
        """Wait until a state has been announced, for however short a time."""

        def announced() -> bool:
            return any(s.state is state and detail in s.detail for s in list(self.log.statuses))

        eventually(announced, f"{state} ({detail}), only {self.log.statuses}")

    def counter(self, name: str) -> float:
        """Return a counter of the device."""
        value = self.front.health().device[name]
        assert isinstance(value, float)
        return value

    def note(self, key: str) -> tuple[Severity, str] | None:
        """Return severity and text of a note of the device's diagnostics."""
        notes = {note.key: (note.severity, note.text) for note in self.front.health().notes}
        return notes.get(key)

    def load(self) -> np.ndarray:
        """Return the newest `measured_cf`."""
        return np.asarray(self.front.measured_cf(age=0.2, wait=LONG).vector)

    def until_load(self, wanted: list[float], tolerance: float = 1e-5) -> None:
        """Wait for a load."""
        eventually(
            lambda: np.allclose(self.load(), wanted, atol=tolerance),
            lambda: f"{wanted}, only {self.load()}",
        )

    def record(self, seconds: float) -> Block:
        """Return every measurement of so many seconds."""
        blocks = []
        deadline = time.monotonic() + LONG
        for block in self.device.blocks():
            blocks.append(np.array(block))
            if block["stamp"][-1] - blocks[0]["stamp"][0] > seconds * 1e9:
                break
            assert time.monotonic() < deadline
        return np.concatenate(blocks)


@contextmanager
def netft_bench(config: dict[str, Any] | None = None, **options: Any) -> Iterator[NetFtBench]:
    """Start both, connected; `options` are the simulator's."""
    with SIM.spawn(**{**FREE_PORTS, **options}) as sim, driver_at(sim, config) as bench:
        yield bench


@contextmanager
def driver_at(sim: RunningSim, config: dict[str, Any] | None = None) -> Iterator[NetFtBench]:
    """Start the driver, connected to a running simulator."""
    bench = NetFtBench(sim, configuration(sim, **(config or {})))
    bench.session.start()
    try:
        bench.connected()
        yield bench
    finally:
        bench.front.close()

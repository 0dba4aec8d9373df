"""An arm of simulated drives for tests: slow enough for a busy machine, and with every mode."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any

from crtk_driver_canopen import PLUGIN
from crtk_driver_canopen.config import CanopenConfig
from crtk_driver_canopen.device import CanopenDevice
from crtk_drivers.front import LocalDevice
from crtk_drivers.session import Session
from crtk_sim_backends.canopen import SIM
from crtk_sim_backends.control import ControlError
from crtk_sim_backends.process import RunningSim
from rigs.waiting import eventually

PERIOD = 0.01
TIMEOUT = 0.8
"""Seconds that drives wait for SYNC, heartbeats and PDOs of ours, and we for theirs."""
SYNC_TIMEOUT = 0x2010
"""Object of a simulated drive: ms, in sub-index 1, that it waits for SYNC."""
LISTENING = 1.0
"""Seconds in which another master is heard that gets no time for a while."""
PATIENT: dict[str, Any] = {
    "missed_cycles": 100,
    "sample_timeout": 3.0,
    "heartbeat": {"ours_timeout": 1.0, "drives_timeout": 1.0},
}
"""Of an arm whose faults are not what is looked at: nobody is given up who gets no time for a while."""
JOINT = {
    "gear": 100.0,
    "lower": -3.0,
    "upper": 3.0,
    "velocity": 2.0,
    "acceleration": 10.0,
    "effort": 20.0,
    "following_error": 1.0,
    "modes": ("csp", "csv", "cst"),
}
"""One that may be half a second behind, at its greatest velocity: drives may get no time for a while."""


def arm_on(
    sim: RunningSim, count: int, joint: dict[str, Any] | None = None, **keys: Any
) -> CanopenConfig:
    """Return the configuration of `count` drives, with changes for every joint, and for the arm."""
    values = {
        "bus": {"interface": "crtk", "channel": sim.paths["crtk"]},
        "joints": {
            f"joint_{node}": {"node": node, **JOINT, **(joint or {})}
            for node in range(1, count + 1)
        },
        "period": PERIOD,
        "missed_cycles": 60,
        "sample_timeout": 1.5,
        "heartbeat": {"ours_timeout": TIMEOUT, "drives_timeout": TIMEOUT},
        "open_timeout": 10.0,
        **keys,
    }
    config = PLUGIN.load_config(values, {})
    assert isinstance(config, CanopenConfig)
    return config


patient_arm_on = partial(arm_on, **PATIENT)


@contextmanager
def arm_of(config: CanopenConfig) -> Iterator[LocalDevice]:
    """The arm of a configuration, connected."""
    arm = LocalDevice(Session(PLUGIN, config))
    try:
        arm._session.start()
        eventually(lambda: arm.engine.connected and arm.engine.has_sample, "it is connected")
        yield arm
    finally:
        arm.close()


def device_of(arm: LocalDevice) -> CanopenDevice:
    """The device behind an arm."""
    device = arm.engine.device
    assert isinstance(device, CanopenDevice)
    return device


def stream(arm: LocalDevice, name: str, value: list[float], seconds: float) -> None:
    """Send the same command in each cycle for a while."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        getattr(arm, name)(value)
        time.sleep(PERIOD)


@contextmanager
def drives(count: int, **options: Any) -> Iterator[RunningSim]:
    """Simulated drives on a bus of their own."""
    with SIM.spawn(nodes=count, realtime=True, **options) as sim:
        for node in sim.control.status()["drives"]:
            with suppress(ControlError):  # of a make that does not watch it
                wait_for_sync(sim, int(node), TIMEOUT)
        yield sim


def start_anew(sim: RunningSim) -> None:
    """Reset all drives, and wait until they answer: a request to a drive that boots is lost."""
    sim.control.inject("reset")

    def are_up() -> bool:
        found = sim.control.status()["drives"].values()
        return {drive["nmt"] for drive in found} == {"pre_operational"}

    eventually(are_up, "the drives are up")


def wait_for_sync(sim: RunningSim, node: int, seconds: float) -> None:
    """Let a drive wait for SYNC for so long; 0: it does not watch it."""
    sim.control.call("object", node=node, index=SYNC_TIMEOUT, sub=1, value=round(1000 * seconds))

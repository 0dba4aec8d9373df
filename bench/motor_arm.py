"""The driver of a motor controller or of drives at its simulator, enabled: for benches that let it follow."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from crtk_drivers.config import from_values, load
from crtk_drivers.front import LocalDevice
from crtk_drivers.plugins import DevicePlugin, RunningSim
from crtk_drivers.session import Session


@contextmanager
def arm_at(
    plugin: DevicePlugin, sim: RunningSim, values: Mapping[str, Any]
) -> Iterator[LocalDevice]:
    """The driver, with time-outs for a busy machine, which is not what is measured."""
    patient = {"sample_timeout": 1.0, "stream_timeout": 1.0, "limits": {"max_step": 1.0}}
    config = plugin.sim_config(load(plugin.config, from_values({**patient, **values})), sim)
    session = Session(plugin, config)
    arm = LocalDevice(session)
    try:
        session.start()
        while not (arm.engine.connected and arm.engine.has_sample):
            time.sleep(0.01)
        arm.enable(10.0)
        yield arm
    finally:
        arm.close()

"""Runs a script as `python SCRIPT` does: a program for processes that are forked (`rigs.warm_start`).

Devices that it opens in its own process are patient: a busy machine is no fault. What a script says itself of
that counts.
"""

import runpy
import sys
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

from crtk_drivers import front

PATIENT: Mapping[str, Any] = MappingProxyType({"sample_timeout": 3.0, "stream_timeout": 0.5})
PATIENT_BUS: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {
        "canopen": {
            "missed_cycles": 100,
            "heartbeat": {"ours_timeout": 1.0, "drives_timeout": 1.0},
        },
        "dynamixel": {"silent_timeout": 0.5, "watchdog": 1.0},
    }
)
"""By device: how long the two ends of a bus wait for each other."""


def patiently(connect: Any, device: str, *, config: Any = None, **given: Any) -> Any:
    """Do what `crtk_drivers.connect` does."""
    if config is None or isinstance(config, Mapping):
        said = {**(config or {}), **given}
        wanted = {**PATIENT, **PATIENT_BUS.get(device, {})}
        given |= {name: value for name, value in wanted.items() if name not in said}
    if device != "ur":
        return connect(device, config=config, **given)
    from rigs.ur_watchdog import rarely_fed  # which imports the driver

    with rarely_fed():
        return connect(device, config=config, **given)


def wait_for_drives(seconds: float) -> None:
    """Let the library `canopen`, in place of 0.3 s, wait so long for an answer."""
    from canopen.sdo import SdoClient

    SdoClient.RESPONSE_TIMEOUT = seconds


if __name__ == "__main__":
    del sys.argv[0]
    if "import canopen\n" in Path(sys.argv[0]).read_text():
        wait_for_drives(5.0)
    sys.path.insert(0, str(Path(sys.argv[0]).parent))
    front.connect = partial(patiently, front.connect)
    runpy.run_path(sys.argv[0], run_name="__main__")

"""How the process of a device is started: the same by whatever starts it."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from crtk_drivers.labs.lab_file import LabDevice


def settings_text(device: LabDevice) -> str:
    """Return the settings of a device as a file of their own (YAML)."""
    return json.dumps(dict(device.values), indent=2) + "\n"


def device_command(device: LabDevice, settings: Path) -> tuple[str, ...]:
    """Return program and arguments.

    Args:
        device: of a lab.
        settings: file that holds `settings_text`.
    """
    simulated = ["--sim"] if device.sim else []
    for key, value in device.sim_options.items():
        simulated += ["--sim-set", f"{key}={_as_typed(value)}"]
    if device.coupled is not None:
        coupled = device.coupled.model_dump(exclude_none=True, exclude_unset=True)
        for key, value in coupled.items():
            simulated += ["--sim-carried", f"{key}={_as_typed(value)}"]
    return (
        *(sys.executable, "-m", "crtk_drivers.cli", device.plugin.name),
        *("--ns", device.namespace, "--config", str(settings.resolve())),
        *simulated,
        *(("--ros-args", "--enclave", device.enclave) if device.enclave else ()),
    )


def _as_typed(value: Any) -> str:
    """Return a value as a person would type it: a key that takes text has quotes for a part of it."""
    return value if isinstance(value, str) else json.dumps(value)

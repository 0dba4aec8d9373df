"""Commands for people; what they do is in `crtk_driver_dynamixel.terminal`."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from typing import Any, Final

from crtk_driver_dynamixel.config import DynamixelConfig
from crtk_driver_dynamixel.tool_options import (
    CalibrateOptions,
    InfoOptions,
    LimitsOptions,
    ScanOptions,
)
from crtk_drivers.errors import ConfigError, MissingExtra
from crtk_drivers.plugins import Tool


def require_libraries() -> None:
    """Make sure that what the driver needs is installed; the plugin itself loads without.

    Raises:
        MissingExtra: it is not.
    """
    for module, name in (("serial", "pyserial"), ("dynamixel_easy_sdk", "dynamixel-sdk")):
        if find_spec(module) is None:
            raise MissingExtra(name, "dynamixel")


def _later(name: str) -> Callable[[Any, Any], int]:
    """Return a function of `terminal`, which is imported when it is called."""

    def run(config: DynamixelConfig, options: Any) -> int:
        require_libraries()
        code: int = getattr(import_module("crtk_driver_dynamixel.terminal"), name)(config, options)
        return code

    return run


def _require_ports(config: DynamixelConfig) -> None:
    if not all(config.bus(name).port for name in config.buses):
        raise ConfigError(
            "no serial port is given",
            where="dynamixel",
            remedy="Give it as --port /dev/ttyUSB0, or better by a name under /dev/serial/by-id.",
        )


TOOLS: Final = (
    Tool(
        "scan",
        "find servos: rates, ids, models and firmware, and write a configuration to start from",
        _later("scan"),
        ScanOptions,
        check_real=_require_ports,
    ),
    Tool(
        "info",
        "tell how the servos of a chain are, and how fast they are read",
        _later("info"),
        InfoOptions,
    ),
    Tool(
        "calibrate",
        "find where the joints are, from a pose that is known",
        _later("calibrate"),
        CalibrateOptions,
    ),
    Tool(
        "limits",
        "put the limits of the configuration into the servos' EEPROM, as a second line",
        _later("limits"),
        LimitsOptions,
    ),
)

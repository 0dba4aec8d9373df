"""The tool's supply and serial line, which are switched on before what hangs there is spoken to."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Final

from typing_extensions import override

from crtk_driver_ur.config import ToolLineConfig
from crtk_driver_ur.output_worker import run_beside
from crtk_drivers.config import from_values, load
from crtk_drivers.device import Device
from crtk_drivers.errors import ConfigError, ConnectionFailed
from crtk_drivers.wrappers.forwarding import WrappedDevice

__all__ = ["TOOL_PORT", "ToolLine", "script_of"]

TOOL_PORT: Final = 54321
"""Of the controller, by which UR's tool communication forwarder has the line."""

_PARITIES: Final = ("none", "odd", "even")
_PIECE: Final = 0.05
_SETTLING: Final = 1.0
"""Seconds after which a line that was switched on lets everybody in."""


def script_of(line: ToolLineConfig) -> str:
    """Return the secondary program that sets them (URScript manual, Module interfaces)."""
    return (
        "sec crtk_tool_line():\n"
        f"  set_tool_voltage({line.voltage})\n"
        f"  set_tool_communication(True, {line.baud}, {_PARITIES.index(line.parity)}, "
        f"{line.stop_bits}, {line.rx_idle:g}, {line.tx_idle:g})\n"
        "end\n"
    )


def _as_needed(its_line: Mapping[str, Any]) -> ToolLineConfig:
    """Return the line as the plugin of a device needs it.

    Raises:
        ConfigError: it has keys that the line has not.
    """
    return load(ToolLineConfig, from_values(dict(its_line), "tool_line of the gripper's plugin"))


class ToolLine:
    """The line of one arm.

    Args:
        config: how it is to be; None: as a device needs it that is reached by it, and otherwise as it is.
        device: that hangs at the tool, None for none.
        host: of the arm.
        its_line: keys of `config` as the device needs them.
        has_line: whether its tool has one.

    Raises:
        ConfigError: it has none, and one is asked for.

    Attributes:
        device: the same; where it is reached by the line, it is not opened before that is on.
    """

    def __init__(
        self,
        config: ToolLineConfig | None,
        device: Device | None,
        host: str,
        its_line: Mapping[str, Any] = MappingProxyType({}),
        *,
        has_line: bool,
    ) -> None:
        place = "" if device is None else device.address.removeprefix("socket://")
        by_line = place == f"{host}:{TOOL_PORT}"
        self._config = config or (_as_needed(its_line) if by_line else None)
        if self._config is not None and not has_line:
            raise ConfigError(
                "the tool of a CB3 arm has no serial line",
                where="gripper",
                remedy="Reach it another way; a Robotiq gripper by its URCap: settings: {link: urcap}.",
            )
        self._host = host
        self._on = threading.Event()
        self.device = _AtLine(device, self._on) if device is not None and by_line else device

    def switch_on(self, where: str) -> None:
        """Have the controller switch it on. That interrupts no program, and moves nothing.

        Raises:
            ConnectionFailed: it could not be told.
        """
        if self._config is None:
            return
        try:
            run_beside(self._host, script_of(self._config))
        except OSError as error:
            raise ConnectionFailed(
                f"the tool's line cannot be switched on: {error}",
                where=where,
                remedy="Is port 30002 (secondary) reachable, and the arm in remote control?",
            ) from error
        self._on.set()


class _AtLine(WrappedDevice):
    """A device that is opened when the line is on."""

    def __init__(self, inner: Device, on: threading.Event) -> None:
        super().__init__(inner)
        self._on = on
        self._aborted = False

    @override
    def open(self, deadline: float) -> None:
        while not self._on.wait(_PIECE):
            if self._aborted or time.monotonic() > deadline:
                raise ConnectionFailed(
                    "the line of the tool is not on",
                    where=f"tool {self.address}",
                    remedy="It is switched on when the arm is connected: see what that says.",
                )
        settled = min(deadline, time.monotonic() + _SETTLING)
        while True:
            try:
                return self.inner.open(deadline)
            except ConnectionError:
                self.inner.close()
                if self._aborted or time.monotonic() > settled:
                    raise
            time.sleep(_PIECE)

    @override
    def abort_open(self) -> None:
        self._aborted = True
        self.inner.abort_open()

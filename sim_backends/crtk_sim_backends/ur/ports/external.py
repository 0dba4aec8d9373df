"""What is around the controller of an arm: fieldbus clients and the device at the tool."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from crtk_sim_backends.kit import Session
from crtk_sim_backends.process import SimStartError
from crtk_sim_backends.ur.ports.tool_port import ToolPort, ToolSession
from crtk_sim_backends.ur.signals.tool_device import ToolDevice
from crtk_sim_backends.ur.signals.tool_line import LineSettings

if TYPE_CHECKING:
    from crtk_sim_backends.ur.config import SimConfig
    from crtk_sim_backends.ur.controller import Controller

_TOOL_SUPPLY = 24  # V, where the line to the tool is on from the start


class ExternalDevices:
    """Sessions of the ports that they use, and the connection to the device at the tool.

    Args:
        config: which there are.
        controller: whose.

    Raises:
        SimStartError: pymodbus or pyserial is missing, or the device at the tool.
    """

    def __init__(self, config: SimConfig, controller: Controller) -> None:
        self._new_modbus_session = _modbus_sessions(controller) if config.modbus else None
        if config.tool_communication:
            controller.set_tool_communication(LineSettings(enabled=True))
            controller.signals.set_tool_voltage(_TOOL_SUPPLY)
        device = ToolDevice(config.tool_device) if config.tool_device else None
        self._tool = ToolPort(controller, device)

    def modbus_session(self) -> Session:
        """Session of a client of the Modbus server."""
        if self._new_modbus_session is None:
            raise RuntimeError("a client of a Modbus server that there is not")
        return self._new_modbus_session()

    def tool_session(self) -> Session:
        """Session of the client of the tool's line."""
        return ToolSession(self._tool)

    @property
    def tool_clients(self) -> int:
        """How many clients the tool's line takes."""
        return 1 if self._tool.enabled else 0

    def advance_tool(self) -> bytes:
        """Move the bytes of the tool's line on to the controller's time; what its client gets."""
        return self._tool.advance()

    def close(self) -> None:
        """Let go of the device at the tool."""
        self._tool.close()


def _modbus_sessions(controller: Controller) -> Callable[[], Session]:
    try:
        from crtk_sim_backends.ur.ports.modbus_server import ModbusSession
    except ImportError as error:
        raise SimStartError(
            f"modbus: {error}; install it with `pip install 'crtk-drivers[ur-sim]'`"
        ) from error
    return lambda: ModbusSession(controller.port_map)

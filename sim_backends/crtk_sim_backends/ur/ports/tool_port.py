"""TCP port 54321, the tool's serial line for a PC, as UR's tool communication forwarder has it.

One client at a time: the line has one master. While the line is switched off nobody is let in.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from crtk_sim_backends.ur.safety.modes import RobotMode
from crtk_sim_backends.ur.signals.tool_device import ToolDevice
from crtk_sim_backends.ur.signals.tool_line import ToolLine

if TYPE_CHECKING:
    from crtk_sim_backends.ur.controller import Controller


class ToolPort:
    """Passes bytes between the client and the device at the tool.

    Args:
        controller: whose tool it is.
        device: what is attached, None for nothing.
    """

    def __init__(self, controller: Controller, device: ToolDevice | None) -> None:
        self._controller = controller
        self._device = device
        self._line = ToolLine(controller.tool_communication)
        if device is not None:
            device.configure(controller.tool_communication)

    @property
    def enabled(self) -> bool:
        """Whether the line is switched on."""
        return self._controller.tool_communication.enabled

    @property
    def powered(self) -> bool:
        """Whether the tool has a supply, without which it neither hears nor says anything."""
        c = self._controller
        return c.robot_mode >= RobotMode.POWER_ON and c.outputs["tool_output_voltage"] > 0

    def send(self, data: bytes) -> None:
        """Have bytes of the client sent to the tool."""
        self._line.put(data, to_tool=True)

    def advance(self) -> bytes:
        """Move on to the controller's time; what the client gets."""
        settings = self._controller.tool_communication
        if settings is not self._line.settings:
            self._line = ToolLine(settings)
            if self._device is not None:
                self._device.configure(settings)
        device = self._device
        if device is None:
            return self._line.advance(self._controller.time)[1]
        now = self._controller.time
        connected = self.enabled and self.powered
        heard = device.read(now)
        if connected:
            self._line.put(heard, to_tool=False)
        to_tool, to_client = self._line.advance(now)
        if connected:
            device.write(to_tool)
        return to_client

    def close(self) -> None:
        """Let go of the device."""
        if self._device is not None:
            self._device.close()


class ToolSession:
    """The client of the port."""

    ended = False

    def __init__(self, port: ToolPort) -> None:
        self._port = port

    def receive(self, data: bytes) -> bytes:
        """Take bytes for the tool; what it answers comes later."""
        self._port.send(data)
        return b""

    def close(self) -> None:
        """Do nothing: what is on the line goes on."""

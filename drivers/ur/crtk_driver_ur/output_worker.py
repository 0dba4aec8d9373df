"""Setting outputs of the control box and the tool, in a thread of its own."""

from __future__ import annotations

import socket
from typing import Any, Final

from typing_extensions import override

from crtk_driver_ur.control_requests import Request
from crtk_driver_ur.request_worker import Controller, RequestWorker
from crtk_driver_ur.rtde.inputs import RtdeInputs

__all__ = ["OUTPUT_REQUESTS", "OutputWorker", "run_beside"]

OUTPUT_REQUESTS: Final = ("write_inputs", "set_tool_voltage")

SECONDARY_PORT: Final = 30002
TIMEOUT: Final = 2.0

_TOOL_VOLTAGE: Final = "sec crtk_tool_voltage():\n  set_tool_voltage({:d})\nend\n"
"""RTDE has no input for it. A secondary program runs beside the one that runs, and does not disturb it
(URScript manual, "Secondary program")."""


class OutputWorker(RequestWorker):
    """Sets RTDE input variables (`write_inputs`) and the tool voltage (`set_tool_voltage`)."""

    def __init__(self, controller: Controller) -> None:
        super().__init__(controller)
        self._inputs = RtdeInputs(self.host)

    @override
    def carry_out(self, request: Request) -> Any:
        if request.name == "write_inputs":
            self._inputs.write(request.arguments["values"])
        else:
            run_beside(self.host, _TOOL_VOLTAGE.format(request.arguments["voltage"]))

    @override
    def release(self) -> None:
        self._inputs.close()


def run_beside(host: str, script: str) -> None:
    """Have a controller run a secondary program.

    Raises:
        OSError: it could not be told.
    """
    with socket.create_connection((host, SECONDARY_PORT), TIMEOUT) as peer:
        peer.recv(4096)  # the controller speaks first, when it has taken the connection
        peer.sendall(script.encode())

"""Dashboard commands in a thread of their own, because an answer may take seconds."""

from __future__ import annotations

from typing import Any

from crtk_driver_ur.control_frames import Request
from crtk_driver_ur.dashboard import DashboardClient
from crtk_driver_ur.request_worker import Controller, RequestWorker
from crtk_driver_ur.robot_api import POLYSCOPE_X, RobotApiClient

__all__ = ["DashboardWorker"]


class DashboardWorker(RequestWorker):
    """For requests whose names are in `crtk_driver_ur.dashboard.REQUESTS`.

    On PolyScope X they are carried out by the Robot API.
    """

    def __init__(self, controller: Controller) -> None:
        super().__init__(controller)
        host, version, port = controller
        self._client: DashboardClient | RobotApiClient = (
            DashboardClient(host) if version < POLYSCOPE_X else RobotApiClient(host, port, version)
        )

    def carry_out(self, request: Request) -> Any:
        """See the base class."""
        return self._client.ask(request.name, request.arguments)

    def interrupt(self) -> None:
        """See the base class."""
        self._client.interrupt()

    def release(self) -> None:
        """See the base class."""
        self._client.close()

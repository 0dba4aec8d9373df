"""Dashboard commands in a thread of their own, because an answer may take seconds."""

from __future__ import annotations

from typing import Any

from typing_extensions import override

from crtk_driver_ur.control_requests import Request
from crtk_driver_ur.dashboard import DashboardClient
from crtk_driver_ur.request_worker import Controller, RequestWorker
from crtk_driver_ur.robot_api import POLYSCOPE_X, RobotApiClient

__all__ = ["DashboardWorker", "client_of"]


def client_of(controller: Controller) -> DashboardClient | RobotApiClient:
    """Return who speaks to the dashboard of a controller, whichever that has."""
    host, version, port = controller
    if version < POLYSCOPE_X:
        return DashboardClient(host)
    return RobotApiClient(host, port, version)


class DashboardWorker(RequestWorker):
    """For requests whose names are in `crtk_driver_ur.dashboard.REQUESTS`.

    On PolyScope X they are carried out by the Robot API.
    """

    def __init__(self, controller: Controller) -> None:
        super().__init__(controller)
        self._client = client_of(controller)

    @override
    def carry_out(self, request: Request) -> Any:
        return self._client.ask(request.name, request.arguments)

    @override
    def interrupt(self) -> None:
        self._client.interrupt()

    @override
    def release(self) -> None:
        self._client.close()

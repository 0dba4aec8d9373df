"""Dashboard commands in a thread of their own, because an answer may take up to 2.5 s."""

from __future__ import annotations

from typing import Any

from crtk_driver_ur.control_frames import Request
from crtk_driver_ur.dashboard import DashboardClient
from crtk_driver_ur.request_worker import RequestWorker

__all__ = ["DashboardWorker"]


class DashboardWorker(RequestWorker):
    """For requests whose names are in `crtk_driver_ur.dashboard.REQUESTS`."""

    def __init__(self, host: str) -> None:
        super().__init__(host)
        self._client = DashboardClient(host)

    def carry_out(self, request: Request) -> Any:
        """See the base class."""
        return self._client.ask(request.name, request.arguments)

    def interrupt(self) -> None:
        """See the base class."""
        self._client.interrupt()

    def release(self) -> None:
        """See the base class."""
        self._client.close()

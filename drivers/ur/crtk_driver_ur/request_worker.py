"""Slow requests to a controller: each worker carries out some of them, in a thread of its own."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, NamedTuple

from crtk_driver_ur.control_requests import CallError, Reply, Request, explain
from crtk_drivers import kit
from crtk_drivers.errors import CrtkError

__all__ = ["Controller", "RequestWorker"]


class Controller(NamedTuple):
    """Whom requests go to.

    Attributes:
        host: address or name.
        version: major and minor version of its software.
        robot_api_port: of its Robot API, if it is PolyScope X.
    """

    host: str
    version: tuple[int, int]
    robot_api_port: int


class RequestWorker(kit.RequestWorker[Request, Reply], ABC):
    """Carries out requests one after the other and hands back their replies.

    Args:
        controller: whom they go to.
    """

    def __init__(self, controller: Controller) -> None:
        super().__init__(
            self._reply, type(self).__name__, interrupt=self.interrupt, release=self.release
        )
        self.controller = controller
        self.host = controller.host

    @abstractmethod
    def carry_out(self, request: Request) -> Any:
        """Do it and return its value, in the thread of this worker; what it raises is the reply."""

    def interrupt(self) -> None:
        """Break off what the thread waits for; called from another."""

    def release(self) -> None:
        """Close what is open, in the thread of this worker, as its last act."""

    def _reply(self, request: Request) -> Reply:
        try:
            return Reply(request.sequence, request.name, self.carry_out(request))
        except KeyError as error:
            problem = CallError(request.name, f"argument {error} is missing")
        except CrtkError as error:
            problem = CallError(request.name, error.message, error.remedy)
        except Exception as error:
            problem = explain(request.name, error)
        return Reply(request.sequence, request.name, error=problem)

"""A device's own services (`crtk_drivers.device.Service`), while they are carried out.

`ask` is for clients' threads, the rest for the I/O thread. One is carried out at a time, and none outlives
the connection that it was asked for in.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping

from crtk_drivers.device import Service
from crtk_drivers.errors import (
    REPORT,
    CommandRefused,
    CrtkError,
    DataTimeout,
    Reason,
    TransitionFailed,
    unexpected,
)
from crtk_drivers.status.procedures import Procedure


class Request:
    """A service that was asked for. Thread-safe."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._ended = threading.Event()
        self._text = ""
        self._error: CrtkError | None = None

    def finish(self, text: str = "", error: CrtkError | None = None) -> None:
        """Record the answer, if there is none yet."""
        if not self._ended.is_set():
            self._text, self._error = text, error
            self._ended.set()

    def wait(self, timeout: float) -> str:
        """Return the answer.

        Raises:
            CrtkError: what the device raised.
            DataTimeout: none in `timeout` s; it goes on all the same.
        """
        if not self._ended.wait(timeout):
            raise DataTimeout(
                f"{self.name} has not ended in {timeout:g} s", remedy="Is the device connected?"
            )
        if self._error is not None:
            raise self._error
        return self._text


class Requests:
    """Carries out the services of one device.

    Args:
        services: by name.
        where: the device, for messages.
        timeout: seconds that one may take.
    """

    def __init__(self, services: Mapping[str, Service], where: str, timeout: float) -> None:
        self._services = services
        self._where = where
        self._timeout = timeout
        self._lock = threading.Lock()
        self._request: Request | None = None
        self._procedure: Procedure | None = None
        self._gone = "not connected yet"

    def begin(self) -> None:
        """The device has been opened: from now on its services may be asked for."""
        with self._lock:
            self._gone = ""

    def ask(self, name: str) -> Request:
        """Let a service begin with the next cycle.

        Raises:
            CommandRefused: there is no such service, one is running, or the device is not connected.
        """
        if name not in self._services:
            raise CommandRefused(
                name,
                Reason.UNSUPPORTED,
                "this device has no such service",
                where=self._where,
                remedy=f"It has: {', '.join(self._services) or 'none'}.",
            )
        with self._lock:
            if self._gone:
                raise CommandRefused(
                    name,
                    Reason.NOT_CONNECTED,
                    self._gone,
                    where=self._where,
                    remedy="The driver keeps trying to connect; ask again afterwards.",
                )
            if self._request is not None:
                raise CommandRefused(
                    name,
                    Reason.TRANSITION_RUNNING,
                    f"{self._request.name} is running",
                    where=self._where,
                    remedy="Wait for it.",
                )
            self._request = request = Request(name)
        return request

    def step(self, now: float) -> None:
        """Resume the service that runs, if one does.

        Raises:
            Exception: what the device must not raise; the service has failed by it.
        """
        request = self._request
        if request is None:
            return
        try:
            if self._procedure is None:
                steps = self._services[request.name].run()
                self._procedure = Procedure(steps, self._where, now + self._timeout)
            has_ended = self._procedure.step()
        except CrtkError as error:
            self._finish(error=error)
        except Exception as error:
            text = f"{request.name}: {unexpected(error)}"
            self._finish(error=TransitionFailed(text, where=self._where, remedy=REPORT))
            raise
        else:
            if has_ended:
                self._finish(self._procedure.answer)
            elif self._procedure.is_overdue(now):
                text = f"{request.name} did not end in {self._timeout:g} s"
                self._finish(error=TransitionFailed(text, where=self._where))

    def end(self, error: CrtkError) -> None:
        """The device was closed, or not reached: end the service that runs by `error`, refuse others."""
        with self._lock:
            self._gone = error.message
        self._finish(error=error)

    def _finish(self, text: str = "", error: CrtkError | None = None) -> None:
        procedure, self._procedure = self._procedure, None
        with self._lock:
            request, self._request = self._request, None
        if procedure is not None:
            procedure.close()
        if request is not None:
            request.finish(text, error)

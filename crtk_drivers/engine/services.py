"""A device's own services (`crtk_drivers.device.Service`), while they are carried out.

`ask` is for clients' threads, the rest for the I/O thread. One is carried out at a time, and none outlives
the connection that it was asked for in.
"""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import ClassVar

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

logger = logging.getLogger(__name__)

PATIENCE = 5.0
"""Seconds for which one that moves waits while a stop is carried out: what is late moves nothing."""


class Request:
    """A service that was asked for. Thread-safe.

    Attributes:
        name: of the service.
        broken_off_by: what has stopped it; empty: nothing.
        put_off_at: monotonic seconds at which it could not begin for the first time; None: it has not been.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.broken_off_by = ""
        self.put_off_at: float | None = None
        self._ended = threading.Event()
        self._text = ""
        self._error: CrtkError | None = None

    @property
    def has_ended(self) -> bool:
        """Whether it has, with whatever answer."""
        return self._ended.is_set()

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


@dataclass(frozen=True, slots=True)
class OwnService:
    """Something that is done for every device, whatever it does: recording, ...

    Attributes:
        summary: one line for people.
        run: does it, in the thread of who asks; returns what is to be told, raises `CrtkError`.
        stops: none of them is a stop, as a `Service` may be.
    """

    summary: str
    run: Callable[[], str]
    stops: ClassVar[bool] = False

    def carried_out(self, name: str) -> Request:
        """Return the request that has ended with its answer."""
        request = Request(name)
        try:
            request.finish(self.run())
        except CrtkError as error:
            request.finish(error=error)
        except Exception as error:  # who asked hears of a mistake, and waits no longer
            logger.exception("%s failed", name)
            text = f"{name}: {unexpected(error)}"
            request.finish(error=TransitionFailed(text, remedy=REPORT))
        return request


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
        self._following: deque[Request] = deque()
        self._procedure: Procedure | None = None
        self._gone = "not connected yet"

    def begin(self) -> None:
        """The device has been opened: from now on its services may be asked for."""
        with self._lock:
            self._gone = ""

    def ask(self, name: str) -> Request:
        """Let a service begin with the next cycle; one that is a stop ends the one that runs.

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
            running = self._request
            if running is None:
                self._request = request = Request(name)
                return request
            if self._services[name].stops:
                return self._stop(name, running)
            raise CommandRefused(
                name,
                Reason.TRANSITION_RUNNING,
                f"{running.name} is running",
                where=self._where,
                remedy="Wait for it.",
            )

    def _stop(self, name: str, running: Request) -> Request:
        """Let a service that is a stop follow the one that runs, which ends; the same one waits once."""
        for request in (running, *self._following):
            if request.name == name and not request.broken_off_by:
                return request
        if not self._services[running.name].stops:
            running.broken_off_by = running.broken_off_by or f"by {name}"
        request = Request(name)
        self._following.append(request)
        return request

    def _put_off(self, request: Request, now: float) -> None:
        """Let a service that is about to move wait for a stop; refuse it where that takes too long."""
        if request.put_off_at is None:
            request.put_off_at = now
        if now - request.put_off_at > PATIENCE:
            self._finish(
                error=CommandRefused(
                    request.name,
                    Reason.TRANSITION_RUNNING,
                    "a stop is still being carried out",
                    where=self._where,
                    remedy="Ask for it again once it stands.",
                )
            )

    def break_off(self, by: str) -> None:
        """Let the service that was asked for go no further if it is one that moves; from any thread.

        Args:
            by: what stops it, in words.
        """
        with self._lock:
            request = self._request
            if request is not None and self._services[request.name].moves:
                request.broken_off_by = request.broken_off_by or by

    @property
    def moves(self) -> bool:
        """Whether a service that moves the device has begun, and has not ended."""
        request = self._request
        if request is None or self._procedure is None:
            return False
        return self._services[request.name].moves

    def end_broken(self) -> bool:
        """End the service that was broken off; return whether it had begun, so that something may move."""
        request = self._request
        if request is None or not request.broken_off_by:
            return False
        has_begun = self._procedure is not None
        text = f"{request.name} was broken off: {request.broken_off_by}"
        self._finish(error=TransitionFailed(text, where=self._where, remedy="Ask for it again."))
        return has_begun

    def step(
        self, now: float, may_move: Callable[[float], bool], moves: Callable[[], object]
    ) -> bool:
        """Resume the service that runs, if one does.

        Args:
            now: monotonic seconds.
            may_move: asked before one that moves begins, of whichever a client has asked for just now; until
                it may, it waits.
            moves: called once one that moves has begun; one that refuses itself has not.

        Returns:
            whether one that moves has failed on its way, or has ended as a stop came: what it has begun is
            to be stopped.

        Raises:
            Exception: what the device must not raise; the service has failed by it. One that moves is ended
                by `end_broken`.
        """
        request = self._request
        if request is None or request.broken_off_by:
            return False
        service, is_new = self._services[request.name], self._procedure is None
        if is_new and service.moves and not may_move(now):
            self._put_off(request, now)
            return False
        try:
            if self._procedure is None:
                steps = service.run()
                self._procedure = Procedure(steps, self._where, now + self._timeout)
            has_ended = self._procedure.step()
        except CrtkError as error:
            self._finish(error=error)
            is_refused = is_new and isinstance(error, CommandRefused)
            return service.moves and not is_refused
        except Exception as error:
            text = f"{request.name}: {unexpected(error)}"
            request.finish(error=TransitionFailed(text, where=self._where, remedy=REPORT))
            if not service.moves:
                self._finish()
            raise
        if is_new and service.moves:
            moves()
        if has_ended:
            self._finish(self._procedure.answer)
            is_broken_off = bool(request.broken_off_by)
            if is_broken_off and service.undo is not None:
                service.undo()
            return is_broken_off
        if self._procedure.is_overdue(now):
            text = f"{request.name} did not end in {self._timeout:g} s"
            self._finish(error=TransitionFailed(text, where=self._where))
            return service.moves
        return False

    def end(self, error: CrtkError) -> None:
        """The device was closed, or not reached: end the service that runs by `error`, refuse others."""
        with self._lock:
            self._gone = error.message
        while self._request is not None:
            self._finish(error=error)

    def _finish(self, text: str = "", error: CrtkError | None = None) -> None:
        procedure, self._procedure = self._procedure, None
        with self._lock:
            request = self._request
            self._request = self._following.popleft() if self._following else None
        if procedure is not None:
            procedure.close()
        if request is not None:
            request.finish(text, error)

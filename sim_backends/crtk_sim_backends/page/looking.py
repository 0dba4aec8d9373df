"""One browser that looks at all devices, and may command them: a WebSocket (RFC 6455) with JSON in it.

The browser asks for each picture when it has drawn the last one, so that one that is hidden, or has stopped
reading, costs nothing and gets the newest when it looks again. Each of its messages is one of::

    {"token": "..."}        answered with {"control": true or false}
    {"scene": true}         answered with {"scene": ...}, what does not change
    {"look": true}          answered with {"live": ...} when the next picture is due; null: it does not answer
    {"watch": [device, value]}   a value that is shown from now on
    {"command": {...}}      answered with {"answer": "why it is not done"}; needs the token

Its end, whatever the cause, is told as the command ``{"do": "gone"}``.
"""

from __future__ import annotations

import hmac
import itertools
import json
import logging
import select
import socket
import threading
import time
from collections.abc import Callable, Iterable
from typing import Any, Final

from websockets.frames import CloseCode, Frame, Opcode
from websockets.http11 import Request
from websockets.protocol import State
from websockets.server import ServerProtocol

from crtk_sim_backends.control import ControlError
from crtk_sim_backends.page.source import PERIOD, PipeSource, json_of

LARGEST: Final = 1 << 12
"""Bytes of a message from a browser."""
WRITE_TIMEOUT: Final = 2.0
"""Seconds in which a browser takes what was sent, or is left."""
SILENT: Final = 10.0
"""Seconds in which a browser says what it wants, or is left."""

FRESH: Final = 0.9 * PERIOD
"""Seconds that a picture may be old which another browser has asked for."""

_POLL: Final = 0.1  # s
_PIECE: Final = 1 << 14
_browsers = itertools.count(1)

log = logging.getLogger(__name__)


class _End(Exception):
    """The connection is to be closed, with a code of RFC 6455 (section 7.4) and a reason."""

    def __init__(self, code: int, reason: str) -> None:
        super().__init__(reason)
        self.code = code
        self.reason = reason


class Looking:
    """One such connection. For one thread.

    Args:
        connection: whose first request has been read.
        source: what is shown.
        watchers: of those who have no token, so many may look.
    """

    def __init__(
        self, connection: socket.socket, source: PipeSource, watchers: threading.BoundedSemaphore
    ) -> None:
        self.has_asked: Callable[[], object] = int
        """Called when it has said what it wants."""
        self._connection = connection
        self._source = source
        self._watchers = watchers
        self._protocol = ServerProtocol(max_size=LARGEST)
        self._browser = next(_browsers)
        self._may_command = self._could_command = False
        self._has_place = False
        self._is_wanted = False
        self._due = 0.0
        self._connection.settimeout(WRITE_TIMEOUT)

    def accept(self, path: str, headers: Iterable[tuple[str, str]]) -> bool:
        """Answer the handshake; return whether it is one."""
        lines = [f"GET {path} HTTP/1.1", *(f"{name}: {value}" for name, value in headers), "", ""]
        self._protocol.receive_data("\r\n".join(lines).encode("latin-1"))
        (request,) = self._protocol.events_received()
        assert isinstance(request, Request)
        response = self._protocol.accept(request)
        self._protocol.send_response(response)
        self._flush()
        return self._protocol.state is State.OPEN

    def serve(self, is_over: Callable[[], bool]) -> None:
        """Answer until the browser has gone, or all is over."""
        try:
            while self._protocol.state is State.OPEN and not is_over():
                self._step()
        except _End as end:
            self._protocol.fail(end.code, end.reason)
            self._flush()
        except ControlError as error:
            log.info("the pictures end: %s", error)
        finally:
            self._leave()

    def _step(self) -> None:
        now = time.monotonic()
        wait = max(0.0, min(_POLL, self._due - now)) if self._is_wanted else _POLL
        if select.select([self._connection], (), (), wait)[0]:
            self._receive()
        elif not (self._has_place or self._may_command):
            if self._due == 0.0:
                self._due = now + SILENT
            elif now > self._due:
                raise _End(CloseCode.POLICY_VIOLATION, "nothing was asked for")
        is_open = self._protocol.state is State.OPEN
        if is_open and self._is_wanted and time.monotonic() >= self._due:
            self._is_wanted = False
            self._due = time.monotonic() + PERIOD
            self._send("live", self._source.picture(FRESH))

    def _receive(self) -> None:
        data = self._connection.recv(_PIECE)
        if data:
            self._protocol.receive_data(data)
        else:
            self._protocol.receive_eof()
        for event in self._protocol.events_received():
            if isinstance(event, Frame) and self._protocol.state is State.OPEN:
                self._read(event)
        self._flush()

    def _read(self, frame: Frame) -> None:
        if frame.opcode in (Opcode.PING, Opcode.PONG, Opcode.CLOSE):
            return  # answered by the library
        if frame.opcode is not Opcode.TEXT or not frame.fin:
            raise _End(CloseCode.UNSUPPORTED_DATA, "expected text in one piece")
        try:
            message = json.loads(bytes(frame.data))
            ((what, given),) = message.items()
        except (ValueError, AttributeError, RecursionError):
            raise _End(CloseCode.INVALID_DATA, "expected a JSON object of one thing") from None
        self._handle(what, given)

    def _handle(self, what: str, given: Any) -> None:
        match what:
            case "token":
                self._check(given)
            case "scene":
                self._take_place()
                self._send("scene", self._source.scene())
            case "look":
                self._take_place()
                self._is_wanted = True
            case "watch" if isinstance(given, list) and [*map(type, given)] == [str, str]:
                self._take_place()
                self._source.watch(*given)
            case "command" if isinstance(given, dict):
                self._send("answer", self._command(given))
            case _:
                raise _End(CloseCode.INVALID_DATA, f"nothing is known of {what[:20]!r}")

    def _check(self, given: object) -> None:
        secret = self._source.secret
        told = given.encode("utf-8", "surrogatepass") if isinstance(given, str) else b""
        self._may_command = secret is not None and hmac.compare_digest(told, secret.encode())
        if self._may_command:
            self._could_command = True
            self.has_asked()
        self._send("control", self._may_command)

    def _take_place(self) -> None:
        if self._has_place or self._may_command:
            return
        if not self._watchers.acquire(blocking=False):
            raise _End(CloseCode.TRY_AGAIN_LATER, "as many browsers as may look do already")
        self._has_place = True
        self.has_asked()

    def _command(self, arguments: dict[str, Any]) -> str:
        if not self._may_command:
            return "Nothing is commanded without the token: open the page by the address that was told."
        return self._source.command(self._browser, arguments)

    def _send(self, what: str, value: Any) -> None:
        self._protocol.send_text(b'{"%s":%s}' % (what.encode(), json_of(value)))
        self._flush()

    def _flush(self) -> None:
        for data in self._protocol.data_to_send():
            if data:
                self._connection.sendall(data)

    def _leave(self) -> None:
        if self._has_place:
            self._watchers.release()
        if self._could_command:
            try:
                self._source.command(self._browser, {"do": "gone"})
            except ControlError as error:
                log.info("nobody is told that a browser has gone: %s", error)

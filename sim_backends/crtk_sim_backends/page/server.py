"""The server of a page: on a loopback address, in a process of its own.

``python -m crtk_sim_backends.page 127.0.0.2:40001 --port 8000`` serves that of the simulator with that
control port; the simulator's option `web` starts it. That of a device is started by
:mod:`crtk_sim_backends.page.device`. The files are in ``files/``; what changes comes as server-sent events.
The simulator, or the driver, is asked for it only while a browser shows it.

Only requests that name this server's own address are answered: no page of somebody else that is open in the
same browser can read it. What changes the simulator needs the token of its control socket as well, which is
in the fragment of the address that the simulator tells (:func:`crtk_sim_backends.page.address_of`), and so
in no request for the page and in no log. The page of a device changes nothing.
"""

from __future__ import annotations

import argparse
import contextlib
import hmac
import json
import logging
import os
import socket
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from functools import cache, partial
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from multiprocessing.connection import Connection
from typing import Any, Final

from typing_extensions import override

from crtk_sim_backends.child_log import FORMAT
from crtk_sim_backends.command_line import stopped_by_signals
from crtk_sim_backends.control import ControlError, ControlRefused
from crtk_sim_backends.page import address_of
from crtk_sim_backends.page.source import (
    PERIOD,
    PipeSource,
    SimulatorSource,
    Source,
    json_of,
)
from crtk_sim_backends.process import Readiness, SimStartError, listen
from crtk_sim_backends.watching import NICENESS, Life, address

HTTP_PORT: Final = 80
"""The port that a browser does not name."""
WATCHERS: Final = 8
"""Browsers that may watch at the same time."""
LARGEST_REQUEST: Final = 1 << 16
"""Bytes."""
BACKLOG: Final = 512
"""Connections that may wait to be accepted: one that finds no place there tries again after a second."""
ASKING: Final = 64
"""Connections that may be open and have asked for nothing yet."""

Files = Mapping[str, tuple[str, str]]
"""Name and type of a file, by path."""

_POLL: Final = 0.1  # s
_READ_TIMEOUT: Final = 10.0  # s


def _files(first: str, *scripts: str) -> Files:
    """Return a page with its scripts, and those that all pages have, by path."""
    shared = ("elements.js", "chain.js", "solids.js", "arm.js", "chart.js")
    return {"/": (first, "text/html; charset=utf-8")} | {
        f"/{name}": (name, "text/javascript; charset=utf-8") for name in (*shared, *scripts)
    }


ONE: Final = _files("index.html", "view.js")
"""The page of a simulator, or of a device."""
MANY: Final = _files("devices.html", "devices.js", "device_card.js", "pilot.js")
"""The page of all devices on the graph, which looks by `/socket`."""

_CHANGES: Final = {"/inject": "inject", "/clear": "clear"}
_HEADERS: Final = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'self'; style-src 'unsafe-inline'; img-src data:",
    "X-Content-Type-Options": "nosniff",
}

log = logging.getLogger(__name__)


@cache
def page(name: str) -> bytes:
    """Return a file of the page."""
    return resources.files(__package__).joinpath("files", name).read_bytes()


class PageServer(ThreadingHTTPServer):
    """Serves a page.

    Raises:
        SimStartError: the port cannot be bound.
    """

    daemon_threads = True
    block_on_close = False

    def __init__(
        self, host: str, port: int, source: Source, life: Life, files: Files = ONE
    ) -> None:
        super().__init__((host, port), _Request, bind_and_activate=False)
        self.socket.close()
        self.socket = listen(
            host, port, "web", "choose another one with web_port (0: any free one)"
        )
        self.socket.listen(BACKLOG)
        self.socket.setblocking(True)  # for `handle_request`, which waits for it
        self.server_address = self.socket.getsockname()
        self.timeout = _POLL
        self.source = source
        self.life = life
        self.files = files
        self.watchers = threading.BoundedSemaphore(WATCHERS)
        self._asking: dict[
            socket.socket, None
        ] = {}  # that have asked nothing yet, the oldest first
        self._asking_lock = threading.Lock()

    @override
    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer in a thread; of `ASKING` connections that ask nothing, the oldest makes place."""
        with self._asking_lock:
            while len(self._asking) >= ASKING:
                oldest = next(iter(self._asking))
                del self._asking[oldest]
                with contextlib.suppress(OSError):
                    oldest.shutdown(socket.SHUT_RDWR)
            self._asking[request] = None
        super().process_request(request, client_address)

    def has_asked(self, request: Any) -> None:
        """A connection is one that is answered, and makes place for none."""
        with self._asking_lock:
            self._asking.pop(request, None)

    @override
    def shutdown_request(self, request: Any) -> None:
        """Close a connection."""
        self.has_asked(request)
        super().shutdown_request(request)

    @property
    def own_names(self) -> set[str]:
        """What the header `Host` may say."""
        host, port = self.server_address[:2]
        names = {str(host), "localhost"}
        return {f"{name}:{port}" for name in names} | (names if port == HTTP_PORT else set())

    def serve(self) -> None:
        """Answer until its life is over."""
        while not self.life.wait(0.0):
            self.handle_request()


class _Refused(Exception):
    """A request that is answered with an error."""

    def __init__(self, status: HTTPStatus, reason: str) -> None:
        super().__init__(reason)
        self.status = status


class _Request(BaseHTTPRequestHandler):
    """One request."""

    server: PageServer
    timeout = _READ_TIMEOUT

    def do_GET(self) -> None:
        """Answer with a file, what does not change, or what does without end."""
        self._answer(self._get)

    def do_POST(self) -> None:
        """Let a fault begin, or end them."""
        self._answer(self._post)

    @override
    def log_message(self, format: str, *args: Any) -> None:
        """Tell it to the log."""
        log.debug(format, *args)

    def _answer(self, act: Any) -> None:
        try:
            if self.headers.get("Host") not in self.server.own_names:
                raise _Refused(HTTPStatus.MISDIRECTED_REQUEST, "this server has another name")
            act()
        except _Refused as refused:
            self._send(str(refused).encode(), "text/plain; charset=utf-8", refused.status)
        except ControlError as error:
            reason = str(error).encode()
            self._send(reason, "text/plain; charset=utf-8", HTTPStatus.BAD_GATEWAY)
        except (ConnectionError, TimeoutError):
            log.debug("the browser has gone")

    def _get(self) -> None:
        files = self.server.files
        if self.path in files:
            name, kind = files[self.path]
            self._send(page(name), kind)
        elif self.path == "/socket" and files is MANY:
            self._serve_socket()
        elif self.path == "/scene.json":
            self._send(json_of(self.server.source.scene()), "application/json")
        elif self.path == "/events":
            self._send_events()
        else:
            raise _Refused(HTTPStatus.NOT_FOUND, f"there is no {self.path}")

    def _send(self, body: bytes, kind: str, status: HTTPStatus = HTTPStatus.OK) -> None:
        self._begin(kind, status)
        self.wfile.write(body)

    def _begin(self, kind: str, status: HTTPStatus = HTTPStatus.OK) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        for name, value in _HEADERS.items():
            self.send_header(name, value)
        self.end_headers()

    def _send_events(self) -> None:
        if not self.server.watchers.acquire(blocking=False):
            raise _Refused(HTTPStatus.SERVICE_UNAVAILABLE, f"{WATCHERS} browsers watch already")
        try:
            self._begin("text/event-stream")
            self.server.has_asked(self.connection)
            for live in self.server.source.pictures(PERIOD, self._wait):
                self.wfile.write(b"data: " + json_of(live) + b"\n\n")
        except ControlRefused as error:
            log.warning("the page shows nothing: %s", error)
        except ControlError as error:
            log.info("the pictures end: %s", error)
        finally:
            self.server.watchers.release()

    def _serve_socket(self) -> None:
        from crtk_sim_backends.page.looking import Looking  # its library is of the extra `view`

        own = {f"http://{name}" for name in self.server.own_names}
        if self.headers.get("Origin") not in own:
            raise _Refused(HTTPStatus.FORBIDDEN, "only pages of this server may look")
        source = self.server.source
        assert isinstance(source, PipeSource)
        looking = Looking(self.connection, source, self.server.watchers)
        looking.has_asked = partial(self.server.has_asked, self.connection)
        self.close_connection = True
        if looking.accept(self.path, self.headers.items()):
            looking.serve(lambda: self.server.life.over)

    def _wait(self, seconds: float) -> bool:
        time.sleep(seconds)
        return self.server.life.over

    def _post(self) -> None:
        self._check_token()
        request = self._read_request()
        if self.path not in _CHANGES:
            raise _Refused(HTTPStatus.NOT_FOUND, f"there is no {self.path}")
        try:
            self.server.source.change(_CHANGES[self.path], request)
        except ControlError as error:
            raise _Refused(HTTPStatus.BAD_REQUEST, str(error)) from error
        self._send(b"{}", "application/json")

    def _check_token(self) -> None:
        secret = self.server.source.secret
        if secret is None:
            raise _Refused(HTTPStatus.METHOD_NOT_ALLOWED, "this page only looks")
        kind, _, given = self.headers.get("Authorization", "").partition(" ")
        given_token = given.encode("utf-8", "surrogatepass")
        if kind != "Bearer" or not hmac.compare_digest(given_token, secret.encode()):
            raise _Refused(
                HTTPStatus.UNAUTHORIZED,
                "nothing is changed without the simulator's token: open the page by the address that it told",
            )

    def _read_request(self) -> dict[str, Any]:
        if self.headers.get_content_type() != "application/json":
            raise _Refused(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "expected application/json")
        try:
            size = int(self.headers.get("Content-Length", ""))
            if not 0 <= size <= LARGEST_REQUEST:
                raise ValueError(size)
            request = json.loads(self.rfile.read(size))
        except (ValueError, RecursionError) as error:
            raise _Refused(HTTPStatus.BAD_REQUEST, "expected JSON and its length") from error
        if not isinstance(request, dict):
            raise _Refused(HTTPStatus.BAD_REQUEST, "expected a JSON object")
        return request


def main(arguments: Sequence[str] | None = None) -> int:
    """Serve the page of the simulator that the command line names; 1 when the port cannot be bound."""
    parser = argparse.ArgumentParser(prog="python -m crtk_sim_backends.page")
    parser.description = "The page of a simulator for the browser."
    parser.add_argument(
        "control", type=address, nargs="?", help="its control socket, HOST:PORT; needed"
    )
    parser.add_argument("--port", type=int, default=0, help="port of the page; 0: any free one")
    parser.add_argument("--host", default="127.0.0.1", help=argparse.SUPPRESS)
    parser.add_argument("--many", action="store_true", help=argparse.SUPPRESS)
    for pipe in ("--pipe-fd", "--ready-fd", "--parent-fd"):
        parser.add_argument(pipe, type=int, default=None, help=argparse.SUPPRESS)
    given: Any = parser.parse_args(arguments)
    if (given.control is None) is (given.pipe_fd is None):
        parser.error("name the simulator by its control socket, HOST:PORT")
    logging.basicConfig(format=FORMAT)
    os.nice(NICENESS)
    readiness = Readiness(given.ready_fd, given.parent_fd)
    life = Life(given.parent_fd)
    try:
        source: Source
        if given.control is None:
            host, source = given.host, PipeSource(Connection(given.pipe_fd), given.many)
        else:
            host, source = given.control[0], SimulatorSource(given.control)
        server = PageServer(host, given.port, source, life, MANY if given.many else ONE)
    except (ControlError, SimStartError) as error:
        readiness.tell(error=str(error))
        if given.parent_fd is None:
            sys.stderr.write(f"{error}\n")
        return 1
    with server, stopped_by_signals(life.end):
        port = server.server_address[1]
        readiness.tell(host=host, ports={"web": port})
        if given.parent_fd is None:
            sys.stdout.write(f"{address_of(host, port)}\n")
            sys.stdout.flush()
        server.serve()
    return 0

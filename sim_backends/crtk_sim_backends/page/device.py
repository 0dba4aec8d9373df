"""Pages of what runs in this process: plug-ins of the group ``crtk_drivers.pages``.

The server of a page is a process of its own. It asks over a pipe, which nobody else can reach, and a thread
of this process answers: what is shown is made here, all else there.
"""

from __future__ import annotations

import json
import logging
import threading
from collections.abc import Callable, Mapping, Sequence
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any, Final, Protocol

from crtk_sim_backends.page.source import LIVE, SCENE, Answer
from crtk_sim_backends.process import RunningSim, spawn

LONGEST_REQUEST: Final = 1 << 14
"""Bytes."""

log = logging.getLogger(__name__)


class Shown(Protocol):
    """What is shown: see :mod:`crtk_sim_backends.page`."""

    def scene(self) -> Mapping[str, Any]:
        """What does not change."""

    def live(self) -> Mapping[str, Any]:
        """What does."""


class ServedPage:
    """A page that is served; made by `serve`.

    Args:
        server: of the page.
        pipe: to it.
        answers: what it may ask.
        ended: called when it has ended without being asked to.
    """

    def __init__(
        self,
        server: RunningSim,
        pipe: Connection,
        answers: Mapping[str, Answer],
        ended: Callable[[], object] = int,
    ) -> None:
        self._server = server
        self._pipe = pipe
        self._answers = answers
        self._ended = ended
        self._stopping = False
        self._failed = ""
        self._thread = threading.Thread(target=self._answer_all, name="page", daemon=True)
        self._thread.start()

    @property
    def address(self) -> str:
        """For a browser on this machine."""
        return f"http://{self._server.host}:{self._server.ports['web']}/"

    @property
    def pid(self) -> int:
        """Process id of its server."""
        return self._server.pid

    def stop(self, timeout: float = 2.0) -> None:
        """End its server, which ends the thread; safe to repeat."""
        self._stopping = True
        self._server.stop(timeout)
        self._thread.join(timeout)

    def _answer_all(self) -> None:
        with self._pipe:
            try:
                while True:
                    request = self._pipe.recv_bytes(LONGEST_REQUEST).decode()
                    number, what, arguments = request.split(maxsplit=2)
                    self._pipe.send_bytes(self._answer(int(number), what, arguments))
            except (EOFError, OSError):
                if not self._stopping:
                    log.warning("the page at %s has ended; nothing else has", self.address)
                    self._ended()

    def _answer(self, number: int, what: str, arguments: str) -> bytes:
        try:
            shown = self._answers[what](**json.loads(arguments))
            return json.dumps({"number": number, "shown": shown}).encode()
        except Exception as error:  # whatever is shown, the page does not end what it shows
            reason = f"{type(error).__name__}: {error}"
            if reason != self._failed:
                log.exception("the page has no picture")
            self._failed = reason
            return json.dumps({"number": number, "error": reason}).encode()


class DevicePage:
    """Serves pages of what runs in this process."""

    name = "web"
    summary = "shows a device in a browser on this machine"

    def serve(self, shown: Shown, port: int, host: str = "127.0.0.1") -> ServedPage:
        """Serve a page, and return when it can be opened.

        Args:
            shown: asked in a thread of its own, only while a browser looks, 30 times a second at most.
            port: 0 for any free one.
            host: the loopback address.

        Raises:
            SimStartError: the port cannot be bound.
        """
        return serve({SCENE: shown.scene, LIVE: shown.live}, port, host)


PAGE: Final = DevicePage()
"""The entry point ``web``."""


def serve(
    answers: Mapping[str, Answer],
    port: int,
    host: str,
    options: Sequence[str] = (),
    ended: Callable[[], object] = int,
) -> ServedPage:
    """Start the server of a page; see `ServedPage` and `DevicePage.serve`.

    Args:
        answers: what it may ask.
        port: 0 for any free one.
        host: a loopback address.
        options: of its command line.
        ended: see `ServedPage`.

    Raises:
        SimStartError: the port cannot be bound.
    """
    own, servers = Pipe()
    try:
        with servers:
            server = spawn(
                "crtk_sim_backends.page",
                [f"--pipe-fd={servers.fileno()}", f"--host={host}", f"--port={port}", *options],
                pass_fds=(servers.fileno(),),
                called="page",
            )
    except BaseException:
        own.close()
        raise
    return ServedPage(server, own, answers, ended)

"""The page of whatever runs in this process: a plug-in of the group ``crtk_drivers.pages``.

The server of the page is a process of its own. It asks over a pipe, which nobody else can reach, and a thread
of this process answers: what is shown is made here, all else there.
"""

from __future__ import annotations

import json
import logging
import threading
from collections.abc import Mapping
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any, Final, Protocol

from crtk_sim_backends.page.source import LIVE, SCENE
from crtk_sim_backends.process import RunningSim, spawn

LONGEST_REQUEST: Final = 64
"""Bytes."""

log = logging.getLogger(__name__)


class Shown(Protocol):
    """What is shown: see :mod:`crtk_sim_backends.page`."""

    def scene(self) -> Mapping[str, Any]:
        """What does not change."""

    def live(self) -> Mapping[str, Any]:
        """What does."""


class ServedPage:
    """A page that is served; made by :meth:`DevicePage.serve`."""

    def __init__(self, server: RunningSim, pipe: Connection, shown: Shown) -> None:
        self._server = server
        self._pipe = pipe
        self._ask = {SCENE: shown.scene, LIVE: shown.live}
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
                    number, what = self._pipe.recv_bytes(LONGEST_REQUEST).decode().split()
                    self._pipe.send_bytes(self._answer(int(number), what))
            except (EOFError, OSError):
                if not self._stopping:
                    log.warning("the page at %s has ended; nothing else has", self.address)

    def _answer(self, number: int, what: str) -> bytes:
        try:
            return json.dumps({"number": number, "shown": self._ask[what]()}).encode()
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
        own, servers = Pipe()
        try:
            with servers:
                server = spawn(
                    "crtk_sim_backends.page",
                    [f"--pipe-fd={servers.fileno()}", f"--host={host}", f"--port={port}"],
                    pass_fds=(servers.fileno(),),
                )
        except BaseException:
            own.close()
            raise
        return ServedPage(server, own, shown)


PAGE: Final = DevicePage()

"""The page of all devices on the graph: a plug-in of the group ``crtk_drivers.pages``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, Protocol

import websockets  # noqa: F401 - the server needs it: told here where it is not installed

from crtk_sim_backends.page.device import ServedPage, Shown, serve
from crtk_sim_backends.page.source import COMMAND, LIVE, SCENE, SECRET, WATCH, Answer

__all__ = ["PAGE", "Commanded", "DevicesPage"]


class Commanded(Shown, Protocol):
    """What is shown, and may be commanded."""

    @property
    def secret(self) -> str | None:
        """The token without which nothing is commanded; None where nothing can be."""

    def command(self, browser: int, arguments: Mapping[str, Any]) -> str:
        """Do something for a browser, and return why it is not done. ``{"do": "gone"}``: it has gone."""

    def watch(self, namespace: str, name: str) -> bool:
        """Show a value of a device from now on; False if there is none."""

    def ended(self) -> None:
        """The server of the page has ended: so have all browsers."""


class DevicesPage:
    """Serves the page of all devices."""

    name = "view"
    summary = "shows all devices on the graph in a browser on this machine, for crtk-driver view"

    def serve(self, shown: Commanded, port: int, host: str = "127.0.0.1") -> ServedPage:
        """Serve the page, and return when it can be opened.

        Args:
            shown: asked in a thread of its own; `live` only while a browser looks, 30 times a second at most.
            port: 0 for any free one.
            host: a loopback address.

        Raises:
            SimStartError: the port cannot be bound.
        """
        answers: dict[str, Answer] = {
            SCENE: shown.scene,
            LIVE: shown.live,
            SECRET: lambda: shown.secret,
            COMMAND: shown.command,
            WATCH: shown.watch,
        }
        return serve(answers, port, host, ["--many"], shown.ended)


PAGE: Final = DevicesPage()
"""The entry point ``view``."""

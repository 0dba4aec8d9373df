"""What the core knows of pages for the browser: three small protocols, and how to start one.

A page comes by the entry point group ``crtk_drivers.pages`` and shares no code with the core: these are
structural types, and nothing has to be imported to satisfy them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

from crtk_drivers.errors import ConnectionFailed


class Shown(Protocol):
    """What is shown, as dictionaries that JSON can hold; see `crtk_drivers.session.scene`."""

    def scene(self) -> Mapping[str, Any]:
        """What does not change."""

    def live(self) -> Mapping[str, Any]:
        """What does."""


class RunningPage(Protocol):
    """A page that is served."""

    @property
    def address(self) -> str:
        """For a browser on this machine."""

    def stop(self, timeout: float = 2.0) -> Any:
        """End it, and all that was opened for it. May be called twice."""


@runtime_checkable
class PagePlugin(Protocol):
    """What an entry point of ``crtk_drivers.pages`` names."""

    @property
    def name(self) -> str:
        """As the entry point is called."""

    @property
    def summary(self) -> str:
        """One line."""

    def serve(self, shown: Shown, port: int) -> RunningPage:
        """Serve the page on a loopback address, and return when it can be opened.

        Args:
            shown: asked in a thread of its own, only while a browser looks, 30 times a second at most.
            port: 0 for any free one.

        Raises:
            RuntimeError: it could not be started, with the reason and what to do.
        """


def start_page(plugin: PagePlugin, shown: Shown, port: int) -> RunningPage:
    """Serve a page.

    Raises:
        ConnectionFailed: it did not start: the port is in use, ...
    """
    try:
        return plugin.serve(shown, port)
    except RuntimeError as error:
        raise ConnectionFailed(f"the page did not start: {error}") from error

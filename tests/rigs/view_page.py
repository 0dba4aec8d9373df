"""A browser of the page of all devices, as far as the wire is concerned."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from typing import Any, Self
from urllib.parse import urlsplit

from websockets.sync.client import connect

from rigs.waiting import LONG


class ViewPage:
    """A WebSocket to it. A context manager.

    Args:
        address: as it is told; with a token behind the ``#``, which is sent at once.
        headers: of the handshake, beside its own `Origin`.
    """

    def __init__(self, address: str, **headers: str) -> None:
        parts = urlsplit(address)
        own = {"Origin": f"http://{parts.netloc}"} | headers
        self.socket = connect(
            f"ws://{parts.netloc}/socket",
            additional_headers={name: value for name, value in own.items() if value},
            open_timeout=LONG,
            max_size=None,
            proxy=None,
        )
        if parts.fragment:
            assert self.ask({"token": parts.fragment}) == {"control": True}

    def send(self, message: object) -> None:
        self.socket.send(json.dumps(message))

    def next(self) -> Any:
        return json.loads(self.socket.recv(timeout=LONG))

    def ask(self, message: object) -> Any:
        self.send(message)
        return self.next()

    def scene(self) -> Any:
        return self.ask({"scene": True})["scene"]

    def live(self) -> Any:
        """Return a picture; there is none where what is shown did not answer for a second."""
        deadline = time.monotonic() + LONG
        while (found := self.ask({"look": True})["live"]) is None:
            assert time.monotonic() < deadline, "what is shown hangs"
        return found

    def command(self, **arguments: Any) -> str:
        answer: str = self.ask({"command": arguments})["answer"]
        return answer

    def until(self, test: Callable[[Any], Any], look: Callable[[Any], Any] | None = None) -> Any:
        """Look until `test` holds of what is shown, and return that."""
        deadline = time.monotonic() + LONG
        while not test(found := (look or type(self).live)(self)):
            assert time.monotonic() < deadline, found
        return found

    def close(self) -> None:
        self.socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def device_of(scene: Mapping[str, Any], namespace: str) -> Any:
    """Return what a scene says of a device; None if it has none of that name."""
    return next((each for each in scene["devices"] if each["namespace"] == namespace), None)

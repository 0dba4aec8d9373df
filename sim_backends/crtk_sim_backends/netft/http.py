"""The web server of a box: one request for each connection. Bytes in, bytes out."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Final
from urllib.parse import parse_qsl, urlsplit

from crtk_sim_backends.netft import pages
from crtk_sim_backends.netft.box import Box
from crtk_sim_backends.netft.hostile import Hostile
from crtk_sim_backends.netft.profiles import CALIBRATION_PAGE, SENSOR_PAGE

log = logging.getLogger(__name__)

_LONGEST_REQUEST: Final = 16384
_REASONS: Final = {200: "OK", 400: "Bad Request", 404: "Not Found"}


class HttpSession:
    """One connection.

    Args:
        box: whose pages they are.
        host: address of the box.
        sender: of the client, for the trace.
        clock: monotonic seconds.
        hostile: what the server does instead of answering; None while it behaves.
        tags: texts of tags that its XML pages have instead of the true ones.
    """

    def __init__(
        self,
        box: Box,
        host: str,
        sender: str,
        clock: Callable[[], float],
        hostile: Hostile | None,
        tags: Mapping[str, str] = MappingProxyType({}),
    ) -> None:
        self.ended = False
        self._box = box
        self._host = host
        self._sender = sender
        self._clock = clock
        self._hostile = hostile
        self._tags = tags
        self._received = bytearray()
        self._answering = False

    def receive(self, data: bytes) -> bytes:
        """Take received bytes and return the answer, once the request is there."""
        if self._answering or self.ended:
            return b""
        self._received += data
        head, blank, _ = bytes(self._received).partition(b"\r\n\r\n")
        if not blank:
            self.ended = len(self._received) > _LONGEST_REQUEST
            return b""
        status, kind, body = self._answer(head.split(b"\r\n", 1)[0].decode("latin-1"))
        self._answering = True
        if self._hostile is not None and kind == "text/xml":
            return self._hostile.begin(body)
        self.ended = True
        return _message(status, kind, body)

    def more(self, now: float) -> bytes:
        """Return what comes by itself, of an answer that takes its time."""
        if not self._answering or self._hostile is None or self.ended:
            return b""
        data = self._hostile.more(now)
        self.ended = self._hostile.ended
        return data

    def close(self) -> None:
        """Do nothing."""

    def _answer(self, line: str) -> tuple[int, str, bytes]:
        words = line.split()
        if len(words) < 2 or words[0] != "GET":
            return 400, "text/html", pages.form_page("Bad request").encode()
        now = self._clock()
        target = urlsplit(words[1])
        pairs = parse_qsl(target.query, keep_blank_values=True)
        page = target.path.lstrip("/")
        self._box.counters.pages += 1
        self._box.note("http", self._sender, now, {**dict(pairs), "page": page})
        known = self._box.profile.pages
        if page == SENSOR_PAGE and page in known:
            index = dict(pairs).get("index", "")
            body = pages.sensor_page(
                self._box, int(index) if index.isdecimal() else None, self._host, now
            )
            return 200, "text/xml", pages.with_tags(body, self._tags).encode()
        if page == CALIBRATION_PAGE and page in known:
            body = pages.calibration_page(self._box)
            return 200, "text/xml", pages.with_tags(body, self._tags).encode()
        if SENSOR_PAGE in known and self._box.write_page(page, pairs):
            return 200, "text/html", pages.form_page(page).encode()
        if page in ("", "index.htm"):
            return 200, "text/html", pages.form_page(self._box.profile.product).encode()
        return 404, "text/html", pages.form_page("Not found").encode()


def _message(status: int, kind: str, body: bytes) -> bytes:
    head = (
        f"HTTP/1.0 {status} {_REASONS[status]}\r\nContent-Type: {kind}\r\n"
        f"Content-Length: {len(body)}\r\nConnection: close\r\n\r\n"
    )
    return head.encode() + body

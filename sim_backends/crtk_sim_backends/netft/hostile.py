"""Answers of a web server that is broken, or means harm: in place of the XML pages of a box."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from typing import Final

_HEAD: Final = b"HTTP/1.0 200 OK\r\nContent-Type: text/xml\r\nConnection: close\r\n\r\n"
_CHUNK: Final = b"<runft>" + b"0;" * 8192 + b"</runft>\n"
_PAUSE: Final = 0.05
"""Seconds between two bytes of a slow answer."""

Parts = Iterator[bytes]


def _replaced(page: bytes, tag: str, by: str) -> bytes:
    return re.sub(rf"<{tag}>[^<]*</{tag}>".encode(), by.encode(), page)


def _entity_bomb(page: bytes) -> Parts:
    rows = ['<!ENTITY a0 "boom">']
    rows += [f'<!ENTITY a{n} "{f"&a{n - 1};" * 10}">' for n in range(1, 10)]
    text = f'<?xml version="1.0"?><!DOCTYPE netft [{"".join(rows)}]><netft><cfgnam>&a9;</cfgnam></netft>'
    yield _HEAD + text.encode()


def _external_entity(page: bytes) -> Parts:
    yield (
        _HEAD + b'<?xml version="1.0"?><!DOCTYPE netft [<!ENTITY x SYSTEM "file:///etc/hostname">]>'
        b"<netft><cfgnam>&x;</cfgnam></netft>"
    )


def _duplicate_tags(page: bytes) -> Parts:
    tag = re.search(rb"<cfgcpf>\d+</cfgcpf>", page)
    twice = b"<cfgcpf>600000</cfgcpf>\n" + tag[0] if tag else b""
    yield _HEAD + re.sub(rb"<cfgcpf>\d+</cfgcpf>", twice, page)


def _missing_tags(page: bytes) -> Parts:
    yield _HEAD + _replaced(_replaced(page, "cfgcpf", ""), "cfgcpt", "")


def _unknown_unit(page: bytes) -> Parts:
    yield _HEAD + _replaced(page, "scfgfu", "<scfgfu>furlong</scfgfu>")


def _no_number(page: bytes) -> Parts:
    yield _HEAD + _replaced(page, "cfgcpf", "<cfgcpf>many</cfgcpf>")


def _cut_off(page: bytes) -> Parts:
    yield _HEAD.replace(b"\r\n\r\n", f"\r\nContent-Length: {len(page)}\r\n\r\n".encode())
    yield page[: len(page) // 2]


def _no_http(page: bytes) -> Parts:
    yield bytes(range(256)) * 4


def _server_error(page: bytes) -> Parts:
    yield b"HTTP/1.0 500 Internal Server Error\r\nContent-Length: 0\r\n\r\n"


def _endless(page: bytes) -> Parts:
    yield _HEAD + b"<netft>"
    while True:
        yield _CHUNK


def _huge(page: bytes) -> Parts:
    yield _HEAD.replace(b"\r\n\r\n", b"\r\nContent-Length: 104857600\r\n\r\n") + b"<netft>"
    for _ in range(104_857_600 // len(_CHUNK)):
        yield _CHUNK


def _slow(page: bytes) -> Parts:
    for byte in _HEAD + page:
        yield bytes([byte])


def _silent(page: bytes) -> Parts:
    while True:
        yield b""


ANSWERS: Final[Mapping[str, Callable[[bytes], Parts]]] = {
    "entity_bomb": _entity_bomb,
    "external_entity": _external_entity,
    "duplicate_tags": _duplicate_tags,
    "missing_tags": _missing_tags,
    "unknown_unit": _unknown_unit,
    "no_number": _no_number,
    "cut_off": _cut_off,
    "no_http": _no_http,
    "server_error": _server_error,
    "endless": _endless,
    "huge": _huge,
    "slow": _slow,
    "silent": _silent,
}
"""What each says, in parts, in place of a page."""


class Hostile:
    """One answer of a kind of `ANSWERS`."""

    def __init__(self, kind: str) -> None:
        self.ended = False
        self._kind = kind
        self._pause = _PAUSE if kind == "slow" else 0.0
        self._parts: Parts = iter(())
        self._next = 0.0

    def begin(self, page: bytes) -> bytes:
        """Return the first part, in place of a page."""
        self._parts = ANSWERS[self._kind](page)
        return next(self._parts)

    def more(self, now: float) -> bytes:
        """Return the next part when it is time for it; `ended` when there is none."""
        if now < self._next:
            return b""
        self._next = now + self._pause
        part = next(self._parts, None)
        self.ended = part is None
        return part or b""

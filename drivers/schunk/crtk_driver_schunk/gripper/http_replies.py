"""HTTP replies out of bytes as they come, cut anywhere; parsed by the standard library. No I/O."""

from __future__ import annotations

import io
from http.client import HTTPException, HTTPResponse, IncompleteRead
from typing import Any, Final

from typing_extensions import override

__all__ = ["Replies"]

LONGEST: Final = 65536


class _Kept(io.BytesIO):
    """A file that the parser does not close: where it stopped is to be asked."""

    @override
    def close(self) -> None:
        pass


class _Heard:
    """In place of a socket: it has said what it has said."""

    def __init__(self, data: bytes) -> None:
        self.file = _Kept(data)

    def makefile(self, *_: Any) -> io.BytesIO:
        """Return what it has said."""
        return self.file


class Replies:
    """Of one connection.

    Attributes:
        closes: the server closes the connection after the last reply.
        rest: what has come and belongs to no reply that was returned.
    """

    def __init__(self) -> None:
        self.closes = False
        self.rest = b""

    def feed(self, data: bytes, *, ended: bool = False) -> bytes | None:
        """Take bytes; return the body of a reply once it is whole.

        Args:
            data: that has come.
            ended: the connection was closed after it.

        Raises:
            ValueError: this is no HTTP, or no success.
        """
        self.rest += data
        if len(self.rest) > LONGEST:
            raise ValueError(f"{len(self.rest)} bytes as one reply")
        if b"\r\n\r\n" not in self.rest:
            return None
        heard = _Heard(self.rest)
        response = HTTPResponse(heard)  # type: ignore[arg-type]
        try:
            response.begin()
            if response.length is None and not response.chunked and not ended:
                return None
            body = response.read()
        except IncompleteRead:
            return None
        except HTTPException as error:
            raise ValueError(f"{self.rest[:60]!r} is no HTTP ({error!r})") from error
        end = heard.file.tell()
        if response.chunked and not self.rest[:end].endswith(b"\r\n\r\n"):
            return None  # the parser takes what is missing for the end of the connection
        self.closes = response.will_close
        self.rest = self.rest[end:]
        if response.status != 200:
            raise ValueError(f"HTTP {response.status} {response.reason}")
        return body

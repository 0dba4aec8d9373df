"""The sensor's web server: its pages read, and its settings written and read back. Blocking, with a deadline.

Every answer has a size cap, and the whole exchange a deadline that a slow server cannot stretch. Settings go
out as ``GET /page.cgi?name=value&...``; the server answers with a page for people, and clamps and rounds
silently: what counts is what `WebPages.read` says afterwards.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from typing import Final
from urllib.parse import urlencode

from crtk_driver_ati_netft.calibration import (
    LONGEST_PAGE,
    CalibrationInfo,
    SensorInfo,
    read_calibration,
    read_sensor,
)
from crtk_drivers.errors import ConnectionFailed, ConnectionLost, ProtocolError
from crtk_drivers.kit import ClosedByPeer, TcpTransport

SENSOR_PAGE: Final = "/netftapi2.xml"

_LONGEST_ANSWER: Final = LONGEST_PAGE + 16384
_ON = "The sensor's web server can be reached with a browser when it is on."


class NoSuchPage(ProtocolError):
    """There is a web server, and it has no page of that name."""


class WebPages:
    """The web server of one sensor. Each call is one connection.

    Args:
        host, port: of the server.
        timeout: seconds for each call at most.
        clock: monotonic seconds.
    """

    def __init__(
        self,
        host: str,
        port: int,
        timeout: float = 1.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.host = host
        self.port = port
        self._timeout = timeout
        self._clock = clock
        self._aborted = False

    @property
    def where(self) -> str:
        """For messages."""
        return f"http://{self.host}:{self.port}"

    def abort(self) -> None:
        """End what waits, from any thread; later calls fail."""
        self._aborted = True

    def read(self, deadline: float | None = None) -> SensorInfo:
        """Return the sensor's configuration.

        Raises:
            ConnectionFailed: no answer in time.
            ProtocolError: the answer is no configuration that can be used.
        """
        return self.understand(self.sensor_page(deadline))

    def sensor_page(self, deadline: float | None = None) -> bytes:
        """Return the page of the sensor's configuration.

        Raises:
            ConnectionFailed, ProtocolError: as `get`.
        """
        return self.get(SENSOR_PAGE, deadline)

    def understand(self, page: bytes) -> SensorInfo:
        """Return what that page says.

        Raises:
            ProtocolError: nothing that can be used.
        """
        return read_sensor(page, self.where + SENSOR_PAGE)

    def calibration(self, index: int, deadline: float | None = None) -> CalibrationInfo:
        """Return the calibration with an index from 0 to 15; raises as `read`."""
        path = f"/netftcalapi.xml?index={index}"
        return read_calibration(self.get(path, deadline), self.where + path)

    def write(
        self,
        page: str,
        values: Mapping[str, object] | Iterable[tuple[str, object]],
        deadline: float | None = None,
    ) -> None:
        """Write settings, all in one request, in the order given. Read them back.

        Args:
            page: ``setting.cgi``, ``config.cgi``, ``comm.cgi`` or ``moncon.cgi``.
            values: of its variables.
            deadline: monotonic, besides the timeout of each call.

        Raises:
            ConnectionFailed, ProtocolError: no answer, or one that is not a success.
        """
        pairs = list(values.items()) if isinstance(values, Mapping) else list(values)
        self.get(f"/{page}?{urlencode(pairs)}", deadline)

    def get(self, path: str, deadline: float | None = None) -> bytes:
        """Return the body of one page.

        Raises:
            ConnectionFailed: no connection, or no complete answer in time.
            ProtocolError: the answer is not HTTP, too long, or not a success.
        """
        until = self._clock() + self._timeout
        until = until if deadline is None else min(until, deadline)
        request = f"GET {path} HTTP/1.0\r\nHost: {self.host}\r\nConnection: close\r\n\r\n"
        connection = TcpTransport(
            self.host, self.port, aborted=lambda: self._aborted, clock=self._clock
        )
        try:
            if until <= self._clock():
                raise ConnectionFailed("no time left; not asked in time")
            connection.open(until)
            connection.write(request.encode("ascii"))
            answer = self._receive(connection, until)
        except (ConnectionFailed, ConnectionLost) as error:
            raise ConnectionFailed(
                f"GET {path}: {error.message}", where=self.where, remedy=_ON
            ) from error
        finally:
            connection.close()
        return self._body(answer, path)

    @staticmethod
    def _receive(connection: TcpTransport, until: float) -> bytes:
        """Return everything up to the end of the answer."""
        data = bytearray()
        complete = _LONGEST_ANSWER
        while len(data) < complete:
            try:
                piece = connection.read(until)
            except ClosedByPeer:
                break
            if not piece:
                raise ConnectionFailed("no complete answer in time")
            searched = max(0, len(data) - 3)
            data += piece
            if complete == _LONGEST_ANSWER and (end := data.find(b"\r\n\r\n", searched)) >= 0:
                size = _size(_headers(data[:end]).get("content-length", ""))
                if size is not None:
                    complete = min(complete, end + 4 + size)
        return bytes(data)

    def _body(self, answer: bytes, path: str) -> bytes:
        head, blank, body = answer.partition(b"\r\n\r\n")
        words = head.split(b"\r\n", 1)[0].decode("latin-1").split(None, 2)
        if not blank or len(words) < 2 or not words[0].startswith("HTTP/"):
            raise self._wrong(f"GET {path}: the answer is not HTTP: {answer[:40]!r}")
        if words[1] == "404":
            raise NoSuchPage(
                f"GET {path}: answered with {' '.join(words[1:])[:80]}",
                where=self.where,
                remedy="Is this the address of a NetFT sensor? For one of OnRobot, give `profile`.",
            )
        if words[1] != "200":
            raise self._wrong(f"GET {path}: answered with {' '.join(words[1:])[:80]}")
        if len(answer) >= _LONGEST_ANSWER:
            raise self._wrong(f"GET {path}: the answer is longer than {LONGEST_PAGE} bytes")
        size = _size(_headers(head).get("content-length", ""))
        if size is not None and len(body) < size:
            raise ConnectionFailed(
                f"GET {path}: closed after {len(body)} of {size} bytes",
                where=self.where,
                remedy=_ON,
            )
        return body

    def _wrong(self, what: str) -> ProtocolError:
        return ProtocolError(
            what, where=self.where, remedy="Is this the address of a NetFT sensor?"
        )


def _size(text: str) -> int | None:
    """Return a length in bytes; None if it is none, or more than any answer may have."""
    return int(text) if text.isdecimal() and len(text) < 10 else None


def _headers(head: bytes | bytearray) -> dict[str, str]:
    lines = bytes(head).decode("latin-1").split("\r\n")[1:]
    pairs = (line.partition(":") for line in lines)
    return {name.strip().lower(): value.strip() for name, _, value in pairs}

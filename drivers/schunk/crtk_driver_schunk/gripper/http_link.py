"""The web server of the fieldbus module: one connection that stays, JSON of hexadecimal values.

Sources: SCHUNK's driver library; web interface of Anybus CompactCom (``/adi/data.json``, ``update.json``).
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from typing import Final

from crtk_driver_schunk.gripper.http_replies import Replies
from crtk_driver_schunk.gripper.link import Question, Reply
from crtk_drivers.errors import ConnectionLost, DeviceError, ProtocolError
from crtk_drivers.kit import ClosedByPeer, TcpTransport
from crtk_drivers.samples import Stamp

__all__ = ["HttpLink"]

AGAIN: Final = 0.2
"""Seconds to connect anew, to a server that closes after each reply."""
SHOUT: Final = 0.1
"""Seconds for the connection of a shout."""


class HttpLink:
    """See `crtk_driver_schunk.gripper.link.Link`.

    HTTP does not tell to which request a reply belongs. So one that has come without a request ends the
    connection before the next is asked, and so does one that is of the request before. A second copy of a
    status that comes on the way of the next one looks like it: it is believed once, is one question old, and
    the reply that follows it ends the connection.

    Args:
        make_transport: makes a connection to the web server, which is not opened yet.
        timeout: seconds after which a question that is not answered ends the connection.
        clock: monotonic seconds.
    """

    def __init__(
        self,
        make_transport: Callable[[], TcpTransport],
        timeout: float,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._make_transport = make_transport
        self._transport = make_transport()
        self._timeout = timeout
        self._clock = clock
        self._asked: tuple[Question, Stamp] | None = None
        self._before: Question | None = None
        self._replies = Replies()
        self._refused = self._surplus = 0

    @property
    def where(self) -> str:
        """See `Link`."""
        return self._transport.where

    @property
    def counters(self) -> Mapping[str, float]:
        """See `Link`."""
        return {"refused": self._refused, "surplus": self._surplus}

    @property
    def trouble(self) -> tuple[str, str]:
        """See `Link`."""
        return (
            "its web server does not answer",
            "Is it powered (24 V), and can a browser see its page at this address?",
        )

    def open(self, deadline: float) -> None:
        """See `Link`."""
        self._asked, self._before, self._replies = None, None, Replies()
        self._transport.open(deadline)

    def close(self) -> None:
        """See `Link`."""
        self._transport.close()

    def exchange(self, question: Question, deadline: float) -> Reply | None:
        """See `Link`."""
        while True:
            if self._asked is None:
                self._ask(question)
            assert self._asked is not None
            asked, since = self._asked
            body = self._body(deadline)
            if body is None:
                if self._clock() - since.monotonic > self._timeout:
                    raise ConnectionLost(self.trouble[0], where=self.where, remedy=self.trouble[1])
                return None
            self._asked = None
            if self._is_of_before(asked, body):
                self._anew()
                continue
            self._before = asked
            data = self._understood(asked, body)
            if asked == question:
                return Reply(data, since)

    def shout(self, question: Question) -> None:
        """See `Link`: by a connection of its own, for which it waits for `SHOUT` seconds at the most."""
        aside = self._make_transport()
        try:
            aside.open(self._clock() + SHOUT)
            aside.write(self._request(question))
            aside.read(self._clock() + SHOUT)
        finally:
            aside.close()

    def _ask(self, question: Question) -> None:
        if self._replies.closes:
            self.open(self._clock() + AGAIN)
        elif self._replies.rest or self._transport.read(0.0):
            self._anew()
        self._asked = question, Stamp.now()
        self._transport.write(self._request(question))

    def _anew(self) -> None:
        """Connect anew: on this connection no reply can be told from another any more."""
        self._surplus += 1
        self._transport.close()
        self.open(self._clock() + AGAIN)

    def _is_of_before(self, asked: Question, body: bytes) -> bool:
        """Whether a reply is to the request before: one wrote and the other read."""
        before = self._before
        if before is None or bool(before.data) is bool(asked.data):
            return False
        is_of_write = body.lstrip().startswith(b"{")
        return is_of_write is bool(before.data)

    def _request(self, question: Question) -> bytes:
        if question.data:
            body = f"inst={question.instance:#06x}&value={question.data.hex().upper()}"
            head = "POST /adi/update.json"
            kind = f"Content-Type: application/x-www-form-urlencoded\r\nContent-Length: {len(body)}\r\n"
        else:
            head, body, kind = f"GET /adi/data.json?inst={question.instance:#06x}&count=1", "", ""
        host = f"{self._transport.host}:{self._transport.port}"
        return f"{head} HTTP/1.1\r\nHost: {host}\r\n{kind}\r\n{body}".encode()

    def _body(self, deadline: float) -> bytes | None:
        try:
            while True:
                try:
                    data = self._transport.read(deadline)
                except ClosedByPeer:
                    if (body := self._replies.feed(b"", ended=True)) is None:
                        raise
                    return body
                if not data:
                    return None
                if (body := self._replies.feed(data)) is not None:
                    return body
        except ValueError as error:
            raise self._strange(error) from error

    def _understood(self, question: Question, body: bytes) -> bytes:
        """Return the value that was asked for; nothing for a write."""
        try:
            told = json.loads(body)
            if question.data:
                self._refused += told["result"] != 0
                return b""
            (value,) = told
            return bytes.fromhex(value)
        except (ValueError, TypeError, KeyError, RecursionError) as error:
            raise self._strange(f"{body[:60]!r}") from error

    def _strange(self, what: object) -> DeviceError:
        return ProtocolError(
            f"it sent {what}",
            where=self.where,
            remedy="Is it the web server of a SCHUNK gripper (EtherNet/IP, PROFINET, EtherCAT)?",
        )

"""SDO transfers with the canopen library: expedited, segmented and block, from any thread.

In the thread that owns the bus a transfer receives by itself until the answer is there; in another one
it waits on a queue, which the owning thread fills as frames come in.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any, Final, Protocol

from crtk_driver_canopen.bus import CanLink
from crtk_driver_canopen.bus_state import Condition, bus_lost
from crtk_driver_canopen.frames import Frame
from crtk_driver_canopen.objects import object_text
from crtk_driver_canopen.sdo import aborted, silent
from crtk_drivers.errors import ConnectionLost, CrtkError, MissingExtra, ProtocolError

try:
    import canopen
    from canopen.objectdictionary import ObjectDictionary
    from canopen.sdo import SdoClient
except ImportError as error:  # pragma: no cover - the extra is installed where tests run
    raise MissingExtra("canopen", "canopen") from error

ATTEMPTS: Final = 2
"""Times that a transfer is tried when no answer comes. All that the driver writes may be written twice."""

UPLOAD: Final = 2
DOWNLOAD: Final = 3
ABORT: Final = 4
"""Command specifiers of a server's answers that name the object (CiA 301, 7.2.4.3)."""

UPLOAD_DEVICE_TYPE: Final = bytes((0x40, 0x00, 0x10, 0x00, 0, 0, 0, 0))
"""Request to read the object that every node has (CiA 301, 1000h)."""
_DEVICE_TYPE: Final = UPLOAD_DEVICE_TYPE[1:4]
"""Its index and sub-index, as requests and answers have them."""

LARGE: Final = 256
"""Bytes from which a transfer goes in blocks."""


class Poll(Protocol):
    """Receives until a time or until something is so, as `CanLink.poll` does."""

    def __call__(self, until: float, done: Callable[[], bool]) -> bool:
        """Return whether `done` was so."""
        ...


class _Network:
    """What the library's client sends with."""

    def __init__(self, link: CanLink) -> None:
        self._link = link
        self._lock = threading.Lock()
        self._is_closed = False

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        """Send a frame."""
        with self._lock:
            if self._is_closed:
                raise bus_lost(Condition.GONE, "it was closed meanwhile", self._link.where)
            self._link.post(can_id, bytes(data))

    def close(self) -> None:
        """Send no more frames: the bus may be open again before a transfer has ended that goes on."""
        with self._lock:
            self._is_closed = True


class _Client(SdoClient):  # type: ignore[misc]
    """The library's client, which receives by itself in the thread that owns the bus."""

    def __init__(self, link: CanLink, node: int, timeout: float, poll: Poll) -> None:
        super().__init__(0x600 + node, 0x580 + node, ObjectDictionary())
        self.network = _Network(link)
        self.RESPONSE_TIMEOUT = timeout
        self._link = link
        self._poll = poll
        self._asked = b""
        self._answer = 0

    def ask(self, index: int, subindex: int, answer: int) -> None:
        """Take no answers from now on but to this: what was asked before may be answered late.

        Args:
            answer: command specifier of the answer, `UPLOAD` or `DOWNLOAD`.
        """
        self._asked = index.to_bytes(2, "little") + bytes([subindex])
        self._answer = answer

    def on_response(self, can_id: int, data: bytes, timestamp: float) -> None:
        """Take an answer; one that names another object is a late one."""
        command = data[0] >> 5 if data else 0
        names_object = command in (UPLOAD, DOWNLOAD, ABORT)
        if names_object and (data[1:4] != self._asked or command not in (self._answer, ABORT)):
            return
        super().on_response(can_id, data, timestamp)

    def read_response(self) -> bytes:
        """Return the next answer."""
        if self._link.owned and not self._poll(
            time.monotonic() + self.RESPONSE_TIMEOUT, lambda: not self.responses.empty()
        ):
            raise canopen.SdoCommunicationError("No SDO response received")
        response: bytes = super().read_response()
        return response


class SdoChannel:
    """Transfers with one node: an `crtk_driver_canopen.sdo.SdoPort`. Thread-safe.

    Args:
        link: the bus; open whenever a transfer is made.
        node: its id.
        timeout: seconds for each answer.
        poll: receives, in the owning thread; that of the link if None.
    """

    def __init__(
        self, link: CanLink, node: int, timeout: float = 0.5, poll: Poll | None = None
    ) -> None:
        self.node = node
        self._link = link
        self._client = _Client(link, node, timeout, poll or link.poll)
        self._lock = threading.Lock()
        self._probe: Callable[[], None] | None = None
        link.subscribe(0x580 + node, self._take)

    @property
    def where(self) -> str:
        """The node and its bus, for errors."""
        return f"{self._link.where} node {self.node}"

    def close(self) -> None:
        """Take no more answers, and ask nothing more: what goes on in other threads ends by `BusLost`."""
        self._client.network.close()
        self._link.unsubscribe(0x580 + self.node)

    def probe(self, answered: Callable[[], None]) -> bool:
        """Ask for the device type, without waiting, in the bus thread; return whether it was sent.

        Args:
            answered: called in that thread when the answer comes; not if another one is asked for before.

        Raises:
            BusLost: the bus cannot be used.
        """
        if self._lock.locked():  # a transfer goes on, which this would break off
            return False
        self._probe = answered
        return self._link.send(Frame(0x600 + self.node, UPLOAD_DEVICE_TYPE))

    def upload(self, index: int, subindex: int) -> bytes:
        """Return the bytes of an object.

        Raises:
            SdoAborted, SdoSilent: it could not be read.
            ProtocolError: the answer is none to what was asked.
            BusLost: the bus cannot be used.
        """
        data = self._tried("read", index, subindex, lambda: self._client.upload(index, subindex))
        return bytes(data)

    def download(self, index: int, subindex: int, data: bytes) -> None:
        """Write the bytes of an object; large ones in blocks, if the node can.

        Raises:
            SdoAborted, SdoSilent, ProtocolError, BusLost: as `upload`.
        """
        if len(data) < LARGE:
            self._tried(
                "write", index, subindex, lambda: self._client.download(index, subindex, data)
            )
            return
        try:
            self._tried("write", index, subindex, lambda: self._blocks(index, subindex, data))
        except CrtkError as error:
            if isinstance(error, ConnectionLost):
                raise
            self._tried(
                "write", index, subindex, lambda: self._client.download(index, subindex, data)
            )

    def _blocks(self, index: int, subindex: int, data: bytes) -> None:
        with self._client.open(
            index, subindex, "wb", size=len(data), block_transfer=True, buffering=1024
        ) as stream:
            stream.write(data)

    def _tried(self, what: str, index: int, sub: int, transfer: Callable[[], Any]) -> Any:
        with self._lock:
            self._client.ask(index, sub, UPLOAD if what == "read" else DOWNLOAD)
            for attempt in range(1, ATTEMPTS + 1):
                try:
                    return transfer()
                except canopen.SdoAbortedError as error:
                    raise aborted(self.where, what, index, sub, error.code) from error
                except canopen.SdoCommunicationError as error:
                    if attempt < ATTEMPTS:
                        continue
                    if "No SDO response" in str(error):
                        raise silent(self.where, what, index, sub) from error
                    raise ProtocolError(
                        f"{what} of {object_text(index, sub)}: {error}",
                        where=self.where,
                        remedy="Another program may be talking to the same node: stop it.",
                    ) from error
        raise AssertionError("every attempt ends above")

    def _take(self, data: bytes, now: float) -> None:
        if self._probe is not None and data[1:4] == _DEVICE_TYPE:
            answered, self._probe = self._probe, None
            answered()
        self._client.on_response(0x580 + self.node, data, now)

"""The interface `crtk` of python-can: a bus at a hub of :mod:`crtk_sim_backends.can`.

``can.Bus(interface="crtk", channel="/path/to.sock")``, or ``channel="can0"`` for the hub that was
started with this name. The errors are those of python-can's `socketcan`, with the same `errno` as
`error_code`: ENOBUFS when the transmit queue is full or the controller is bus-off, ENETDOWN when
the interface is down.
"""

from __future__ import annotations

import errno
import os
import select
import socket
import threading
import time
from typing import Any, Final

import can

from crtk_sim_backends.can import frames, native
from crtk_sim_backends.can.native import Page
from crtk_sim_backends.can.port import DEAF, REFUSING, State

_HELLO_TIMEOUT: Final = 2.0  # s
_HUB_TIMEOUT: Final = 1.0  # s; longest wait for a hub that does not get the time to read
_SELECTABLE: Final = 1024  # select waits to the microsecond, poll rounds up to the millisecond
_NO_LIMIT: Final = 1 << 31  # frames, where none ever waits
_QUEUE_POLL: Final = 0.0005  # s; between two looks at a full queue


class HubBus(can.BusABC):  # type: ignore[misc]
    """A bus at a hub.

    Args:
        channel: path of the hub's socket, or its name.
        can_filters: as for every python-can bus.
        receive_own_messages: whether sent frames come back, marked ``is_rx=False``.
        name: how this participant is called in the hub's status and in its faults.

    Raises:
        can.CanInitializationError: when there is no hub, or it does not answer within 2 s.
    """

    def __init__(
        self,
        channel: str,
        can_filters: Any = None,
        *,
        receive_own_messages: bool = False,
        name: str = "",
        **options: Any,
    ) -> None:
        path = native.socket_path(str(channel))
        self.channel_info = f"crtk hub at {path}"
        self.channel = channel
        self._sent = 0  # frames
        self._poll = select.poll()
        self._page: Page | None = None
        self._lock = threading.Lock()
        self._frames: list[bytes] = []  # of a packet that has been looked at, the last one first
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        flags = native.BATCHES | (native.ECHO if receive_own_messages else 0)
        try:
            self._connect(path, native.hello(name, flags))
            super().__init__(channel=channel, can_filters=can_filters, **options)
        except OSError as error:
            self._release()
            raise can.CanInitializationError(
                f"no CAN hub at {path}: {error.strerror or error}; start one with "
                "`crtk-driver sim can`, which prints how to connect",
                error.errno,
            ) from error
        except BaseException:
            self._release()
            raise

    def _connect(self, path: str, hello: bytes) -> None:
        """Connect and get the page; frames that come before it are not for this bus."""
        deadline = time.monotonic() + _HELLO_TIMEOUT
        self._socket.settimeout(_HELLO_TIMEOUT)
        self._socket.connect(path)
        self._socket.send(hello)
        while self._page is None:
            left = deadline - time.monotonic()
            if left <= 0.0:
                raise TimeoutError(errno.ETIMEDOUT, "it does not answer")
            self._socket.settimeout(left)
            packet, fds, _, _ = socket.recv_fds(self._socket, native.MAX_PACKET, 4)
            if fds:
                self._page = Page(fds[0], write=False)
                for fd in fds:
                    os.close(fd)
            elif not packet:
                raise ConnectionResetError(errno.ECONNRESET, "the hub closed the connection")
        self._socket.setblocking(False)
        self._poll.register(self._socket, select.POLLIN)
        self._selectable = self._socket.fileno() < _SELECTABLE

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Wait at most `timeout` seconds (None: for ever) for a frame that passes the filters.

        Raises:
            can.CanOperationError: when the interface goes down (ENETDOWN, once), the hub has ended
                (ECONNRESET), or the bus is shut down (EBADF).
        """
        deadline = None if timeout is None else time.monotonic() + timeout
        while True:
            raw = self._next()
            if raw is None:
                if not self._wait(deadline):
                    return None
            elif len(raw) == frames.SIZE:
                message = self._message(raw)
                if self._matches_filters(message):
                    return message
            else:
                self._check_state(raw)

    def recv_frames(self) -> bytes:
        """Return the frames that are there, `struct can_frame` after `struct can_frame`; empty without.

        Does not wait (see `fileno`), and knows no filters. Not for a bus from which `recv` is called too.

        Raises:
            can.CanOperationError: as `recv`.
        """
        while (packet := self._receive()) is not None:
            if len(packet) % frames.SIZE == 0:
                return packet
            self._check_state(packet)
        return b""

    def _check_state(self, packet: bytes) -> None:
        if State(*native.STATE_PACKET.unpack(packet)) & State.DOWN:
            raise can.CanOperationError(
                f"{self.channel_info}: the interface went down", errno.ENETDOWN
            )

    def _next(self) -> bytes | None:
        """Return the next frame or state, None when there is none.

        A packet with several frames stays in the socket until the last of them is taken: `fileno` is
        readable for as long.
        """
        with self._lock:
            if not self._frames:
                packet = self._receive(socket.MSG_PEEK)
                if packet is None:
                    return None
                if len(packet) <= frames.SIZE:
                    return self._receive()
                last = len(packet) - frames.SIZE
                self._frames = [
                    packet[at : at + frames.SIZE] for at in range(last, -1, -frames.SIZE)
                ]
            raw = self._frames.pop()
            if not self._frames:
                self._receive()
            return raw

    def _receive(self, flags: int = 0) -> bytes | None:
        """Return the next packet, None when there is none."""
        try:
            packet = self._socket.recv(native.MAX_PACKET, flags)
        except BlockingIOError:
            return None
        except OSError as error:
            raise can.CanOperationError(
                f"cannot receive from the {self.channel_info}: {error.strerror}", error.errno
            ) from error
        if not packet:
            raise can.CanOperationError(
                f"the {self.channel_info} has ended; start it again and open a new bus",
                errno.ECONNRESET,
            )
        return packet

    def _wait(self, deadline: float | None) -> bool:
        """Wait until something can be read; False when the deadline has passed."""
        if deadline is None:
            self._poll.poll()
            return True
        left = deadline - time.monotonic()
        if left <= 0.0:
            return False
        if self._selectable:
            select.select([self._socket], [], [], left)
        else:
            self._poll.poll(left * 1000.0)
        return True

    def _message(self, raw: bytes) -> can.Message:
        can_id, data = frames.unpack(raw)
        remote = bool(can_id & frames.REMOTE)
        return can.Message(
            timestamp=time.time(),
            arbitration_id=can_id & frames.EXTENDED_MASK,
            is_extended_id=bool(can_id & frames.EXTENDED),
            is_remote_frame=remote,
            is_error_frame=bool(can_id & frames.ERROR),
            dlc=len(data),
            data=None if remote else data,
            channel=self.channel,
            is_rx=raw[frames.OWN_AT] == 0,
        )

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Put a frame into the transmit queue.

        Args:
            msg: a classic frame.
            timeout: how many seconds to wait while the queue is full; None or 0: not at all.

        Raises:
            can.CanOperationError: with ENOBUFS, ENETDOWN or ECONNRESET as `error_code`, or for a
                frame that a classic CAN interface does not send.
        """
        if msg.is_fd or msg.is_error_frame:
            kind = "CAN FD" if msg.is_fd else "error"
            raise can.CanOperationError(
                f"the {self.channel_info} cannot send {kind} frames", errno.EINVAL
            )
        can_id = msg.arbitration_id
        if msg.is_extended_id:
            can_id |= frames.EXTENDED
        if msg.is_remote_frame:
            can_id |= frames.REMOTE
        self._send(frames.LAYOUT.pack(can_id, msg.dlc, msg.data), timeout)

    def _send(self, raw: bytes, timeout: float | None) -> None:
        page = self._open_page()
        began = time.monotonic()
        while not self._room(page):
            if time.monotonic() >= began + (timeout or 0.0):
                raise self._refusal(page)
            time.sleep(_QUEUE_POLL)
        self._put(raw, began + max(timeout or 0.0, _HUB_TIMEOUT))

    def send_frames(self, raw: bytes) -> int:
        """Put frames, `struct can_frame` after `struct can_frame`, into the transmit queue.

        Returns:
            How many of them, from the first on, there was room for.

        Raises:
            can.CanOperationError: with ENETDOWN or ECONNRESET as `error_code`.
        """
        page = self._open_page()
        room = self._room(page)
        if not room and page.numbers[Page.STATE] & State.DOWN:
            raise self._refusal(page)
        raw = raw[: room * frames.SIZE]
        deadline = time.monotonic() + _HUB_TIMEOUT
        for at in range(0, len(raw), native.MAX_PACKET):
            try:
                self._put(raw[at : at + native.MAX_PACKET], deadline)
            except can.CanOperationError as error:
                if error.error_code != errno.ENOBUFS:
                    raise
                return at // frames.SIZE
        return len(raw) // frames.SIZE

    def _open_page(self) -> Page:
        if self._page is None:
            raise can.CanOperationError(f"the {self.channel_info} is shut down", errno.EBADF)
        return self._page

    def _room(self, page: Page) -> int:
        """How many frames the transmit queue takes now."""
        state, limit, gone = page.numbers[: Page.GONE + 1].tolist()
        if state and state & REFUSING:
            return 0
        if not limit:
            return _NO_LIMIT
        return max(0, limit - ((self._sent - gone) & 0xFFFFFFFF))

    def _refusal(self, page: Page) -> can.CanOperationError:
        """Why no frame can be sent now."""
        state = State(page.numbers[Page.STATE])
        if state & State.DOWN:
            why, number = "the interface is down", errno.ENETDOWN
        elif state & State.BUS_OFF:
            why, number = "no buffer space available, the controller is bus-off", errno.ENOBUFS
        elif state & State.FULL:
            why, number = "no buffer space available", errno.ENOBUFS
        else:
            why, number = "the transmit queue is full", errno.ENOBUFS
        return can.CanOperationError(f"{self.channel_info}: {why}", number)

    def _put(self, raw: bytes, deadline: float) -> None:
        """Hand frames to the kernel, waiting until `deadline` for room in the socket."""
        count = len(raw) // frames.SIZE
        self._sent += count  # before the hub can count them, for what other threads make of both
        try:
            self._hand_over(raw, deadline)
        except can.CanOperationError:
            self._sent -= count
            raise

    def _hand_over(self, raw: bytes, deadline: float) -> None:
        while True:
            try:
                self._socket.send(raw)
                return
            except BlockingIOError:
                left = deadline - time.monotonic()
                if left <= 0.0:
                    raise can.CanOperationError(
                        f"{self.channel_info}: no buffer space available, the hub does not read",
                        errno.ENOBUFS,
                    ) from None
                writable = select.poll()
                writable.register(self._socket, select.POLLOUT)
                writable.poll(left * 1000.0)
            except OSError as error:
                raise can.CanOperationError(
                    f"cannot send to the {self.channel_info}: {error.strerror}", error.errno
                ) from error

    @property
    def state(self) -> can.BusState:
        """ERROR when bus-off or down, PASSIVE when error passive, else ACTIVE."""
        if self._page is None:
            return can.BusState.ERROR
        state = State(self._page.numbers[Page.STATE])
        if state & DEAF:
            return can.BusState.ERROR
        return can.BusState.PASSIVE if state & State.PASSIVE else can.BusState.ACTIVE

    def fileno(self) -> int:
        """File descriptor that is readable when a frame, or a change of state, can be received."""
        return self._socket.fileno()

    def shutdown(self) -> None:
        """Stop the periodic tasks and disconnect; safe to repeat."""
        super().shutdown()
        self._release()

    def _release(self) -> None:
        self._socket.close()
        self._frames = []
        if self._page is not None:
            self._page.close()
            self._page = None

    @staticmethod
    def _detect_available_configs() -> list[dict[str, Any]]:
        """Hubs of this user that were started with a name."""
        return [
            {"interface": "crtk", "channel": path.stem}
            for path in sorted(native.runtime_folder().glob("*.sock"))
        ]

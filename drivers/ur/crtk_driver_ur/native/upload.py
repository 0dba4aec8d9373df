"""Connecting to the controller's registers and uploading a program, in a thread of its own."""

from __future__ import annotations

import socket
from typing import Any, Final

from typing_extensions import override

from crtk_driver_ur.control_requests import Request
from crtk_driver_ur.native.registers import ControlChannel
from crtk_driver_ur.request_worker import Controller, RequestWorker
from crtk_drivers.errors import ConnectionFailed

__all__ = ["PROGRAM_REQUESTS", "ProgramWorker"]

PROGRAM_REQUESTS: Final = ("connect", "upload")

PRIMARY_PORT: Final = 30001
"""The one that takes programs and tells what is wrong with them (UR Client Interface)."""
TIMEOUT: Final = 2.0


class ProgramWorker(RequestWorker):
    """``connect(first)`` returns a `ControlChannel`, ``upload(text)`` the socket that tells of the program.

    What it returned is closed when it is asked for again, and when the worker ends.
    """

    def __init__(self, controller: Controller) -> None:
        super().__init__(controller)
        self._channel: ControlChannel | None = None
        self._primary: socket.socket | None = None

    @override
    def carry_out(self, request: Request) -> Any:
        if request.name == "connect":
            if self._channel is not None:
                self._channel.close()
            self._channel = ControlChannel(self.host, request.arguments["first"])
            return self._channel
        if self._primary is not None:
            self._primary.close()
        self._primary = self._upload(request.arguments["text"])
        return self._primary

    @override
    def release(self) -> None:
        if self._channel is not None:
            self._channel.close()
        if self._primary is not None:
            self._primary.close()

    def _upload(self, text: str) -> socket.socket:
        try:
            peer = socket.create_connection((self.host, PRIMARY_PORT), TIMEOUT)
            try:
                # The controller speaks first, when it has taken the connection.
                peer.recv(1, socket.MSG_PEEK)
                peer.sendall(text.encode())
                peer.setblocking(False)
            except BaseException:
                peer.close()
                raise
        except OSError as error:
            raise ConnectionFailed(
                f"the control program cannot be sent: {error}",
                where=f"primary interface {self.host}:{PRIMARY_PORT}",
                remedy="Check the network, and that the robot is in remote control; PolyScope 5 can "
                "switch the interface off under Settings, Security, Services.",
            ) from error
        return peer

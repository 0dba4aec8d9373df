"""Setting the controller's I/O over RTDE: a connection that only sends.

A variable is claimed when it is first set, and is the connection's until that is closed: another client
that wants it is told IN_USE, and so is this one where another was first. What is set stays set.

Source: RTDE Guide, "Robot controller inputs".
"""

from __future__ import annotations

import socket
import time
from collections.abc import Mapping
from typing import Final, TypeVar

from crtk_driver_ur.rtde import codec
from crtk_driver_ur.rtde.codec import (
    Recipe,
    RtdeDecoder,
    RtdeFramingError,
    SetupReply,
    VersionReply,
)
from crtk_driver_ur.rtde.stream import RTDE_PORT
from crtk_driver_ur.rtde.variables import IN_USE, NOT_FOUND, TYPES
from crtk_drivers.errors import ConnectionFailed, ConnectionLost

__all__ = ["RtdeInputs"]

TIMEOUT: Final = 2.0
"""Seconds for each answer of the controller."""

_ReplyT = TypeVar("_ReplyT", VersionReply, SetupReply)


class RtdeInputs:
    """Blocking, for a thread of its own. Connects when it is first used, and anew when it was cut off.

    Args:
        host: address or name of the controller.
        port: of the real-time data exchange.
    """

    def __init__(self, host: str, port: int = RTDE_PORT) -> None:
        self._address = (host, port)
        self._where = f"RTDE {host}:{port}"
        self._socket: socket.socket | None = None
        self._decoder = RtdeDecoder()
        self._recipes: dict[tuple[str, ...], Recipe] = {}

    def close(self) -> None:
        """Close the connection, and leave the variables to others."""
        peer, self._socket = self._socket, None
        self._recipes.clear()
        if peer is not None:
            peer.close()

    def write(self, values: Mapping[str, float]) -> None:
        """Set input variables, all in the same control cycle.

        Raises:
            ConnectionFailed: unreachable, or a variable is in use by another client or unknown.
            ConnectionLost: it went away meanwhile; the values may have been set or not.
            ValueError: a value that does not fit its type.
        """
        try:
            if self._cut_off():
                self.close()
            if self._socket is None:
                self._connect()
            recipe = self._recipe(tuple(values))
            self._peer.sendall(codec.encode_data(recipe, list(values.values())))
        except ConnectionFailed:  # which is an OSError too
            raise
        except (OSError, RtdeFramingError) as error:
            self.close()
            raise ConnectionLost(
                f"the values could not be sent: {error}",
                where=self._where,
                remedy="Check the network and the controller, and send them again.",
            ) from error

    @property
    def _peer(self) -> socket.socket:
        assert self._socket is not None
        return self._socket

    def _cut_off(self) -> bool:
        """Take what has arrived, which are texts if anything; whether it is the end."""
        if self._socket is None:
            return False
        self._socket.setblocking(False)
        try:
            while data := self._socket.recv(4096):
                self._decoder.feed(data)
        except BlockingIOError:
            self._socket.settimeout(TIMEOUT)
            return False
        except OSError:
            pass
        return True

    def _connect(self) -> None:
        try:
            self._socket = socket.create_connection(self._address, TIMEOUT)
        except OSError as error:
            raise ConnectionFailed(
                f"cannot connect: {error}",
                where=self._where,
                remedy="Check the address, and that the controller has finished starting.",
            ) from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._decoder = RtdeDecoder()
        if not self._ask(codec.encode_protocol_version(2), VersionReply).accepted:
            self.close()
            raise ConnectionFailed(
                "the controller refuses version 2 of the protocol",
                where=self._where,
                remedy="Update the controller's software (CB3: 3.5 or later, e-Series: any).",
            )
        self._decoder.protocol_version = 2

    def _recipe(self, names: tuple[str, ...]) -> Recipe:
        if names not in self._recipes:
            reply = self._ask(codec.encode_input_setup(names), SetupReply)
            found = dict(zip(names, reply.types, strict=False))
            refused = [f"{name} ({kind})" for name, kind in found.items() if kind not in TYPES]
            if refused or not reply.recipe_id or len(reply.types) != len(names):
                in_use, unknown = IN_USE in found.values(), NOT_FOUND in found.values()
                remedy = "Report it with the version of the controller's software."
                if in_use:
                    remedy = "Close the other client (a fieldbus, a second driver) that sets it."
                elif unknown:
                    remedy = "Update the controller's software."
                raise ConnectionFailed(
                    f"the controller refuses {', '.join(refused) or ', '.join(names)}",
                    where=self._where,
                    remedy=remedy,
                )
            self._recipes[names] = Recipe(reply.recipe_id, names, reply.types)
        return self._recipes[names]

    def _ask(self, request: bytes, kind: type[_ReplyT]) -> _ReplyT:
        deadline = time.monotonic() + TIMEOUT
        self._peer.sendall(request)
        while time.monotonic() < deadline:
            data = self._peer.recv(4096)
            if not data:
                raise ConnectionResetError("the controller closed the connection")
            for message in self._decoder.feed(data):
                if isinstance(message, kind):
                    return message
        raise TimeoutError("the controller does not answer")

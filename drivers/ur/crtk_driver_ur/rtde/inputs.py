"""Writing the controller's input variables over RTDE: a connection that only sends.

A variable is claimed when it is first set, and is the connection's until that is closed: another client
that wants it is told IN_USE, and so is this one where another was first. What is set stays set.

Source: RTDE Guide, "Robot controller inputs".
"""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
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
    """Connects when it is first used, and anew when it was cut off.

    `write` and `claim` block, for a thread of its own; `post` and `check` never do, and may be called from
    another thread than these once the recipes are claimed.

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
        with self._blocking():
            recipe = self._recipe(tuple(values))
            self._peer.sendall(codec.encode_data(recipe, list(values.values())))

    def claim(self, names: Sequence[str]) -> Recipe:
        """Claim input variables, to be written together by `post`.

        Raises:
            ConnectionFailed, ConnectionLost: as `write`.
        """
        with self._blocking():
            return self._recipe(tuple(names))

    def post(self, recipe: Recipe, values: Sequence[float]) -> None:
        """Set the variables of a recipe, all in the same control cycle, without waiting.

        Raises:
            ConnectionLost: there is no connection, or the controller does not read.
            ValueError: a value that does not fit its type.
        """
        data = codec.encode_data(recipe, values)
        try:
            if self._peer.send(data, socket.MSG_DONTWAIT) != len(data):
                raise BlockingIOError("the controller does not read")
        except OSError as error:
            raise self._lost(error) from error

    def check(self) -> None:
        """Take what the controller has sent, which are texts if anything.

        Raises:
            ConnectionLost: that was the end.
        """
        try:
            while data := self._peer.recv(4096, socket.MSG_DONTWAIT):
                self._decoder.feed(data)
        except BlockingIOError:
            return
        except (OSError, RtdeFramingError) as error:
            raise self._lost(error) from error
        raise self._lost(ConnectionResetError("the controller closed the connection"))

    @contextmanager
    def _blocking(self) -> Iterator[None]:
        """Be connected, and let the connection wait within."""
        try:
            if self._socket is not None:
                with suppress(ConnectionLost):
                    self.check()
            if self._socket is None:
                self._connect()
            self._peer.settimeout(TIMEOUT)
            yield
            self._peer.setblocking(False)
        except ConnectionFailed:  # which is an OSError too
            raise
        except (OSError, RtdeFramingError) as error:
            raise self._lost(error) from error

    def _lost(self, error: Exception) -> ConnectionLost:
        self.close()
        return ConnectionLost(
            f"the values could not be sent: {error}",
            where=self._where,
            remedy="Check the network and the controller, and send them again.",
        )

    @property
    def _peer(self) -> socket.socket:
        if self._socket is None:
            raise ConnectionResetError("not connected")
        return self._socket

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

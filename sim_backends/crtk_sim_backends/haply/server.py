"""The simulated service behind its port: a WebSocket (RFC 6455), of which `websockets` makes the frames."""

from __future__ import annotations

from typing import Final

from websockets.frames import Frame, Opcode
from websockets.http11 import Request
from websockets.protocol import State
from websockets.server import ServerProtocol

from crtk_sim_backends.haply.config import SimConfig
from crtk_sim_backends.haply.handle import STEP
from crtk_sim_backends.haply.service import Service
from crtk_sim_backends.kit import LoopServer, TcpDoor

LARGEST: Final = 1 << 16
"""Bytes of a message."""


class Connection:
    """One client.

    Args:
        service: that answers.
    """

    def __init__(self, service: Service) -> None:
        self.ended = False
        self._service = service
        self._protocol = ServerProtocol(max_size=LARGEST)
        self._text = bytearray()

    def receive(self, data: bytes) -> bytes:
        """Take received bytes and return what is to be sent."""
        protocol = self._protocol
        protocol.receive_data(data)
        for event in protocol.events_received():
            if isinstance(event, Request):
                protocol.send_response(protocol.accept(event))
                if protocol.state is State.OPEN:
                    self._send(self._service.inventory())
            elif isinstance(event, Frame) and event.opcode in (Opcode.TEXT, Opcode.CONT):
                self._text += event.data
                if event.fin:
                    text = bytes(self._text)
                    self._text.clear()
                    self._send(self._service.obey(text))
        answer = protocol.data_to_send()
        self.ended = protocol.state in (State.CLOSING, State.CLOSED) or b"" in answer
        return b"".join(answer)

    def _send(self, pieces: list[bytes]) -> None:
        """Send a text in one frame, or in several."""
        if self._protocol.state is not State.OPEN or not pieces:
            return
        first, *rest = pieces
        self._protocol.send_text(first, fin=not rest)
        for number, piece in enumerate(rest, 1):
            self._protocol.send_continuation(piece, fin=number == len(rest))

    def close(self) -> None:
        """Forget an unfinished text."""
        self._text.clear()


def serve(config: SimConfig, parent_fd: int | None) -> LoopServer:
    """Bind the port of a simulated service."""
    service = Service(config)
    server = LoopServer(
        config,
        parent_fd,
        service,
        title="Haply Inverse3",
        tcp={"service": TcpDoor(config.port, lambda: Connection(service))},
        gauges=service.gauges,
        requests={"put": service.put},
    )
    server.every(STEP, service.step)
    return server

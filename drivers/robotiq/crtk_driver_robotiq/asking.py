"""Asking who is there, at a place as a person writes it: a port, ``socket://HOST:PORT``, ``modbus://HOST``.

What is found is asked, and told nothing: what holds something goes on to hold it, what streams goes on to
stream.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any, Final
from urllib.parse import urlsplit

from crtk_drivers.errors import ProtocolError
from crtk_drivers.kit import TcpTransport, Transport
from crtk_drivers.kit.modbus_frames import Framing, Mbap, Question, Rtu

__all__ = [
    "OPENING",
    "PATIENCE",
    "TCP",
    "USUAL",
    "ask",
    "framing_at",
    "settings_at",
    "takes",
    "way_to",
]

USUAL: Final = 9
"""Address as delivered."""
PATIENCE: Final = 0.03
"""Seconds in which an answer begins; for the usual address thrice."""
OPENING: Final = 3.0
"""Seconds in which a connection is made."""
MOST_STRANGE: Final = 8192
"""Bytes that are no answer: more than any such line carries while one is waited for."""
TCP: Final = "modbus://"


def takes(place: str) -> bool:
    """Whether it is such a place."""
    return place.startswith(("/", "socket://", TCP))


def way_to(place: str, baud: int) -> Transport:
    """Return the way there, not open."""
    if place.startswith(TCP):
        host, port = _address(place)
        return TcpTransport(host, port, "modbus", "Check the address.")
    from crtk_drivers.kit.serial_port import SerialPort  # needs pyserial

    return SerialPort(place, baud)


def _address(place: str) -> tuple[str, int]:
    parts = urlsplit(place)
    return parts.hostname or "", parts.port or 502


def framing_at(place: str, unit: int) -> Framing:
    """Return the framing of questions to an address there."""
    return Mbap(unit) if place.startswith(TCP) else Rtu(unit)


def settings_at(place: str, baud: int, usual_baud: int, unit: int) -> Mapping[str, Any]:
    """Return the settings of a configuration for what is there, without what is as usual."""
    settings: dict[str, Any] = {"port": place}
    if place.startswith(TCP):
        host, port = _address(place)
        settings = {"link": "modbus", "host": host, "tcp_port": port}
    elif baud != usual_baud:
        settings["baud"] = baud
    return settings if unit == USUAL else {**settings, "address": unit}


def ask(way: Transport, framing: Framing, question: Question, patience: float) -> bytes | None:
    """Return the data of an answer; None: there is none, or it is an exception.

    Raises:
        ProtocolError: what comes there is no Modbus: nobody else there need be asked.
    """
    deadline, strange = time.monotonic() + patience, 0
    while time.monotonic() < deadline and (data := way.read(0.0)):
        strange += len(data)
        if strange > MOST_STRANGE:
            raise _no_modbus(way)
    way.write(framing.ask(question))
    deadline = time.monotonic() + patience
    while data := way.read(deadline):
        try:
            reply = framing.feed(data)
        except ValueError as error:
            raise _no_modbus(way) from error
        if framing.strange > MOST_STRANGE:
            raise _no_modbus(way)
        if reply is not None:
            return None if reply[0] & 0x80 else reply[2:]
        if time.monotonic() >= deadline:
            break
    return None


def _no_modbus(way: Transport) -> ProtocolError:
    return ProtocolError(
        "what comes there is no Modbus",
        where=way.where,
        remedy="Is it another device's port, or does something else stream there?",
    )

"""How a gripper is reached, and what it says of itself."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Final

from crtk_driver_schunk.gripper.config import SchunkConfig
from crtk_driver_schunk.gripper.http_link import HttpLink
from crtk_driver_schunk.gripper.link import Link, Question
from crtk_driver_schunk.gripper.parameters import ASKED, Described, describe
from crtk_driver_schunk.gripper.rtu_link import Registers, RtuLink
from crtk_drivers.errors import ConnectionFailed, ProtocolError
from crtk_drivers.kit import TcpTransport
from crtk_drivers.kit.modbus_link import ModbusLink
from crtk_drivers.plugins import modbus_ways

__all__ = ["ask", "asked_of", "make_link", "told_by"]

PIECE: Final = 0.05
"""Seconds after which what waits is looked at again."""
HTTP_TIMEOUT: Final = 1.0
"""Seconds that a web server has for an answer at least."""
_SLACK: Final = 1e-4
"""Of what fits, in m, m/s and N: parameters are single precision."""


def _never() -> bool:
    return False


def make_link(config: SchunkConfig, aborted: Callable[[], bool] = _never) -> Link:
    """Return the way to a gripper; nothing is opened.

    Args:
        config: where it is.
        aborted: whether to give up what waits.
    """
    if config.link == "http":

        def server() -> TcpTransport:
            remedy = "Check the address, the network, and that the gripper is on."
            where = config.host, config.number, "schunk http", remedy
            return TcpTransport(*where, aborted=aborted)

        return HttpLink(server, max(HTTP_TIMEOUT, config.reply_timeout))
    way, framing = (
        modbus_ways.transport_of(config, "schunk", aborted),
        modbus_ways.framing_of(config),
    )
    return RtuLink(ModbusLink(Registers(), way, framing, config.reply_timeout))


def ask(link: Link, question: Question, deadline: float) -> bytes:
    """Return the answer to a question.

    Raises:
        ConnectionFailed: not by the monotonic `deadline`.
        ConnectionLost, ProtocolError: as `Link.exchange`.
    """
    while (now := time.monotonic()) < deadline:
        until = min(deadline, now + PIECE)
        reply = link.exchange(question, until)
        if reply is not None:
            return reply.data
        time.sleep(max(0.0, until - time.monotonic()))  # it is busy, or not there yet
    text, remedy = link.trouble
    raise ConnectionFailed(text, where=link.where, remedy=remedy)


def told_by(link: Link, deadline: float) -> Mapping[str, bytes]:
    """Return the values of `ASKED`; those of one size are alike, so if one was missed they must come twice.

    Raises:
        ConnectionFailed, ConnectionLost, ProtocolError: as `ask`.
    """
    before: Mapping[str, bytes] = {}
    while True:
        missed = link.counters.get("missed", 0)
        told = {name: ask(link, Question(*asked), deadline) for name, asked in ASKED.items()}
        if told == before or link.counters.get("missed", 0) == missed:
            return told
        before = told


def asked_of(link: Link, config: SchunkConfig, deadline: float) -> Described:
    """Return what a gripper says of itself.

    Raises:
        ConnectionFailed: no answer in time, or it cannot do what is configured.
        ConnectionLost, ProtocolError: as `Link.exchange`.
    """
    try:
        found = describe(told_by(link, deadline))
    except ValueError as error:
        raise ProtocolError(
            f"it tells {error}", where=link.where, remedy="Is it a SCHUNK EGU, EGK or EZU?"
        ) from error
    for key, value, fits in (
        ("lower", found.lower, config.lower >= found.lower - _SLACK),
        ("upper", found.upper, config.upper <= found.upper + _SLACK),
        ("speed", found.speed, config.speed <= found.speed + _SLACK),
        ("max_force", found.max_force, config.max_force <= found.max_force + _SLACK),
    ):
        if not fits:
            raise ConnectionFailed(
                f"{found.model} cannot do what is configured: its {key} is {value:.6g}, not "
                f"{getattr(config, key):g}",
                where=link.where,
                remedy=f"Set {key}: {value:.6g}; `crtk-driver schunk info` tells all of it.",
            )
    return found

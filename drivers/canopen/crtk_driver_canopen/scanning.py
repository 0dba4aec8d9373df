"""Who is on a bus: every node with its identity, and every axis with its modes and state. Changes nothing."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

from crtk_driver_canopen.bus import CanLink, Handler
from crtk_driver_canopen.drive_profile import DriveProfile, of_identity
from crtk_driver_canopen.emcy import error_text
from crtk_driver_canopen.identity import SERVO_PROFILE, Identity, read_identity
from crtk_driver_canopen.master import NODES, Master
from crtk_driver_canopen.modes import OpMode, supported
from crtk_driver_canopen.objects import OBJECTS
from crtk_driver_canopen.sdo import Sdo, SdoAborted, SdoSilent
from crtk_driver_canopen.transfers import UPLOAD_DEVICE_TYPE

AXES: Final = 8

_ASKING: Final = 0.0005
"""Seconds between two nodes that are asked, so that the answers find room."""


@dataclass(frozen=True)
class Axis:
    """One axis of a drive.

    Attributes:
        statusword: (6041).
        mode: shown (6061); None: it does not tell.
        modes: that it has (6502, and by its profile).
        error: last error code (603F); 0 if there was none.
        error_text: what that means.
    """

    number: int
    statusword: int
    mode: int | None
    modes: frozenset[OpMode]
    error: int
    error_text: str = ""


@dataclass(frozen=True)
class Found:
    """One node.

    Attributes:
        nmt: state that its heartbeat tells; None without one.
        trouble: what it refused to tell, in words.
    """

    node: int
    identity: Identity
    nmt: int | None
    axes: tuple[Axis, ...]
    trouble: str = ""


def answering(link: CanLink, wait: float, nodes: Iterable[int] = NODES) -> list[int]:
    """Return the nodes that answer an SDO, whatever they answer.

    Args:
        link: open, and owned by this thread. Subscriptions of SDO answers are lost.
        wait: seconds for the last answer.

    Raises:
        BusLost: the bus cannot be used.
    """
    found: set[int] = set()
    nodes = list(nodes)

    def taker(node: int) -> Handler:
        return lambda data, now: found.add(node)

    for node in nodes:
        link.subscribe(0x580 + node, taker(node))
    try:
        for node in nodes:
            link.post(0x600 + node, UPLOAD_DEVICE_TYPE)
            link.poll(time.monotonic() + _ASKING)
        link.poll(time.monotonic() + wait, lambda: len(found) == len(nodes))
    finally:
        for node in nodes:
            link.unsubscribe(0x580 + node)
    return sorted(found)


def survey(master: Master, nodes: Iterable[int]) -> list[Found]:
    """Return what each node tells of itself; what one does not tell does not keep the others from it.

    Raises:
        BusLost: the bus cannot be used.
    """
    return [_survey(master, node) for node in nodes]


def _survey(master: Master, node: int) -> Found:
    identity, axes, trouble = Identity(), [], ""
    try:
        identity = read_identity(Sdo(master.sdo(node)))
        if identity.profile == SERVO_PROFILE:
            axes = _axes(master, node, of_identity(identity))
    except (SdoAborted, SdoSilent) as error:
        trouble = error.message
    life = master.watch.nodes.get(node)
    return Found(node, identity, None if life is None else life.state, tuple(axes), trouble)


def _axes(master: Master, node: int, profile: DriveProfile) -> list[Axis]:
    axes = []
    for number in range(AXES):
        sdo = Sdo(master.sdo(node), number)
        statusword = sdo.find(OBJECTS["statusword"])
        if statusword is None:
            break
        code = sdo.find(OBJECTS["error_code"]) or 0
        row = profile.error(code)
        axes.append(
            Axis(
                number,
                statusword,
                sdo.find(OBJECTS["mode_of_operation_display"]),
                supported(sdo.find(OBJECTS["supported_drive_modes"]) or 0) | profile.more_modes,
                code,
                row.text if row else error_text(code) if code else "",
            )
        )
    return axes

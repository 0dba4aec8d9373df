"""Heartbeats both ways (CiA 301, 7.2.8): written into the nodes and read back, and watched on the bus.

A drive that does not see our heartbeats any more must stop by itself: that is the consumer heartbeat
(1016), the error behaviour (1029) and the abort connection option (6007) in it. A drive that ignores
one of them is refused, for nothing would stop it when this process dies.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from types import MappingProxyType
from typing import Final

from crtk_driver_canopen.objects import OBJECTS, Entry
from crtk_driver_canopen.sdo import ObjectIgnored, Sdo, SdoAborted
from crtk_driver_canopen.statemachine import option_text
from crtk_drivers.errors import DeviceError


class NmtState(IntEnum):
    """States of a node, as its heartbeat tells them."""

    BOOT_UP = 0x00
    STOPPED = 0x04
    OPERATIONAL = 0x05
    PRE_OPERATIONAL = 0x7F


class NmtCommand(IntEnum):
    """Commands of the NMT master (CiA 301, 7.2.8.3.1.1)."""

    START = 0x01
    STOP = 0x02
    PRE_OPERATIONAL = 0x80
    RESET_NODE = 0x81
    RESET_COMMUNICATION = 0x82


NMT_COMMANDS: Final[Mapping[NmtCommand, NmtState | None]] = MappingProxyType(
    {
        NmtCommand.START: NmtState.OPERATIONAL,
        NmtCommand.STOP: NmtState.STOPPED,
        NmtCommand.PRE_OPERATIONAL: NmtState.PRE_OPERATIONAL,
        NmtCommand.RESET_NODE: None,
        NmtCommand.RESET_COMMUNICATION: None,
    }
)
"""The state that a node is in after each command; None: it boots."""

_TOGGLE: Final = 0x80


def nmt_text(state: int | None) -> str:
    """Return a state of a node in words."""
    if state is None:
        return "unknown"
    try:
        return NmtState(state).name.lower().replace("_", "-")
    except ValueError:
        return f"unknown state 0x{state:02x}"


_REMEDY: Final = (
    "Without it nothing stops the drive when this computer fails. Check its manual and firmware; if the "
    "machine is safe without, switch the check off in the configuration."
)


def ensure_heartbeat(sdo: Sdo, *, produced_ms: int, watched: int, watched_ms: int) -> bool:
    """Make a node produce a heartbeat, and watch that of another node, usually ours.

    Args:
        produced_ms: time between two of its heartbeats; 0: none.
        watched: node whose heartbeat it is to watch.
        watched_ms: time after which it takes that node for lost; 0: it does not watch.

    Returns:
        Whether it can produce one: by CiA 301 a node may have node guarding in place of it.

    Raises:
        DeviceError: it has no object for that of another node.
        ObjectIgnored: it acknowledged one of them and holds another value, or it has no room.
        SdoAborted, SdoSilent, ProtocolError: it could not be read or written.
    """
    produces = sdo.has(OBJECTS["producer_heartbeat_time"])
    if produces:
        sdo.ensure(OBJECTS["producer_heartbeat_time"], produced_ms, _REMEDY)
    entries = sdo.find(OBJECTS["consumer_heartbeat_entries"])
    if not watched_ms and not entries:
        return produces
    if entries is None:
        raise DeviceError(
            f"{OBJECTS['consumer_heartbeat_time']}: the node has no such object, so that it cannot watch our "
            "heartbeat",
            where=sdo.where,
            remedy=_REMEDY,
        )
    wanted = (watched << 16 | watched_ms) if watched_ms else 0
    sdo.ensure(_consumer_entry(sdo, entries, watched), wanted, _REMEDY)
    return produces


def _consumer_entry(sdo: Sdo, entries: int, watched: int) -> Entry:
    """Return the entry of 1016 that watches `watched` already, or else the first free one."""
    first = OBJECTS["consumer_heartbeat_time"]
    free: Entry | None = None
    for sub in range(1, entries + 1):
        entry = Entry(first.index, sub, first.type, first.name)
        found = sdo.read(entry)
        if found >> 16 & 0xFF == watched:
            return entry
        if free is None and not found & 0xFFFF:
            free = entry
    if free is None:
        raise ObjectIgnored(
            f"{first}: none of its {entries} entries is free, so it cannot watch our heartbeat",
            where=sdo.where,
            remedy=_REMEDY,
        )
    return free


def ensure_abort_option(sdo: Sdo, option: int) -> None:
    """Make a drive do `option` (6007) when the connection is lost.

    Args:
        option: 0 no action, 1 fault, 2 disable voltage, 3 quick stop.

    Raises:
        DeviceError: it has no such object.
        ObjectIgnored: it acknowledged it and holds another value.
        SdoAborted, SdoSilent, ProtocolError: it could not be read or written.
    """
    entry = OBJECTS["abort_connection_option"]
    if sdo.find(entry) is None:
        raise DeviceError(
            f"{entry.on_axis(sdo.axis)}: the drive has no such object, so '{option_text(0x6007, option)}' "
            "at the loss of the connection cannot be asked for",
            where=sdo.where,
            remedy=f"{_REMEDY} Where its manual says that it stops by itself, give `abort_option: null`.",
        )
    try:
        sdo.ensure(entry, option, _REMEDY)
    except SdoAborted as error:
        raise SdoAborted(
            error.message, where=error.where, remedy=_REMEDY, code=error.code
        ) from error


@dataclass(slots=True)
class NodeLife:
    """What is known of one node.

    Attributes:
        timeout: seconds without a heartbeat after which it is lost; 0: it is not watched.
        state: last one that it told; None before.
        seen: monotonic seconds of its last heartbeat or boot-up; None before.
        boot_ups: how many were seen.
        heartbeats: how many were seen.
        mute: it produces no heartbeat; only its boot-up tells its state.
    """

    timeout: float
    state: int | None = None
    seen: float | None = None
    boot_ups: int = 0
    heartbeats: int = 0
    mute: bool = False

    def lost(self, now: float) -> bool:
        """Whether its heartbeat is overdue; never before the first one."""
        if self.mute or self.seen is None:
            return False
        return self.timeout > 0.0 and now - self.seen > self.timeout


class HeartbeatWatch:
    """Heartbeats and boot-ups of the nodes on one bus.

    Args:
        timeouts: seconds without a heartbeat after which a node is lost, by node; 0: not watched.
    """

    def __init__(self, timeouts: Mapping[int, float] | Iterable[tuple[int, float]] = ()) -> None:
        self.nodes = {node: NodeLife(timeout) for node, timeout in dict(timeouts).items()}

    def take(self, node: int, data: bytes, now: float) -> bool:
        """Take a frame with the COB-ID 700h + node; return whether it is a boot-up.

        A node that is not known is kept as well, for a scan.
        """
        life = self.nodes.setdefault(node, NodeLife(0.0))
        life.seen = now
        state = data[0] & ~_TOGGLE if data else NmtState.BOOT_UP
        life.state = state
        if state == NmtState.BOOT_UP:
            life.boot_ups += 1
            life.state = NmtState.PRE_OPERATIONAL
            return True
        life.heartbeats += 1
        return False

    def restart(self, now: float) -> None:
        """Give every watched node its whole time again, from now on, whether it was seen or not."""
        for life in self.nodes.values():
            life.seen = now

    def lost(self, now: float) -> list[int]:
        """Return the nodes whose heartbeat is overdue."""
        return [node for node, life in self.nodes.items() if life.lost(now)]

"""The boards of a controller, reached through the one with the Ethernet cable. Belongs to the I/O thread.

A board answers one request at a time; requests carry a label, by which what is late, doubled or of somebody
else is told from the answer.
"""

from __future__ import annotations

import socket
import time
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Final

from crtk_driver_dvrk import packets
from crtk_driver_dvrk.packets import BROADCAST, Extra, Reply
from crtk_driver_dvrk.registers import (
    FIRMWARE,
    HARDWARE,
    OTHER_HARDWARE,
    QUADLETS,
    Register,
    board_of,
)
from crtk_drivers.errors import ConnectionFailed, ConnectionLost, DeviceError
from crtk_drivers.kit import UdpTransport

REMEDY: Final = (
    "Is the controller on, is this computer in the network of its Ethernet cable, and does nobody else "
    "(dVRK's own program) talk to it?"
)

_UNANSWERED: Final = 0
"""Label of writes; reads have the others."""

_NODES: Final = 16
_TRIES: Final = 2
"""How often all nodes are asked whether they are there: most are not, and each is waited for."""

_CONFIRMED: Final = 2
"""Replies in a row that must tell another generation of the bus: one may be damaged."""


_OVERDUE: Final = 32
"""Datagrams that are looked at when the time for an answer is over: it may lie behind late ones, but not
behind a flood of somebody's."""


@dataclass(frozen=True, slots=True)
class Found:
    """A board that is there.

    Attributes:
        node: of the FireWire bus.
        board: its number.
        hardware: what register 4 says; `registers.HARDWARE` for a QLA.
        firmware: its version.
        fpga: version of the FPGA board: 1, 2 or 3.
    """

    node: int
    board: int
    hardware: int
    firmware: int
    fpga: int

    @property
    def hardware_name(self) -> str:
        """Of the four letters."""
        return letters(self.hardware)


def letters(value: int) -> str:
    """Return the four letters of a quadlet; hexadecimal if they are none."""
    text = value.to_bytes(4).decode("ascii", "replace")
    return text if text.isprintable() and text.isascii() else f"0x{value:08x}"


class Boards:
    """The way to the boards.

    Args:
        host: address of the one with the cable.
        port: UDP port.
        told_at: where they are told that address; empty: they have it.
        timeout: seconds for a reply.

    Attributes:
        strays: datagrams that answer nothing that was asked: late, doubled, or of somebody else.
        damaged: datagrams that are no reply, or whose CRC is wrong.
        dropped: requests that the board with the cable did not carry out.
    """

    def __init__(self, host: str, port: int, told_at: str, timeout: float) -> None:
        self._opening = self._given_up = False
        given_up = self._is_given_up
        self._link = UdpTransport(host, port, "dvrk", REMEDY, aborted=given_up)
        self._told_at = told_at
        self._timeout = timeout
        self._label = 0
        self._generation: int | None = None  # until a board has told it
        self._others = 0
        self.strays = self.damaged = self.dropped = 0

    @property
    def where(self) -> str:
        """The controller, for errors."""
        return self._link.where

    @property
    def is_open(self) -> bool:
        """Whether they were reached, and the connection was not closed since."""
        return self._link.is_open

    def open(self, deadline: float, wanted: Collection[int] | None = None) -> list[Found]:
        """Connect, let boards find their nodes, and return those that are there, by node.

        It writes two registers, as dVRK does: the boards' IP address (11), and 0 to the PHY (1), which lets
        each board ask for its node.

        Args:
            deadline: monotonic s.
            wanted: numbers of boards; nodes are asked once more only if one of these is missing.

        Raises:
            ConnectionFailed: nobody answers by the monotonic `deadline`.
            DeviceError: what answers is no board with a QLA.
        """
        self._opening = True
        try:
            return self._search(deadline, wanted)
        finally:
            self._opening = False

    def _search(self, deadline: float, wanted: Collection[int] | None) -> list[Found]:
        self._generation, self._others = None, 0
        self._link.open(deadline)
        self._tell_address()
        hub = self._ask_hub(Register.HARDWARE, deadline)
        self._generation = hub.extra.generation
        self._refuse_other_hardware(hub.quadlets[0])
        label = self._next()
        self._send(packets.write_quadlet(BROADCAST, Register.PHY, 0, label), forward=True)
        self._ask_hub(Register.STATUS, deadline)
        found: dict[int, Found] = {}
        for _ in range(_TRIES):
            for node in range(_NODES):
                board = None if node in found else self._look(node, deadline)
                if board is not None:
                    found[node] = board
            if wanted is not None and set(wanted) <= {board.board for board in found.values()}:
                break
        return [found[node] for node in sorted(found)]

    def close(self) -> None:
        """Disconnect. May be called twice."""
        self._link.close()

    def abort_open(self) -> None:
        """End an `open` that waits, from any thread, and let later ones fail."""
        self._given_up = True

    def _is_given_up(self) -> bool:
        return self._opening and self._given_up

    def ask_state(self, node: int) -> int:
        """Ask a node for its state, and return the label of the answer.

        Raises:
            ConnectionLost: the connection is gone.
        """
        label = self._next()
        self._send(packets.read_block(node, Register.STATUS, QUADLETS, label), forward=True)
        return label

    def ask_register(self, node: int, address: int) -> int:
        """Ask a node for a register, and return the label of the answer.

        Raises:
            ConnectionLost: the connection is gone.
        """
        label = self._next()
        self._send(packets.read_quadlet(node, address, label), forward=True)
        return label

    def order(self, node: int, quadlets: Sequence[int]) -> None:
        """Write a block at 0 of a node, see `crtk_driver_dvrk.orders`. From any thread; nothing answers.

        Raises:
            ConnectionLost: the connection is gone.
        """
        packet = packets.write_block(node, Register.STATUS, quadlets, _UNANSWERED)
        self._send(packet, forward=True)

    def write(self, node: int, address: int, value: int) -> None:
        """Write a register of a node. No answer comes.

        Raises:
            ConnectionLost: the connection is gone.
        """
        self._send(packets.write_quadlet(node, address, value, _UNANSWERED), forward=True)

    def answer(self, node: int, label: int, deadline: float) -> Reply | None:
        """Return the answer of a node, or None if it does not come by the monotonic `deadline`.

        Raises:
            ConnectionLost: the connection is gone, or the bus has been reset, and nodes are others.
        """
        overdue = 0
        while overdue < _OVERDUE:
            data = self._link.read(deadline)
            if time.monotonic() >= deadline:
                if not data:
                    return None
                overdue += 1
            if not data:
                continue  # a datagram without bytes
            try:
                reply = packets.parse(data)
            except ValueError:
                self.damaged += 1
                continue
            self._watch_generation(reply if isinstance(reply, Extra) else reply.extra)
            if isinstance(reply, Extra):
                self.dropped += bool(reply.flags & packets.DROPPED)
                continue
            if reply.label == label and node in (reply.node, BROADCAST):
                return reply
            self.strays += 1
        return None

    def register(self, node: int, address: int, deadline: float, tries: int) -> int | None:
        """Return a register of a node, or None if it does not answer.

        Raises:
            ConnectionLost: as `answer`.
        """
        reply = self._ask(node, address, deadline, tries, forward=True)
        return None if reply is None else reply.quadlets[0]

    def _look(self, node: int, deadline: float) -> Found | None:
        """Return the board of a node; None if there is none, or if it does not tell what it is."""
        hardware = self.register(node, Register.HARDWARE, deadline, 1)
        if hardware is None:
            return None
        firmware, status, ethernet = (
            self.register(node, address, deadline, 2 * _TRIES)
            for address in (Register.FIRMWARE, Register.STATUS, Register.ETHERNET)
        )
        if firmware is None or status is None or ethernet is None:
            return None
        return Found(node, board_of(status), hardware, firmware, _fpga(ethernet))

    def _ask_hub(self, address: int, deadline: float) -> Reply:
        """Return what the board with the cable answers, whichever that is."""
        tries = 1 + int(max(0.0, deadline - time.monotonic()) / self._timeout)
        reply = self._ask(BROADCAST, address, deadline, tries, forward=False)
        if reply is None:
            hint = "" if self._told_at else " If it has just been switched on, give `broadcast`."
            raise ConnectionFailed(
                "no board answers", where=self._link.where, remedy=f"{REMEDY}{hint}"
            )
        return reply

    def _ask(
        self, node: int, address: int, deadline: float, tries: int, *, forward: bool
    ) -> Reply | None:
        for _ in range(tries):
            label = self._next()
            self._send(packets.read_quadlet(node, address, label), forward=forward)
            until = min(deadline, time.monotonic() + self._timeout)
            reply = self.answer(node, label, until)
            if reply is not None and len(reply.quadlets) == 1:
                return reply
        return None

    def _refuse_other_hardware(self, hardware: int) -> None:
        if hardware == HARDWARE:
            return
        name = letters(hardware)
        raise DeviceError(
            f"the board is {name}{_known(name)}, not QLA1",
            where=self._link.where,
            remedy="This driver reads boards with a QLA.",
        )

    def _watch_generation(self, extra: Extra) -> None:
        """Notice that the bus was reset: boards came or went, and nodes may be others."""
        if self._generation in (None, extra.generation):
            self._others = 0
            return
        self._others += 1
        if self._others >= _CONFIRMED:
            raise ConnectionLost(
                "the FireWire bus was reset: a board has come, gone or restarted",
                where=self._link.where,
                remedy="Check cables and power of the boards. The driver connects again by itself.",
            )

    def _tell_address(self) -> None:
        """Tell boards which address they have: a broadcast reaches those that have none yet."""
        value = int.from_bytes(socket.inet_aton(self._link.host), "little")
        packet = packets.write_quadlet(BROADCAST, Register.IP_ADDRESS, value, self._next())
        if not self._told_at:
            self._send(packet, forward=True)
            return
        data = packets.datagram(packet, 0, forward=True)
        try:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as everybody:
                everybody.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
                everybody.sendto(data, (self._told_at, self._link.port))
        except OSError as error:
            raise ConnectionFailed(
                f"boards cannot be told their address at {self._told_at}: {error.strerror or error}",
                where=self._link.where,
                remedy="Give this computer an address in the network of the boards, or correct `broadcast`.",
            ) from error

    def _next(self) -> int:
        self._label = self._label % (packets.LABELS - 1) + 1
        return self._label

    def _send(self, packet: bytes, *, forward: bool) -> None:
        self._link.write(packets.datagram(packet, self._generation or 0, forward=forward))


def _known(name: str) -> str:
    what = OTHER_HARDWARE.get(name, "")
    return f" ({what})" if what else ""


def _fpga(ethernet: int) -> int:
    """Return the version of the FPGA board that register 12 tells."""
    if ethernet >> 31:
        return 2
    return 3 if ethernet >> 30 else 1


def chosen(found: list[Found], wanted: tuple[int, ...], where: str) -> list[Found]:
    """Return the boards of an arm among those that are there, and refuse others.

    Args:
        found: all of the bus.
        wanted: numbers of those of the arm.
        where: for errors.

    Raises:
        DeviceError: one is missing, is there twice, or is not what this driver reads.
    """
    at = {board: [each for each in found if each.board == board] for board in wanted}
    there = ", ".join(str(each.board) for each in found) or "none"
    missing = [str(board) for board, boards in at.items() if not boards]
    if missing:
        raise DeviceError(
            f"board {', '.join(missing)} is not there; boards are: {there}",
            where=where,
            remedy="Check power, FireWire cables and the rotary switches of the boards, or board_id in `io`.",
        )
    for board, boards in at.items():
        if len(boards) > 1:
            raise DeviceError(
                f"two boards have the number {board}",
                where=where,
                remedy="Set the rotary switch of one of them otherwise.",
            )
        (each,) = boards
        if each.hardware != HARDWARE:
            raise DeviceError(
                f"board {board} is {each.hardware_name}{_known(each.hardware_name)}, not QLA1",
                where=where,
                remedy="This driver reads boards with a QLA.",
            )
        if each.firmware != FIRMWARE:
            raise DeviceError(
                f"board {board} has firmware {each.firmware}, and this driver reads that of {FIRMWARE}",
                where=where,
                remedy=f"Load firmware {FIRMWARE} (mechatronics-firmware), or use dVRK's own program.",
            )
    return [at[board][0] for board in wanted]

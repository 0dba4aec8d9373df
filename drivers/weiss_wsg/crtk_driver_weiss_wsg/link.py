"""The way to a gripper: what is sent, what it has told, and which commands are under way."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable
from typing import Final

from crtk_driver_weiss_wsg.binary import BinaryCodec
from crtk_driver_weiss_wsg.config import WsgConfig
from crtk_driver_weiss_wsg.orders import Order, Orders
from crtk_driver_weiss_wsg.tables import (
    BUSY,
    FAULTS,
    MOTIONS,
    STATES,
    STATUS,
    Command,
    Flag,
    Grasping,
    Message,
    Status,
)
from crtk_driver_weiss_wsg.text import TextCodec
from crtk_drivers.errors import ConnectionFailed, DeviceError, ProtocolError
from crtk_drivers.kit import TcpTransport, Transport

__all__ = ["WsgLink"]

PIECE: Final = 0.05
"""Seconds after which `open` looks whether it is given up."""
ASKING: Final = 0.1
"""Seconds from one flag that is asked for to the next (text mode)."""
FAREWELL: Final = 0.2
"""Seconds in which a last command must be answered."""
ALIKE: Final = 1e-3
"""Metres by which the stroke that it tells may differ from that of its model."""
HELD_UP: Final = 0.5
PERIODS: Final = 3.0
"""Seconds, and updates, for which nobody has looked, after which what comes may have waited as long."""
MOST_KEPT: Final = 32
"""Pieces that a port or a socket keeps meanwhile."""
UPDATES: Final = frozenset(
    {Command.SYSTEM, Command.GRASPING, Command.WIDTH, Command.SPEED, Command.FORCE}
)


class WsgLink:
    """One gripper at its address. It belongs to the I/O thread, but for `stop`.

    Args:
        config: where it is.
        period: seconds from one update to the next.

    Attributes:
        told: values in SI units, by what they are about; empty while it is not open.
        orders: commands under way.
    """

    def __init__(self, config: WsgConfig, period: float) -> None:
        self._config = config
        self._period = period
        self._given_up: Callable[[], bool] = lambda: False
        self._transport = self._make_transport()
        self._io: int | None = None
        self._begin()

    def _begin(self) -> None:
        """A connection begins: nothing is known."""
        self.codec = TextCodec() if self._config.link == "text" else BinaryCodec()
        self.orders = Orders()
        self.told: dict[Command, tuple[float, ...]] = {}
        self._asked = 0.0
        self._looked = time.monotonic()
        self._stopped_aside = False

    def _make_transport(self) -> Transport:
        config = self._config
        if config.link == "serial":
            from crtk_drivers.kit.serial_port import SerialPort  # needs pyserial

            return SerialPort(config.port, config.baud)
        remedy = "Check the address, the network, and that the gripper is on."
        return TcpTransport(
            config.host,
            config.tcp_port,
            "weiss-wsg",
            remedy,
            aborted=lambda: self._given_up() and not self.is_open,
        )

    @property
    def where(self) -> str:
        """For messages."""
        return self._transport.where

    # ------------------------------------------------------------------------------------ connection

    @property
    def is_open(self) -> bool:
        """Whether all is told that it tells."""
        needed = UPDATES if self._config.link == "text" else UPDATES | {Command.LIMITS}
        return needed <= self.told.keys()

    def open(self, deadline: float, given_up: Callable[[], bool]) -> None:
        """Connect, and ask for updates; that moves nothing.

        Raises:
            ConnectionFailed: there is no such gripper.
        """
        self._io = threading.get_ident()
        self._given_up = given_up
        self._begin()
        self._transport.open(deadline)
        heard = False
        try:
            self._transport.write(self.codec.subscribe(self._period))
            while not self.is_open and not given_up() and time.monotonic() < deadline:
                heard |= self.receive(min(deadline, time.monotonic() + PIECE)) is not None
        except DeviceError as error:
            raise self._no_link(
                error.message, "It lets one program in: is another connected? Its web page tells."
            ) from error
        if not self.is_open:
            text = "bytes come, and too few are its answers" if heard else "it does not answer"
            raise self._no_link(
                text,
                "Does it speak this protocol there? Its web page (Settings, Command Interface) has "
                "interface, port and text mode: link is tcp, text or serial.",
            )
        stroke = self.told.get(Command.LIMITS, (self._config.data.stroke,))[0]
        if abs(stroke - self._config.data.stroke) > ALIKE:
            raise self._no_link(
                f"its stroke is {1e3 * stroke:.0f} mm, that of a {self._config.model} "
                f"{1e3 * self._config.data.stroke:.0f} mm",
                "Give the right model.",
            )

    def _no_link(self, text: str, remedy: str) -> ConnectionFailed:
        with contextlib.suppress(DeviceError):
            self.last(Order(Command.GOODBYE))  # so that it does not stop for one who only looked
        self.close()
        return ConnectionFailed(text, where=self.where, remedy=remedy)

    def close(self) -> None:
        """Disconnect. Without a `last` goodbye the gripper stops fast."""
        self._begin()
        self._transport.close()

    def last(self, order: Order) -> None:
        """Send one more command, and wait a moment for its first answer.

        Raises:
            DeviceError: there is nobody any more.
        """
        self.put(order)
        deadline = time.monotonic() + FAREWELL
        under_way = (self.orders.waiting, self.orders.asked)
        while order in under_way and time.monotonic() < deadline:
            self.receive(deadline)
            under_way = (self.orders.waiting, self.orders.asked)

    # ----------------------------------------------------------------------------------- what is told

    @property
    def flags(self) -> Flag:
        """The system state."""
        return Flag(int(self.told.get(Command.SYSTEM, (0.0,))[0]))

    @property
    def grasping(self) -> Grasping:
        """The grasping state."""
        return Grasping(int(self.told.get(Command.GRASPING, (0.0,))[0]))

    @property
    def is_stopped_fast(self) -> bool:
        """Whether it refuses motions until that is acknowledged."""
        return bool(self.flags & Flag.FAST_STOP)

    @property
    def fault(self) -> tuple[str, str] | None:
        """What stops it by itself, and what to do."""
        return next((words for flag, words in FAULTS.items() if self.flags & flag), None)

    @property
    def width(self) -> float:
        """The opening in m."""
        return self.told[Command.WIDTH][0]

    @property
    def moves(self) -> bool:
        """Whether it says that its fingers move."""
        return bool(self.flags & Flag.MOVING) or self.grasping in BUSY

    @property
    def rests(self) -> bool:
        """Whether it goes nowhere, and is not about to."""
        return self.orders.settled and not self.moves

    def receive(self, deadline: float) -> bool | None:
        """Send what is due, and take what arrives next.

        Returns:
            whether a width of now is among it; None: nothing came by the deadline.

        Raises:
            ConnectionLost: the connection is gone.
            ProtocolError: it does not answer, or tells nothing.
        """
        self._send(time.monotonic())
        data = self._transport.read(deadline)
        now = time.monotonic()
        looked, self._looked = self._looked, now
        if not data:
            return None
        is_kept = now - looked > max(HELD_UP, PERIODS * self._period)
        if is_kept:
            data += self._kept()
        messages = self.codec.feed(data)
        for message in messages:
            self._take(message)
        now = time.monotonic()
        # What is in the way of a move ends it anywhere.
        is_anywhere = Command.WIDTH not in self.told or bool(self.flags & Flag.BLOCKED)
        self.orders.see(not self.moves, now, None if is_anywhere else self.width)
        self._send(now)
        return not is_kept and any(about is Command.WIDTH for about, *_ in messages)

    def _kept(self) -> bytes:
        """Return all that has come by now: it is as old as nobody has looked, and tells no width of now."""
        data = b""
        for _ in range(MOST_KEPT):
            piece = self._transport.read(0.0)
            if not piece:
                break
            data += piece
        return data

    def _take(self, message: Message) -> None:
        about, status, values = message
        if about not in UPDATES and about is not Command.LIMITS:
            self.orders.heed(message)
        elif status != Status.OK:
            text, remedy = STATUS.get(status, (f"status {status}", "See its manual."))
            raise ProtocolError(
                f"it does not tell {about.name.lower()}: {text}", where=self.where, remedy=remedy
            )
        elif about is not Command.GRASPING or values[0] in STATES:
            self.told[about] = values
            self.orders.unseen.discard(about)

    # ----------------------------------------------------------------------------------- what is sent

    def put(self, order: Order) -> Order:
        """Let an order be sent as soon as may be; one that this protocol does not have is done."""
        if self.codec.encode(order.command, *order.values):
            self.orders.put(order)
            self._send(time.monotonic())
        else:
            order.end(Status.OK)
        return order

    def stop(self) -> None:
        """Stop it; from any thread, and waits for nothing."""
        if threading.get_ident() == self._io:
            self.orders.stop()
            self._send(time.monotonic())
        else:
            self._stopped_aside = True
            self._transport.write(self.codec.encode(Command.STOP))

    def _is_obeyed(self, command: Command) -> bool:
        """Whether what it does shows that it has heard a motion whose answer was lost."""
        ends = {Command.GRASP: Grasping.HOLDING, Command.RELEASE: Grasping.IDLE}
        return command in MOTIONS and (self.moves or ends.get(command) is self.grasping)

    def _send(self, now: float) -> None:
        if self._stopped_aside:  # nothing that waits follows it
            self._stopped_aside = False
            self.orders.stop()
        order = self.orders.due(now)
        if order is not None and order.tries > 1 and self._is_obeyed(order.command):
            self.orders.heed(Message(order.command, Status.PENDING))
        elif order is not None:
            if order.tries > Orders.TRIES:
                raise ProtocolError(
                    f"it does not answer {order.command.name.lower()}",
                    where=self.where,
                    remedy="Switch it off and on; is its firmware up to date?",
                )
            self._transport.write(self.codec.encode(order.command, *order.values))
        if now - self._asked > ASKING:
            self._asked = now
            if question := self.codec.ask():
                self._transport.write(question)

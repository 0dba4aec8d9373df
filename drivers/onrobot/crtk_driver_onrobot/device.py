"""What all OnRobot tools have in common: the way to them, and that the right one is there."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from crtk_driver_onrobot.config import OnRobotConfig
from crtk_driver_onrobot.registers import Command, Identity, Registers, Status
from crtk_drivers.device import Answer as Told
from crtk_drivers.errors import ConnectionFailed, ConnectionLost, DeviceError
from crtk_drivers.kit import modbus_frames as codec
from crtk_drivers.kit.gripping import HandService, When
from crtk_drivers.kit.modbus_link import Answer as AnyAnswer
from crtk_drivers.kit.modbus_link import ModbusLink, first_answer
from crtk_drivers.plugins import modbus_ways
from crtk_drivers.samples import Text, Value

__all__ = ["Answer", "Talk"]

Answer = AnyAnswer[Command, Status]

BOX: Final = 63
"""Address of the Compute Box itself; 2 in its register 0 takes the tool's power away and gives it back."""


class Talk:
    """An open link to one tool, and who that is.

    Args:
        config: where it is, and which it should be.

    Attributes:
        status: what was read last; None while it is not connected.
    """

    def __init__(self, config: OnRobotConfig) -> None:
        self._config = config
        self._given_up: Callable[[], bool] = lambda: False
        self._registers = Registers(config.tool)
        way = modbus_ways.transport_of(
            config, "onrobot", lambda: self._given_up() and self.status is None
        )
        self._link = ModbusLink(
            self._registers, way, modbus_ways.framing_of(config), config.reply_timeout
        )
        self.status: Status | None = None

    @property
    def where(self) -> str:
        """For messages."""
        return self._link.where

    @property
    def counters(self) -> Mapping[str, float]:
        """What went wrong, counted."""
        return self._link.counters

    def open(self, deadline: float, given_up: Callable[[], bool]) -> Status:
        """Connect, and return what is there; nothing is written.

        Raises:
            ConnectionFailed: nobody answers, or it is another model.
        """
        self._given_up = given_up
        self.status = None
        self._registers.begin()
        try:
            answer = first_answer(self._link, deadline, given_up)
            self._check(answer.status.identity)
        except DeviceError:
            self.close()
            raise
        self.status = answer.status
        return answer.status

    def close(self) -> None:
        """Disconnect. May be called twice."""
        self.status = None
        self._link.close()

    def exchange(self, command: Command | None, deadline: float) -> Answer | None:
        """Send a command, if there is one, and read the status; None: not by the deadline.

        Raises:
            ConnectionLost: the connection is gone, or another tool is there.
            ConnectionFailed: it is another model than it should be.
        """
        answer = self._link.exchange(command, deadline)
        if answer is not None:
            self._check(answer.status.identity)
            self.status = answer.status
        return answer

    def _check(self, found: Identity) -> None:
        if found.code != self._config.data.code:
            title = self._config.data.title
            raise ConnectionFailed(
                f"this is {found.title}, and {title} is configured",
                where=self.where,
                remedy="Set model to what is there, or mount the other one.",
            )
        if self.status is not None and self.status.identity.serial != found.serial:
            raise ConnectionLost(
                f"{self.status.identity.title} was replaced by {found.title}",
                where=self.where,
                remedy="It is connected anew; enable it when it may move.",
            )

    def shout(self, command: Command) -> None:
        """Send a command from any thread, and wait for nothing."""
        self._link.shout(command)

    def tell_tool(self) -> Value | None:
        """Which one is there, as a reading."""
        if self.status is None:
            return None
        identity = self.status.identity
        return Text(f"{identity.title}, firmware {identity.firmware}")

    def services(self, *, empty: bool) -> Mapping[str, HandService]:
        """What the Compute Box does; `empty`: while nothing is held only, which falls without power."""
        if self._config.link != "modbus":
            return {}
        text = "have the Compute Box take the tool's power away and give it back: clears latched faults"
        run = self._power_cycle
        return {"power_cycle": HandService(text, run, When.ANY, empty=empty, moves=False)}

    def _power_cycle(self) -> Told:
        self._link.tell(codec.write(0, b"\0\2"), BOX)
        yield
        return "the Compute Box was told; the tool is connected anew, if it was away for long"

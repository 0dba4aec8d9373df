"""A device that hangs at another one, which has the link: its address, bus, opening and closing."""

from __future__ import annotations

from abc import abstractmethod
from typing import Protocol

from typing_extensions import override

from crtk_drivers.device import Capabilities, Device
from crtk_drivers.errors import ConnectionFailed, ConnectionLost

__all__ = ["DeviceBehind", "Unit"]


class Unit(Protocol):
    """What a device needs of the one that it hangs at."""

    @property
    def address(self) -> str:
        """Where it is, which is the bus of all that hangs at it."""


class DeviceBehind(Device):
    """What such devices have in common; what it measures and does, a driver adds.

    Args:
        unit: at which it hangs.
        name: of it, behind the address of the unit.
        capabilities: of it.
        called: how the unit is called, for messages.
        remedy: what to do if it is not connected.
    """

    def __init__(
        self, unit: Unit, name: str, capabilities: Capabilities, called: str, remedy: str = ""
    ) -> None:
        self._hangs_at = unit
        self.name = name
        self._capabilities = capabilities
        self._missing = f"{called} is not connected"
        self._remedy = remedy

    @property
    @abstractmethod
    def is_linked(self) -> bool:
        """Whether the unit is connected."""

    @property
    @override
    def capabilities(self) -> Capabilities:
        return self._capabilities

    @property
    @override
    def address(self) -> str:
        return f"{self._hangs_at.address} {self.name}"

    @property
    @override
    def bus(self) -> str:
        return self._hangs_at.address

    @override
    def open(self, deadline: float) -> None:
        if not self.is_linked:
            raise ConnectionFailed(self._missing, where=self.address, remedy=self._remedy)

    @override
    def close(self) -> None:
        """The link is the unit's."""

    def check_link(self) -> None:
        """See before each `read` that the unit is connected still.

        Raises:
            ConnectionLost: it is not.
        """
        if not self.is_linked:
            raise ConnectionLost(self._missing, where=self.address, remedy=self._remedy)

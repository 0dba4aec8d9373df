"""Robotiq's own Modbus TCP controller: the six bytes from register 0 on (2F-200 manual, 4.10)."""

from __future__ import annotations

from collections.abc import Callable, Collection

from typing_extensions import override

from crtk_sim_backends.kit.modbus import window
from crtk_sim_backends.kit.modbus_line import Distortion, TcpSession
from crtk_sim_backends.kit.modbus_server import nobody
from crtk_sim_backends.kit.ports import Session
from crtk_sim_backends.robotiq.gripper import GTO, REGISTERS, Gripper


class Controller:
    """What it is to a client: input registers to read, and others to write.

    Args:
        gripper: behind it.
    """

    functions: Collection[int] = frozenset({4, 16})

    def __init__(self, gripper: Gripper) -> None:
        self._gripper = gripper

    @property
    def powered(self) -> bool:
        """Whether it answers."""
        return self._gripper.powered

    def heard(self) -> None:
        """A request was understood."""
        self._gripper.heard()

    def read(self, address: int, count: int) -> bytes:
        """Return the bytes of the status."""
        return self._gripper.report[window(0, REGISTERS, address, count)]

    def write(self, address: int, data: bytes) -> None:
        """Take bytes of the command."""
        at = window(0, REGISTERS, address, len(data) // 2).start
        self._gripper.meanwhile()
        self._gripper.command(at, data)


class ControllerSession(TcpSession):
    """A client of it: "shutting down communication will stop the Gripper".

    Args:
        gripper: behind the controller.
        distortion, unit, later: as of `TcpSession`.
    """

    def __init__(
        self,
        gripper: Gripper,
        distortion: Distortion,
        unit: int,
        later: Callable[[float, Session, bytes], object],
    ) -> None:
        super().__init__(Controller(gripper), distortion, unit, nobody, later)
        self._gripper = gripper

    @override
    def close(self) -> None:
        """Stop the fingers, and forget an unfinished frame."""
        super().close()
        if self._gripper.written[0] & GTO:
            self._gripper.command(0, bytes((self._gripper.written[0] & ~GTO,)))

"""The two memories of a board, which hold its serial numbers, as JHU's programs read them.

Source: ``PromReadData`` and ``PromReadByte25AA128`` of AmpIO.cpp in mechatronics-software.
"""

from __future__ import annotations

from typing import Final

COMMAND, RESULT = 8, 9
"""Registers of the memory of the FPGA (M25P16)."""

DATA: Final = 0x2000
"""Address of the block with what was read of it."""

QLA_COMMAND, QLA_RESULT = 0x3000, 0x3002
"""Registers of the memory of the QLA (25AA128)."""

_READ: Final = 0x03
_IDENTIFY: Final = 0x9F
_IDENTITY: Final = 0x00202015
"""Of an M25P16."""
_SERIAL: Final = 0x1FFF00
_PAGE: Final = 64
"""Quadlets that are read at once."""


class Prom:
    """Both memories.

    Args:
        board: number of the board, which its serial numbers end with.
    """

    def __init__(self, board: int) -> None:
        self._fpga = f"FPGA 1234-{board:02d}".encode()
        self._qla = f"QLA 5678-{board:02d}".encode()
        self._result = self._qla_result = 0
        self._page = bytes(4 * _PAGE)

    def obey(self, value: int) -> None:
        """Take a command to the memory of the FPGA."""
        command, address = value >> 24, value & 0xFFFFFF
        if command == _READ:
            found = bytes(self._at(address + at) for at in range(4 * _PAGE))
            self._page, self._result = found, _PAGE
        elif command == _IDENTIFY:
            self._result = _IDENTITY
        else:
            self._result = 0

    def _at(self, address: int) -> int:
        at = address - _SERIAL
        return self._fpga[at] if 0 <= at < len(self._fpga) else 0xFF

    @property
    def result(self) -> int:
        """What the register of the result holds."""
        return self._result

    @property
    def page(self) -> list[int]:
        """The quadlets that were read last."""
        return [int.from_bytes(self._page[at : at + 4]) for at in range(0, 4 * _PAGE, 4)]

    def obey_qla(self, value: int) -> None:
        """Take a command to the memory of the QLA."""
        if value >> 24 == _READ:
            address = value >> 8 & 0xFFFF
            self._qla_result = self._qla[address] if address < len(self._qla) else 0xFF

    @property
    def qla_result(self) -> int:
        """The byte that was read last."""
        return self._qla_result

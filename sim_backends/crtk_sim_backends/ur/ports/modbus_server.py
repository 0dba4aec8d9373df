"""One client of the controller's Modbus TCP server: bytes in, bytes out.

Frames and messages are pymodbus', what they mean is `port_map`'s. The server answers functions 1 to
6, 15 and 16 for any unit, and refuses others with exception 1, addresses with 2, values with 3
(UR support article 16377, "Modbus Server"). A refused request changes nothing. This module is
imported only where the server is on: pymodbus takes longer to import than all the rest to start.
"""

from __future__ import annotations

from collections.abc import Coroutine
from typing import Any, Final

from pymodbus.constants import ExcCodes
from pymodbus.framer import FramerSocket
from pymodbus.pdu import DecodePDU, ExceptionResponse, ModbusPDU

from crtk_sim_backends.ur.signals.port_map import PortError, PortMap, PortTable

_BIT_FUNCTIONS: Final = (1, 2, 5, 15)
_REGISTER_FUNCTIONS: Final = (3, 4, 6, 16)
_SINGLE_WRITES: Final = (5, 6)
_LARGEST_FRAME: Final = 260  # bytes (Modbus Messaging on TCP/IP Implementation Guide, 3.1.3)


class _Store:
    """The ports as the store that pymodbus' requests read and write."""

    def __init__(self, port_map: PortMap) -> None:
        self._tables: dict[int, PortTable] = {
            **dict.fromkeys(_BIT_FUNCTIONS, port_map.bits),
            **dict.fromkeys(_REGISTER_FUNCTIONS, port_map.registers),
        }
        self._echo: list[Any] = []

    async def async_getValues(  # noqa: N802
        self, unit: int, function: int, address: int, count: int
    ) -> list[Any] | ExcCodes:
        """Values for a reading request, or the echo for one that has set a single value."""
        if function in _SINGLE_WRITES:
            return self._echo
        table = self._tables[function]
        try:
            values = [table[address + i] for i in range(count)]
        except PortError:
            return ExcCodes.ILLEGAL_ADDRESS
        return [bool(value) for value in values] if table is self._tables[1] else values

    async def async_setValues(  # noqa: N802
        self, unit: int, function: int, address: int, values: list[Any]
    ) -> ExcCodes | None:
        """Set all values, or none of them."""
        table = self._tables[function]
        wanted = {address + i: int(value) for i, value in enumerate(values)}
        try:
            for item in wanted.items():
                table.check(*item)
        except PortError:
            return ExcCodes.ILLEGAL_ADDRESS
        except ValueError:
            return ExcCodes.ILLEGAL_VALUE
        for place, value in wanted.items():
            table[place] = value
        self._echo = values
        return None


class ModbusSession:
    """One client."""

    def __init__(self, port_map: PortMap) -> None:
        self._store: Any = _Store(port_map)
        self._decoder = DecodePDU(is_server=True)
        self._framer = FramerSocket(self._decoder)
        self._buffer = b""
        self.packages_in = 0
        self.packages_bad = 0
        self.ended = False

    def receive(self, data: bytes) -> bytes:
        """Take received bytes and return the answers to the requests that they complete."""
        self._buffer += data
        answers = []
        while not self.ended:
            size, unit, transaction, message = self._framer.decode(self._buffer)
            if not size:
                # What cannot become a frame any more: the place of the next is not known.
                self.ended = len(self._buffer) >= _LARGEST_FRAME
                break
            self._buffer = self._buffer[size:]
            self.packages_in += 1
            answer = self._answer(message)
            self.packages_bad += answer.isError()
            answer.dev_id, answer.transaction_id = unit, transaction
            answers.append(self._framer.buildFrame(answer))
        return b"".join(answers)

    def _answer(self, message: bytes) -> ModbusPDU:
        function = message[0] if message else 0
        if function not in _BIT_FUNCTIONS + _REGISTER_FUNCTIONS:
            return ExceptionResponse(function, ExcCodes.ILLEGAL_FUNCTION)
        request = self._decoder.decode(message)
        if request is None:
            return ExceptionResponse(function, ExcCodes.ILLEGAL_VALUE)
        return _result(request.datastore_update(self._store, 0))

    def close(self) -> None:
        """Do nothing: the client is gone."""


def _result(steps: Coroutine[Any, Any, ModbusPDU]) -> ModbusPDU:
    """What a coroutine returns that waits for nothing, as those of the store do not."""
    try:
        steps.send(None)
    except StopIteration as finished:
        answer: ModbusPDU = finished.value
        return answer
    raise RuntimeError("a request to the store of the Modbus server has waited")

"""The controller as a Modbus TCP client: signals of other units that it reads and writes all the time.

Each unit has a thread of its own, in which pymodbus' client waits for its answers; the controller
only looks at the newest ones. Source: URScript manual, `modbus_add_signal` and the functions after it.
"""

from __future__ import annotations

import contextlib
import errno
import logging
import threading
import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from typing_extensions import override

PORT: Final = 502
FREQUENCY: Final = 10.0  # Hz, of a new signal
WATCHDOG: Final = 2.0  # s without a valid answer after which a signal is in error
ANSWER_TIMEOUT: Final = 1.0  # s
RETRY_PERIOD: Final = 0.5  # s between attempts to connect
DISCONNECTED: Final = -2
_CONNECTIONS: Final = 32

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Kind:
    """How signals of one type are read and written: names of pymodbus' calls."""

    bits: bool
    read: str
    write: str | None = None
    write_single: str | None = None

    @property
    def output(self) -> bool:
        """Whether it can be set."""
        return self.write is not None


KINDS: Final[Mapping[int, Kind]] = {
    0: Kind(True, "read_discrete_inputs"),
    1: Kind(True, "read_coils", "write_coils"),
    2: Kind(False, "read_input_registers"),
    3: Kind(False, "read_holding_registers", "write_registers", "write_register"),
    15: Kind(True, "read_coils", "write_coils"),
    16: Kind(False, "read_holding_registers", "write_registers"),
}
"""Types of `modbus_add_signal`."""

READ_WRITE: Final = Kind(False, "read_holding_registers", "readwrite_registers")
"""That of `modbus_add_rw_signal`: function 3 until it is set, then 23, which writes and reads."""


@dataclass(frozen=True, slots=True)
class Answer:
    """The outcome of the newest request: values (None: never valid), when valid, and errors."""

    values: tuple[int, ...] | None = None
    valid_time: float = 0.0  # monotonic, s
    device_error: int = 0  # Modbus exception
    connection_error: int = DISCONNECTED  # errno, or DISCONNECTED
    count: int = 0  # answers and failures so far


@dataclass(eq=False, slots=True)
class Signal:
    """One signal of a unit; `written` are first address and count of what a READ_WRITE one writes."""

    name: str
    kind: Kind
    unit: int
    address: int
    count: int
    written: tuple[int, int] | None = None
    frequency: float = FREQUENCY
    watchdog: float = WATCHDOG
    wanted: tuple[int, ...] | None = None  # of an output, once a program has set it
    due: float = 0.0  # monotonic, s
    requested: bool = False
    answer: Answer = field(default_factory=lambda: Answer(valid_time=time.monotonic()))

    @property
    def settable(self) -> int:
        """How many values can be set."""
        return self.written[1] if self.written else self.count

    @property
    def present(self) -> tuple[int, ...]:
        """What is written where nothing else is asked for: what was, or what the unit had."""
        if self.wanted is not None:
            return self.wanted
        held = None if self.written else self.answer.values
        return held or (0,) * self.settable

    @property
    def valid(self) -> bool:
        """Whether the newest request went well."""
        return self.answer.device_error == self.answer.connection_error == 0

    @property
    def invalid_for(self) -> float:
        """Seconds since the last valid answer, 0 while all is well."""
        return 0.0 if self.valid else time.monotonic() - self.answer.valid_time


class UnitConnection:
    """The connection to one Modbus TCP address, and the thread that serves its signals.

    Args:
        host: its address.
        port: its TCP port.
        source: address of the robot, from which the connection leaves.
    """

    def __init__(self, host: str, port: int, source: str) -> None:
        self._address = host, port
        self._source = source
        self._signals: tuple[Signal, ...] = ()
        self._commands: deque[tuple[int, int, bytes]] = deque(maxlen=100)
        self._changed = threading.Condition()
        self._ended = self._reset = False
        self._thread = threading.Thread(target=self._run, name=f"modbus {host}", daemon=True)
        self._thread.start()

    @property
    def signals(self) -> tuple[Signal, ...]:
        """The signals of this address."""
        return self._signals

    def set_signals(self, signals: Sequence[Signal]) -> None:
        """Serve these from now on."""
        with self._changed:
            self._signals = tuple(signals)
            self._changed.notify()

    def request(self, signal: Signal) -> None:
        """Read or write a signal as soon as possible."""
        with self._changed:
            signal.requested = True
            self._changed.notify()

    def command(self, unit: int, function: int, data: bytes) -> None:
        """Send a request whose answer nobody waits for."""
        with self._changed:
            self._commands.append((unit, function, data))
            self._changed.notify()

    def reset(self) -> None:
        """Close the connection and open it again."""
        with self._changed:
            self._reset = True
            for signal in self._signals:
                signal.requested = True
            self._changed.notify()

    def end(self) -> None:
        """Let the thread end after the request that it is at, and close the connection."""
        with self._changed:
            self._ended = True
            self._changed.notify()

    def close(self) -> None:
        """End it, and wait for that."""
        self.end()
        self._thread.join(2.0 * ANSWER_TIMEOUT)

    def _run(self) -> None:
        from pymodbus.client import ModbusTcpClient

        # What it would say at each attempt, `modbus_get_error` tells.
        logging.getLogger("pymodbus").setLevel(logging.CRITICAL)
        host, port = self._address
        client: Any = ModbusTcpClient(
            host,
            port=port,
            timeout=ANSWER_TIMEOUT,
            retries=0,
            source_address=(self._source, 0),
        )
        try:
            while True:
                with self._changed:
                    self._changed.wait(self._rest())
                    if self._ended:
                        return
                    commands, reset = list(self._commands), self._reset
                    self._commands.clear()
                    self._reset = False
                if reset:
                    client.close()
                for command in commands:
                    _send(client, *command)
                now = time.monotonic()
                for signal in self._signals:
                    if signal.requested or (signal.frequency > 0 and signal.due <= now):
                        self._serve(client, signal)
        finally:
            client.close()

    def _rest(self) -> float:
        """Seconds until something is to be done."""
        if self._ended or self._reset or self._commands:
            return 0.0
        cyclic = [signal.due for signal in self._signals if signal.frequency > 0]
        if any(signal.requested for signal in self._signals):
            return 0.0
        return max(0.0, min(cyclic) - time.monotonic()) if cyclic else 60.0

    def _serve(self, client: Any, signal: Signal) -> None:
        signal.requested = False
        wanted = signal.wanted
        before = signal.answer
        values = before.values
        device = connection = 0
        try:
            found = _exchange(client, signal, wanted)
        except Exception as error:  # pymodbus' own, and those of sockets, have no common class
            log.info("Modbus unit %s:%d: %s", *self._address, error)
            connection = errno.ETIMEDOUT if client.connected else DISCONNECTED
            client.close()  # an answer that is late must not be taken for the next one
        else:
            if found.isError():
                device = found.exception_code
            else:
                writes_alone = wanted is not None and signal.written is None
                values = wanted if writes_alone else _values(found, signal)
        now = time.monotonic()
        valid = before.valid_time if device or connection else now
        signal.answer = Answer(values, valid, device, connection, before.count + 1)
        period = 1.0 / signal.frequency if signal.frequency > 0 else 0.0
        signal.due = max(signal.due + period, now)
        if connection:
            signal.due = now + max(period, RETRY_PERIOD)


def _exchange(client: Any, signal: Signal, wanted: tuple[int, ...] | None) -> Any:
    kind, unit = signal.kind, signal.unit
    if wanted is None or kind.write is None:
        read = getattr(client, kind.read)
        return read(signal.address, count=signal.count, device_id=unit)
    if signal.written is not None:
        return getattr(client, kind.write)(
            read_address=signal.address,
            read_count=signal.count,
            write_address=signal.written[0],
            values=list(wanted),
            device_id=unit,
        )
    if kind.write_single and signal.count == 1:
        return getattr(client, kind.write_single)(signal.address, wanted[0], device_id=unit)
    values = [bool(value) for value in wanted] if kind.bits else list(wanted)
    return getattr(client, kind.write)(signal.address, values, device_id=unit)


def _values(answer: Any, signal: Signal) -> tuple[int, ...]:
    found = answer.bits if signal.kind.bits else answer.registers
    return tuple(int(value) for value in found[: signal.count])


def _send(client: Any, unit: int, function: int, data: bytes) -> None:
    from pymodbus.pdu import ModbusPDU

    class Command(ModbusPDU):
        """A request with the given function and data."""

        function_code = function

        @override
        def encode(self) -> bytes:
            return data

    with contextlib.suppress(Exception):  # its fate is not reported
        client.execute(True, Command(dev_id=unit))
    client.close()  # with the answer, which would be taken for that of the next request


class ModbusUnits:
    """The units that the controller talks to, by address as programs write it.

    Args:
        source: address of the robot.
        own_port: where its own Modbus server is, which its programs find at 127.0.0.1.
    """

    def __init__(self, source: str, own_port: int | None = None) -> None:
        self._source = source
        self._own_port = own_port
        self._connections: dict[str, UnitConnection] = {}
        self._by_name: dict[str, tuple[Signal, UnitConnection]] = {}

    def connection(self, address: str) -> UnitConnection:
        """The connection to ``host`` or ``host:port``, begun when it is new.

        Raises:
            OverflowError: there are too many.
        """
        if address not in self._connections:
            if len(self._connections) >= _CONNECTIONS:
                raise OverflowError(f"more than {_CONNECTIONS} Modbus units")
            host, _, text = address.partition(":")
            port = int(text or PORT)
            if address == "127.0.0.1" and self._own_port is not None:
                host, port = self._source, self._own_port
            self._connections[address] = UnitConnection(host, port, self._source)
        return self._connections[address]

    def add(self, address: str, signal: Signal) -> None:
        """Serve a signal; one of the same name is replaced."""
        connection = self.connection(address)
        connection.set_signals([*connection.signals, signal])
        self.delete(signal.name)
        self._by_name[signal.name] = signal, connection

    def delete(self, name: str) -> None:
        """Serve a signal no more; nothing happens when there is none."""
        if name not in self._by_name:
            return
        signal, connection = self._by_name.pop(name)
        connection.set_signals([other for other in connection.signals if other is not signal])
        if not connection.signals:
            connection.end()
            self._connections = {
                address: other
                for address, other in self._connections.items()
                if other is not connection
            }

    def find(self, name: str) -> tuple[Signal, UnitConnection] | None:
        """A signal and its connection."""
        return self._by_name.get(name)

    @property
    def count(self) -> int:
        """How many signals there are."""
        return len(self._by_name)

    def known(self, address: str) -> bool:
        """Whether there is a connection to this address."""
        return address in self._connections

    def close(self) -> None:
        """End every connection."""
        for connection in self._connections.values():
            connection.close()
        self._connections.clear()
        self._by_name.clear()

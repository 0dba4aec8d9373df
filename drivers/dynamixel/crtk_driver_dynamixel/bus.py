"""The servos on one port: instructions to one of them, and groups that are read and written as one."""

from __future__ import annotations

import random
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Final, NamedTuple

from crtk_driver_dynamixel import protocol2
from crtk_driver_dynamixel.groups import GroupRead, GroupResult, GroupWrite, Item
from crtk_driver_dynamixel.line import Line, LineCounters
from crtk_driver_dynamixel.matching import Slot
from crtk_driver_dynamixel.protocols import PROTOCOLS, Codec
from crtk_driver_dynamixel.replies import (
    Counters,
    Failure,
    Reply,
    ServoCorrupt,
    ServoSilent,
    failure_error,
)
from crtk_drivers.kit.serial_port import SerialPort

BROADCAST: Final = protocol2.BROADCAST
SETTLING: Final = range(36, 47)
"""Bytes of which a servo is asked for some first, from address 0 on: no other read is as long, and of each
model the control table goes on for longer."""
_PING_LENGTH: Final = MappingProxyType({1: 0, 2: 3})


@dataclass(frozen=True, slots=True)
class ServoLink:
    """How one servo is spoken to.

    Attributes:
        protocol: 2 or 1.
        return_delay: seconds between a request and its reply: Return Delay Time, 2 µs a count.
        answers_writes: whether its Status Return Level is 2.
    """

    protocol: int = 2
    return_delay: float = 250 * 2e-6
    answers_writes: bool = True


_FACTORY_LINK: Final = ServoLink()


class Ping(NamedTuple):
    """What a ping tells; protocol 1.0 tells neither model nor firmware (0), which are then read."""

    id: int
    model: int
    firmware: int
    alert: bool


class Bus:
    """The servos on one port. Not thread-safe: it belongs to one thread.

    Args:
        port: open whenever the bus is used.
        links: of servos that are not as they left the factory; see `set_link`.
        latency_budget: seconds allowed to adapter and operating system. An adapter whose latency timer is
            known to be longer gets that and 2 ms.
        clock: monotonic seconds.
    """

    def __init__(
        self,
        port: SerialPort,
        links: Mapping[int, ServoLink] | None = None,
        *,
        latency_budget: float = 0.004,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.port = port
        self.line = Line(port, clock)
        self.revision = 0
        """Changes whenever deadlines do."""
        self._links = dict(links or {})
        self._latency_budget = latency_budget

    def open(self) -> None:
        """Open the port, or open it anew after the adapter was unplugged.

        Raises:
            ConnectionFailed: it cannot be opened.
        """
        self.port.open()
        self.line.reopened()
        self.revision += 1

    def close(self) -> None:
        """Close the port. May be called twice."""
        self.port.close()

    def set_baud(self, baud: int) -> None:
        """Change the rate of the port (not of the servos).

        Raises:
            DeviceError: the adapter does not take it.
        """
        self.port.set_baud(baud)
        self.line.forget()
        self.revision += 1

    # How servos are spoken to

    @property
    def latency_budget(self) -> float:
        """Seconds allowed to adapter and operating system."""
        timer = self.port.latency.milliseconds
        return max(self._latency_budget, 0.0 if timer is None else (timer + 2) * 1e-3)

    @latency_budget.setter
    def latency_budget(self, seconds: float) -> None:
        self._latency_budget = seconds
        self.revision += 1

    def link(self, id: int) -> ServoLink:
        """Return how a servo is spoken to."""
        return self._links.get(id, _FACTORY_LINK)

    def set_link(self, id: int, **changes: Any) -> None:
        """Change attributes of a servo's `ServoLink`, after its registers were read or written."""
        self._links[id] = replace(self.link(id), **changes)
        self.revision += 1

    def slot(self, id: int, length: int, patience: float = 0.0) -> Slot:
        """Return the reply with `length` bytes that is expected of a servo."""
        link = self.link(id)
        size = PROTOCOLS[link.protocol].status_size(length)
        return Slot(
            id,
            length,
            size,
            link.return_delay + self.port.wire_time(size) + self.latency_budget + patience,
            keeps_data=link.protocol == 1,
        )

    def counters(self, id: int) -> Counters:
        """Return the counters of a servo, which go on counting."""
        return self.line.servo(id)

    @property
    def line_counters(self) -> LineCounters:
        """What happened on the line so far."""
        return self.line.counters

    # One servo

    def settle(self, id: int) -> None:
        """Let what servos still owe whoever used the line before come.

        A status tells only its servo and its length, so that it would be taken for an answer to us: 12.0 V
        and a temperature for the model number 120. Since bytes do not overtake each other, all of it has come
        before a reply that is like none of them. What was answered before this says nothing.

        Raises:
            ServoSilent, ServoCorrupt, ServoRefused: there is no such reply.
        """
        self.read(id, 0, random.choice(SETTLING))

    def ping(self, id: int, *, attempts: int = 2) -> Ping:
        """Ask a servo whether it is there.

        Raises:
            ServoSilent, ServoCorrupt: there is no intelligible answer.
        """
        request = self._codec(id).ping(id)
        length = _PING_LENGTH[self.link(id).protocol]
        reply = self._ask(id, request, length, "ping", attempts)
        data = reply.data or bytes(3)
        return Ping(id, int.from_bytes(data[:2], "little"), data[2], reply.alert)

    def ping_many(self, ids: Iterable[int], *, attempts: int = 1) -> list[Ping]:
        """Return what those of `ids` tell that answer."""
        found = []
        for id in ids:
            try:
                found.append(self.ping(id, attempts=attempts))
            except (ServoSilent, ServoCorrupt):
                continue
        return found

    def read(self, id: int, address: int, length: int, *, attempts: int = 2) -> bytes:
        """Return `length` bytes from `address` of a servo.

        Raises:
            ServoSilent, ServoCorrupt, ServoRefused: there is no such answer.
        """
        return self.read_reply(id, address, length, attempts=attempts).data or b""

    def read_reply(self, id: int, address: int, length: int, *, attempts: int = 2) -> Reply:
        """Return the reply to a read, alert included.

        Raises:
            ServoSilent, ServoCorrupt, ServoRefused: there is no such answer.
        """
        request = self._codec(id).read(id, address, length)
        return self._ask(id, request, length, f"read of {length} bytes at {address}", attempts)

    def write(
        self, id: int, address: int, data: bytes, *, attempts: int = 2, patience: float = 0.02
    ) -> None:
        """Write to a servo, or to all (`BROADCAST`), which do not answer.

        Args:
            patience: seconds more than usual in which it may answer: EEPROM takes its time.

        Raises:
            ServoSilent, ServoCorrupt, ServoRefused: there is no answer that it was done.
        """
        request = self._codec(id).write(id, address, data)
        self._command(id, request, f"write of {data.hex(' ')} at {address}", attempts, patience)

    def reboot(self, id: int) -> None:
        """Restart: torque goes off, the hardware error is cleared, RAM is reset; raises as `write`."""
        self._command(id, self._codec(id).reboot(id), "reboot")

    # Several servos

    def sync_group(
        self, ids: Sequence[int], address: int, length: int, *, fast: bool = False
    ) -> GroupRead:
        """Prepare to read the same range of several servos of protocol 2.0, over and over."""
        return GroupRead(
            self, [Item(id, address, length) for id in ids], same_range=True, fast=fast
        )

    def bulk_group(self, items: Sequence[tuple[int, int, int]], *, fast: bool = False) -> GroupRead:
        """Prepare to read (id, address, length) of several servos of one protocol, over and over."""
        return GroupRead(self, [Item(*item) for item in items], fast=fast)

    def single_group(self, items: Sequence[tuple[int, int, int]]) -> GroupRead:
        """Prepare to read (id, address, length) of servos one by one, over and over."""
        return GroupRead(self, [Item(*item) for item in items], one_by_one=True)

    def write_group(self, ids: Sequence[int], address: int, length: int) -> GroupWrite:
        """Prepare to write the same range of several servos of one protocol, over and over."""
        return GroupWrite(self, ids, address, length)

    def sync_read(self, ids: Sequence[int], address: int, length: int) -> GroupResult:
        """Read the same range of several servos once."""
        return self.sync_group(ids, address, length).run()

    def fast_sync_read(self, ids: Sequence[int], address: int, length: int) -> GroupResult:
        """Read the same range of several servos once, in one reply."""
        return self.sync_group(ids, address, length, fast=True).run()

    def bulk_read(self, items: Sequence[tuple[int, int, int]]) -> GroupResult:
        """Read (id, address, length) of several servos once."""
        return self.bulk_group(items).run()

    def fast_bulk_read(self, items: Sequence[tuple[int, int, int]]) -> GroupResult:
        """Read (id, address, length) of several servos once, in one reply."""
        return self.bulk_group(items, fast=True).run()

    def sync_write(self, address: int, length: int, values: Mapping[int, bytes]) -> None:
        """Write the same range of several servos of one protocol; nobody answers."""
        codec = PROTOCOLS[self.common_protocol(list(values))]
        self.line.send(codec.sync_write(address, length, values))

    def common_protocol(self, ids: Sequence[int]) -> int:
        """Return the protocol of servos.

        Raises:
            ValueError: they do not have the same.
        """
        protocols = {self.link(id).protocol for id in ids}
        if len(protocols) != 1:
            raise ValueError(f"servos of one protocol can be asked at once, not {list(ids)}")
        return protocols.pop()

    def _codec(self, id: int) -> Codec:
        return PROTOCOLS[self.link(id).protocol]

    def _command(
        self, id: int, request: bytes, what: str, attempts: int = 1, patience: float = 0.0
    ) -> None:
        if id == BROADCAST or not self.link(id).answers_writes:
            self.line.send(request)
        else:
            self._ask(id, request, 0, what, attempts, patience)

    def _ask(
        self,
        id: int,
        request: bytes,
        length: int,
        what: str,
        attempts: int,
        patience: float = 0.0,
    ) -> Reply:
        slots = [self.slot(id, length, patience)]
        protocol = self.link(id).protocol
        for attempt in range(attempts):
            (reply,) = self.line.ask(protocol, request, slots, again=attempt > 0)
            if reply.failure is None:
                return reply
            if reply.failure is Failure.REFUSED:
                break
        raise failure_error(reply, what, self.port.where, protocol)

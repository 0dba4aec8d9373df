"""The same registers of many servos, by as few requests as their models allow.

What is asked for is named by roles (``position``, ``torque``), since models have different names, places and
codings for one thing. Servos of one bus and protocol are asked at once: by a sync read if their registers lie
at the same place, else by a bulk read; protocol 1.0 one by one.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from crtk_driver_dynamixel.bus import Bus
from crtk_driver_dynamixel.control_tables import Coding, Item
from crtk_driver_dynamixel.groups import GroupRead, GroupResult
from crtk_driver_dynamixel.servo_state import ServoState
from crtk_driver_dynamixel.units import Counts, decoded, read_number, record


class Member(NamedTuple):
    """One servo that is read.

    Attributes:
        place: in the chain.
        items: by role; what it does not have is left out.
    """

    place: int
    items: Mapping[str, Item]


class _Layout(NamedTuple):
    """Where the roles lie: servos of one layout are decoded at once."""

    address: int
    length: int
    roles: tuple[tuple[str, int, int, Coding], ...]


@dataclass(frozen=True, slots=True)
class _Part:
    """The servos of one layout in a request.

    Attributes:
        places: of the servos.
        first: index of the first of them among the replies.
        offset: of its data in those of all.
        dtype: of the data of one, a field for each role.
        codings: by role.
    """

    places: NDArray[np.int64]
    first: int
    offset: int
    dtype: np.dtype[Any]
    codings: Mapping[str, Coding]


@dataclass(frozen=True, slots=True)
class _Request:
    read: GroupRead
    members: tuple[Member, ...]
    parts: tuple[_Part, ...]
    starts: tuple[int, ...]


class BlockReads:
    """Prepared reads of the same roles of several servos.

    Args:
        buses: by name.
        states: of all servos of the chain.
        members: whom to read, and what.
        fast: use fast sync and fast bulk reads where all servos of a request have them.
    """

    def __init__(
        self,
        buses: Mapping[str, Bus],
        states: Sequence[ServoState],
        members: Iterable[Member],
        *,
        fast: bool,
    ) -> None:
        by_bus: dict[tuple[str, int], list[Member]] = defaultdict(list)
        for member in members:
            servo = states[member.place].servo
            by_bus[servo.bus, servo.protocol].append(member)
        self._requests = [
            _request(buses[name], protocol, states, listed, fast)
            for (name, protocol), listed in by_bus.items()
        ]

    def run(self) -> Iterator[tuple[Mapping[str, Item], int, int, bytes | None, bool, int]]:
        """Read once, one servo at a time.

        Yields:
            items, first address, place, data or None, whether it alerts, hardware error bits with the status.

        Raises:
            ConnectionLost: an adapter is gone.
        """
        for request in self._requests:
            result = request.read.run()
            for member, start, reply in zip(
                request.members, request.starts, result.replies, strict=True
            ):
                yield (
                    member.items,
                    start,
                    member.place,
                    reply.data,
                    reply.alert,
                    reply.hardware,
                )

    def read_into(self, columns: Mapping[str, Counts], valid: NDArray[np.bool_]) -> bool:
        """Read once, into arrays (servos,) by role; of servos that do not answer they stay as they are.

        Args:
            columns: to be changed.
            valid: (servos,) set for those that answer.

        Returns:
            whether any servo reports a hardware error.

        Raises:
            ConnectionLost: an adapter is gone.
        """
        alert = False
        for request in self._requests:
            result = request.read.run()
            alert = alert or result.alert
            for part in request.parts:
                _decode(part, result, columns, valid)
        return alert


def values_of(items: Mapping[str, Item], first: int, data: bytes) -> dict[str, int]:
    """Return the numbers of a block by role."""
    return {role: read_number(data, item, item.address - first) for role, item in items.items()}


def _decode(
    part: _Part, result: GroupResult, columns: Mapping[str, Counts], valid: NDArray[np.bool_]
) -> None:
    count, places = len(part.places), part.places
    block = np.frombuffer(result.block, part.dtype, count, part.offset)
    if not result.complete:
        replies = result.replies[part.first : part.first + count]
        answered = np.array([reply.data is not None for reply in replies])
        block, places = block[answered], places[answered]
    for role, coding in part.codings.items():
        columns[role][places] = decoded(block[role], coding)
    valid[places] = True


def _request(
    bus: Bus, protocol: int, states: Sequence[ServoState], listed: Sequence[Member], fast: bool
) -> _Request:
    by_layout: dict[_Layout, list[Member]] = defaultdict(list)
    for member in listed:
        by_layout[_layout(member.items)].append(member)
    members = [member for group in by_layout.values() for member in group]
    items = [
        (states[member.place].servo.id, layout.address, layout.length)
        for layout, group in by_layout.items()
        for member in group
    ]
    fast = fast and all(
        states[m.place].servo.units.model.has_fast_read(states[m.place].firmware) for m in members
    )
    ranges = {(address, length) for _, address, length in items}
    if protocol == 1:
        read = bus.single_group(items)
    elif len(ranges) == 1:
        ((address, length),) = ranges
        read = bus.sync_group([id for id, _, _ in items], address, length, fast=fast)
    else:
        read = bus.bulk_group(items, fast=fast)
    parts, first, offset = [], 0, 0
    for layout, group in by_layout.items():
        parts.append(_part(layout, group, first, offset))
        first, offset = first + len(group), offset + len(group) * layout.length
    return _Request(read, tuple(members), tuple(parts), tuple(address for _, address, _ in items))


def _layout(items: Mapping[str, Item]) -> _Layout:
    address = min(item.address for item in items.values())
    length = max(item.end for item in items.values()) - address
    roles = tuple((role, i.address, i.size, i.coding) for role, i in sorted(items.items()))
    return _Layout(address, length, roles)


def _part(layout: _Layout, group: Sequence[Member], first: int, offset: int) -> _Part:
    items = [Item(role, address, size, coding) for role, address, size, coding in layout.roles]
    return _Part(
        np.array([member.place for member in group]),
        first,
        offset,
        record(items, layout.address, layout.length),
        {item.name: item.coding for item in items},
    )

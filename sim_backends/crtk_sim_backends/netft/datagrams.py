"""Ways in which datagrams go wrong on their way to the client: each takes one and returns what arrives."""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Callable, Iterable
from typing import TypeAlias

DatagramHook: TypeAlias = Callable[[bytes], list[bytes]]


def every_nth(every: int, change: Callable[[bytes], list[bytes]]) -> DatagramHook:
    """Change every `every`-th datagram and leave the others alone."""
    seen = 0

    def hook(data: bytes) -> list[bytes]:
        nonlocal seen
        seen += 1
        return change(data) if seen % every == 0 else [data]

    return hook


def lose(every: int, burst: int) -> DatagramHook:
    """Lose the last `burst` of every `every` datagrams."""
    seen = 0

    def hook(data: bytes) -> list[bytes]:
        nonlocal seen
        seen += 1
        return [] if (seen - 1) % every >= every - burst else [data]

    return hook


def duplicate(every: int) -> DatagramHook:
    """Send every n-th datagram twice."""
    return every_nth(every, lambda data: [data, data])


def late(every: int, by: int) -> DatagramHook:
    """Let `by` later datagrams overtake every `every`-th one."""
    seen = 0
    held: deque[tuple[int, bytes]] = deque()

    def hook(data: bytes) -> list[bytes]:
        nonlocal seen
        seen += 1
        found = [data]
        if seen % every == 0:
            held.append((seen + by, data))
            found = []
        while held and held[0][0] <= seen:
            found.append(held.popleft()[1])
        return found

    return hook


def corrupt(every: int, seed: int) -> DatagramHook:
    """Change one random byte in every `every`-th datagram, the same ones for one `seed`."""
    generator = random.Random(seed)

    def change(data: bytes) -> list[bytes]:
        changed = bytearray(data)
        changed[generator.randrange(len(data))] ^= generator.randrange(1, 256)
        return [bytes(changed)]

    return every_nth(every, change)


def cut(every: int, size: int) -> DatagramHook:
    """Cut every `every`-th datagram to `size` bytes."""
    return every_nth(every, lambda data: [data[:size]])


def lengthen(every: int, size: int) -> DatagramHook:
    """Hang `size` zero bytes on every `every`-th datagram."""
    return every_nth(every, lambda data: [data + bytes(size)])


def empty(every: int) -> DatagramHook:
    """Send an empty datagram before every `every`-th one."""
    return every_nth(every, lambda data: [b"", data])


def through(hooks: Iterable[DatagramHook], datagrams: Iterable[bytes]) -> list[bytes]:
    """Pass datagrams through all hooks in turn."""
    found = list(datagrams)
    for hook in hooks:
        found = [piece for data in found for piece in hook(data)]
    return found

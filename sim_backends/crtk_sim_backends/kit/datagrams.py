"""Ways in which datagrams go wrong on their way to the client: each takes one and returns what arrives."""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final, TypeAlias

from crtk_sim_backends.faults import FaultKind, Parameter

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


class Late:
    """Lets `by` later datagrams overtake every `every`-th one."""

    def __init__(self, every: int, by: int) -> None:
        self._every, self._by = every, by
        self._seen = 0
        self._held: deque[tuple[int, bytes]] = deque()

    def __call__(self, data: bytes) -> list[bytes]:
        """Return what arrives when this one is sent."""
        self._seen += 1
        found = [data]
        if self._seen % self._every == 0:
            self._held.append((self._seen + self._by, data))
            found = []
        while self._held and self._held[0][0] <= self._seen:
            found.append(self._held.popleft()[1])
        return found

    @property
    def held(self) -> list[bytes]:
        """Those that have not arrived yet."""
        return [data for _, data in self._held]


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


EVERY: Final = Parameter(int, 10, minimum=1)

STREAM: Final[Mapping[str, Callable[[Mapping[str, Any]], DatagramHook]]] = {
    "loss": lambda p: lose(p["every"], p["burst"]),
    "duplicate": lambda p: duplicate(p["every"]),
    "late": lambda p: Late(p["every"], p["by"]),
    "corrupt": lambda p: corrupt(p["every"], p["seed"]),
    "short": lambda p: cut(p["every"], p["size"]),
    "long": lambda p: lengthen(p["every"], p["size"]),
    "empty": lambda p: empty(p["every"]),
}
"""What the kinds of `STREAM_KINDS` do, by name."""


class FaultyWay:
    """The way of a stream to its client, with the faults that are on it."""

    def __init__(self) -> None:
        self._hooks: dict[str, DatagramHook] = {}
        self._left: list[bytes] = []

    @property
    def is_plain(self) -> bool:
        """Whether datagrams arrive just as they are."""
        return not self._hooks and not self._left

    def begin(self, kind: str, hook: DatagramHook) -> None:
        """Let a fault begin, in place of one of its kind."""
        self.end(kind)
        self._hooks[kind] = hook

    def end(self, kind: str) -> None:
        """Let it end, if it was there; what is late by it arrives with what is sent next."""
        hook = self._hooks.pop(kind, None)
        if isinstance(hook, Late):
            self._left += hook.held

    def through(self, datagrams: Iterable[bytes]) -> list[bytes]:
        """Return what arrives of them."""
        found = list(datagrams)
        for hook in self._hooks.values():
            found = [piece for data in found for piece in hook(data)]
        left, self._left = self._left, []
        return left + found


def _kind(name: str, summary: str, **parameters: Parameter) -> FaultKind:
    return FaultKind(name, summary, {"every": EVERY, **parameters}, lasting=True)


STREAM_KINDS: Final[Mapping[str, FaultKind]] = {
    kind.name: kind
    for kind in (
        _kind(
            "loss",
            "the last `burst` of every n datagrams are lost",
            burst=Parameter(int, 1, minimum=1),
        ),
        _kind("duplicate", "every n-th datagram comes twice"),
        _kind(
            "late",
            "every n-th datagram is overtaken by later ones",
            by=Parameter(int, 2, minimum=1, maximum=10_000),
        ),
        _kind(
            "corrupt", "a byte of every n-th datagram is changed", seed=Parameter(int, 0, minimum=0)
        ),
        _kind(
            "short", "every n-th datagram is cut", size=Parameter(int, 20, minimum=0, maximum=1439)
        ),
        _kind(
            "long",
            "every n-th datagram is too long",
            size=Parameter(int, 4, minimum=1, maximum=60_000),
        ),
        _kind("empty", "an empty datagram comes before every n-th one"),
    )
}
"""Kinds that change the datagrams of a stream, by name."""

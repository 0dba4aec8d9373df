"""The faults that a CAN bus can have, as a table for fault files and injection.

The kinds of `HOOKS` happen to frames on their way to the bus, those of `STATES` to the interfaces of
nodes, `babbling` and `error_frames` add frames. Nodes are named by shell patterns, such as ``drive-*``; the
status of the hub names those that there are. Clients are called native (or as they have asked for),
socketcand and slcan, with a number from the second one on.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping
from fnmatch import fnmatchcase
from typing import Any, Final, TypeAlias

from crtk_sim_backends import wire
from crtk_sim_backends.can import frames
from crtk_sim_backends.can.port import State
from crtk_sim_backends.faults import FaultKind, Parameter
from crtk_sim_backends.wire import Direction, Pieces, WireHook

Parameters = Mapping[str, Any]

FrameHook: TypeAlias = Callable[[str, bytes, float], Pieces]
"""``hook(sender, frame, now) -> [(delay, frame), ...]``: what really goes onto the bus, and when."""

EVENTS: Final = ("client_connected", "first_frame", "replay_ended")
"""What an entry of a fault file can wait for with `when`."""

ANY_ID: Final = -1
PLACES: Final = ("node", "sender", "id")
"""Parameters that say where a fault is; there it replaces another one of its kind."""

_EVERY: Final = Parameter(int, 1, minimum=1)
_SEED: Final = Parameter(int, 0)
_NODE: Final = Parameter(str, "*")
_ID: Final = Parameter(int, ANY_ID, minimum=ANY_ID, maximum=frames.EXTENDED_MASK)
_MATCH: Final = {
    "sender": Parameter(str, "*"),
    "id": _ID,
    "mask": Parameter(int, frames.EXTENDED_MASK, minimum=0, maximum=frames.EXTENDED_MASK),
}


def duplicate(every: int) -> WireHook:
    """Send every `every`-th frame twice."""
    seen = 0

    def hook(direction: Direction, data: bytes, now: float) -> Pieces:
        nonlocal seen
        seen += 1
        return [(0.0, data)] * (1 if seen % every else 2)

    return hook


def single(effect: str, number: int, seconds: float) -> WireHook:
    """Lose the frame with this `number`, send it twice, or let it be late; all others pass."""
    seen = 0

    def hook(direction: Direction, data: bytes, now: float) -> Pieces:
        nonlocal seen
        seen += 1
        return _EFFECTS[effect](data, seconds) if seen == number else [(0.0, data)]

    return hook


_EFFECTS: Final[Mapping[str, Callable[[bytes, float], Pieces]]] = {
    "lost": lambda data, seconds: [],
    "doubled": lambda data, seconds: [(0.0, data)] * 2,
    "late": lambda data, seconds: [(seconds, data)],
}


def corrupt(what: str, every: int, seed: int) -> WireHook:
    """Change one bit of the data, or of the identifier, of every `every`-th frame."""
    generator = random.Random(seed)
    seen = 0

    def hook(direction: Direction, data: bytes, now: float) -> Pieces:
        nonlocal seen
        seen += 1
        return [(0.0, data if seen % every else _CHANGES[what](data, generator))]

    return hook


def _change_id(raw: bytes, generator: random.Random) -> bytes:
    can_id, data = frames.unpack(raw)
    return frames.pack(
        can_id ^ 1 << generator.randrange(29 if can_id & frames.EXTENDED else 11), data
    )


def _change_data(raw: bytes, generator: random.Random) -> bytes:
    can_id, data = frames.unpack(raw)
    if not data or can_id & frames.REMOTE:
        return raw
    changed = bytearray(data)
    changed[generator.randrange(len(data))] ^= 1 << generator.randrange(8)
    return frames.pack(can_id, bytes(changed))


_CHANGES: Final[Mapping[str, Callable[[bytes, random.Random], bytes]]] = {
    "id": _change_id,
    "data": _change_data,
}

HOOKS: Final[Mapping[str, Callable[[Parameters], WireHook]]] = {
    "drop": lambda p: wire.drop(p["every"]),
    "duplicate": lambda p: duplicate(p["every"]),
    "delay": lambda p: wire.delay(p["seconds"]),
    "corrupt": lambda p: corrupt(p["what"], p["every"], p["seed"]),
    "message": lambda p: single(p["effect"], p["number"], p["seconds"]),
}
"""Kinds that change the frames of some senders and identifiers, by name."""

STATES: Final = {
    "down": State.DOWN,
    "bus_off": State.BUS_OFF,
    "full": State.FULL,
    "listen_only": State.LISTEN_ONLY,
    "error_passive": State.PASSIVE,
}
"""Kinds that are a state of some nodes, by name."""

ERROR_FRAMES: Final = {
    "protocol": frames.ERROR_PROTOCOL | frames.ERROR_BUS,
    "no_ack": frames.ERROR_NO_ACK | frames.ERROR_BUS,
    "controller": frames.ERROR_CONTROLLER,
}
"""Classes of the error frames that the kind `error_frames` sends, by name."""


def selecting(hook: WireHook, parameters: Parameters) -> FrameHook:
    """Apply `hook` to the frames of matching senders with matching identifiers."""
    sender, number, mask = parameters["sender"], parameters["id"], parameters["mask"]

    def selected(name: str, raw: bytes, now: float) -> Pieces:
        can_id = int.from_bytes(raw[:4], "little") & frames.EXTENDED_MASK
        if (number != ANY_ID and (can_id ^ number) & mask) or not fnmatchcase(name, sender):
            return [(0.0, raw)]
        return hook(Direction.IN, raw, now)

    return selected


def _frame_kind(name: str, summary: str, **parameters: Parameter) -> FaultKind:
    return FaultKind(name, summary, {**_MATCH, **parameters}, lasting=True)


def _node_kind(name: str, summary: str) -> FaultKind:
    return FaultKind(name, summary, {"node": _NODE}, lasting=True)


KINDS: Final[Mapping[str, FaultKind]] = {
    kind.name: kind
    for kind in (
        _frame_kind("drop", "every n-th frame is lost", every=_EVERY),
        _frame_kind("duplicate", "every n-th frame is sent twice", every=_EVERY),
        _frame_kind(
            "delay",
            "frames are late (s)",
            seconds=Parameter(float, minimum=0.0001, maximum=3600.0),
        ),
        _frame_kind(
            "corrupt",
            "a bit of every n-th frame is changed",
            what=Parameter(str, "data", choices=tuple(_CHANGES)),
            every=_EVERY,
            seed=_SEED,
        ),
        _frame_kind(
            "message",
            "the n-th frame, and only that, is lost, sent twice, or late",
            effect=Parameter(str, "lost", choices=tuple(_EFFECTS)),
            number=Parameter(int, 1, minimum=1),
            seconds=Parameter(float, 0.03, minimum=0.0001, maximum=3600.0),
        ),
        _node_kind("down", "the interface is down: ENETDOWN"),
        _node_kind("bus_off", "the controller is bus-off; cleared: restarted"),
        _node_kind("full", "the transmit queue takes nothing: ENOBUFS"),
        _node_kind("listen_only", "the node only listens, what it sends is lost"),
        _node_kind("error_passive", "the controller is error passive"),
        FaultKind(
            "babbling",
            "a node sends all the time",
            {
                "id": Parameter(int, 0, minimum=0, maximum=frames.STANDARD_MASK),
                "rate": Parameter(float, 2000.0, minimum=0.1, maximum=20000.0),
                "length": Parameter(int, 8, minimum=0, maximum=frames.MAX_DATA),
            },
            lasting=True,
        ),
        FaultKind(
            "error_frames",
            "error frames on the bus",
            {
                "rate": Parameter(float, 10.0, minimum=0.1, maximum=20000.0),
                "what": Parameter(str, "protocol", choices=tuple(ERROR_FRAMES)),
            },
            lasting=True,
        ),
    )
}
"""Every kind of fault, by name."""

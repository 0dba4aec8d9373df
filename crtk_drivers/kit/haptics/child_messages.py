"""What goes between a driver and the process that moves its haptic device: packed numbers, and JSON."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping, Sequence
from enum import Enum, IntFlag
from typing import Any, Final, NamedTuple

from crtk_drivers.kit.haptics.fixtures import Motion
from crtk_drivers.kit.haptics.triples import ZERO, Triple

__all__ = ["Flags", "Kind", "State", "order", "order_of", "state_of", "text", "text_of"]


class Kind(bytes, Enum):
    """The first byte of a message."""

    # to the process
    OPEN = b"O"
    ENABLE = b"E"
    DISABLE = b"D"
    PAUSE = b"Z"
    STOP = b"S"
    HOME = b"H"
    UNHOME = b"U"
    GRAVITY = b"G"
    WRENCH = b"W"
    POSE = b"P"
    GRIP = b"J"
    FIXTURES = b"F"
    ALIVE = b"A"
    # to the driver
    STATE = b"s"
    OPENED = b"o"
    FAILED = b"f"
    REPLY = b"r"
    WITHDRAWN = b"w"


class Flags(IntFlag):
    """What is so now."""

    NONE = 0
    INITIALIZED = 1
    ENABLED = 2
    HOMING = 4
    SATURATED = 8
    WEIGHTLESS = 16


class State(NamedTuple):
    """What the process tells of a cycle.

    Attributes:
        time: monotonic s at which it was read.
        motion: of the hand.
        force, torque: N, N·m, that the device makes.
        gripper, gripper_speed, gripper_force: rad, rad/s, N.
        buttons: a bit each.
        flags: see `Flags`.
        done: number of the order that was carried out last.
        counts: cycles, late ones, forces of fixtures that were reduced, ends by the watchdog, silences of
            the driver.
        longest: s, the longest cycle so far.
    """

    time: float
    motion: Motion
    force: Triple = ZERO
    torque: Triple = ZERO
    gripper: float = 0.0
    gripper_speed: float = 0.0
    gripper_force: float = 0.0
    buttons: int = 0
    flags: Flags = Flags.NONE
    done: int = 0
    counts: tuple[int, ...] = (0, 0, 0, 0, 0)
    longest: float = 0.0


_ORDER: Final = struct.Struct("<cQ7d")
_STATE: Final = struct.Struct("<cd13d6d3dIIQ5Qd")
_NUMBER: Final = struct.Struct("<Q")
_NO_NUMBERS: Final = (0.0,) * 7


def order(kind: Kind, number: int, values: Sequence[float] = ()) -> bytes:
    """Return an order with up to seven numbers."""
    return _ORDER.pack(kind.value, number, *(*values, *_NO_NUMBERS[len(values) :]))


def order_of(message: bytes) -> tuple[int, tuple[float, ...]]:
    """Return number and numbers of an order.

    Raises:
        ValueError: it is none.
    """
    try:
        _, number, *values = _ORDER.unpack(message)
    except struct.error as error:
        raise ValueError(str(error)) from error
    return number, tuple(values)


def text(kind: Kind, number: int, content: Mapping[str, Any]) -> bytes:
    """Return a message with JSON."""
    return kind.value + _NUMBER.pack(number) + json.dumps(content).encode()


def text_of(message: bytes) -> tuple[int, dict[str, Any]]:
    """Return number and content of a message with JSON.

    Raises:
        ValueError: it is none.
    """
    begin = 1 + _NUMBER.size
    if len(message) < begin:
        raise ValueError("cut off")
    (number,) = _NUMBER.unpack_from(message, 1)
    content = json.loads(message[begin:])
    if not isinstance(content, dict):
        raise ValueError("no object")
    return number, content


def state(told: State) -> bytes:
    """Return the message of a state."""
    motion = told.motion
    return _STATE.pack(
        Kind.STATE.value,
        told.time,
        *motion.position,
        *motion.orientation,
        *motion.velocity,
        *motion.turning,
        *told.force,
        *told.torque,
        told.gripper,
        told.gripper_speed,
        told.gripper_force,
        told.buttons,
        told.flags,
        told.done,
        *told.counts,
        told.longest,
    )


def state_of(message: bytes) -> State:
    """Return the state of a message.

    Raises:
        ValueError: it has none.
    """
    try:
        _, time, *n = _STATE.unpack(message)
    except struct.error as error:
        raise ValueError(str(error)) from error
    motion = Motion(
        (n[0], n[1], n[2]), (n[3], n[4], n[5], n[6]), (n[7], n[8], n[9]), (n[10], n[11], n[12])
    )
    return State(
        time,
        motion,
        (n[13], n[14], n[15]),
        (n[16], n[17], n[18]),
        n[19],
        n[20],
        n[21],
        n[22],
        Flags(n[23]),
        n[24],
        tuple(n[25:30]),
        n[30],
    )

"""What the kernel tells of pedals and joysticks, by event devices and joystick devices: bytes to events.

Sources: Linux, include/uapi/linux/input.h (struct input_event), input-event-codes.h, joystick.h (struct
js_event). Both are in the machine's own byte order. The package `evdev` has the first of the two as a C
extension that must be compiled and takes real devices alone; of it a struct and two ioctls are needed here.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Final

from crtk_drivers.kit import FrameDecoder

EVENT: Final = struct.Struct("@llHHi")
"""struct input_event: time in s and µs, type, code, value."""
JS_EVENT: Final = struct.Struct("@IhBB")
"""struct js_event: time in ms, value, type, number."""

SYN: Final = 0
KEY: Final = 1
DROPPED: Final = 3
"""Code of SYN: the kernel's buffer was full, and events are missing."""
_JS_BUTTON: Final = 1
_JS_AXIS: Final = 2
_JS_INITIAL: Final = 0x80
_JS_FULL: Final = 32767.0

KEYS: Final = 96
"""Bytes of the state of all keys (KEY_MAX is 0x2ff)."""


def get_keys_request() -> int:
    """Return EVIOCGKEY: ask for the state of all keys."""
    return (2 << 30) | (KEYS << 16) | (ord("E") << 8) | 0x18


GRAB: Final = (1 << 30) | (4 << 16) | (ord("E") << 8) | 0x90
"""EVIOCGRAB: let nobody else have the events."""


@dataclass(frozen=True, slots=True)
class Press:
    """A button or key is pressed, or is not any more."""

    code: int
    pressed: bool


@dataclass(frozen=True, slots=True)
class Axis:
    """An axis is somewhere, -1 to 1."""

    number: int
    value: float


@dataclass(frozen=True, slots=True)
class Dropped:
    """Events are missing: what is pressed is not known."""


Event = Press | Axis | Dropped | None


def event_decoder() -> FrameDecoder[Event]:
    """Return what turns the bytes of an event device into events; None is one that does not matter."""
    return FrameDecoder(lambda data: EVENT.size, _event, strict=True)


def js_decoder() -> FrameDecoder[Event]:
    """Return the same for a joystick device. At the start it tells what is pressed already."""
    return FrameDecoder(lambda data: JS_EVENT.size, _js_event, strict=True)


def _event(frame: bytes) -> Event:
    _, _, kind, code, value = EVENT.unpack(frame)
    if kind == KEY:
        return Press(code, value in (1, 2))  # 2: the kernel repeats a key that is held
    if kind == SYN and code == DROPPED:
        return Dropped()
    return None


def _js_event(frame: bytes) -> Event:
    _, value, kind, number = JS_EVENT.unpack(frame)
    if kind & ~_JS_INITIAL == _JS_BUTTON:
        return Press(number, value != 0)
    if kind & ~_JS_INITIAL == _JS_AXIS:
        return Axis(number, max(-1.0, value / _JS_FULL))
    return None


def pressed_keys(state: bytes) -> frozenset[int]:
    """Return the codes that are pressed, of the answer to EVIOCGKEY: a bit a key."""
    return frozenset(
        8 * at + bit for at, byte in enumerate(state) for bit in range(8) if byte >> bit & 1
    )

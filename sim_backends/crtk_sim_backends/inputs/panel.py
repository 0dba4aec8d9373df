"""What is pressed and pushed, and how the kernel and spacenavd tell it.

Written from input.h, joystick.h and libspnav's proto.h: an event of the kernel is a time, two short and one
long number; one of the joystick device eight bytes; one of spacenavd eight int32.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Callable, Mapping
from typing import Any, Final

from crtk_sim_backends.kit import Fault, FaultKind, Parameter
from crtk_sim_backends.page import Gauge, Gauges

AXES: Final = ("x", "y", "z", "rx", "ry", "rz")
FULL: Final = 350
REPEAT_AFTER: Final = 0.25
"""Seconds for which a key is held before the kernel repeats it."""
PROTOCOL: Final = 0x7FAA5501
MOUSE_TYPE: Final = 0x7FAA2005
SPACE_NAVIGATOR: Final = 0x206

_COUNTS: Final[Mapping[str, Parameter]] = {
    axis: Parameter(int, 0, minimum=-32768, maximum=32767) for axis in AXES
}
KINDS: Final[Mapping[str, FaultKind]] = {
    kind.name: kind
    for kind in (
        FaultKind(
            "press",
            "a pedal, or the button of that number, is pressed",
            {"code": Parameter(int, 30, minimum=0, maximum=767)},
            lasting=True,
        ),
        FaultKind("push", "the mouse is pushed, in counts", _COUNTS, lasting=True),
        FaultKind("stuck", "the mouse tells nothing more", lasting=True),
        FaultKind("no_mouse", "the mouse is unplugged from the daemon's machine", lasting=True),
        FaultKind("overrun", "the kernel's buffer was full: events are missing"),
        FaultKind("garbage", "bytes that are no event"),
    )
}


class Panel:
    """All inputs."""

    kinds = KINDS

    def __init__(self) -> None:
        self.send: Callable[[str, bytes], object] = lambda name, data: None
        self.has_mouse = True
        self._pressed: dict[int, float] = {}
        self._pushed: tuple[int, ...] | None = None
        self._is_stuck = False
        self._told = 0

    # ---------------------------------------------------------------------------------- as told

    def _kernel(self, kind: int, code: int, value: int) -> None:
        seconds, micros = divmod(time.time_ns() // 1000, 1_000_000)
        self.send("evdev", struct.pack("@llHHi", seconds, micros, kind, code, value))

    def _key(self, code: int, value: int) -> None:
        if value != 2:
            self._kernel(4, 4, 0x70000 + code)
        self._kernel(1, code, value)
        self._kernel(0, 0, 0)

    def _daemon(self, *numbers: int) -> None:
        padded = (*numbers, *(0,) * (8 - len(numbers)))
        self.send("spacenavd", struct.pack("@8i", *padded))

    def _button(self, code: int, pressed: bool) -> None:
        self._told += 1
        self._key(code, int(pressed))
        milliseconds = time.monotonic_ns() // 1_000_000 & 0xFFFFFFFF
        self.send("js", struct.pack("@IhBB", milliseconds, int(pressed), 1, code & 0xFF))
        if self.has_mouse:
            self._daemon(1 if pressed else 2, code)

    def _motion(self, counts: tuple[int, ...]) -> None:
        if self._is_stuck or not self.has_mouse:
            return
        self._told += 1
        self._daemon(0, *counts, 16)
        for axis, count in enumerate(counts):
            value = max(-32767, min(32767, round(32767 * count / FULL)))
            self.send("js", struct.pack("@IhBB", 0, value, 2, axis))

    def tick(self) -> None:
        """Repeat what is held: a key as the kernel does, the mouse as it tells of itself."""
        now = time.monotonic()
        for code, since in self._pressed.items():
            if now - since > REPEAT_AFTER:
                self._key(code, 2)
        if self._pushed is not None:
            self._motion(self._pushed)

    # ----------------------------------------------------------------------------------- its faults

    def begin(self, fault: Fault) -> None:
        """Let something be pressed, or go wrong."""
        if fault.kind == "press":
            code = fault.parameters["code"]
            self._pressed[code] = time.monotonic()
            self._button(code, True)
        elif fault.kind == "push":
            self._pushed = tuple(fault.parameters[axis] for axis in AXES)
        elif fault.kind == "stuck":
            self._is_stuck = True
        elif fault.kind == "no_mouse":
            self.has_mouse = False
            self._daemon(3, 1, 0, SPACE_NAVIGATOR)
        elif fault.kind == "overrun":
            self._kernel(0, 3, 0)
        else:
            self.send("spacenavd", struct.pack("@8i", *(-559038737,) * 8))

    def end(self, fault: Fault) -> None:
        """Let it end."""
        if fault.kind == "press":
            code = fault.parameters["code"]
            if self._pressed.pop(code, None) is not None:
                self._button(code, False)
        elif fault.kind == "push":
            self._pushed = None
            self._motion((0,) * 6)
        elif fault.kind == "stuck":
            self._is_stuck = False
        elif fault.kind == "no_mouse":
            self.has_mouse = True
            self._daemon(3, 0, 0, SPACE_NAVIGATOR)

    def status(self) -> dict[str, Any]:
        """What a test or a person wants to know."""
        return {
            "pressed": sorted(self._pressed),
            "pushed": list(self._pushed or ()),
            "told": self._told,
        }

    def gauges(self) -> list[Gauges]:
        """What the page shows."""
        counts = self._pushed or (0,) * 6
        shown: list[Gauge] = [
            {"name": axis, "low": -FULL, "high": FULL, "value": float(value)}
            for axis, value in zip(AXES, counts, strict=True)
        ]
        return [{"title": "Mouse", "unit": "counts", "rate": "", "digits": 0, "gauges": shown}]


class EventClient:
    """A client of an input device of the kernel: it reads events, and what it writes changes nothing."""

    ended = False

    def receive(self, data: bytes) -> bytes:
        """Drop what was written."""
        return b""

    def close(self) -> None:
        """Do nothing."""


class Daemon:
    """A client of spacenavd.

    Args:
        panel: with the mouse.
        protocol: that it speaks.
    """

    ended = False

    def __init__(self, panel: Panel, protocol: int) -> None:
        self._panel = panel
        self._protocol = protocol
        self._begun = False
        self._rest = b""

    def receive(self, data: bytes) -> bytes:
        """Take requests and return their answers; one of protocol 0 takes sensitivities alone."""
        if not self._protocol:
            return b""
        self._rest += data
        answer = b""
        if not self._begun and len(self._rest) >= 4:
            (word,) = struct.unpack_from("@i", self._rest)
            self._begun, self._rest = True, self._rest[4:]
            answer += struct.pack("@i", PROTOCOL) if word == PROTOCOL else b""
        while self._begun and len(self._rest) >= 32:
            kind, *_ = struct.unpack_from("@8i", self._rest)
            self._rest = self._rest[32:]
            known = kind == MOUSE_TYPE and self._panel.has_mouse
            told = (SPACE_NAVIGATOR, 0, 0, 0, 0, 0, 0) if known else (0, 0, 0, 0, 0, 0, -1)
            answer += struct.pack("@8i", kind, *told)
        return answer

    def close(self) -> None:
        """Forget an unfinished request."""
        self._rest = b""

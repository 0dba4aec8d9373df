"""Pedals, a joystick or a mouse as a CRTK device.

What is not known counts as released, and is told as not valid: a device that was unplugged, a daemon that has
ended or answers nothing, a driver whose I/O thread stands. A mouse that is pushed and falls silent is let go.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from functools import partial
from typing import Final

from typing_extensions import override

from crtk_driver_inputs import events, spacenav
from crtk_driver_inputs.config import InputsConfig
from crtk_driver_inputs.ways import FileWay, SocketWay
from crtk_drivers.commands import Payload
from crtk_drivers.device import Capabilities, Condition, Reading, Sensor, StopPolicy
from crtk_drivers.errors import ConnectionLost, CrtkError, DeviceFault
from crtk_drivers.kit import FrameDecoder
from crtk_drivers.kit.decoding import BadData
from crtk_drivers.samples import Joy, Sample, Stamp, Twist, vector
from crtk_drivers.state import OperatingState

__all__ = ["InputsDevice"]

STALE: Final = 0.25
"""Seconds after which what was read last is not known any more."""
ASK_PERIOD: Final = 0.1
"""Seconds after which spacenavd is asked whether it is alive."""
ANSWERED: Final = 0.5
"""Seconds after which one that tells nothing, and answers nothing, is not: a button may have been let go."""
NO_MOUSE: Final = "no mouse is plugged in"


class InputsDevice(Sensor):
    """One device of the kernel, or the mouse of spacenavd."""

    def __init__(self, config: InputsConfig) -> None:
        self._config = config
        self._way: FileWay | SocketWay = (
            SocketWay(config.place) if self._is_mouse else FileWay(config.place, grab=config.grab)
        )
        self._decoder = self._make_decoder()
        self._pressed: frozenset[int] = frozenset()
        self._axes: dict[int, float] = {}
        self._pushed_at = 0.0
        self._is_there = True
        self._read_at = 0.0
        self._asked_at = self._told_at = 0.0
        self._dropped = 0
        self._events = 0
        self._capabilities = Capabilities(
            measured=("measured_cv",) if self._is_mouse else (),
            rate=config.rate,
            base_frame=config.frame_id,
            tool_frame=config.frame_id,
            stop=StopPolicy(0.0, "has nothing that moves"),
        )

    @property
    def _is_mouse(self) -> bool:
        return self._config.link == "spacenavd"

    def _make_decoder(self) -> FrameDecoder[events.Event] | FrameDecoder[spacenav.Event]:
        if self._is_mouse:
            return spacenav.decoder()
        return events.js_decoder() if self._config.link == "js" else events.event_decoder()

    @property
    @override
    def capabilities(self) -> Capabilities:
        return self._capabilities

    @property
    @override
    def address(self) -> str:
        return self._config.place

    @override
    def open(self, deadline: float) -> None:
        self._release()
        self._is_there, self._decoder = True, self._make_decoder()
        told = self._way.open(deadline)
        self._asked_at = self._told_at = time.monotonic()
        self._take(told)
        if self._config.link == "evdev":
            self._look()

    @override
    def close(self) -> None:
        self._way.close()
        self._release()

    def _release(self) -> None:
        self._pressed, self._axes, self._read_at = frozenset(), {}, 0.0

    def _look(self) -> None:
        """Ask which keys are pressed now."""
        assert isinstance(self._way, FileWay)
        self._pressed = self._way.pressed()

    def _ask(self) -> None:
        """Ask now and then whether it is alive: what it said last may be old."""
        now = time.monotonic()
        if now - self._asked_at >= ASK_PERIOD:
            self._asked_at = now
            self._way.ask()

    @override
    def read(self, deadline: float) -> Sample | None:
        try:
            self._ask()
            while data := self._way.read():
                self._take(data)
                if time.monotonic() > deadline:
                    break  # more has come: what is pressed now is not known
            else:
                self._read_at = time.monotonic()
        except ConnectionLost:
            self._release()
            raise
        now = time.monotonic()
        if self._is_mouse and now - self._pushed_at > self._config.silence:
            self._axes = {}
        values = {"measured_cv": self._twist()} if self._is_mouse else {}
        return Sample(Stamp.now(), values)

    def _take(self, data: bytes) -> None:
        try:
            found = self._decoder.feed(data)
        except BadData as error:
            self._release()
            raise ConnectionLost(
                f"it sent {error}",
                where=self._way.where,
                remedy="Is it the right device, and the right link?",
            ) from error
        if found:
            self._told_at = time.monotonic()
        for event in found:
            self._happened(event)
        if any(isinstance(event, events.Dropped) for event in found):
            self._look()  # after what was told: the kernel drops the older events that it is asked past

    def _happened(self, event: events.Event | spacenav.Event) -> None:
        self._events += 1
        match event:
            case events.Press() | spacenav.Press():
                change = frozenset((event.code,))
                self._pressed = self._pressed | change if event.pressed else self._pressed - change
            case events.Axis():
                self._axes[event.number] = event.value
            case events.Dropped():
                self._dropped += 1
            case spacenav.Motion():
                self._pushed_at = time.monotonic()
                self._axes = dict(enumerate(map(self._share, event.counts)))
            case spacenav.Mouse():
                self._is_there = event.present
                if not event.present:
                    self._pressed, self._axes = frozenset(), {}

    def _share(self, counts: int) -> float:
        """Return how far it is pushed, -1 to 1, beyond the dead band."""
        share = min(max(counts / self._config.full_scale, -1.0), 1.0)
        dead = self._config.deadband
        beyond = max(abs(share) - dead, 0.0) / (1.0 - dead)
        return beyond if share > 0.0 else 0.0 - beyond

    def _twist(self) -> Twist:
        """Return what a mouse says: of x right, y up, z to the user, made x ahead, y left, z up."""
        x, y, z, a, b, c = (self._axes.get(number, 0.0) for number in range(6))
        speed, turn = self._config.speed, self._config.turn_speed
        return Twist(
            vector((0.0 - speed * z, 0.0 - speed * x, speed * y)),
            vector((0.0 - turn * c, 0.0 - turn * a, turn * b)),
            self._config.frame_id,
        )

    @property
    @override
    def obstacles(self) -> tuple[CrtkError, ...]:
        if self._is_there:
            return ()
        remedy = "Plug it in, and enable again."
        return (DeviceFault(NO_MOUSE, where=self._way.where, remedy=remedy),)

    @property
    @override
    def condition(self) -> Condition:
        if self._is_there:
            return Condition()
        return Condition(OperatingState.FAULT, NO_MOUSE)

    @property
    @override
    def counters(self) -> Mapping[str, float]:
        counted = {"events": self._events, "dropped": self._dropped}
        return counted | ({"mice": int(self._is_there)} if self._is_mouse else {})

    @property
    @override
    def readings(self) -> Mapping[str, Reading]:
        rows = {
            name: Reading(
                "1 while it is pressed", Payload.JOY, partial(self._pedal, code), True, True
            )
            for name, code in self._config.pedals.items()
        }
        summary = "all axes, -1 to 1, and the pedals in the order of their names in the settings"
        return {**rows, "joy": Reading(summary, Payload.JOY, self._joy, True, True)}

    @property
    def _known(self) -> bool:
        now = time.monotonic()
        if self._way.answers and now - self._told_at > ANSWERED:
            return False
        return self._is_there and now - self._read_at <= STALE

    def _pedal(self, code: int) -> Joy:
        known = self._known
        return Joy(buttons=(int(known and code in self._pressed),), is_valid=known)

    def _joy(self) -> Joy:
        known = self._known
        axes = dict(self._axes) if known else {}
        count = 6 if self._is_mouse else max(axes, default=-1) + 1
        return Joy(
            tuple(axes.get(number, 0.0) for number in range(count)),
            tuple(int(known and code in self._pressed) for code in self._config.pedals.values()),
            is_valid=known,
        )

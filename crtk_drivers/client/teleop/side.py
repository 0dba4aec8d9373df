"""One side of a teleoperation: what is heard of it, and how it is sent something without waiting."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable
from typing import Any, Final

from crtk_drivers.client.announcements import is_moot
from crtk_drivers.client.remote import RemoteDevice
from crtk_drivers.errors import CommandRefused, ConfigError, ConnectionLost, Reason
from crtk_drivers.motion.teleop.both_sides import Heard, Side
from crtk_drivers.samples import Value
from crtk_drivers.state import Status

LATE: Final = 1.0
"""Seconds by which a stamp may be behind the last one, and the message is left out: it came late, or twice.
One further behind comes from a clock that was set back."""


class Listened:
    """A device whose newest values are kept, and that takes commands. Thread-safe.

    Args:
        device: connected.
        heard: CRTK names that it must tell.
        also: names that are heard if it tells them.
        sent: CRTK names that it must take.
        held: names that it is sent if it takes them: ``hold``, ``free``.
        woken: called when the first of `heard` came.

    Raises:
        ConfigError: it lacks one that it must have.
        ConnectionFailed: nobody is at the other end of one.
    """

    def __init__(
        self,
        device: RemoteDevice,
        heard: tuple[str, ...],
        also: tuple[str, ...],
        sent: tuple[str, ...],
        held: tuple[str, ...],
        woken: Callable[[], None],
    ) -> None:
        self.namespace = device.namespace
        self._device = device
        self._values: dict[str, tuple[Heard[Any], float]] = {}
        self._refusals: deque[str] = deque(maxlen=1)
        self._lost = ""
        self._anew = time.time_ns()
        self._ends: list[Callable[[], None]] = []
        offered = device.crtk_commands
        missing = [name for name in (*heard, *sent) if name not in offered]
        if missing:
            raise ConfigError(
                f"does not offer {', '.join(missing)}",
                where=device.namespace,
                remedy=f"It offers: {', '.join(offered) or 'nothing'}.",
            )
        self._has_status = "operating_state" in offered
        if self._has_status:
            device.operating_state()
            self._ends.append(device.on_refusal(self._refused))
        self._senders = {name: device.sender(name) for name in (*sent, *_of(held, offered))}
        for name in (*heard, *_of(also, offered)):
            wake = woken if name == heard[0] else nothing
            self._ends.append(device.on(name, self._keeper(name, wake)))

    def _keeper(self, name: str, wake: Callable[[], None]) -> Callable[[Value, float], None]:
        def keep(value: Value, stamp: float) -> None:
            if stamp == 0.0:
                return  # not valid: what was heard before grows old
            last = self._values.get(name)
            if last is not None and 0.0 <= last[1] - stamp < LATE:
                return
            self._values[name] = Heard(value, time.monotonic()), stamp
            wake()

        return keep

    def _refused(self, refusal: CommandRefused) -> None:
        if refusal.command not in self._senders or refusal.reason is Reason.STREAM_ENDED:
            return
        if is_moot(refusal.stamp_ns, self._anew):
            return
        self._refusals.append(refusal.detail)

    def close(self) -> None:
        """Hear nothing more of it."""
        for end in self._ends:
            end()
        self._ends = []

    @property
    def takes(self) -> frozenset[str]:
        """What it can be sent."""
        return frozenset(self._senders)

    def _newest(self, name: str) -> Heard[Any] | None:
        kept = self._values.get(name)
        return None if kept is None else kept[0]

    def read(self, wrench: str = "measured_cf") -> Side:
        """Return what is known of it now; a refusal is told once.

        Args:
            wrench: which of its names is one.
        """
        refusal = self._refusals.popleft() if self._refusals else ""
        lost, self._lost = self._lost, ""
        status, silence = self._state()
        return Side(
            lost or silence,
            status,
            self._newest("measured_cp"),
            self._newest("measured_cv"),
            self._newest(wrench),
            self._newest("setpoint_cp"),
            refusal,
            self._newest("measured_js"),
            self._newest("setpoint_js"),
        )

    def _state(self) -> tuple[Status | None, str]:
        """Return the state, and why it counts as gone; a device that tells no state has neither."""
        if not self._has_status:
            return None, ""
        try:
            return self._device.operating_state(), ""
        except ConnectionLost as error:
            return None, error.message

    def send(self, name: str, value: Value | None = None) -> None:
        """Send it, if it takes that; that nobody listens is told by the next `read`."""
        sender = self._senders.get(name)
        if sender is None:
            return
        if name == "hold":
            self._anew = time.time_ns()
        try:
            sender(value)
        except ConnectionLost as error:
            self._lost = error.message


def _of(names: Iterable[str], offered: Iterable[str]) -> tuple[str, ...]:
    there = set(offered)
    return tuple(name for name in names if name in there)


def nothing() -> None:
    """Nobody waits for it."""

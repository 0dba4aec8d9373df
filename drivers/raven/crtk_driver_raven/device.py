"""Raven II as a CRTK device, and its arms behind it.

Packets go out in each cycle, moving or not. What Raven makes of them does not come back, so that ENABLED says
that the pedal was told to be down, and a stop that packets lead nowhere any more.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Mapping
from typing import Final

from typing_extensions import override

from crtk_driver_raven.arm import STOP, Arm
from crtk_driver_raven.config import RavenConfig
from crtk_driver_raven.packets import FIRST, NOTHING, PRIMING, after, encode
from crtk_drivers.device import (
    Capabilities,
    Device,
    Note,
    Sensor,
    Severity,
    Steps,
)
from crtk_drivers.errors import ConnectionFailed, ConnectionLost, TransitionFailed
from crtk_drivers.kit import UdpTransport, until
from crtk_drivers.kit.address_lock import AddressLock
from crtk_drivers.samples import Sample, Stamp

__all__ = ["RavenDevice"]

ARMS: Final = ("gold", "green")
REFUSAL: Final = 0.05
"""Seconds in which a computer says that nobody listens at a port."""
LATE: Final = 4.0
"""Periods of which a packet makes up the way at most."""
TELLINGS: Final = 5
"""Packets that tell of the pedal before that counts as told: Raven drops two for each one that is lost."""
TOLD: Final = 2.0
"""Seconds in which so many packets go out."""
NUMBERS: Final = 1 << 31
AT_MOST_WAITING: Final = 8192
"""Bytes that may wait in this computer, about 20 packets: what waits for a cable or an address leads the arms
all at once in the end."""
_CHECK: Final = (
    "Does Raven's software run there, and does the port (36000) belong to its network layer?"
)


class RavenDevice(Sensor):
    """Both arms."""

    def __init__(self, config: RavenConfig) -> None:
        self._config = config
        self._link = UdpTransport(
            config.host, config.port, "raven", _CHECK, send_buffer=AT_MOST_WAITING
        )
        self._lock = AddressLock("raven", config.host, config.port)
        self._sending = threading.Lock()
        self._number = FIRST
        self._packets = 0
        self._sent_at = 0.0
        self._told = 0
        """Packets since the pedal was moved last."""
        self.is_lost = True
        """Whether packets cannot be sent; not once it was closed on purpose: then nothing leads the arms."""
        self.engaged = False
        """Whether packets say that the pedal is down."""
        self._arms = {name: Arm(self, name, config) for name in ARMS}
        self._capabilities = Capabilities(
            measured=(),
            rate=float(config.rate),
            base_frame="itp",
            transition_timeout=10.0,
            stop=STOP,
        )

    @property
    @override
    def capabilities(self) -> Capabilities:
        return self._capabilities

    @property
    @override
    def address(self) -> str:
        return f"{self._config.host}:{self._config.port}"

    @property
    @override
    def children(self) -> Mapping[str, Device]:
        return self._arms

    @property
    @override
    def followers(self) -> frozenset[str]:
        return frozenset(self._arms)

    @override
    def open(self, deadline: float) -> None:
        """Begin a series of packets, the pedal up; nobody answers, so all that can be seen is who refuses.

        A second driver on this machine is refused; a console elsewhere cannot be seen.
        """
        self.engaged, self._told = False, 0
        self._lock.take()
        is_open = False
        try:
            self._begin(deadline)
            is_open = True
        finally:
            if not is_open:
                self._lock.release()
        for arm in self._arms.values():
            arm.begin_anew()
        self.is_lost = False

    def _begin(self, deadline: float) -> None:
        self._link.open(deadline)
        # Higher than the last number of a driver that sent 1000 a second until now.
        self._number = max(FIRST, time.time_ns() // 1_000_000 % NUMBERS)
        try:
            self._send()
            self._number = after(self._number, PRIMING - 1)
            self._send()
            self._link.read(min(deadline, time.monotonic() + REFUSAL))
        except ConnectionLost as error:
            self._link.close()
            raise ConnectionFailed(
                "nobody listens there", where=self._link.where, remedy=_CHECK
            ) from error

    @override
    def close(self) -> None:
        if self._link.is_open and self.engaged:
            self._lift_at_once()
        self._link.close()
        self._lock.release()

    @override
    def read(self, deadline: float) -> Sample | None:
        """Send the packet of this cycle; see whether it is refused."""
        try:
            self._send()
            self._link.read(0.0)
        except ConnectionLost:
            self.is_lost = True
            raise
        return Sample(Stamp.now(), {})

    def _send(self) -> None:
        """Send one packet.

        Raises:
            ConnectionLost: the computer is unreachable, or says that nobody listens.
        """
        with self._sending:
            engaged, before = self.engaged, self._sent_at
            self._sent_at = now = time.monotonic()
            since = min(now - before, LATE / self._config.rate)
            arms = [arm.step(since) if engaged else NOTHING for arm in self._arms.values()]
            self._number = after(self._number)
            self._link.write(encode(self._number, arms, engaged=engaged))
            self._packets += 1
            self._told += 1

    @override
    def left(self) -> None:
        """The pedal goes up at once, also while the I/O thread does not get on."""
        self._lift_at_once()

    def _lift_at_once(self) -> None:
        self._move_pedal(down=False)
        with contextlib.suppress(
            ConnectionLost
        ):  # Raven lifts it itself, 5 s after the last packet
            for _ in range(TELLINGS):
                self._send()

    def _move_pedal(self, *, down: bool) -> None:
        with self._sending:
            for arm in self._arms.values():
                arm.pedal_moved()
            self.engaged, self._told = down, 0

    def _tell_pedal(self, *, down: bool) -> Steps:
        self._move_pedal(down=down)
        if not (yield from until(lambda: self._told >= TELLINGS, TOLD)):
            raise TransitionFailed("packets do not go out", where=self._link.where, remedy=_CHECK)

    @override
    def enable(self) -> Steps:
        """Tell that the pedal is down; whether Raven's is does not come back.

        It goes up at once where that is broken off, or fails.
        """
        is_told = False
        try:
            yield from self._tell_pedal(down=True)
            is_told = True
        finally:
            if not is_told:
                self._lift_at_once()

    @override
    def disable(self) -> Steps:
        yield from self._tell_pedal(down=False)

    @override
    def pause(self) -> Steps:
        yield from self._tell_pedal(down=False)

    @property
    @override
    def counters(self) -> Mapping[str, float]:
        return {"packets": self._packets, "number": self._number, "pedal": int(self.engaged)}

    @property
    @override
    def notes(self) -> tuple[Note, ...]:
        text = (
            "nothing comes back: whether it follows, stands or is stopped, and whether another console leads "
            "it as well, only its operator sees"
        )
        return (Note(Severity.WARNING, "one way", text),)

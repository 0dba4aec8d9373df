"""What the device needs of whatever brings measurements: the RDT stream, or the TCP channel."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from crtk_driver_ati_netft.profiles import Action
from crtk_driver_ati_netft.stream import Batch


class Source(Protocol):
    """See `crtk_driver_ati_netft.stream.RdtStream`."""

    @property
    def address(self) -> str:
        """Host and port."""

    @property
    def frozen(self) -> bool:
        """Whether the same measurement comes again and again."""

    @property
    def record_rate(self) -> float:
        """Measurements per second, 0 if unknown."""

    @property
    def counters(self) -> Mapping[str, float]:
        """What happened so far."""

    def open(self, deadline: float) -> None:
        """Connect, and wait for the first measurement."""

    def abort(self) -> None:
        """End an `open` that waits."""

    def close(self) -> None:
        """Disconnect."""

    def receive(self, deadline: float, begin: float = 0.0) -> Batch | None:
        """Return what arrived, or None."""

    def request(self, action: Action) -> None:
        """Ask the sensor for something."""

    def hold(self) -> None:
        """Stop the stream until `resume`."""

    def resume(self) -> None:
        """Go on."""

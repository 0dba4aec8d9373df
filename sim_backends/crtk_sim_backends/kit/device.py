"""What a simulated device is to the process that it lives in."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from crtk_sim_backends.faults import Fault, KindTable


class Device(Protocol):
    """A simulated device: mechanics and memory, without a socket or a clock."""

    @property
    def kinds(self) -> KindTable:
        """Its kinds of fault, beside those of its wire."""

    def begin(self, fault: Fault) -> None:
        """Let a fault of its own begin."""

    def end(self, fault: Fault) -> None:
        """Let it end."""

    def status(self) -> Mapping[str, Any]:
        """What the status of the simulator says about it, ready for JSON."""

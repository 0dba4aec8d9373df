"""TCP ports at which a robot carries out what it is sent: no driver of another device ever writes to one."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

__all__ = ["SCRIPT_PORTS", "script_port"]

SCRIPT_PORTS: Final[Mapping[int, str]] = MappingProxyType(
    {
        30001: "the primary interface",
        30002: "the secondary interface",
        30003: "the real-time interface",
        30020: "interpreter mode",
    }
)
"""Of Universal Robots: each line that comes there is run as URScript."""


def script_port(port: int) -> str:
    """Return why a port is none for a device, in words; empty if it may be one."""
    name = SCRIPT_PORTS.get(port)
    return f"a robot runs what it is sent at port {port} as URScript ({name})" if name else ""

"""What /diagnostics says of devices, as `crtk_drivers.ros.diagnostics` writes it; anybody may write there."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

__all__ = ["Told", "told_of"]


@dataclass(frozen=True, slots=True)
class Told:
    """One status.

    Attributes:
        namespace: of the device; empty for ``/``.
        thing: of it that this is about: ``device``, ``bus``, ``commands``.
        text: in words.
        level: of diagnostic_msgs.
        values: as text, by key.
    """

    namespace: str
    thing: str
    text: str
    level: int
    values: Mapping[str, str]


def told_of(message: Any) -> Iterator[Told]:
    """Yield what a DiagnosticArray says of devices."""
    for status in message.status:
        node, colon, thing = status.name.partition(": ")
        if colon:
            level = status.level[0] if isinstance(status.level, bytes) else int(status.level)
            values = {value.key: value.value for value in status.values}
            yield Told(node.rpartition("/")[0], thing, status.message, level, values)

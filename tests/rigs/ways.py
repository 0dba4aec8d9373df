"""Every driver that is installed, on every way to its simulated device."""

from __future__ import annotations

import typing
from collections.abc import Iterator

from crtk_drivers import plugins
from crtk_drivers.config import from_values, load
from crtk_drivers.session import Session, open_session

KEYS = ("transport", "link", "control")
"""Keys that say over what a driver talks to its device, or by which of its programs."""


def _ways() -> Iterator[tuple[str, str, str]]:
    """Yield name, key and value; without key for a driver that has one way."""
    for name, entry in sorted(plugins.devices().items()):
        if entry.error is not None:
            continue
        fields = plugins.device(name).config.model_fields
        keys = [key for key in KEYS if key in fields]
        choices = [(key, way) for key in keys for way in typing.get_args(fields[key].annotation)]
        yield from ((name, key, way) for key, way in choices or [("", "")])


WAYS = tuple(_ways())


def session_on(name: str, key: str, way: str) -> Session:
    """Return a session with a simulated device, not started; of a device without hardware, that."""
    plugin = plugins.device(name)
    config = load(plugin.config, from_values({key: way} if key else {}))
    return open_session(name, config, sim=plugin.sim is not None)

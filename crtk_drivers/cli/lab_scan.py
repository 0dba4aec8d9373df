"""``crtk-driver lab new --scan``: a lab file of the hardware that answers."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from crtk_drivers import plugins
from crtk_drivers.cli.terminal import ERR
from crtk_drivers.errors import ConfigError, CrtkError, PluginError
from crtk_drivers.plugins import Finder, FoundDevice

__all__ = ["lab_text", "scanned_lab"]

_BARE = re.compile(r"[A-Za-z0-9_-]+")


def scanned_lab(places: tuple[str, ...]) -> str:
    """Look for hardware, tell what answers, and return a lab file of it; empty if nothing does.

    Args:
        places: where to look; where each driver would, if empty.

    Raises:
        ConfigError: a place at which no driver can look.
    """
    finders, blind = _finders()
    for place in places:
        if not any(finder.takes(place) for finder in finders.values()):
            raise ConfigError(
                "is neither a serial port nor a CAN bus",
                where=place,
                remedy="For example: /dev/ttyUSB0, can0, slcan:/dev/ttyACM0, socket://192.168.1.10:54321",
            )
    found: dict[str, list[FoundDevice]] = {}
    for name, finder in finders.items():
        looked = [p for p in places if finder.takes(p)] if places else list(finder.places())
        found[name] = [device for place in looked for device in _looked(name, finder, place)]
        if not looked and not places:
            _say(f"{name}: there is no place to look at")
    _say(f"Cannot be looked for, so enter their addresses: {', '.join(blind)}.")
    return lab_text(found) if any(found.values()) else ""


def _finders() -> tuple[dict[str, Finder], list[str]]:
    """Return who can look, by plugin, and the plugins of hardware that cannot."""
    finders: dict[str, Finder] = {}
    blind: list[str] = []
    for name in plugins.devices():
        try:
            plugin = plugins.device(name)
        except CrtkError as error:
            _say(f"{name}: {error}")
            continue
        if plugin.finder is not None:
            finders[plugin.name] = plugin.finder
        elif plugin.addresses:
            blind.append(plugin.name)
    return finders, blind


def _looked(name: str, finder: Finder, place: str) -> list[FoundDevice]:
    _say(f"{name}: looking at {place} ...")
    try:
        found = _checked(name, finder.look(place))
    except CrtkError as error:
        _say(f"  not possible: {error}")
        return []
    for device in found:
        _say(f"  {device.told}")
    if not found:
        _say("  nobody answers")
    return found


def _checked(name: str, found: Any) -> list[FoundDevice]:
    """Return what a finder found.

    Raises:
        PluginError: that is something else than devices: a mistake in the plugin.
    """
    devices = list(found) if isinstance(found, Iterable) else [found]
    for device in devices:
        if not isinstance(device, FoundDevice):
            raise PluginError(
                f"the finder of {name} returned {type(device).__name__}, "
                "must return FoundDevice objects (crtk_drivers.plugins)"
            )
    return devices


def _say(text: str) -> None:
    ERR.print(text, markup=False, highlight=False, soft_wrap=True)


def lab_text(found: Mapping[str, list[FoundDevice]]) -> str:
    """Return a lab file of what was found, by plugin."""
    lines = [
        "# Found by crtk-driver lab new --scan. What hardware cannot tell, such as limits, is missing:",
        "# `crtk-driver lab check` names it. Settings are those of `crtk-driver schema <plugin>`.",
        "",
        'name = "lab"',
    ]
    for plugin, devices in found.items():
        for number, device in enumerate(devices, 1):
            name = plugin.replace("-", "_") + (f"_{number}" if number > 1 else "")
            told = "".join(filter(str.isprintable, " ".join(device.told.split())))
            lines += ["", f"# {told}", f"[devices.{name}]", f"plugin = {json.dumps(plugin)}"]
            lines += _table(("devices", name, "settings"), device.settings)
    return "\n".join(lines) + "\n"


def _table(path: tuple[str, ...], values: Mapping[str, Any]) -> Iterator[str]:
    """Yield a table of TOML, its own values before the tables in it."""
    yield f"\n[{'.'.join(map(_key, path))}]"
    for key, value in values.items():
        if not isinstance(value, Mapping):
            yield f"{_key(key)} = {json.dumps(value, ensure_ascii=False)}"
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _table((*path, key), value)


def _key(key: str) -> str:
    return key if _BARE.fullmatch(key) else json.dumps(key)

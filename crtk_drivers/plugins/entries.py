"""Entry points, where devices, simulators and pages are found: a stranger's package counts as much as ours.

    [project.entry-points."crtk_drivers.devices"]
    ur = "crtk_driver_ur:PLUGIN"               # a `DevicePlugin`

    [project.entry-points."crtk_drivers.sims"]
    ur = "crtk_sim_backends.ur:SIM"            # a `SimPlugin`

    [project.entry-points."crtk_drivers.pages"]
    web = "crtk_sim_backends.page.device:PAGE"  # a `crtk_drivers.plugins.page_plugin.PagePlugin`

Finding imports nothing, nor does a `description` that is written beside the entry point; a plugin is imported
when it is asked for. One that cannot be loaded, whatever it does, is an entry with an `error` and leaves the
others alone. The environment variable
``CRTK_DRIVERS_ONLY`` (a list with commas) is an allow-list: no other plugin is ever imported.
"""

from __future__ import annotations

import os
import re
import traceback
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from importlib.metadata import Distribution, EntryPoint, PackageNotFoundError, distribution
from importlib.metadata import entry_points as installed_entry_points
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from crtk_drivers.errors import MissingExtra, PluginError
from crtk_drivers.errors.near_names import near_names
from crtk_drivers.plugins.description import Description, description_of

if TYPE_CHECKING:
    from crtk_drivers.commands import Command
    from crtk_drivers.device import Device
    from crtk_drivers.plugins.declared import DevicePlugin
    from crtk_drivers.plugins.page_plugin import PagePlugin
    from crtk_drivers.plugins.sim_plugin import SimPlugin

DEVICES: Final = "crtk_drivers.devices"
SIMS: Final = "crtk_drivers.sims"
PAGES: Final = "crtk_drivers.pages"
PAGE: Final = "web"
"""Name of the page that shows a device."""

FORMER: Final[Mapping[str, str]] = MappingProxyType({"netft": "ati-netft"})
"""Names that simulators had in the release before, and have now."""

ONLY: Final = "CRTK_DRIVERS_ONLY"
"""Environment variable: the names of the plugins that may be loaded, with commas; all if unset."""

OWN_DISTRIBUTION: Final = "crtk-drivers"


@dataclass(frozen=True)
class PluginEntry:
    """One entry point, imported at the first use of `plugin` or `error`."""

    entry_point: EntryPoint
    conflict: str = ""

    @property
    def name(self) -> str:
        """As it is called on the command line."""
        return self.entry_point.name

    @property
    def distribution(self) -> str:
        """Name of the package that brings it, empty if unknown."""
        return self.entry_point.dist.name if self.entry_point.dist else ""

    @property
    def version(self) -> str:
        """Version of the package that brings it."""
        return self.entry_point.dist.version if self.entry_point.dist else ""

    @cached_property
    def _loaded(self) -> tuple[Any, BaseException | None]:
        try:
            if self.conflict:
                raise PluginError(self.conflict, remedy="Uninstall one of them.")
            plugin = self.entry_point.load()
            _CHECKS[self.entry_point.group](plugin, self.name)
        except KeyboardInterrupt:
            raise
        except BaseException as error:
            return None, _as_missing_extra(error, self.entry_point.dist) or error
        return plugin, None

    @property
    def is_loaded(self) -> bool:
        """Whether it was imported by this entry, with success or without."""
        return "_loaded" in vars(self)

    @property
    def error(self) -> BaseException | None:
        """Why it cannot be used; None if it can."""
        return self._loaded[1]

    @property
    def traceback(self) -> str:
        """The error as Python prints it, empty if there is none."""
        error = self.error
        return "".join(traceback.format_exception(error)) if error else ""

    @property
    def plugin(self) -> Any:
        """The `DevicePlugin` or `SimPlugin`.

        Raises:
            MissingExtra: a library of an extra is not installed.
            PluginError: it cannot be loaded.
        """
        plugin, error = self._loaded
        if isinstance(error, MissingExtra):
            raise error
        if error:
            raise PluginError(
                f"the plugin {self.name!r} of {self.distribution or 'an unknown package'} "
                f"cannot be loaded: {type(error).__name__}: {error}",
                remedy=f"`crtk-driver list {self.name}` shows where it fails; "
                "report it to its author.",
            ) from error
        return plugin

    @cached_property
    def _written(self) -> Description | None:
        return None if self.conflict else description_of(self.entry_point)

    @property
    def is_described(self) -> bool:
        """Whether its `description` is written beside its entry point, so that nothing is imported for it."""
        return self._written is not None

    @cached_property
    def description(self) -> Description | None:
        """What is told of it: what is written, else what it says itself; None if it cannot be loaded."""
        if self._written is not None:
            return self._written
        plugin, error = self._loaded
        return None if error else described(plugin)

    @property
    def missing(self) -> MissingExtra | None:
        """What keeps it from running: a library of its extra, imported at once or only when used."""
        if self.description is None:
            return self.error if isinstance(self.error, MissingExtra) else None
        dist, extra = self.entry_point.dist, self.description.extra
        packages = ", ".join(_not_installed(dist, extra)) if dist and extra else ""
        return MissingExtra(packages, extra, dist.name) if dist and packages else None


def devices() -> Mapping[str, PluginEntry]:
    """Return the device plugins by name, none of them imported yet."""
    return _entries(DEVICES)


def sims() -> Mapping[str, PluginEntry]:
    """Return the simulator plugins by name, none of them imported yet."""
    return _entries(SIMS)


def pages() -> Mapping[str, PluginEntry]:
    """Return the pages for the browser by name, none of them imported yet."""
    return _entries(PAGES)


def device(name: str) -> DevicePlugin:
    """Return a device plugin.

    Raises:
        PluginError: there is none of that name (with what was probably meant), or it is broken.
        MissingExtra: a library of an extra is not installed.
    """
    plugin: DevicePlugin = find_entry(devices(), name, "device").plugin
    return plugin


def simulator(name: str) -> SimPlugin:
    """Return a simulator plugin.

    Raises:
        PluginError: there is none of that name (with what was probably meant), or it is broken.
        MissingExtra: a library of an extra is not installed.
    """
    plugin: SimPlugin = find_entry(sims(), FORMER.get(name, name), "simulator").plugin
    return plugin


def page(name: str = PAGE) -> PagePlugin:
    """Return the plugin that shows a device in the browser, or another one: ``view`` shows all devices.

    Raises:
        PluginError: there is none, or it is broken.
        MissingExtra: a library of an extra is not installed.
    """
    plugin: PagePlugin = find_entry(pages(), name, "page").plugin
    return plugin


def find_entry(entries: Mapping[str, PluginEntry], name: str, what: str) -> PluginEntry:
    """Return the entry of a name.

    Raises:
        PluginError: there is no `what` of that name, with what was probably meant.
    """
    if name in entries:
        return entries[name]
    close = near_names(name, entries)
    hint = f"Did you mean {close[0]!r}? " if close else ""
    known = ", ".join(entries) or "none; is the package that brings it installed?"
    allowed = _allowed()
    if allowed is not None and name in allowed:
        allowed = None
    only = f" ({ONLY} allows no others.)" if allowed is not None else ""
    raise PluginError(f"there is no {what} {name!r}", remedy=f"{hint}Installed: {known}.{only}")


def _allowed() -> frozenset[str] | None:
    names = os.environ.get(ONLY, "")
    return frozenset(name.strip() for name in names.split(",")) if names.strip() else None


def _entries(group: str) -> Mapping[str, PluginEntry]:
    """Return the entries by name; of those that share a name, see `_rivals`."""
    allowed = _allowed()
    by_name: dict[str, list[EntryPoint]] = {}
    for entry_point in installed_entry_points(group=group):
        if allowed is None or entry_point.name in allowed:
            by_name.setdefault(entry_point.name, []).append(entry_point)
    entries: dict[str, PluginEntry] = {}
    for name in sorted(by_name):
        entries |= _rivals(name, by_name[name])
    return MappingProxyType(entries)


def _rivals(name: str, points: Sequence[EntryPoint]) -> dict[str, PluginEntry]:
    """Settle who has a name: ours keeps it; of strangers nobody has it, as none has a better claim.

    The losers are listed as ``name@distribution``.
    """
    if len(points) == 1:
        return {name: PluginEntry(points[0])}
    rivals = sorted({(_dist_name(point), point.value): point for point in points}.items())
    if len(rivals) == 1:
        return {name: PluginEntry(rivals[0][1])}
    owners = " and ".join(owner for (owner, _), _ in rivals)
    conflict = f"{owners} both bring a plugin named {name!r}"
    entries = {
        f"{name}@{owner}": PluginEntry(point, conflict)
        for (owner, _), point in rivals
        if owner != OWN_DISTRIBUTION
    }
    own = [point for (owner, _), point in rivals if owner == OWN_DISTRIBUTION]
    first = PluginEntry(own[0]) if own else PluginEntry(rivals[0][1], conflict)
    return {name: first} | entries


def _dist_name(point: EntryPoint) -> str:
    return point.dist.name if point.dist else ""


def _check_device(plugin: Any, name: str) -> None:
    from crtk_drivers.config import DeviceConfig
    from crtk_drivers.plugins.declared import DevicePlugin

    if not isinstance(plugin, DevicePlugin):
        raise TypeError(f"a DevicePlugin is needed, not {type(plugin).__name__}")
    if plugin.name != name:
        raise ValueError(f"it calls itself {plugin.name!r}, but its entry point {name!r}")
    if not (isinstance(plugin.config, type) and issubclass(plugin.config, DeviceConfig)):
        raise TypeError(f"its config is no subclass of DeviceConfig: {plugin.config!r}")


def _check_sim(plugin: Any, name: str) -> None:
    from crtk_drivers.plugins.sim_plugin import SimPlugin

    if not isinstance(plugin, SimPlugin):
        lacks = [
            part for part in ("name", "summary", "Config", "spawn") if not hasattr(plugin, part)
        ]
        raise TypeError(f"it is no simulator: it lacks {', '.join(lacks)}")
    if plugin.name != name:
        raise ValueError(f"it calls itself {plugin.name!r}, but its entry point {name!r}")


def _check_page(plugin: Any, name: str) -> None:
    from crtk_drivers.plugins.page_plugin import PagePlugin

    if not isinstance(plugin, PagePlugin):
        lacks = [part for part in ("name", "summary", "serve") if not hasattr(plugin, part)]
        raise TypeError(f"it is no page: it lacks {', '.join(lacks)}")
    if plugin.name != name:
        raise ValueError(f"it calls itself {plugin.name!r}, but its entry point {name!r}")


_CHECKS: Mapping[str, Callable[[Any, str], None]] = {
    DEVICES: _check_device,
    SIMS: _check_sim,
    PAGES: _check_page,
}


_EXTRA_REQUIREMENT = re.compile(r"^([A-Za-z0-9._-]+).*;.*extra\s*==\s*['\"]([^'\"]+)['\"]")


@lru_cache(maxsize=16)
def _extras(dist: Distribution) -> list[tuple[str, str]]:
    """Return (package, extra) of what the metadata of a distribution lists as optional."""
    matches = map(_EXTRA_REQUIREMENT.match, dist.requires or ())
    return [(match[1], match[2]) for match in matches if match]


def _not_installed(dist: Distribution, extra: str) -> Iterable[str]:
    for package, of_extra in _extras(dist):
        if _normal(of_extra) == _normal(extra):
            try:
                distribution(package)
            except PackageNotFoundError:
                yield package


def _as_missing_extra(error: BaseException, dist: Distribution | None) -> MissingExtra | None:
    """Return the error that names the extra, if a library of an extra is what is missing."""
    if isinstance(error, MissingExtra):
        return error
    if dist is None or not isinstance(error, ModuleNotFoundError) or not error.name:
        return None
    module = _normal(error.name.partition(".")[0])
    for package, extra in _extras(dist):
        if _normal(package) == module:
            return MissingExtra(package, extra, dist.name)
    return None


def _normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def commands_of(name: str) -> Mapping[str, Command]:
    """Return the CRTK commands of a device in its default or typical configuration; none if there is none.

    A plugin that is broken, or whose configuration has required keys, offers none that are known here.
    """
    entry = devices().get(name)
    return MappingProxyType({}) if entry is None or entry.error else _offered(entry.plugin)


def typical_device(plugin: DevicePlugin) -> Device | None:
    """Return a device in its default or typical configuration, not opened.

    None if it cannot be made: its configuration has required keys, or what makes it fails.
    """
    from crtk_drivers.config import from_values, load

    try:
        config: Any = load(plugin.config, from_values(plugin.typical))
        return plugin.make(config)
    except Exception:  # of a stranger's `create`; whoever asks for the device is told
        return None


def _offered(plugin: DevicePlugin) -> Mapping[str, Command]:
    from crtk_drivers.device.offered import offered

    device = typical_device(plugin)
    try:
        return MappingProxyType({}) if device is None else offered(device)
    except Exception:  # of a stranger's device; `crtk-driver list NAME` says it
        return MappingProxyType({})


def described(plugin: Any) -> Description:
    """Return what a plugin, be it a device, a simulator or a page, says of itself."""
    from crtk_drivers.plugins.declared import DevicePlugin

    if not isinstance(plugin, DevicePlugin):
        return Description(plugin.summary)
    return Description(plugin.summary, plugin.extra, plugin.sim or "", " ".join(_offered(plugin)))

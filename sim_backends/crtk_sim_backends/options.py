"""Options of a simulator: a frozen dataclass whose fields tell what they are for.

Each simulator has its own on top of :class:`Options`. Every field has a default, made by
:func:`option`; :mod:`crtk_sim_backends.command_line` makes a command line of them.
"""

from __future__ import annotations

import dataclasses
import ipaddress
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Final, Self

from crtk_sim_backends.faults import unknown
from crtk_sim_backends.process import AUTO

HIGHEST_PORT: Final = 65535


class ConfigError(ValueError):
    """A simulator option with a value that cannot be used."""


def option(default: Any, help_text: str, choices: Collection[str] = ()) -> Any:
    """Make a field; `choices` are offered on the command line."""
    return dataclasses.field(
        default=default, metadata={"help": help_text, "choices": tuple(choices)}
    )


def check_choice(name: str, value: str, choices: Collection[str], what: str = "value") -> None:
    """Refuse what is none of the choices.

    Raises:
        ConfigError: with the choices that come nearest.
    """
    if value not in choices:
        raise ConfigError(f"{name}: {unknown(what, value, choices)}")


def check_range(name: str, value: float, low: float, high: float) -> None:
    """Refuse what does not lie in ``[low, high]``.

    Raises:
        ConfigError: with the range.
    """
    if not low <= value <= high:
        raise ConfigError(f"{name} must lie in [{low:.16g}, {high:.16g}], not {value}")


def check_port(name: str, value: int) -> None:
    """Refuse what is no TCP or UDP port; 0 is any free one.

    Raises:
        ConfigError: with the range.
    """
    check_range(name, value, 0, HIGHEST_PORT)


def check_file(name: str, path: str) -> None:
    """Refuse the path of a file that is not there; an empty path is none.

    Raises:
        ConfigError: with the path.
    """
    if path and not Path(path).is_file():
        raise ConfigError(f"{name}: there is no file {path}")


def _check_loopback(host: str) -> None:
    try:
        address = ipaddress.IPv4Address(host)
    except ValueError as error:
        raise ConfigError(f"host must be {AUTO!r} or an IPv4 address, not {host!r}") from error
    if not address.is_loopback:
        raise ConfigError(
            f"host must be a loopback address (127.x.y.z), not {host}: whoever reaches a simulator "
            "needs no password"
        )


@dataclass(frozen=True, kw_only=True)
class Options:
    """What every simulator can be told.

    ``HEADINGS``, here and in subclasses, groups the options in help pages.

    Raises:
        ConfigError: from the constructor, naming the option and what can be given instead.
    """

    HEADINGS: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "Where and how it runs": ("host", "control_port", "faults", "realtime")
    }

    host: str = option(
        AUTO, "loopback address to listen on; 'auto' finds a free one in 127.0.0.0/8"
    )
    control_port: int = option(
        0, "port of the control socket, which asks for the token of this user; 0: any free one"
    )
    faults: str = option("", "fault file (YAML) to play from the start")
    realtime: bool = option(
        False, "run with real-time priority (SCHED_FIFO) when the system permits it"
    )
    web: bool = option(False, "serve a page for a browser that shows it live")
    web_port: int = option(8000, "port of that page; 0: any free one")

    def __post_init__(self) -> None:
        if self.host != AUTO:
            _check_loopback(self.host)
        check_port("control_port", self.control_port)
        check_port("web_port", self.web_port)
        check_file("faults", self.faults)

    def replace(self, **changes: Any) -> Self:
        """Return these with other values for some.

        Raises:
            ConfigError: for an unknown option (with a suggestion) or a wrong value.
        """
        names = {entry.name for entry in dataclasses.fields(self)}
        for name in changes:
            if name not in names:
                raise ConfigError(unknown("simulator option", name, names))
        return dataclasses.replace(self, **changes)

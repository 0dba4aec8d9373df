"""Configuration of a simulated NetFT sensor box."""

from __future__ import annotations

import dataclasses
import ipaddress
import re
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Final

from crtk_sim_backends.faults import unknown
from crtk_sim_backends.netft.loads import Load, LoadError, parse_load
from crtk_sim_backends.netft.profiles import PRESETS, PROFILES, USUAL_PRESET, Preset, Profile
from crtk_sim_backends.netft.settings import MOST_RECORDS
from crtk_sim_backends.process import AUTO

HTTP_PORT: Final = 80
"""Of a real box; the system may not permit it."""

BIASES: Final = ("continues", "stops")


class ConfigError(ValueError):
    """A simulator option with a value that cannot be used."""


def _option(default: Any, help_text: str, choices: tuple[str, ...] = ()) -> Any:
    return field(default=default, metadata={"help": help_text, "choices": choices})


@dataclass(frozen=True, kw_only=True)
class SimConfig:
    """Options of a simulated sensor box; the `help` of each field says what it is for.

    Raises:
        ConfigError: from the constructor, naming the option and what can be given instead.
    """

    host: str = _option(
        AUTO, "loopback address to listen on; 'auto' finds a free one in 127.0.0.0/8"
    )
    profile: str = _option(
        AUTO, "family of the box; 'auto': the usual one of the preset", (AUTO, *PROFILES)
    )
    preset: str = _option(
        AUTO, "sensor: serial number, calibration, range; 'auto': a usual one", (AUTO, *PRESETS)
    )
    load: str = _option(
        "", "what acts on the sensor, such as 'constant:fz=-20 + sine:axis=2,amplitude=5'"
    )
    rdt_rate: int = _option(
        1000, "records per second; the next fraction of the internal rate above it; 0: all"
    )
    internal_rate: int = _option(
        0, "measurements per second, of those that the family has; 0: the fastest"
    )
    buffer_size: int = _option(10, "records per datagram of the buffered mode")
    bias: str = _option("continues", "what the stream does at a bias request", BIASES)
    serial: str = _option("SIM00001", "serial number of the box")
    ft_sequence: int = _option(0, "number of the first measurement, as after a long time")
    rdt_port: int = _option(49152, "UDP port of the stream; 0: any free one")
    tcp_port: int = _option(49151, "port of the TCP channel; 0: any free one")
    http_port: int = _option(
        HTTP_PORT, "port of the web pages; 0, or when the system does not permit 80: any free one"
    )
    control_port: int = _option(0, "port of the control socket; 0: any free one")
    faults: str = _option("", "fault file (YAML) to play from the start")
    realtime: bool = _option(
        False, "run with real-time priority (SCHED_FIFO) when the system permits it"
    )

    def __post_init__(self) -> None:
        choices = {"profile": (AUTO, *PROFILES), "preset": (AUTO, *PRESETS), "bias": BIASES}
        for name, known in choices.items():
            value = getattr(self, name)
            if value not in known:
                raise ConfigError(f"{name}: {unknown(name, value, known)}")
        if self.host != AUTO:
            _check_loopback(self.host)
        for name in ("rdt_port", "tcp_port", "http_port", "control_port"):
            _check_range(name, getattr(self, name), 0, 65535)
        _check_range("rdt_rate", self.rdt_rate, 0, max(self.family.rates))
        _check_range("buffer_size", self.buffer_size, 1, MOST_RECORDS)
        _check_range("ft_sequence", self.ft_sequence, 0, 2**32 - 1)
        if self.internal_rate and self.internal_rate not in self.family.rates:
            rates = ", ".join(map(str, self.family.rates))
            raise ConfigError(f"internal_rate: {self.family.name} has {rates}")
        if not re.fullmatch(r"[\w. -]{1,32}", self.serial):
            raise ConfigError(f"serial must be 1 to 32 letters and digits, not {self.serial!r}")
        if self.faults and not Path(self.faults).is_file():
            raise ConfigError(f"faults: there is no file {self.faults}")
        try:
            _ = self.acting
        except LoadError as error:
            raise ConfigError(f"load: {error}") from error

    @cached_property
    def acting(self) -> Load:
        """The load, read once: it may come from a large file."""
        return parse_load(self.load)

    @property
    def family(self) -> Profile:
        """The family of the box."""
        if self.profile != AUTO:
            return PROFILES[self.profile]
        return PROFILES["netbox" if self.preset == AUTO else PRESETS[self.preset].profile]

    @property
    def sensor(self) -> Preset:
        """The sensor on it."""
        return PRESETS[USUAL_PRESET[self.family.name] if self.preset == AUTO else self.preset]


def make_config(config: SimConfig | None = None, **options: Any) -> SimConfig:
    """Make a configuration from another one and options that replace its values.

    Raises:
        ConfigError: for an unknown option (with a suggestion) or a wrong value.
    """
    names = {entry.name for entry in dataclasses.fields(SimConfig)}
    for name in options:
        if name not in names:
            raise ConfigError(unknown("simulator option", name, names))
    return dataclasses.replace(config or SimConfig(), **options)


def _check_range(name: str, value: int, low: int, high: int) -> None:
    if not low <= value <= high:
        raise ConfigError(f"{name} must lie in [{low}, {high}], not {value}")


def _check_loopback(host: str) -> None:
    try:
        address = ipaddress.IPv4Address(host)
    except ValueError as error:
        raise ConfigError(f"host must be 'auto' or an IPv4 address, not {host!r}") from error
    if not address.is_loopback:
        raise ConfigError(
            f"host must be a loopback address (127.x.y.z), not {host}: the protocols of the box "
            "have no authentication"
        )

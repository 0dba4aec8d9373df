"""Configuration of a simulated NetFT sensor box."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property
from typing import Final

from typing_extensions import override

from crtk_sim_backends.defects import read_one
from crtk_sim_backends.kit.loads import Load, LoadError, parse_load
from crtk_sim_backends.netft.defects import TransducerDefects
from crtk_sim_backends.netft.profiles import PRESETS, PROFILES, USUAL_PRESET, Preset, Profile
from crtk_sim_backends.netft.settings import MOST_RECORDS
from crtk_sim_backends.options import (
    ConfigError,
    Options,
    check_choice,
    check_port,
    check_range,
    option,
)
from crtk_sim_backends.process import AUTO

HTTP_PORT: Final = 80
"""Of a real box; the system may not permit it."""

BIASES: Final = ("continues", "stops")


@dataclass(frozen=True, kw_only=True)
class SimConfig(Options):
    """Options of a simulated sensor box; the `help` of each field says what it is for.

    Raises:
        ConfigError: from the constructor, naming the option and what can be given instead.
    """

    profile: str = option(
        AUTO, "family of the box; 'auto': the usual one of the preset", (AUTO, *PROFILES)
    )
    preset: str = option(
        AUTO, "sensor: serial number, calibration, range; 'auto': a usual one", (AUTO, *PRESETS)
    )
    load: str = option(
        "", "what acts on the sensor, such as 'constant:fz=-20 + sine:axis=2,amplitude=5'"
    )
    defects: str = option(
        "", "what is wrong with the transducer, such as 'noise=0.05,drift=0.01,bias_left=0.1'"
    )
    rdt_rate: int = option(
        1000, "records per second; the next fraction of the internal rate above it; 0: all"
    )
    internal_rate: int = option(
        0, "measurements per second, of those that the family has; 0: the fastest"
    )
    buffer_size: int = option(10, "records per datagram of the buffered mode")
    bias: str = option("continues", "what the stream does at a bias request", BIASES)
    serial: str = option("SIM00001", "serial number of the box")
    ft_sequence: int = option(0, "number of the first measurement, as after a long time")
    rdt_port: int = option(49152, "UDP port of the stream; 0: any free one")
    tcp_port: int = option(49151, "port of the TCP channel; 0: any free one")
    http_port: int = option(
        HTTP_PORT, "port of the web pages; 0, or when the system does not permit 80: any free one"
    )

    @override
    def __post_init__(self) -> None:
        super().__post_init__()
        choices = {"profile": (AUTO, *PROFILES), "preset": (AUTO, *PRESETS), "bias": BIASES}
        for name, known in choices.items():
            check_choice(name, getattr(self, name), known, name)
        for name in ("rdt_port", "tcp_port", "http_port"):
            check_port(name, getattr(self, name))
        check_range("rdt_rate", self.rdt_rate, 0, max(self.family.rates))
        check_range("buffer_size", self.buffer_size, 1, MOST_RECORDS)
        check_range("ft_sequence", self.ft_sequence, 0, 2**32 - 1)
        if self.internal_rate and self.internal_rate not in self.family.rates:
            rates = ", ".join(map(str, self.family.rates))
            raise ConfigError(f"internal_rate: {self.family.name} has {rates}")
        if not re.fullmatch(r"[\w. -]{1,32}", self.serial):
            raise ConfigError(f"serial must be 1 to 32 letters and digits, not {self.serial!r}")
        try:
            _ = self.acting
        except LoadError as error:
            raise ConfigError(f"load: {error}") from error
        _ = self.wrong

    @cached_property
    def acting(self) -> Load:
        """The load, read once: it may come from a large file."""
        return parse_load(self.load)

    @property
    def wrong(self) -> TransducerDefects | None:
        """What `defects` says."""
        return read_one(TransducerDefects, self.defects) if self.defects.strip() else None

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
